"""Where a solved stack sends its light: the numbers behind importance sampling, in numpy.

For light from each node, f is taken at every outgoing node (and once more at the horizon) and at evenly spaced points
of the stretched azimuth of the pair (`warp`); between them it is thought linear, in the square of the cosine and in
the stretched azimuth. So a density is a sum of hats (1 at its own point, 0 at its neighbours), and the mass of each is
the luminance of the light under it, less the lobe of the outermost interface where that has a closed form to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import warp
from .solution import Solution
from .table import SIDES, Series

#: intervals of the azimuth, from 0 to pi
BINS = 32
#: points per interval at which light is looked for
FINER = 4
#: weights of linear RGB in luminance
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

#: flux density (C, N) of what `Series` leaves out, for light with cosine mu_i from above to cosine mu_o and azimuth phi
Extra = Callable[[np.ndarray, np.ndarray, np.ndarray, bool, bool], np.ndarray]


@dataclass(frozen=True)
class Cells:
    """See the module docstring. Rows are incident nodes, those above first; columns outgoing ones, likewise.

    Attributes:
        counts: numbers of nodes above and below; the latter is 0 for an opaque stack.
        theta: (n,) polar angles of the nodes of each side.
        mass: (R, columns, BINS + 1) luminance under each hat, both halves of the circle together. A side has one column
            more than nodes: the last is the horizon.
        width: (R, columns) d of each pair.
        peak: (R, C) largest f from each node, over all outgoing nodes.
        negative: the lowest value that had to be raised to 0, relative to the peak.
    """

    counts: tuple[int, int]
    theta: list[np.ndarray]
    mass: np.ndarray
    width: np.ndarray
    peak: np.ndarray
    negative: float

    @classmethod
    def build(cls, solution: Solution, series: Series, extra: Extra | None) -> Cells:
        """Cells of a solution.

        Args:
            solution: the solved stack.
            series: its table.
            extra: what is to be added to it; None for nothing.
        """
        grid, opaque = solution.grid, (True, False) not in series.parts
        regions = (0,) if opaque else (0, -1)
        theta = [np.arctan2(np.sqrt((1 - grid.mu[r]) * (1 + grid.mu[r])), grid.mu[r]) for r in regions]
        counts = len(theta[0]), 0 if opaque else len(theta[1])
        rows, columns = sum(counts), sum(counts) + len(theta)
        mass = np.zeros((rows, columns, BINS + 1))
        width = np.ones((rows, columns))
        peak = np.zeros((rows, solution.colours))
        negative = 0.0
        places: dict[tuple[bool, bool], tuple[slice, slice]] = {}
        for k, (from_above, to_above) in enumerate(SIDES[: 1 if opaque else 4]):
            i = slice(0, counts[0]) if from_above else slice(counts[0], rows)
            o = slice(0, counts[0] + 1) if to_above else slice(counts[0] + 1, columns)
            twin = solution.twin((from_above, to_above), places)
            places[from_above, to_above] = i, o
            if twin is not None:
                mass[i, o], width[i, o] = mass[places[twin]], width[places[twin]]
                peak[i] = np.maximum(peak[i], peak[places[twin][0]])
                continue
            area = 0.5 * hats(*squares(theta[0 if to_above else 1]))  # integrals of hat mu dmu
            angles = grid.mu[0 if to_above else -1], grid.mu[0 if from_above else -1]
            index = grid.indices[0 if to_above else -1]
            f = Reflectance(series.values[k], series.width[k], *angles, index, extra, (from_above, to_above))
            best: np.ndarray | None = None
            chosen = series.width[k].copy()
            for d in (series.width[k], *(warp.WIDTHS[1:6] if extra is not None else ())):
                found, top, low = f.bins(d)
                share = found / np.maximum(found.sum(axis=2, keepdims=True), 1e-300)
                uneven = (share**2).sum(axis=2)
                peak[i] = np.maximum(peak[i], top)
                negative = min(negative, low)
                if best is None:
                    best, least = found, uneven
                    continue
                better = uneven < least
                best[better], least[better] = found[better], uneven[better]
                chosen[better] = np.broadcast_to(d, chosen.shape)[better]
            assert best is not None
            # f at the horizon is that of the last node.
            best, chosen = (np.concatenate([x, x[-1:]]) for x in (best, chosen))
            mass[i, o] = (best * area[:, None, None]).transpose(1, 0, 2)
            width[i, o] = chosen.T
        return cls(counts, theta, mass, width, peak, negative)


def squares(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared sines and cosines of ascending polar angles and of the horizon."""
    return np.append(np.sin(theta) ** 2, 1.0), np.append(np.cos(theta) ** 2, 0.0)


def hats(sin: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """Integrals, over the squared sine, of the hats at these `squares`; those at the ends are halves."""
    step = steps(sin, cos)
    return 0.5 * (np.append(step, 0) + np.append(0, step))


def steps(sin: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """Differences of squared sines, each by whichever of sine and cosine is small and has the digits."""
    return np.where(sin[1:] < 0.5, np.diff(sin), -np.diff(cos))


@dataclass(frozen=True)
class Reflectance:
    """f between the nodes of one part (see `table` for the numbers of it)."""

    values: np.ndarray
    width: np.ndarray
    mu_o: np.ndarray
    mu_i: np.ndarray
    index: float
    extra: Extra | None
    sides: tuple[bool, bool]

    def bins(self, width: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, float]:
        """Luminance of f under the hats over a stretched azimuth.

        Returns:
            (n_out, n_in, BINS + 1) integrals over the azimuth, both halves of the circle; the largest f (n_in, C); and
            the lowest, relative to that.
        """
        s = np.pi * (np.arange(BINS * FINER) + 0.5) / (BINS * FINER)
        width = np.broadcast_to(width, self.width.shape)[..., None]
        phi = warp.azimuth(s, width)
        # cos of the series' own stretched azimuth
        x = np.cos(2 * np.arctan2(np.sin(0.5 * phi), self.width[..., None] * np.cos(0.5 * phi)))
        n = self.values.shape[-1]
        scale = (self.index**2 / (self.mu_o[:, None] + self.mu_i))[..., None]
        luminance: np.ndarray | float = 0.0
        top, low = [], 0.0
        more = None if self.extra is None else self._more(phi)
        colours = self.values.shape[2]
        for c in range(colours):
            one, two = np.zeros_like(x), np.zeros_like(x)
            for k in reversed(range(1, n)):
                one, two = 2 * x * one - two + self.values[..., c, k, None], one
            f = (x * one - two + self.values[..., c, 0, None]) * scale
            if more is not None:
                f = f + more[c]
            top.append(f.max(axis=(0, 2)))
            least, most = float(f.min()), float(f.max())
            low = min(low, least / most if most > 0 else 0.0)
            weight = LUMINANCE[c] if colours == 3 else 1 / colours
            luminance = luminance + weight * np.maximum(f, 0)
        dense = luminance * warp.slope(s, width) * (2 * np.pi / len(s))
        hat = np.clip(1 - np.abs(s[:, None] * (BINS / np.pi) - np.arange(BINS + 1)), 0, None)
        return dense @ hat, np.stack(top, axis=1), low

    def _more(self, phi: np.ndarray) -> np.ndarray:
        """(C, n_out, n_in, S) f of what the table does not hold."""
        assert self.extra is not None
        mu_o, mu_i, phi = np.broadcast_arrays(self.mu_o[:, None, None], self.mu_i[:, None], phi)
        flux = self.extra(mu_i.ravel(), mu_o.ravel(), phi.ravel(), *self.sides)
        return (flux / mu_o.ravel()).reshape(-1, *phi.shape)
