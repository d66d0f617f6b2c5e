"""Light scattered once: by integration over the depth, on the nodes, and as the limit of dark media."""

from __future__ import annotations

import numpy as np
import pytest

from urushi.solvers.adding import single
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.media import Scattering, slab
from urushi.solvers.adding.phase import HenyeyGreenstein

COSINES = np.array([1.0, 0.7, 0.7 + 1e-9, 0.3, 0.02, 1e-4])
GRID = Grid.build([1.0], 12)


@pytest.mark.parametrize("depth", [1e-6, 1e-2, 1.0, 30.0, 1e3])
def test_by_integration_over_the_depth(depth: float) -> None:
    """In at t by exp(-t / mu_i) / mu_i dt, out again by exp(-(t or depth - t) / mu_o)."""
    x, w = np.polynomial.legendre.leggauss(24)
    edges = np.unique(
        np.concatenate([depth * 2.0 ** -np.arange(40), depth * (1 - 2.0 ** -np.arange(40)), [0]])
    )
    t = (edges[:-1, None] + np.diff(edges)[:, None] * (1 + x) / 2).ravel()
    weight = (np.diff(edges)[:, None] * w / 2).ravel()
    mu_i, mu_o = (m.ravel() for m in np.meshgrid(COSINES, COSINES))
    # Exponents taken together: either factor alone may underflow where the other does not.
    for found, way_out in ((single.reflected, t), (single.transmitted, depth - t)):
        truth = [weight @ np.exp(-t / i - way_out / o) / i for i, o in zip(mu_i, mu_o, strict=True)]
        value = found(np.array([depth]), mu_i, mu_o)[0]
        assert np.allclose(value, truth, rtol=1e-8, atol=1e-300)


def test_against_the_geometry_of_the_angles() -> None:
    """The phase function sees the true angle between the directions; colours have their own depth and albedo."""
    phase, depth, albedo = HenyeyGreenstein(0.6), np.array([0.5, 2.0]), np.array([0.9, 0.3])
    mu_i, mu_o, phi = np.array([0.4, 1.0, 0.8]), np.array([0.7, 0.5, 0.8]), np.array([2.0, 1.0, 0.0])
    into = np.stack([np.sqrt(1 - mu_i**2), 0 * phi, -mu_i])
    truncated = Truncated.of(phase, 200)
    for sign, k, part in zip(
        (1, -1),
        single.single(phase, truncated, depth, albedo, mu_i, mu_o, phi),
        (single.reflected, single.transmitted),
        strict=True,
    ):
        sin = np.sqrt(1 - mu_o**2)
        out = np.stack([sin * np.cos(phi), sin * np.sin(phi), sign * mu_o])
        cos = np.sum(into * out, axis=0)
        p = (1 - 0.6**2) / (4 * np.pi * (1 + 0.6**2 - 2 * 0.6 * cos) ** 1.5)
        assert np.allclose(k, albedo[:, None] * p * part(depth, mu_i, mu_o), rtol=1e-10, atol=1e-14)


def test_reciprocity() -> None:
    mu_i, mu_o = (m.ravel() for m in np.meshgrid(COSINES, COSINES))
    for part in (single.reflected, single.transmitted):
        one, other = part(np.array([0.7]), mu_i, mu_o), part(np.array([0.7]), mu_o, mu_i)
        assert np.allclose(one * mu_i, other * mu_o, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("g", [0.5, -0.95])
def test_the_limit_of_dark_media(g: float) -> None:
    """What little albedo there is scatters once, on the nodes as in the formula; a delta-M peak included."""
    mu, weights = GRID.mu[0], GRID.weights[0]
    truncated = Truncated.fit(HenyeyGreenstein(g), mu, weights)
    orders = range(len(truncated.moments))
    scattering = Scattering.build(mu, weights, truncated.moments, orders, truncated.backward)
    depth, albedo = np.array([1e-3, 0.8, 40.0]), np.full(3, 1e-5)
    found = slab(scattering, depth, albedo)
    for part, once in zip(found[:2], single.operators(scattering, depth, albedo), strict=True):
        assert np.max(np.abs(part.dense - once)) < 3e-5 * 1e-5


def test_the_series_on_the_nodes_is_the_phase_function() -> None:
    """Azimuths put together again, the operator between nodes is w_o times the formula."""
    phase, grid = HenyeyGreenstein(0.3), Grid.build([1.0], 40)
    mu, weights = grid.mu[0], grid.weights[0]
    truncated = Truncated.fit(phase, mu, weights)
    m = np.arange(len(truncated.moments))
    scattering = Scattering.build(mu, weights, truncated.moments, range(len(m)), truncated.backward)
    for phi in (0.0, 1.0, np.pi):
        exact = single.single(
            phase,
            truncated,
            np.ones(1),
            np.ones(1),
            mu[None, :].repeat(40, 0),
            mu[:, None].repeat(40, 1),
            np.full((40, 40), phi),
        )
        series = (2 - (m == 0)) * np.cos(m * phi) / (2 * np.pi)
        for part, truth in zip(single.operators(scattering, np.ones(1), np.ones(1)), exact, strict=True):
            found = np.tensordot(series, part[0], (0, 0)) / weights[:, None]
            assert np.allclose(found, np.reshape(truth, (40, 40)), atol=1e-8)


def test_a_truncated_peak_leaves_the_light_scattered_once_whole() -> None:
    """Beside the peak, what is scattered once is the same however the series is cut, in the limit of thin slabs."""
    phase, depth, albedo = HenyeyGreenstein(0.9), np.array([1e-4]), np.array([0.7])
    angles = np.array([0.5, 0.9]), np.array([0.8, 0.2]), np.array([1.0, 2.0])
    few, many = (single.single(phase, Truncated.of(phase, n), depth, albedo, *angles) for n in (8, 300))
    for one, other in zip(few, many, strict=True):
        assert np.allclose(one, other, rtol=1e-3, atol=1e-14)
