"""Choosing the resolution: more nodes, until more nodes change nothing that anyone asked for.

Two solutions on different nodes are compared where neither has a node: at fixed angles of incidence, grazing ones
included, and at directions around the mirror direction, where lobes peak. What they differ by is the error of the
coarser one; how fast such differences shrink tells what is left in the finer one, which is kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import OutOfReach
from .basis import Grid
from .retro import Retro
from .solution import Part, Solution
from .table import ORDER

#: (from above, to above)
Side = tuple[bool, bool]
#: of a solution, by side: f (C, I, O, A) of those closed forms that depend on the nodes, where `Seen` looks
Closed = Callable[[Solution], Mapping[Side, np.ndarray]]
#: cosines of incidence that are compared (normal incidence is a node: beside it, lobes may take more);
#: `OFFSETS` from the mirror direction in polar angle, `AZIMUTHS` in azimuth
COSINES = np.array([1.0, 0.996, 0.96, 0.83, 0.68, 0.52, 0.37, 0.23, 0.11])
OFFSETS = np.radians([0, 0.7, -1.1, 2.3, -3.1, 5.7, -7.9, 13.0, -17.0, 31.0, -41.0, 57.0])
AZIMUTHS = np.radians([0, 0.9, 3.7, 11.0, 29.0, 75.0, 120.0, 180.0])
#: nodes that are interpolated from
WIDE = 8
#: what the number of nodes is multiplied with in a whole step; the shortest step, for where less should do; and what of
#: the accuracy asked for the next solution is to have
GROWTH, SHORTEST, AIM = 1.5, 0.45, 0.7
#: by how much a whole step makes errors smaller: no less is believed in, and no more
SLOWEST, FASTEST = 0.75, 1 / 6
#: changes that this is told from
LOOKED_BACK = 3
#: a BSDF whose peak is darker than that of a diffuse black of three per cent counts as no darker
FAINT = 0.03 / np.pi
#: nodes beyond which refining gives up
MOST_NODES = 1500


def refine(
    solve: Callable[[list[int]], Solution],
    counts: list[int],
    accuracy: float,
    more: bool = True,
    progress: Callable[[int, float], Any] | None = None,
    heights: Mapping[Side, np.ndarray] | None = None,
    closed: Closed | None = None,
    step: float = 1.0,
) -> Solution:
    """Solve with more and more nodes until nothing changes any more.

    Args:
        solve: from numbers of nodes per panel to a solution.
        counts: the numbers that should do; two solutions with fewer are tried first.
        accuracy: absolute error allowed of reflectance and transmittance, and of the BSDF relative to its peak for
            the same angle of incidence, or to `FAINT`.
        more: False to stay with these numbers, whatever their error.
        progress: called with (nodes, error) after each solution.
        heights: see `difference`.
        closed: see `Seen`.
        step: that of the first three solutions, and whether later ones may be shorter than whole ones: for lobes that
            a few nodes more resolve.

    Returns:
        the last solution, its diagnostics completed by "estimated_error", "accuracy", "seconds" and "history".

    Raises:
        OutOfReach: the accuracy is not reached with `MOST_NODES` nodes.
    """
    start = time.perf_counter()
    if more:
        counts = _fewer(counts, step)
    coarse = Seen(solve(_fewer(counts, step)), closed)
    history: list[tuple[int, float]] = []
    found, steps = [], [step]
    while True:
        fine = solve(counts)
        seen = Seen(fine, closed)
        found.append(changes(coarse, seen, heights))
        pace = _pace(found[-LOOKED_BACK:], steps[-LOOKED_BACK:]) if len(found) > 1 else None
        left = found[-1] if pace is None else found[-1] * (pace ** steps[-1] / (1 - pace ** steps[-1]))
        # Three digits, never fewer than there are.
        error = float(f"{1.005 * float(left.max()):.2e}")
        history.append((len(fine.grid.s), error))
        if progress is not None:
            progress(*history[-1])
        if error <= accuracy or not more:
            told = {
                "estimated_error": error,
                "accuracy": accuracy,
                "seconds": round(time.perf_counter() - start, 4),
            }
            return replace(fine, diagnostics={**fine.diagnostics, **told, "history": history})
        steps.append(step if pace is None or step == 1 else _step(left, pace, accuracy))
        counts = [int(np.ceil(GROWTH ** steps[-1] * n)) for n in counts]
        if sum(counts) > MOST_NODES:
            raise OutOfReach(
                f"accuracy: found {accuracy:g}, but {len(fine.grid.s)} nodes still leave an error of {error:.2g}; "
                "allowed: a larger one, or fixed nodes=..."
            )
        coarse = seen
        del fine  # as large as all else together


def _fewer(counts: list[int], step: float) -> list[int]:
    return [max(int(n / GROWTH**step), 4) for n in counts]


def _pace(found: Sequence[np.ndarray], steps: Sequence[float]) -> np.ndarray:
    """By how much a whole step makes each error smaller, from the first and the last of some changes.

    An error e that shrinks by p^s in a step s changes by e (1 - p^s), and after further steps t by e p^(s + t) times as
    much as its last step makes of it. Those between may be small by chance, as what goes up and down passes 0.
    """
    pace = np.linspace(FASTEST, SLOWEST, 100)
    shrunk = pace ** sum(steps[:-1]) * (1 - pace ** steps[-1]) / (1 - pace ** steps[0])
    rate: np.ndarray = np.interp(found[-1] / np.maximum(found[0], 1e-300), shrunk, pace)
    return rate


def _step(left: np.ndarray, pace: np.ndarray, accuracy: float) -> float:
    """The shortest step after which what is `left` should be small enough; a whole one if none is."""
    steps = np.linspace(SHORTEST, 1.0, 12)
    enough = (left * pace ** steps[:, None]).max(axis=1) <= AIM * accuracy
    return float(steps[np.argmax(enough)]) if enough.any() else 1.0


def difference(
    one: Solution | Seen, other: Solution | Seen, heights: Mapping[Side, np.ndarray] | None = None
) -> float:
    """The largest difference of two solutions of the same stack (see `refine`).

    Args:
        one, other: the solutions, or what was `Seen` of them.
        heights: by (from above, to above), f of what has a closed form, the largest that is known at each of `COSINES`:
            (I,). The solutions hold no more of it than they need.
    """
    return float(changes(one, other, heights).max())


def changes(
    one: Solution | Seen, other: Solution | Seen, heights: Mapping[Side, np.ndarray] | None = None
) -> np.ndarray:
    """The differences of two solutions, of energies and of the BSDF, by side and cosine of incidence: flat.

    Each shrinks at a pace of its own, and the largest may give way to one that hardly does.
    """
    one, other = (Seen(s) if isinstance(s, Solution) else s for s in (one, other))
    found = []
    for side in other.albedo:
        found.append(np.abs(one.albedo[side] - other.albedo[side]).max(axis=0))
        peak = np.maximum(other.peak[side], 0 if heights is None else heights[side])
        change = np.abs(one.values[side] - other.values[side]).max(axis=(0, 2, 3))
        found.append(change / np.maximum(peak, FAINT))
    return np.concatenate(found)


class Seen:
    """What is compared of a solution, by (from above, to above).

    Attributes:
        albedo: (C, I) reflectance or transmittance at `COSINES`, delta parts included.
        values: (C, I, O, A) BSDF f (without squared index) there and at O cosines of exit (`exits`) and A `AZIMUTHS`:
            of the blocks and of what is `closed`; other closed forms are left out.
        peak: (I,) the largest f of these, and among the nodes, at azimuths 0 and 180 degrees, closed forms included.

    Args:
        solution: what to look at.
        closed: how light scattered once fades depends on how much of the peak the nodes resolve, and the blocks make up
            for that: their sum is what anyone sees.
    """

    def __init__(self, solution: Solution, closed: Closed | None = None) -> None:
        sharp = {} if closed is None else closed(solution)
        self._weights: dict[tuple[int, bytes], np.ndarray] = {}
        self.albedo: dict[Side, np.ndarray] = {}
        self.values: dict[Side, np.ndarray] = {}
        self.peak: dict[Side, np.ndarray] = {}
        for side, part in solution.parts.items():
            twin = solution.twin(side, self.peak)
            self.albedo[side] = self._albedo(solution, part) if twin is None else self.albedo[twin]
            self.values[side] = self._values(solution, part) if twin is None else self.values[twin]
            self.peak[side] = self._peak(solution, part) if twin is None else self.peak[twin]
            if side in sharp and twin is None:
                self.values[side] = self.values[side] + sharp[side]
                here = self.values[side].max(axis=(0, 2, 3))
                # What goes exactly back is no value: nodes hold it as one of any height.
                spikes = any(isinstance(peak, Retro) for peak in solution.peaks.values())
                self.peak[side] = here if spikes else np.maximum(self.peak[side], here)

    def _stencil(self, grid: Grid, region: int, mu: np.ndarray) -> np.ndarray:
        """(2, N, n) weights of all nodes of a region, for even and for odd orders."""
        key = grid.indices.index(grid.indices[region]), mu.tobytes()
        if key not in self._weights:
            # Where nodes are closer together at one end, they are so far apart at the other that it matters.
            order = WIDE if grid.panels[0].squeeze == 1 else ORDER
            stencil = grid.stencil(region % len(grid.indices), mu, order)
            found = np.zeros((2, len(mu), grid.count(region)))
            row = np.arange(len(mu))[:, None]
            for weights, of_parity in zip(found, (stencil.even, stencil.odd), strict=True):
                np.add.at(weights, (row, stencil.node), of_parity)
            self._weights[key] = found
        return self._weights[key]

    def _albedo(self, solution: Solution, part: Part) -> np.ndarray:
        region = 0 if part.from_above else -1
        total = np.zeros((solution.colours, len(solution.grid.mu[region])))
        if part.delta is not None:
            total[:, : part.delta.shape[1]] += part.delta
        for block in part.whole():
            if block.orders.start == 0:
                total[:, block.first :] += block.values[:, 0].sum(axis=1)
        found: np.ndarray = total @ self._stencil(solution.grid, region, COSINES)[0].T
        return found

    def _values(self, solution: Solution, part: Part) -> np.ndarray:
        grid, region_i, region_o = _ends(solution, part)
        mu_o = exits(grid.indices, (part.from_above, part.to_above))
        into = self._stencil(grid, region_i, COSINES)
        out = self._stencil(grid, region_o, mu_o.ravel())
        own_i, own_o = grid.mu[region_i], grid.mu[region_o]
        scale = (own_o[:, None] + own_i) / (own_o * grid.weights[region_o])[:, None] / (2 * np.pi)
        found = np.zeros((solution.colours, *mu_o.shape, len(AZIMUTHS)))
        for block in part.blocks:
            orders = np.array(block.orders)
            waves = np.cos(orders[:, None] * AZIMUTHS) * np.where(orders > 0, 2, 1)[:, None]
            q = block.values * scale[block.first :, block.first :]
            for odd in (0, 1):
                these = slice((block.orders.start + odd) % 2, None, 2)
                column = q[:, these] @ into[odd][:, block.first :].T  # (C, M, n_out, I)
                rows = out[odd][:, block.first :].reshape(*mu_o.shape, -1)
                at = rows @ column.transpose(3, 2, 0, 1).reshape(len(COSINES), rows.shape[-1], -1)
                series = at.reshape(*mu_o.shape, solution.colours, -1) @ waves[these]
                found += series.transpose(2, 0, 1, 3)
        found /= (mu_o + COSINES[:, None])[..., None]
        return found

    def _peak(self, solution: Solution, part: Part) -> np.ndarray:
        grid, region_i, region_o = _ends(solution, part)
        mu_o, weight = grid.mu[region_o], grid.weights[region_o]
        nearest = np.abs(grid.mu[region_i][:, None] - COSINES).argmin(axis=0)
        total = np.zeros((2, solution.colours, len(mu_o), len(COSINES)))
        for block in part.whole():
            orders = np.array(block.orders)
            both = np.stack([np.where(orders > 0, 2, 1), np.where(orders > 0, 2, 1) * (-1.0) ** orders])
            lit = nearest >= block.first
            some = block.values[..., np.maximum(nearest - block.first, 0)]
            flat = some.transpose(1, 0, 2, 3).reshape(len(orders), -1)
            total[:, :, block.first :] += (both @ flat).reshape(2, -1, *some.shape[2:]) * lit
        return np.asarray((total / (2 * np.pi * mu_o * weight)[:, None]).max(axis=(0, 1, 2)))


def exits(indices: Sequence[float], side: Side) -> np.ndarray:
    """(I, O) for each of `COSINES` the cosines of exit to look at, by the indices of all regions and by the side."""
    n_i, n_o = (indices[0 if above else -1] for above in side)
    mirror = np.arcsin(np.minimum(np.sqrt(1 - COSINES**2) * n_i / n_o, 1))
    theta = np.abs(mirror[:, None] + OFFSETS)
    return np.cos(np.where(theta > np.radians(86), np.radians(86) - OFFSETS**2, theta))


def _ends(solution: Solution, part: Part) -> tuple[Grid, int, int]:
    """The nodes, and the regions that light of a part comes from and goes to."""
    return solution.grid, 0 if part.from_above else -1, 0 if part.to_above else -1
