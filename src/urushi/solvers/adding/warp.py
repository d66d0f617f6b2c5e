"""Azimuth at the price of a few terms: cosine series in an angle that is stretched where the lobe is.

A lobe of width d around phi = 0 takes 10 / d terms of a cosine series, and a lobe that is narrow in one place of the
table makes every place pay. With the angle s,

    tan(phi / 2) = d tan(s / 2),    cos s = (d^2 (1 + cos phi) - (1 - cos phi)) / (d^2 (1 + cos phi) + (1 - cos phi)),

the lobe covers all of s: what GGX and Henyey & Greenstein make of phi are powers of 1 / (d^2 + tan^2(phi / 2)), which
are short polynomials in cos s. So each pair of nodes has a d of its own, and all have the same few terms in cos(k s).
d = 1 is the plain series. See theory (basis.17).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from .solution import Block

#: the widths that a pair of nodes may have
WIDTHS = 2.0 ** -np.arange(11)
#: terms by which the widths are chosen, and the most that there can be
PROBE, MOST = 32, 256
#: azimuths at which the terms tried must agree with the plain series
BETWEEN = np.array([0.02, 0.07, 0.2, 0.5, 1.0, 1.6, 2.2, 2.7, np.pi])
#: orders of a plain series that need no stretching
FEW = 16


def azimuth(s: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """phi of the stretched angle s, both in [0, pi]."""
    return 2 * np.arctan2(width * np.sin(0.5 * s), np.cos(0.5 * s))


def slope(s: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """dphi / ds."""
    return width / (np.cos(0.5 * s) ** 2 + (width * np.sin(0.5 * s)) ** 2)


@lru_cache(maxsize=64)
def matrix(width: float, orders: range, terms: int) -> np.ndarray:
    """(len(orders), terms): cos(m phi) as series in cos(k s), by interpolation in the `terms` Chebyshev points."""
    s = np.pi * (np.arange(terms) + 0.5) / terms
    project = np.cos(s[:, None] * np.arange(terms)) * (2 / terms)
    project[:, 0] *= 0.5
    found: np.ndarray = np.cos(np.array(orders)[:, None] * azimuth(s, width)) @ project
    return found


def fit(
    blocks: Sequence[Block], shape: tuple[int, int, int], tolerance: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """The same functions of phi as short series.

    Args:
        blocks: cosine series: what each order's cos(m phi) is to be multiplied with.
        shape: (C, n_out, n_in) of the whole.
        tolerance: error allowed, relative to the peak over phi and over all outgoing directions of an incident one. No
            series is asked to be better than the one it is made from, whose last eighth says how good that is; nor
            are there more terms for what twice as many hardly make better, which is noise.

    Returns:
        series: (n_out, n_in, C, K) coefficients of cos(k s).
        width: (n_out, n_in) d.
        error: the largest error made, relative as `tolerance` is.
    """
    colours, n_out, n_in = shape
    if not blocks:
        return np.zeros((n_out, n_in, colours, 1)), np.ones((n_out, n_in)), 0.0
    orders = max(block.orders.stop for block in blocks)
    if orders <= FEW:
        plain = np.zeros((n_out, n_in, colours, orders))
        for block in blocks:
            plain[block.first :, block.first :, :, block.orders.start : block.orders.stop] = (
                block.values.transpose(2, 3, 0, 1)
            )
        return plain, np.ones((n_out, n_in)), 0.0
    grey = [Block(block.orders, block.first, block.values.sum(axis=0, keepdims=True)) for block in blocks]
    width = _widths(grey, n_out, n_in)
    most = min(max(4 * orders, 2 * PROBE), MOST)
    long = _stretched(grey, width, 1, most, most)[:, :, 0]
    peak = np.abs(long).sum(axis=2).max(axis=0)
    # By incident direction: the root mean square over phi of what is lost by leaving out all from the k-th term on.
    left = np.sqrt(np.cumsum(0.5 * long[..., ::-1] ** 2, axis=2)[..., ::-1]).max(axis=0)
    floor = np.maximum(_last(grey, orders, n_out, n_in).max(axis=0), tolerance * peak)
    twice = left[:, np.minimum(2 * np.arange(most), most - 1)]
    noise = (twice > 0.5 * left) & (np.arange(most) >= FEW) & (2 * np.arange(most) < most)
    enough = ((left <= floor[:, None]) | noise).all(axis=0)
    terms = int(np.argmax(enough)) if enough.any() else most
    terms = min(-(-max(terms, 1) // 8) * 8, most)
    error = float((left[:, min(terms, most - 1)] / np.where(peak > 0, peak, 1)).max())
    return _stretched(blocks, width, colours, most, terms), width, error


def _widths(grey: Sequence[Block], n_out: int, n_in: int) -> np.ndarray:
    """(n_out, n_in) the widths that leave the least after a few terms."""
    least, chosen = np.full((n_out, n_in), np.inf), np.ones((n_out, n_in))
    there = np.zeros((n_out, n_in, len(BETWEEN)))
    for block in grey:
        waves = np.cos(np.array(block.orders)[:, None] * BETWEEN)
        there[block.first :, block.first :] += np.einsum("moi,mp->oip", block.values[0], waves, optimize=True)
    for d in WIDTHS:
        series = _stretched(grey, np.full((n_out, n_in), d), 1, PROBE, PROBE)[:, :, 0]
        # The points of a narrow width all lie near 0, and what is elsewhere leaves no trace in the last terms.
        s = 2 * np.arctan2(np.sin(0.5 * BETWEEN), d * np.cos(0.5 * BETWEEN))
        off = np.abs(series @ np.cos(np.arange(PROBE)[:, None] * s) - there).max(axis=2)
        left = np.maximum(np.abs(series[..., -PROBE // 4 :]).max(axis=2), off)
        better = left < 0.9 * least  # not for rounding errors
        least[better], chosen[better] = left[better], d
    return chosen


def _last(grey: Sequence[Block], orders: int, n_out: int, n_in: int) -> np.ndarray:
    """(n_out, n_in) root mean square of the last eighth of a plain series: about what is missing behind it."""
    found = np.zeros((n_out, n_in))
    for block in grey:
        here = np.array(block.orders) >= orders - max(orders // 8, 2)
        found[block.first :, block.first :] += 0.5 * (block.values[0, here] ** 2).sum(axis=0)
    return np.sqrt(found)


def _stretched(
    blocks: Sequence[Block], width: np.ndarray, colours: int, points: int, terms: int
) -> np.ndarray:
    """(n_out, n_in, C, terms) series in the stretched azimuths of these widths, from so many points."""
    found = np.zeros((*width.shape, colours, terms))
    for d in np.unique(width):
        chosen = width == d
        for block in blocks:
            here = chosen[block.first :, block.first :]
            if not here.any():
                continue
            change = matrix(float(d), block.orders, points)[:, :terms]
            values = (
                block.values[:, :, here]
                if not here.all()
                else block.values.reshape(*block.values.shape[:2], -1)
            )
            part = found[block.first :, block.first :]
            for c in range(colours):
                part[:, :, c][here] += values[c].T @ change
    return found
