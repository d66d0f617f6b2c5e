"""Paths that begin at either end carry the same light as those that begin at wi, and less noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from urushi.solvers.walk import walk

pytestmark = needs_llvm

SAMPLES = 1 << 15
METAL = ur.Conductor(eta=0.2, k=3.9, alpha=0.2)
COATED = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), METAL])
GOLD = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Conductor(material="Au", alpha=0.3)])
BRUSHED = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.4, alpha=(0.05, 0.2), rotation=30),
        ur.Medium(depth=0.2, albedo=0.0),
        ur.Conductor(
            eta=1.5, k=7, alpha=(0.25, 0.5), rotation=70, distribution="beckmann", masking="separable"
        ),
    ]
)


def cosines() -> tuple[np.ndarray, np.ndarray]:
    """Directions at all angles to each other and to the surface, grazing ones included."""
    cos_i, cos_o = np.array([0.9, 0.5, 0.5, 0.02, 0.9, 0.26]), np.array([0.9, 0.5, 0.9, 0.7, 0.03, 0.87])
    return direction(cos_i, np.full(6, 0.3)), direction(cos_o, 0.3 + np.array([0.1, 0, 1, 2, 4, np.pi]))


@pytest.mark.parametrize(
    ("stack", "options"), [(COATED, {}), (COATED, {"max_depth": 3}), (GOLD, {}), (BRUSHED, {})]
)
def test_either_end_carries_the_same_light(
    stack: ur.Stack, options: dict[str, int], monkeypatch: Any
) -> None:
    wi, wo = cosines()
    value, error = ur.solve(stack, "walk", samples=SAMPLES, **options).eval(wi, wo, with_error=True)
    monkeypatch.setattr(walk, "either_way", lambda _: False)
    plain, plain_error = ur.solve(stack, "walk", samples=SAMPLES, seed=1, **options).eval(
        wi, wo, with_error=True
    )
    assert not np.array_equal(value, plain)
    away = np.abs(value - plain) / np.hypot(error, plain_error)
    assert np.all(away < 4.5), away
    assert np.all(error / value < 0.03)


def test_far_from_the_mirror_direction_noise_is_less(monkeypatch: Any) -> None:
    w = direction(np.cos(np.radians([30, 60])), np.zeros(2))
    _, error = ur.solve(COATED, "walk", samples=SAMPLES).eval(w, w, with_error=True)
    monkeypatch.setattr(walk, "either_way", lambda _: False)
    _, plain = ur.solve(COATED, "walk", samples=SAMPLES).eval(w, w, with_error=True)
    assert np.all(error[:, 0] < [0.87, 0.78] * plain[:, 0])


def test_half_a_pair_swapped_is_the_same_light_by_reciprocity() -> None:
    wi, wo = cosines()
    bsdf = ur.solve(COATED, "walk", samples=SAMPLES)
    (there, error), (back, back_error) = (bsdf.eval(a, b, with_error=True) for a, b in ((wi, wo), (wo, wi)))
    ratio = (wo[:, 2] / wi[:, 2])[:, None]
    assert np.all(np.abs(there - back * ratio) < 4.5 * np.hypot(error, back_error * ratio))
