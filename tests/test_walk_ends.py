"""Between a coat and a rough metal: the light of the general walk, and less noise."""

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
TURNED = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.6, alpha=(0.04, 0.15), rotation=30),
        ur.Conductor(material="Cu", alpha=(0.2, 0.5), rotation=70),
    ]
)
DENSE_OUTSIDE = ur.Stack(
    exterior=1.6, layers=[ur.Dielectric(ior=1.3, alpha=0.15), ur.Conductor(eta=1.1, k=2, alpha=0.3)]
)


def cosines() -> tuple[np.ndarray, np.ndarray]:
    """Directions at all angles to each other and to the surface, grazing ones included."""
    cos_i, cos_o = np.array([0.9, 0.5, 0.5, 0.02, 0.9, 0.26]), np.array([0.9, 0.5, 0.9, 0.7, 0.03, 0.87])
    return direction(cos_i, np.full(6, 0.3)), direction(cos_o, 0.3 + np.array([0.1, 0, 1, 2, 4, np.pi]))


@pytest.mark.parametrize(
    ("stack", "options"),
    [
        (COATED, {}),
        (COATED, {"max_depth": 3}),
        (COATED, {"max_depth": 4}),
        (GOLD, {}),
        (BRUSHED, {}),
        (TURNED, {}),
        (DENSE_OUTSIDE, {}),
    ],
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


@pytest.mark.parametrize("alpha", [0.0, 0.1], ids=["smooth coat", "rough coat"])
def test_indices_of_their_own_for_every_evaluation(alpha: float, monkeypatch: Any) -> None:
    """Coats that match what is above them, nearly or quite, beside others that are thinner and denser."""
    wi, wo = cosines()
    stack = ur.Stack(exterior=1.2, layers=[ur.Dielectric(ior=1.5, alpha=alpha), METAL])
    options = {
        "samples": SAMPLES,
        "parameters": {"layer_0.ior": np.array([1.1, 1.6, 1.21, 1.2 + 1e-5, 2.5, 1.2])},
    }
    value, error = ur.solve(stack, "walk", **options).eval(wi, wo, with_error=True)
    monkeypatch.setattr(walk, "either_way", lambda _: False)
    plain, plain_error = ur.solve(stack, "walk", seed=1, **options).eval(wi, wo, with_error=True)
    assert not np.array_equal(value, plain)
    assert np.all(np.abs(value - plain) <= 4.5 * np.hypot(error, plain_error) + 1e-5 * plain)
    bare = ur.solve(ur.Stack(exterior=1.2, layers=[METAL]), "walk").eval(wi[5], wo[5])
    assert np.allclose(value[5], bare, rtol=1e-5)


def test_far_from_the_mirror_direction_noise_is_less(monkeypatch: Any) -> None:
    """About 0.61 and 0.6 of it; straight back from normal incidence 0.94."""
    w = direction(np.cos(np.radians([30, 60])), np.zeros(2))
    _, error = ur.solve(COATED, "walk", samples=SAMPLES).eval(w, w, with_error=True)
    monkeypatch.setattr(walk, "either_way", lambda _: False)
    _, plain = ur.solve(COATED, "walk", samples=SAMPLES).eval(w, w, with_error=True)
    assert np.all(error[:, 0] < [0.66, 0.65] * plain[:, 0])


def test_swapped_directions_are_the_same_light_by_reciprocity() -> None:
    wi, wo = cosines()
    bsdf = ur.solve(COATED, "walk", samples=SAMPLES)
    (there, error), (back, back_error) = (bsdf.eval(a, b, with_error=True) for a, b in ((wi, wo), (wo, wi)))
    ratio = (wo[:, 2] / wi[:, 2])[:, None]
    assert np.all(np.abs(there - back * ratio) < 4.5 * np.hypot(error, back_error * ratio))


@pytest.mark.parametrize("stack", [COATED, GOLD, BRUSHED], ids=["coated", "smooth coat", "brushed"])
def test_plain_floats_and_double_precision_agree(stack: ur.Stack) -> None:
    """Plain floats draw the same numbers: a few paths differ where rounding decides; doubles draw others."""
    wi, wo = cosines()
    options: dict[str, Any] = {"samples": 64}
    one, other = (
        ur.solve(stack, "walk", backend=backend, **options).eval(wi, wo) for backend in ("auto", "scalar")
    )
    close = np.isclose(one, other, rtol=1e-3)
    assert close.mean() >= 0.6, (one, other)
    (single, error), (double, double_error) = (
        ur.solve(stack, "walk", samples=SAMPLES, precision=precision).eval(wi, wo, with_error=True)
        for precision in ("single", "double")
    )
    assert np.all(np.abs(single - double) < 4.5 * np.hypot(error, double_error))


def test_what_comes_from_below_is_dark() -> None:
    wi, wo = cosines()
    for a, b in ((-wi, wo), (wi, -wo), (-wi, -wo)):
        for stack in (COATED, BRUSHED):
            assert np.all(ur.solve(stack, "walk", samples=16).eval(a, b) == 0)


def test_nothing_breaks_at_grazing_angles() -> None:
    cos = np.array([1e-7, 1e-6, 1e-4, 1e-2, 0.5, 1.0])
    wi = np.repeat(direction(cos, 0.3), len(cos), axis=0)
    wo = np.tile(direction(cos, 0.3 + np.pi), (len(cos), 1))
    for stack in (COATED, GOLD, BRUSHED, TURNED, DENSE_OUTSIDE):
        found = ur.solve(stack, "walk", samples=256).eval(wi, wo)
        assert np.all(np.isfinite(found)) and np.all(found >= 0)
