"""Importance sampling of solved stacks: a density known exactly, nearly in proportion to the light."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import urushi as ur
from chi2 import SIGNIFICANCE, p_value
from lanes import direction, needs_llvm
from urushi.checks import chi2, normalisation
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.cells import BINS, hats, squares
from urushi.solvers.adding.result import AddingBSDF
from urushi.solvers.adding.solution import Block, Part, Solution

pytestmark = needs_llvm

FOG = ur.Medium(depth=0.5, albedo=(0.95, 0.6, 0.2), phase=ur.HenyeyGreenstein(g=0.7))
STACKS = {
    "slab": ur.Stack(layers=[FOG]),
    "pane": ur.Stack(layers=[ur.Dielectric(ior=1.33), FOG, ur.Dielectric(ior=1.6)]),
    "wet": ur.Stack(layers=[ur.Dielectric(ior=1.33), FOG, ur.Diffuse(reflectance=0.5)]),
    "coat": ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), ur.Diffuse(reflectance=(0.8, 0.4, 0.1))]),
    "glass": ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2)]),
    "mirror": ur.Stack(layers=[ur.Conductor(material="Au")]),
    "black": ur.Stack(layers=[ur.Diffuse(reflectance=0.0)]),
}


@cache
def solved(name: str, precision: str = "double") -> Any:
    """Few nodes: sampling must be that of the solution, however good it is. Weights in flux, as sampling goes by it."""
    return ur.solve(STACKS[name], "adding", nodes=16, precision=precision, mode="importance")


every = pytest.mark.parametrize("name", STACKS)


def slow(name: str) -> Any:
    return pytest.param(name, marks=pytest.mark.slow)


def numbers(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((n, 3))


def views(name: str) -> np.ndarray:
    found = direction(np.array([1.0, 0.8, 0.3, 0.02]), np.array([0.3, 1.0, 2.0, 4.0]))
    return found if STACKS[name].layers[-1].opaque else np.concatenate([found, found[:3] * (1, 1, -1)])


@pytest.mark.parametrize("name", ["slab", slow("pane"), slow("wet"), "coat", slow("glass")])
def test_the_density_integrates_to_one(name: str) -> None:
    for wi in views(name)[1:5]:
        density, left, delta = normalisation.total(solved(name), wi, 3e-5)
        assert left < 3e-3 and abs(density + delta - 1) < 1e-3, (wi, density, delta, left)


@pytest.mark.parametrize("name", ["slab", slow("pane"), "coat", slow("glass")])
def test_chi2(name: str) -> None:
    report = chi2.check(lambda _: solved(name), True)
    assert report.passed, report.text


@pytest.mark.parametrize("precision", ["double", "single"])
@every
def test_samples_say_the_density_that_pdf_says(name: str, precision: str) -> None:
    bsdf, n = solved(name, precision), 1000
    for wi in views(name):
        sample = bsdf.sample(wi[None], numbers(n, 1))
        assert np.allclose(np.linalg.norm(sample.wo, axis=1), 1, atol=1e-6)
        rough = ~sample.delta & (sample.pdf > 0)
        density = bsdf.pdf(wi[None], sample.wo)
        if precision == "double":
            assert np.allclose(density[rough], sample.pdf[rough], rtol=1e-9)
        else:  # a direction that rounding moves past the horizon of single precision is another
            assert (
                np.mean(np.abs(density[rough] / sample.pdf[rough] - 1) > 1e-3) < 2e-3 if rough.any() else True
            )
        value = bsdf.eval(wi[None], sample.wo)[rough]
        exact = rough if precision == "double" else rough & (np.abs(sample.wo[:, 2]) > 1e-3)
        assert np.allclose(
            (sample.weight * sample.pdf[:, None])[exact], value[exact[rough]], rtol=2e-3, atol=1e-6
        )


@every
def test_the_mean_weight_is_the_energy(name: str) -> None:
    """Samples of all parts together carry what reflectance and transmittance say, but for chance and the nodes."""
    bsdf, n = solved(name), 1 << 14
    error = 3 * bsdf.diagnostics["estimated_error"] + 1e-6
    for wi in views(name):
        sample = bsdf.sample(wi[None], numbers(n, 2))
        for up, energy in ((True, bsdf.reflectance(wi)), (False, bsdf.transmittance(wi))):
            carried = sample.weight * ((sample.wo[:, 2] * wi[2] > 0) == up)[:, None]
            spread = carried.std(axis=0) / np.sqrt(n)
            assert (np.abs(carried.mean(axis=0) - energy) < 4 * spread + error).all(), (wi, up)


def test_delta_parts_come_with_their_probability() -> None:
    bsdf, wi = solved("pane"), direction(0.7, 0.5)
    sample = bsdf.sample(wi[None], numbers(1 << 15, 3))
    for side in (1, -1):
        here = sample.delta & (sample.wo[:, 2] * side > 0)
        assert np.ptp(sample.pdf[here]) < 1e-12 and np.ptp(sample.wo[here], axis=0).max() < 1e-12
        share = float(sample.pdf[here][0])
        counts = np.array([here.sum(), len(here) - here.sum()])
        assert p_value(counts, len(here) * np.array([share, 1 - share])) > SIGNIFICANCE
        assert bsdf.pdf(wi[None], sample.wo[here][:1])[0] < 10  # no peak in the density there


@pytest.mark.parametrize(("name", "limit"), [("slab", 0.06), ("pane", 0.06), ("wet", 0.06), ("coat", 0.25)])
def test_weights_are_nearly_constant(name: str, limit: float) -> None:
    """The standard deviation of the luminance, relative to its mean; a mirror lobe adds what masking takes off it."""
    bsdf = solved(name)
    for wi in views(name)[:3]:
        luminance = bsdf.sample(wi[None], numbers(1 << 13, 4)).weight @ (0.2126, 0.7152, 0.0722)
        assert luminance.std() < limit * luminance.mean(), (wi, luminance.std() / luminance.mean())


@every
def test_the_density_reaches_wherever_there_is_light(name: str) -> None:
    bsdf, rng = solved(name), np.random.default_rng(5)
    wi, wo = (direction(rng.uniform(-1, 1, 4000), rng.uniform(0, 7, 4000)) for _ in range(2))
    edge = direction(np.array([1e-6, -1e-6, 1.0, 1e-3]), 0.2)
    wi, wo = np.concatenate([wi, edge, edge]), np.concatenate([wo, edge, edge[::-1]])
    value, density = bsdf.eval(wi, wo), bsdf.pdf(wi, wo)
    assert np.isfinite(density).all() and (density >= 0).all()
    assert (density[(value > 0).any(axis=1)] > 0).all()
    if STACKS[name].layers[-1].opaque:
        assert (density[(wi[:, 2] <= 0) | (wo[:, 2] <= 0)] == 0).all()


def test_no_light_is_out_of_reach_where_the_nodes_see_none() -> None:
    """Interpolation spreads light past the next node, where no cell holds any: the floor reaches there."""
    grid = Grid.build([1.0, 1.0], 16)
    flux = np.zeros((1, 1, 16, 16))
    flux[0, 0, 8, 8] = 0.5
    part = Part(True, True, None, [Block(range(1), 0, flux)])
    bsdf = AddingBSDF(STACKS["black"], Solution(grid, {(True, True): part}, None, 1, {}))
    mu = np.linspace(0.01, 1, 400)
    wo, wi = direction(mu, 0.5), np.tile(direction(grid.mu[0][8]), (400, 1))
    value, density = bsdf.eval(wi, wo)[:, 0], bsdf.pdf(wi, wo)
    far = np.abs(np.arange(16)[:, None] - 8).ravel() > 1
    assert (value[np.interp(mu, grid.mu[0][::-1], far[::-1].astype(float)) == 1] > 0).any()
    assert (density[value > 0] > 0).all()


def test_all_of_one_side_and_then_all_of_the_other() -> None:
    """The second number runs from the normal above to the horizon, then from the normal below to the horizon."""
    low, high = 0.0, 1.0 - 1e-9
    for _ in range(4):  # closer and closer to where one side ends
        u = np.stack([np.zeros(1000), np.linspace(low, high, 1000), np.full(1000, 0.3)], axis=1)
        z = solved("slab").sample(direction(0.2)[None], u).wo[:, 2]
        (change,) = np.flatnonzero(np.diff(np.sign(z)))
        low, high = u[change, 1], u[change + 1, 1]
    assert 0 < z[change] < 1e-3 and z[change + 1] < -0.9


def test_nothing_to_sample() -> None:
    """A black base, and light from below an opaque one: weight 0 and density 0, nothing undefined."""
    for name, wi in (("black", direction(0.5)), ("wet", direction(-0.5)), ("mirror", direction(-0.5))):
        sample = solved(name).sample(wi[None], numbers(100, 6))
        assert not sample.weight.any() and not sample.pdf.any() and np.isfinite(sample.wo).all()


def test_the_first_and_the_last_numbers() -> None:
    """The corners of the unit cube give directions and finite weights."""
    last = 1 - 2.0**-24
    corners = np.array([[a, b, c] for a in (0, last) for b in (0, last) for c in (0, 0.5, last)])
    for name in ("slab", "coat", "glass"):
        for precision in ("double", "single"):
            for wi in views(name):
                sample = solved(name, precision).sample(wi[None], corners)
                assert np.isfinite(sample.weight).all() and np.isfinite(sample.pdf).all()
                assert np.allclose(np.linalg.norm(sample.wo, axis=1), 1, atol=1e-6)


def test_hats() -> None:
    """They add up to 1 everywhere, so their integrals to that of 1; grazing ones keep their digits."""
    theta = np.array([0.0, 0.1, 0.8, 1.2, 1.57, np.pi / 2 - 1e-10])
    sin, cos = squares(theta)
    areas = hats(sin, cos)
    assert np.isclose(areas.sum(), 1) and (areas > 0).all()
    assert np.isclose(areas[1], (sin[2] - sin[0]) / 2)
    assert np.isclose(areas[-1], 0.5e-20, rtol=1e-5)
    f = 2 + 3 * sin  # linear in the squared sine
    assert np.isclose(areas @ f, 3.5)


def test_cells_hold_the_luminance() -> None:
    """All hats of a row together: the luminance of both energies less the delta parts; nearly, as f is not linear."""
    bsdf = solved("slab")
    cells = bsdf.prepared.cells
    assert cells.mass.shape[2] == BINS + 1 and cells.negative > -1e-3
    wi = np.array([[np.sin(t), 0, np.cos(t)] for t in cells.theta[0]])
    passed = np.exp(-0.5 / wi[:, 2])
    luminance = (bsdf.reflectance(wi) + bsdf.transmittance(wi)) @ (0.2126, 0.7152, 0.0722) - passed
    assert np.allclose(cells.mass.sum(axis=(1, 2))[: len(wi)], luminance, rtol=0.06)
