"""One seed and one rate of false alarms for everything that is decided by chance."""

from __future__ import annotations

import numpy as np
from scipy import special, stats

#: where all random numbers of the checks start; never changed to make a check pass
SEED = 20240731

#: probability that a right BSDF fails any part of one check (Šidák: shared out over its comparisons)
FALSE_ALARM = 1e-5


def significance(comparisons: int) -> float:
    """The probability below which one of so many comparisons fails."""
    return float(-np.expm1(np.log1p(-FALSE_ALARM) / max(comparisons, 1)))


def sigmas(comparisons: int) -> float:
    """How many standard errors one of so many comparisons may be off, on either side."""
    return float(stats.norm.isf(significance(comparisons) / 2))


def chi2_p_value(counts: np.ndarray, expected: np.ndarray) -> float:
    """Pearson's test; bins that expect fewer than five are pooled.

    Both cover all samples. A count where nothing at all is expected gives 0.
    """
    counts, expected = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
    if (counts[expected <= 0] > 0).any() or not np.isfinite(expected).all() or (expected < 0).any():
        return 0.0
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    few = int(np.searchsorted(expected, 5.0))
    if few:
        # A pool that stays small takes the next bin as well.
        few = min(few + int(expected[:few].sum() < 5.0), len(counts))
        counts = np.append(counts[few:], counts[:few].sum())
        expected = np.append(expected[few:], expected[:few].sum())
    counts, expected = counts[expected > 0], expected[expected > 0]
    if len(counts) < 2:
        return 1.0
    statistic = float(np.sum((counts - expected) ** 2 / expected))
    return float(special.gammaincc((len(counts) - 1) / 2, statistic / 2))


def numbers(n: int, stream: int) -> np.ndarray:
    """Points of the unit cube, (n, 3) and below 1: one in each of n slices of every axis (Latin hypercube).

    They spread no wider than independent points would, so a test stays valid and sees more.
    """
    rng = np.random.default_rng((SEED, stream))
    slices = np.stack([rng.permutation(n) for _ in range(3)], axis=1)
    return np.minimum((slices + rng.random((n, 3))) / n, 1 - 2.0**-24)
