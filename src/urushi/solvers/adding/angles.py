"""Quadrature over the outgoing directions of a rough interface, placed where its lobe is.

A lobe of roughness alpha may be much narrower than the nodes are apart. So the integrals that make a matrix of it have
points of their own: Gauss & Legendre on panels that shrink by powers of 2 towards the direction of the smooth
interface, towards grazing directions (where masking sets in at cosines near alpha), and end wherever the integrand
has a kink. No panel is longer than the highest basis function or cosine lets it be.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from .basis import SAME, Grid

#: how many radians of phase one Gauss point takes: a panel of g points resolves cos(m phi) over REACH g / m
REACH = 0.55
#: no panel is longer than this, whatever it integrates
LONGEST = 0.35
#: Gauss points per panel where polynomials are integrated with cosines
CLOSE = 8


@cache
def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (1 + x), 0.5 * w


def composite(breaks: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss & Legendre with `points` points on every panel between ascending breaks."""
    x, w = gauss(points)
    length = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + length * x).ravel(), (length * w).ravel()


def cut(breaks: Iterable[float], low: float, high: float, longest: float) -> np.ndarray:
    """Sorted breaks from low to high, further cut so that no panel is longer than `longest`."""
    inside = np.asarray(sorted(b for b in breaks if low < b < high))
    found = np.concatenate([[low], inside, [high]])
    # Two kinks that nearly coincide, or a kink at an end, leave no panel worth its points.
    keep = np.append(True, np.diff(found) > 1e-9 * (high - low))
    found = found[keep]
    found[-1] = high
    length = np.diff(found)
    parts = np.maximum(np.ceil(length / longest).astype(int), 1)
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(found[:-1], parts) + number * np.repeat(length / parts, parts), high)


def towards(centre: float, scale: float, reach: float = np.pi / 2) -> list[float]:
    """Breaks on both sides of a centre, at distances that double from `scale` on."""
    steps = scale * 2.0 ** np.arange(0, max(int(np.ceil(np.log2(reach / scale))), 1))
    return [centre, *(centre - steps), *(centre + steps)]


@dataclass(frozen=True)
class Fan:
    """Points in the polar angle of one region: where the light of one node may go.

    Attributes:
        sin, cos: (F,) of the polar angle in the region.
        weight: (F,) quadrature weights dmu of the region.
        coordinate: (F,) the cosine in the medium of the grid's panel that a point lies in.
        starts: the points of panel p of the grid are those from starts[p] to starts[p + 1].
    """

    sin: np.ndarray
    cos: np.ndarray
    weight: np.ndarray
    coordinate: np.ndarray
    starts: np.ndarray


def fan(
    grid: Grid, region: int, centre: float, width: float, grazing: float, kinks: Iterable[float], points: int
) -> Fan:
    """Points for a lobe.

    Args:
        grid, region: where the light goes.
        centre: polar angle of the lobe in the region (pi / 2 where it lies beyond the horizon).
        width: half-width of the lobe in that angle.
        grazing: height above the horizon, in radians, below which masking bends the integrand.
        kinks: polar angles at which the integrand has a kink.
        points: Gauss points per panel.
    """
    index = grid.indices[region]
    angles = [*towards(centre, width), *kinks]
    angles += [np.pi / 2 - h for h in towards(0.0, grazing) if h > 0]
    invariants = index * np.sin([a for a in angles if 0 < a < np.pi / 2])
    sin, cos, weight, coordinate, starts = [], [], [], [], [0]
    for panel in grid.panels:
        if panel.first >= grid.count(region):
            break
        # In psi = arccos x the basis functions have no frequency above their number, and nothing bends at the ends.
        within = invariants[
            (invariants < panel.index) & (invariants > panel.index * np.sqrt(1 - panel.high**2))
        ]
        cosines = np.sqrt((panel.index - within) * (panel.index + within)) / panel.index
        breaks = np.arccos(panel.coordinate(cosines))
        ends = cut(breaks, 0.0, np.pi / 2, min(REACH * points / panel.count, LONGEST))
        psi, w = composite(ends, points)
        y = np.cos(psi)
        own = panel.cosine(y)
        s = panel.index * np.sqrt((1 - own) * (1 + own))
        same = abs(panel.index - index) <= SAME * index
        mu = own if same else np.sqrt((index - s) * (index + s)) / index
        sin.append(s / index)
        cos.append(mu)
        coordinate.append(own)
        # n^2 mu dmu is the same in all media.
        w *= panel.density(y) * np.sin(2 * psi)
        weight.append(w if same else w * panel.index**2 * own / (index**2 * mu))
        starts.append(starts[-1] + len(own))
    joined = [np.concatenate(parts) for parts in (sin, cos, weight, coordinate)]
    return Fan(joined[0], joined[1], joined[2], joined[3], np.asarray(starts))


