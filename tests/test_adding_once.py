"""Light scattered once, in closed form on Dr.Jit arrays: as in numpy, as on the nodes, and at the extremes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import DOUBLE, Lanes, both_precisions, direction, needs_llvm
from urushi.solvers.adding import phase, single
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.once import Once, attenuation, covers, faded
from urushi.solvers.adding.whole import solution
from urushi.solvers.bound import BoundStack, bind
from urushi.solvers.numbers import gather_numbers

pytestmark = needs_llvm

COSINES = np.array([1.0, 0.7, 0.7 + 1e-7, 0.3, 0.02, 1e-4, 1e-6])


def bound(stack: ur.Stack, double: bool = True) -> BoundStack:
    import drjit.llvm.ad as module

    numbers = gather_numbers(stack, None, module, double, "adding")
    return bind(stack, numbers.values, numbers.fixed)


def fog(depth: Any = 0.5, albedo: Any = 0.9, phase: Any = None) -> ur.Medium:
    return ur.Medium(depth=depth, albedo=albedo, phase=phase or ur.HenyeyGreenstein(g=0.6))


PHASES = [
    (ur.HenyeyGreenstein(g=0.6), phase.HenyeyGreenstein(0.6)),
    (ur.HenyeyGreenstein(g=-0.99), phase.HenyeyGreenstein(-0.99)),
    (ur.Isotropic(), phase.Isotropic()),
    (ur.Rayleigh(), phase.Rayleigh()),
]


@both_precisions
@pytest.mark.parametrize("depth", [1e-6, 0.3, 30.0, 1e3])
@pytest.mark.parametrize(("described", "series"), PHASES, ids=["hg", "backward", "isotropic", "rayleigh"])
def test_as_in_numpy(lanes: Lanes, depth: float, described: Any, series: Any) -> None:
    """Equal cosines and grazing ones, thin slabs and thick ones, a truncated peak or none."""
    albedo = (0.95, 0.5, 1.0)
    stack = bound(ur.Stack(layers=[fog(depth, albedo, described)]), lanes is DOUBLE)
    mu_i, mu_o, phi = (m.ravel() for m in np.meshgrid(COSINES, COSINES, [0.0, 1.0, np.pi]))
    wi, wo = direction(mu_i, np.pi + 0.4), direction(mu_o, phi + 0.4)
    for forward in (0.0, 0.3):
        once = Once(stack, attenuation(stack, {1: forward}))
        truncated = Truncated(np.ones(1), forward, 0.0)
        truth = single.single(series, truncated, np.full(3, depth), np.array(albedo), mu_i, mu_o, phi)
        for up in (1, -1):
            for k, side in zip(truth, (up, -up), strict=True):
                value = np.array(once.eval(lanes.vectors(wi * (1, 1, up)), lanes.vectors(wo * (1, 1, side))))
                tolerance = 1e-9 if lanes is DOUBLE else 2e-4
                assert np.allclose(value, k, rtol=tolerance, atol=tolerance * k.max() + 1e-30)


def test_the_share_that_fades() -> None:
    from drjit.llvm.ad import Float, Float64

    x = np.array([0.0, 1e-30, 1e-12, 1e-9, 1e-4, 0.3, 5.0, 80.0, 1e6])
    truth = np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1), 1)
    assert np.allclose(np.array(faded(Float64(x))), truth, rtol=1e-12)
    assert np.allclose(np.array(faded(Float(x.astype(np.float32)))), truth, rtol=1e-6)


SMOOTH = ur.Dielectric(ior=1.5)
PANE = ur.Stack(layers=[SMOOTH, fog(), ur.Dielectric(ior=1.2)])


@pytest.mark.parametrize(
    ("layers", "covered"),
    [
        ([fog()], "RTTR"),
        ([SMOOTH, fog(), ur.Dielectric(ior=1.0)], "RTTR"),
        ([SMOOTH, fog(), ur.Dielectric(ior=1.0, alpha=0.1)], "R---"),
        ([ur.Dielectric(ior=1.5, alpha=0.1), fog(), ur.Dielectric(ior=1.0)], "---R"),
        ([SMOOTH, fog(), ur.Diffuse(reflectance=0.5)], "R---"),
        ([SMOOTH, fog(albedo=0.0), ur.Dielectric(ior=1.0)], "----"),
        ([fog(), SMOOTH, fog()], "R--R"),
        ([SMOOTH, ur.Dielectric(ior=1.0)], "----"),
        ([SMOOTH], "----"),
        ([ur.Diffuse(reflectance=0.5)], "----"),
    ],
)
def test_what_it_covers(layers: list[Any], covered: str) -> None:
    stack = bound(ur.Stack(layers=layers))
    sides = [(True, True), (True, False), (False, True), (False, False)]
    if stack.opaque:
        sides, covered = sides[:1], covered[:1]
    assert [covers(stack, *side) for side in sides] == [c != "-" for c in covered]


def test_through_glass_as_on_the_nodes() -> None:
    """What the solver takes off on its nodes, order by order, is what is added here: no light is lost or is twice."""
    stack = bound(PANE)
    found = solution(PANE, 1e-6, 32)  # enough for all terms
    once = Once(stack, attenuation(stack, found.forward))
    grid = found.grid
    assert found.forward.get(1, 0.0) < 1e-3
    phi = np.array([0.0, 0.8, 2.5])
    for (from_above, to_above), part in found.parts.items():
        mu_i, mu_o = grid.mu[0 if from_above else -1], grid.mu[0 if to_above else -1]
        weight = grid.weights[0 if to_above else -1]
        total = np.zeros((len(mu_o), len(mu_i), len(phi)))
        for block in part.rest:
            waves = (
                np.cos(np.array(block.orders)[:, None] * phi)
                * np.where(np.array(block.orders) > 0, 2, 1)[:, None]
            )
            total[block.first :, block.first :] += np.einsum("moi,mp->oip", block.values[0], waves)
        total /= 2 * np.pi * weight[:, None, None]
        o, i, p = (x.ravel() for x in np.meshgrid(mu_o, mu_i, phi, indexing="ij"))
        wi, wo = (
            direction(i, np.pi) * (1, 1, 1 if from_above else -1),
            direction(o, p) * (1, 1, 1 if to_above else -1),
        )
        value = np.array(once.eval(DOUBLE.vectors(wi), DOUBLE.vectors(wo)))
        assert np.allclose(value, total.ravel(), atol=2e-4 * value.max())


def test_reciprocity_through_glass() -> None:
    stack = bound(PANE)
    once = Once(stack, {})
    rng = np.random.default_rng(3)
    w, o = direction(rng.uniform(-1, 1, 400), rng.uniform(0, 7, 400)), direction(rng.uniform(-1, 1, 400), 0.0)
    index = np.where(w[:, 2] > 0, 1.0, 1.2), np.where(o[:, 2] > 0, 1.0, 1.2)
    there = np.array(once.eval(DOUBLE.vectors(w), DOUBLE.vectors(o))) / (np.abs(o[:, 2]) * index[1] ** 2)
    back = np.array(once.eval(DOUBLE.vectors(o), DOUBLE.vectors(w))) / (np.abs(w[:, 2]) * index[0] ** 2)
    assert np.allclose(there, back, rtol=1e-9) and there.max() > 0.01


@both_precisions
def test_total_reflection_lets_nothing_in(lanes: Lanes) -> None:
    """From a denser exterior, beyond the critical angle."""
    layers = [ur.Dielectric(ior=1.0), fog(), ur.Dielectric(ior=1.5)]
    once = Once(bound(ur.Stack(exterior=1.5, layers=layers), lanes is DOUBLE), {})
    wi, wo = direction(np.array([0.5, 0.7, 0.8])), direction(np.full(3, 0.9))  # critical at 0.745
    value = np.array(once.eval(lanes.vectors(wi), lanes.vectors(wo)))
    assert (value[:2] == 0).all() and value[2] > 0
