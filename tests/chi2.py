"""Pearson's test of samples against a density, and the one false-alarm rate of all statistical tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

from quadrature import gauss

SIGNIFICANCE = 1e-6
"""What a statistical test calls impossible; ten thousand of them raise a false alarm once in a hundred seeds."""


def p_value(counts: np.ndarray, expected: np.ndarray) -> float:
    """Probability of counts at least as far from `expected` as these; cells that expect few are pooled.

    Both cover all samples, those that fell nowhere included.
    """
    counts, expected = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
    assert np.isclose(counts.sum(), expected.sum(), rtol=2e-3), (counts.sum(), expected.sum())
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    # The smallest cells join until they expect 5 together; a pool that stays smaller joins the next cell.
    few = int(np.searchsorted(expected, 5.0))
    if few:
        few += int(expected[:few].sum() < 5.0)
        counts = np.append(counts[few:], counts[:few].sum())
        expected = np.append(expected[few:], expected[:few].sum())
    if len(counts) == 1:
        return 1.0
    statistic = float(np.sum((counts - expected) ** 2 / expected))
    return float(stats.chi2.sf(statistic, len(counts) - 1))


def rectangles(
    density: Callable[[np.ndarray, np.ndarray], np.ndarray],
    x: tuple[float, float, int],
    y: tuple[float, float, int],
    finer: int = 8,
) -> np.ndarray:
    """Integrals of a density over the cells of a grid, each by Gauss's rule on `finer` squared points.

    Args:
        density: of two arrays.
        x, y: (low, high, number of cells).
    """
    nodes, weights = gauss(finer, 0, 1)
    axes = []
    for low, high, n in (x, y):
        step = (high - low) / n
        axes.append(((low + step * (np.arange(n)[:, None] + nodes)).ravel(), np.tile(weights * step, n)))
    values = density(*(grid.ravel() for grid in np.meshgrid(axes[0][0], axes[1][0], indexing="ij")))
    values = values * np.outer(axes[0][1], axes[1][1]).ravel()
    return values.reshape(x[2], finer, y[2], finer).sum(axis=(1, 3))


def counted(
    first: np.ndarray, second: np.ndarray, x: tuple[float, float, int], y: tuple[float, float, int]
) -> np.ndarray:
    """How many points fall into each cell of the same grid."""
    return np.histogram2d(first, second, bins=(x[2], y[2]), range=(x[:2], y[:2]))[0]


def strata(rng: np.random.Generator, side: int) -> np.ndarray:
    """`side` squared points of the unit square, one in each of as many equal squares, (N, 2), below 1.

    What they are mapped to spreads no more than independent points would, so the tests stay valid and see more.
    """
    corners = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), axis=-1).reshape(-1, 2)
    return np.minimum((corners + rng.random(corners.shape)) / side, 1 - 2.0**-24)


def mean_p_value(samples: np.ndarray, truth: float) -> float:
    """Probability of a mean at least as far from `truth`, by the central limit theorem."""
    error = float(np.std(samples)) / np.sqrt(len(samples))
    distance = abs(float(np.mean(samples)) - truth)
    if error == 0:
        return 1.0 if distance <= 1e-6 * max(1.0, abs(truth)) else 0.0
    return float(2 * stats.norm.sf(distance / error))
