"""Solutions between the nodes: the stencils, the table they weigh, and what both are worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanes import DOUBLE, SINGLE, Lanes, both_precisions, direction, needs_llvm
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.solution import Block, Part, Solution
from urushi.solvers.adding.stencil import Stencils, away_and_toward
from urushi.solvers.adding.table import Series, Table

pytestmark = needs_llvm


def module() -> Any:
    import drjit.llvm.ad

    return drjit.llvm.ad


# ------------------------------------------------------------------------------------------------- stencils


@both_precisions
@pytest.mark.parametrize("order", [2, 6, 8])
@pytest.mark.parametrize(
    ("indices", "squeeze"), [((1.0, 1.5), 1.0), ((1.5, 1.2, 1.0), 0.4), ((1.33, 1.33), 1.0)]
)
def test_stencils_are_those_of_the_grid(
    lanes: Lanes, order: int, indices: tuple[float, ...], squeeze: float
) -> None:
    """The same nodes and weights as `Grid.stencil`, on both sides, in every panel and near both ends."""
    grid = Grid.build(indices, 10, squeeze)
    stencils = Stencils(grid, (0, -1), order, module(), lanes is DOUBLE)
    cos = np.concatenate([np.linspace(1e-3, 1, 200), [1e-6, 1 - 1e-9], grid.mu[0], grid.mu[-1]])
    for side, region in ((1, 0), (-1, len(indices) - 1)):
        w = direction(cos, 0.7)
        w[:, 2] *= side
        place = stencils.place(lanes.vectors(w))
        truth = grid.stencil(region, np.clip(lanes.rounded(cos), 0, 1), order)
        n = grid.count(region)
        for odd in (False, True):
            values = np.sin(3 * grid.s[:n]) if odd else np.cos(3 * grid.s[:n] ** 2)
            found = np.zeros(len(cos))
            for k in range(order):
                node, flip = stencils.entry(place, k)
                sign = np.where(np.array(flip) == 1, -1.0 if odd else 1.0, 1.0)
                found += np.array(stencils.weight(place, k)) * sign * values[np.array(node).astype(int)]
            weight = truth.odd if odd else truth.even
            expected = (weight * values[truth.node]).sum(axis=1)
            # In single precision a point may fall into the next interval, or the next panel, and be as well off there.
            assert np.allclose(found, expected, atol=1e-11 if lanes is DOUBLE else 2e-3)
            assert np.mean(np.abs(found - expected)) < (1e-12 if lanes is DOUBLE else 1e-5)


@both_precisions
def test_the_azimuth_keeps_its_digits(lanes: Lanes) -> None:
    """1 - cos phi of two directions 1e-3 apart in azimuth is good to single precision of 1e-3, not of 1."""
    phi = np.array([1e-3, 0.5, np.pi - 1e-3, np.pi])
    wi, wo = lanes.vectors(direction(0.6, np.full(4, np.pi + 0.3))), lanes.vectors(direction(0.2, phi + 0.3))
    away, toward = (np.array(x) for x in away_and_toward(wi, wo))
    tolerance = 1e-9 if lanes is DOUBLE else 1e-6
    assert np.allclose(np.sqrt(away), np.sqrt(2) * np.sin(phi / 2), atol=tolerance)
    assert np.allclose(np.sqrt(toward), np.sqrt(2) * np.cos(phi / 2), atol=tolerance)


# ------------------------------------------------------------------------------------------------- tables


def solution(
    kernel: Any, n: int, orders: int, indices: tuple[float, float] = (1.0, 1.0), opaque: bool = True
) -> Solution:
    """Operators of known kernels: kernel(mu_o, mu_i, phi) -> (C, ...) flux density, the same from and to all sides."""
    grid = Grid.build(indices, n)
    phi = np.pi * (np.arange(2 * orders) + 0.5) / (2 * orders)
    sides = [(True, True)] if opaque else [(a, b) for a in (True, False) for b in (True, False)]
    parts = {}
    for side in sides:
        i, o = (0 if above else -1 for above in side)
        k = kernel(grid.mu[o][:, None, None], grid.mu[i][:, None], phi)
        a = np.einsum("coip,pm->cmoi", k, np.cos(phi[:, None] * np.arange(orders))) * (np.pi / orders)
        a *= grid.weights[o][:, None]
        parts[side] = Part(*side, None, [Block(range(orders), 0, a)])
    return Solution(grid, parts, None, k.shape[0], {})


def table(found: Solution, order: int = 6, lanes: Lanes = DOUBLE) -> Table:
    regions = (0,) if (True, False) not in found.parts else (0, -1)
    stencils = Stencils(found.grid, regions, order, module(), lanes is DOUBLE)
    return Table(found, Series(found), stencils, module(), lanes is DOUBLE)


def scattering(g: float) -> Any:
    """The light a thin, dark slab would scatter once: not smooth where both directions graze."""

    def kernel(mu_o: Any, mu_i: Any, phi: Any) -> np.ndarray:
        cos = np.sqrt((1 - mu_o**2) * (1 - mu_i**2)) * np.cos(phi) - mu_o * mu_i
        p = (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cos) ** 1.5)
        value: np.ndarray = np.stack([p, 0.5 * p]) * (mu_o / (mu_o + mu_i))
        return value

    return kernel


MU = np.array([1.0, 0.999, 0.7, 0.31, 0.05, 1e-3, 1e-6])


@both_precisions
@pytest.mark.parametrize("opaque", [True, False])
def test_a_known_kernel(lanes: Lanes, opaque: bool) -> None:
    """Everywhere, at normal incidence and as both directions graze, too."""
    kernel = scattering(0.5)
    found = table(solution(kernel, 20, 40, (1.0, 1.0), opaque), 6, lanes)
    mu_i, mu_o, phi = (m.ravel() for m in np.meshgrid(MU, MU, [0, 0.4, 2.0, np.pi]))
    wi, wo = direction(mu_i, 0.9 + np.pi), direction(mu_o, 0.9 + phi)
    truth = kernel(mu_o, mu_i, phi)
    for side_i in (1, -1):
        for side_o in (1, -1):
            value = found.eval(lanes.vectors(wi * (1, 1, side_i)), lanes.vectors(wo * (1, 1, side_o)))
            there = not opaque or (side_i == side_o == 1)
            for c in range(2):
                assert np.allclose(np.array(value[c]), truth[c] * there, atol=1e-5, rtol=1e-3)


def test_what_the_order_of_interpolation_is_worth() -> None:
    kernel = scattering(0.6)
    rng = np.random.default_rng(3)
    mu_i, mu_o, phi = rng.uniform(0.02, 1, 2000), rng.uniform(0.02, 1, 2000), rng.uniform(0, np.pi, 2000)
    wi, wo = DOUBLE.vectors(direction(mu_i, np.pi)), DOUBLE.vectors(direction(mu_o, phi))
    truth, operators = kernel(mu_o, mu_i, phi)[0], solution(kernel, 24, 60)
    error = [np.abs(np.array(table(operators, p).eval(wi, wo)[0]) - truth).max() for p in (2, 4, 6, 8)]
    assert error[0] < 2e-2 and error[1] < 1e-3 and error[2] < 1e-4 and error[3] < 2e-5
    assert error == sorted(error, reverse=True)


@pytest.mark.parametrize(("alpha", "nodes"), [(0.3, 28), (0.15, 56)])
def test_a_rough_lobe(alpha: float, nodes: int) -> None:
    """1e-3 of the peak, with nodes a fifth of alpha apart."""

    def kernel(mu_o: Any, mu_i: Any, phi: Any) -> np.ndarray:
        sin_i, sin_o = np.sqrt(1 - mu_i**2), np.sqrt(1 - mu_o**2)
        x, y, z = (
            sin_o * np.cos(phi) - sin_i,
            sin_o * np.sin(phi),
            mu_i + mu_o,
        )  # light goes straight on at phi = 0
        slope = (x**2 + y**2) / z**2
        density = 1 / (np.pi * alpha**2 * (1 + slope / alpha**2) ** 2)
        value: np.ndarray = (density * mu_o / (1 + 3 * mu_i * mu_o))[None]
        return value

    operators = solution(kernel, nodes, 400)
    series = Series(operators)
    assert series.terms <= 48
    rng = np.random.default_rng(4)
    for mu_i in (1.0, 0.8, 0.5, 0.3):
        theta = np.clip(np.arccos(mu_i) + alpha * rng.normal(size=4000), 0, 1.5)
        mu_o, phi = np.cos(theta), np.clip(np.abs(alpha * rng.normal(size=4000)), 0, np.pi)
        wi = DOUBLE.vectors(direction(np.full(4000, mu_i), np.pi))
        truth = kernel(mu_o, mu_i, phi)[0]
        value = np.array(table(operators).eval(wi, DOUBLE.vectors(direction(mu_o, phi)))[0])
        assert np.abs(value / mu_o - truth / mu_o).max() < 1e-3 * (truth / mu_o).max()


def test_nothing_is_negative() -> None:
    """A lobe that the nodes are too far apart for rings below 0: the sum is raised, and nothing else changes."""

    def kernel(mu_o: Any, mu_i: Any, phi: Any) -> np.ndarray:
        value: np.ndarray = (np.exp(-(((mu_o - mu_i) / 0.02) ** 2)) * (1 + 0 * phi))[None]
        return value

    rng = np.random.default_rng(5)
    wi, wo = (DOUBLE.vectors(direction(rng.uniform(0, 1, 5000), rng.uniform(0, 7, 5000))) for _ in range(2))
    value = np.array(table(solution(kernel, 12, 4)).eval(wi, wo)[0])
    assert value.min() == 0 and np.mean(value == 0) > 0.05


def test_reciprocity_between_different_indices() -> None:
    """A symmetric q is stored, so what is interpolated is symmetric: f goes with the squared index of its side."""
    kernel = scattering(0.3)
    operators = solution(lambda o, i, p: kernel(o, i, p), 12, 16, (1.0, 1.5), opaque=False)
    above, below = operators.parts[True, False], operators.parts[False, True]
    grid = operators.grid
    # Make upward transmission the reverse of downward transmission, as physics does.
    for down, up in zip(above.blocks, below.blocks, strict=True):
        w = [grid.etendue[: grid.count(r)] for r in (0, 1)]
        up.values[:] = np.swapaxes(down.values, 2, 3) * (w[0][:, None] / w[1])
    found = table(operators)
    rng = np.random.default_rng(6)
    w, o = direction(rng.uniform(0, 1, 500), rng.uniform(0, 7, 500)), direction(rng.uniform(0, 1, 500), 0.0)
    low = o * (1, 1, -1)
    there = np.array(found.eval(DOUBLE.vectors(w), DOUBLE.vectors(low))[0]) / (np.abs(low[:, 2]) * 1.5**2)
    back = np.array(found.eval(DOUBLE.vectors(low), DOUBLE.vectors(w))[0]) / w[:, 2]
    assert np.allclose(there, back, rtol=1e-9, atol=1e-12) and there.max() > 0.01


def test_single_precision_near_the_mirror_direction() -> None:
    """A narrow lobe in single precision: azimuths and angles keep the digits that it needs."""

    def kernel(mu_o: Any, mu_i: Any, phi: Any) -> np.ndarray:
        away = (np.arccos(mu_o) - np.arccos(mu_i)) ** 2 + (2 * np.sin(phi / 2) * np.sqrt(1 - mu_i**2)) ** 2
        value: np.ndarray = (mu_o / (1 + away / 0.2**2) ** 2)[None]
        return value

    operators = solution(kernel, 24, 100)
    angle = np.linspace(-1e-3, 1e-3, 41)
    wi, wo = direction(np.full(41, 0.8), np.pi), direction(np.full(41, 0.8), angle)
    one = np.array(table(operators, 6, DOUBLE).eval(DOUBLE.vectors(wi), DOUBLE.vectors(wo))[0])
    other = np.array(table(operators, 6, SINGLE).eval(SINGLE.vectors(wi), SINGLE.vectors(wo))[0])
    assert np.allclose(one, other, rtol=1e-5)
