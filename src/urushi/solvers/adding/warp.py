"""Azimuth at the price of a few terms: cosine series in an angle that is stretched where the lobe is.

A lobe of width d around phi = 0 takes 10 / d terms of a cosine series, and a lobe that is narrow in one place of the
table makes every place pay. With the angle s,

    tan(phi / 2) = d tan(s / 2),    cos s = (d^2 (1 + cos phi) - (1 - cos phi)) / (d^2 (1 + cos phi) + (1 - cos phi)),

the lobe covers all of s: what GGX and Henyey & Greenstein make of phi are powers of 1 / (d^2 + tan^2(phi / 2)), which
are short polynomials in cos s. So each pair of nodes has a d of its own, and all have the same few terms in cos(k s).
d = 1 is the plain series.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .solution import Block

#: the widths that a pair of nodes may have
WIDTHS = 2.0 ** -np.arange(11)
#: numbers of terms to try, in this order
TERMS = (16, 24, 32, 48, 64, 96, 128, 192, 256)


def azimuth(s: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """phi of the stretched angle s, both in [0, pi]."""
    return 2 * np.arctan2(width * np.sin(0.5 * s), np.cos(0.5 * s))


def slope(s: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """dphi / ds."""
    return width / (np.cos(0.5 * s) ** 2 + (width * np.sin(0.5 * s)) ** 2)


def matrix(width: float, orders: np.ndarray, terms: int) -> np.ndarray:
    """(len(orders), terms): cos(m phi) as series in cos(k s), by interpolation in the `terms` Chebyshev points."""
    s = np.pi * (np.arange(terms) + 0.5) / terms
    project = np.cos(s[:, None] * np.arange(terms)) * (2 / terms)
    project[:, 0] *= 0.5
    found: np.ndarray = np.cos(orders[:, None] * azimuth(s, width)) @ project
    return found


def fit(
    blocks: Sequence[Block], shape: tuple[int, int, int], tolerance: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """The same functions of phi as short series.

    Args:
        blocks: cosine series: what each order's cos(m phi) is to be multiplied with.
        shape: (C, n_out, n_in) of the whole.
        tolerance: error allowed, relative to the peak over phi and over all outgoing directions of an incident one.

    Returns:
        series: (n_out, n_in, C, K) coefficients of cos(k s).
        width: (n_out, n_in) d.
        error: the error made, estimated from the last terms and relative as `tolerance` is.
    """
    colours, n_out, n_in = shape
    if not blocks:
        return np.zeros((n_out, n_in, colours, 1)), np.ones((n_out, n_in)), 0.0
    most = max(block.orders.stop for block in blocks)
    if most <= TERMS[0]:
        return _transformed(blocks, shape, 1.0, most, exact=True), np.ones((n_out, n_in)), 0.0
    for terms in TERMS:
        series, width, left = _best(blocks, shape, terms)
        peak = np.abs(series).sum(axis=3).max(axis=(0, 2))  # by incident direction
        error = float((left / np.where(peak > 0, peak, 1)).max())
        if error <= tolerance:
            break
        if terms >= most:
            return _transformed(blocks, shape, 1.0, most, exact=True), np.ones((n_out, n_in)), 0.0
    return series, width, error


def _best(
    blocks: Sequence[Block], shape: tuple[int, int, int], terms: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Series of so many terms, each pair's with the width that leaves the least, and what that leaves (n_out, n_in)."""
    best: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    for d in WIDTHS:
        series = _transformed(blocks, shape, d, terms)
        left = np.abs(series[..., -max(terms // 4, 2) :]).max(axis=(2, 3))
        if best is None:
            best = series, np.full(left.shape, d), left
            continue
        better = left < 0.9 * best[2]  # not for rounding errors
        best[0][better], best[1][better], best[2][better] = series[better], d, left[better]
    assert best is not None
    return best


def _transformed(
    blocks: Sequence[Block], shape: tuple[int, int, int], width: float, terms: int, exact: bool = False
) -> np.ndarray:
    """(n_out, n_in, C, K) with one width for all pairs; `exact` for the plain series with all its terms."""
    colours, n_out, n_in = shape
    found = np.zeros((n_out, n_in, colours, terms))
    for block in blocks:
        orders = np.array(block.orders)
        change = np.eye(terms)[orders] if exact else matrix(width, orders, terms)
        found[block.first :, block.first :] += np.einsum("cmoi,mk->oick", block.values, change, optimize=True)
    return found