@dataclass(frozen=True)
class Ring:
    """Points in the azimuth, on [0, pi], for lobes of about one width, and what makes cosine integrals of values there.

    Attributes:
        breaks: ends of the panels.
        phi, weight: (Q,) points and weights, twice the length of the panels' for the other half of the circle.
        project: (Q, M) values times this are integrals over the circle, times cos(m phi) of the orders asked for.
        points: Gauss points per panel.
    """

    breaks: np.ndarray
    phi: np.ndarray
    weight: np.ndarray
    project: np.ndarray
    points: int

    def places(self, panel: int) -> slice:
        """The points of a panel."""
        return slice(panel * self.points, (panel + 1) * self.points)

    def finer(self, panel: int, start: int, stop: int, points: int) -> Ring:
        """One panel alone, cut into so short ones that `points` points on each resolve the cosines, too."""
        low, high = (float(end) for end in self.breaks[panel : panel + 2])
        return _fine(low, high, start, stop, points)


@lru_cache(maxsize=256)
def _fine(low: float, high: float, start: int, stop: int, points: int) -> Ring:
    breaks = cut([], low, high, REACH * points / max(stop - 1, 1))
    phi, weight = composite(breaks, points)
    return Ring(
        breaks, phi, 2 * weight, 2 * weight[:, None] * np.cos(phi[:, None] * np.arange(start, stop)), points
    )


@lru_cache(maxsize=64)
def ring(level: int, start: int, stop: int, points: int) -> Ring:
    """Points for lobes of width 2^-level at phi = 0, and for the orders from `start` on and below `stop`.

    Args:
        level, start, stop: see above.
        points: Gauss points per panel, which resolve the lobe: the polynomials through its values are integrated with
            the cosines exactly (Filon 1928).
    """
    orders = np.arange(start, stop)
    lobe = np.pi * 2.0 ** -np.arange(1, level + 2)
    breaks = cut(lobe, 0.0, np.pi, np.pi / 4)
    resolving = cut(breaks, 0.0, np.pi, REACH * CLOSE / max(stop - 1, 1))
    phi, weight = composite(breaks, points)
    close, shares = composite(resolving, CLOSE)
    waves = 2 * shares[:, None] * np.cos(close[:, None] * orders)
    panel = np.searchsorted(breaks, close) - 1
    x = (close - breaks[panel]) / np.diff(breaks)[panel]
    parts = lagrange(gauss(points)[0], x)
    project = [parts[panel == k].T @ waves[panel == k] for k in range(len(breaks) - 1)]
    return Ring(breaks, phi, 2 * weight, np.concatenate(project), points)


def lagrange(nodes: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(..., n) the Lagrange polynomials of few nodes at x, in [0, 1] (barycentric)."""
    apart = 4 * (nodes[:, None] - nodes)
    np.fill_diagonal(apart, 1.0)
    away = x[..., None] - nodes
    # A point on a node is moved by less than rounding would.
    found = 1 / (np.where(np.abs(away) < 1e-14, 1e-14, away) * apart.prod(axis=1))
    found /= found.sum(axis=-1, keepdims=True)
    return found
