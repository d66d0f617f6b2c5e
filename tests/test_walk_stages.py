"""Paths run in stages are the same paths, to the last bit; and run in stages only where that can be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from urushi.solvers.walk import stages

pytestmark = needs_llvm

LANES = 3000
FOG = ur.Medium(depth=0.8, albedo=(0.9, 0.7, 0.5), phase=ur.HenyeyGreenstein(g=0.5))
SHARP = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(eta=0.2, k=3.9, alpha=0.05)])
BROAD = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(material="Au", alpha=0.2)])
ENAMEL = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), FOG, ur.Conductor(material="Au", alpha=0.3)])
PANES = ur.Stack(
    layers=[ur.Dielectric(ior=1.5, alpha=0.2), FOG, ur.Dielectric(ior=1.3), ur.Dielectric(ior=1.6, alpha=0.4)]
)


@pytest.fixture
def packed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Few lanes are many, and the list of how many paths each packing left."""
    left: list[int] = []
    pack = stages._pack

    def noted(*args: Any) -> Any:
        found = pack(*args)
        left.append(int(found[0].sum()))
        return found

    monkeypatch.setattr(stages, "_pack", noted)
    monkeypatch.setattr(stages, "MANY", 32)
    monkeypatch.setattr(stages, "SEGMENT", 256)
    yield left


def pairs(rng: np.random.Generator, opaque: bool) -> tuple[np.ndarray, np.ndarray]:
    low = 0 if opaque else -1
    return tuple(direction(rng.uniform(low, 1, LANES), rng.uniform(0, 7, LANES)) for _ in range(2))


@pytest.mark.parametrize(
    ("stack", "options"),
    [
        (SHARP, {}),
        (SHARP, {"max_depth": 3}),
        (BROAD, {}),
        (BROAD, {"max_depth": 3}),
        (ENAMEL, {}),
        (PANES, {}),
    ],
)
def test_stages_change_no_bit(
    stack: ur.Stack, options: dict[str, int], packed: list[int], rng: np.random.Generator, monkeypatch: Any
) -> None:
    wi, wo = pairs(rng, stack is not PANES)
    bsdf = ur.solve(stack, "walk", samples=1, **options)
    staged = bsdf.eval(wi, wo)
    if not options:
        assert len(packed) > 1 and packed[0] > packed[-1] > 0
    monkeypatch.setattr(stages, "MANY", 1 << 30)
    count = len(packed)
    assert np.array_equal(staged, bsdf.eval(wi, wo))
    assert len(packed) == count
    assert np.count_nonzero(staged) > LANES / 4


def test_numbers_that_differ_from_lane_to_lane_are_not_packed(
    packed: list[int], rng: np.random.Generator
) -> None:
    wi, wo = pairs(rng, True)
    alphas = {"layer_1.alpha": rng.uniform(0.05, 0.5, LANES)}
    bsdf = ur.solve(SHARP, "walk", samples=1, parameters=alphas)
    value = bsdf.eval(wi, wo)
    assert packed == []
    last = slice(LANES - 1, LANES)
    alone = ur.solve(SHARP, "walk", samples=1, parameters={"layer_1.alpha": alphas["layer_1.alpha"][last]})
    assert np.allclose(alone.eval(wi[last], wo[last]), value[last], rtol=1e-5)


def test_where_nothing_can_be_launched_no_stages(
    packed: list[int], rng: np.random.Generator, mi: Any
) -> None:
    bsdf = ur.solve(SHARP, "walk", samples=1)
    wi, wo = (mi.Vector3f(np.ascontiguousarray(w.T)) for w in pairs(rng, True))

    def doubled(wi: Any, wo: Any) -> Any:
        _, total = dr.while_loop(
            (mi.UInt(0), mi.Vector3f(0)),
            lambda i, _: i < 2,
            lambda i, total: (i + 1, total + bsdf.eval(wi, wo)),
        )
        return total

    looped = np.array(doubled(wi, wo))
    with dr.scoped_set_flag(dr.JitFlag.FreezingScope, True):
        assert not stages.may_stage(wi, wo)
    assert packed == []
    value = np.array(bsdf.eval(wi, wo))
    assert len(packed) > 1
    assert np.array_equal(looped, 2 * value)


def test_derivatives_are_not_lost(packed: list[int], rng: np.random.Generator, mi: Any) -> None:
    bsdf = ur.solve(SHARP, "walk", samples=1)
    wi, wo = (mi.Vector3f(np.ascontiguousarray(w.T)) for w in pairs(rng, True))
    dr.enable_grad(wo)
    assert dr.grad_enabled(bsdf.eval(wi, wo))
    assert packed == []
