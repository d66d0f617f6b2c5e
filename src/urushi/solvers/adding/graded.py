"""A medium that varies with depth, as a layer: piece by piece by the continuous adding equation.

Between two of the heights that have values, what each of its phase functions scatters is linear in the optical depth,
which `riccati` solves; the pieces are added. Where the series of a phase function j is cut, a share f_j of the light
that it scatters counts as not scattered (`delta_m`), more of it where its albedo a_j is higher. The optical depth then
counts for 1 - F of itself, F the sum of all a_j f_j: over a piece of depth h, at whose top this is F and at whose
bottom F + D,

    tau' = h ((1 - F) s - D s^2 / 2),        a_j' = a_j (1 - f_j) / (1 - F),        0 <= s <= 1,

and the piece is solved in tau', where those shares do not exist. Light scattered once, which has a closed
form elsewhere, has that of the mean medium here (`MediumLayer.once`); the difference is solved with the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from ...adding import Slab, add
from ...description.graded import GradedMedium
from ...media.graded import BoundGraded
from . import media, riccati
from .basis import Grid
from .delta_m import Truncated
from .layers import MediumLayer, numbers
from .mixture import Mixture, parts
from .operator import OPERATORS
from .phase import Phase, series

#: the steps of `riccati` are not asked for more than this
FINEST = 1e-11


def mixture(layer: GradedMedium) -> Phase:
    """The mean phase function of a described medium."""
    found = [series(phase) for phase, _ in layer.scatterers]
    return found[0] if len(found) == 1 else Mixture(found, layer.shares)


@dataclass(frozen=True)
class Piece:
    """A stretch in which the albedo of each phase function is linear in the optical depth.

    Attributes:
        depth: optical depth, > 0.
        top, bottom: albedos at both ends.
        forward: share of what each scatters that counts as not scattered.
    """

    depth: float
    top: Sequence[float]
    bottom: Sequence[float]
    forward: Sequence[float]

    @property
    def scaled(self) -> float:
        """Optical depth without those shares."""
        linear, square = self._left()
        return self.depth * (linear - square)

    def albedo(self, which: int, t: float) -> np.ndarray:
        """(1,) the albedo of one of them without those shares, at the part t of the scaled depth from the top."""
        linear, square = self._left()
        passed = t * (linear - square)  # = linear s - square s^2
        s = min(2 * passed / (linear + np.sqrt(linear**2 - 4 * square * passed)), 1.0)  # no more, by rounding
        here = self.top[which] + (self.bottom[which] - self.top[which]) * s
        return np.atleast_1d(here * (1 - self.forward[which]) / (linear - 2 * square * s))

    def _left(self) -> tuple[float, float]:
        """1 - F and D / 2."""
        top, bottom = (
            sum(a * f for a, f in zip(end, self.forward, strict=True)) for end in (self.top, self.bottom)
        )
        return 1 - top, 0.5 * (bottom - top)


class GradedLayer(MediumLayer):
    """A graded medium; see `MediumLayer` for the arguments."""

    def __init__(
        self,
        medium: BoundGraded,
        phase: Phase,
        grid: Grid,
        region: int,
        tolerance: float,
        method: media.Method = media.METHODS[0],
    ) -> None:
        super().__init__(medium, phase, grid, region, tolerance, method=method)
        deep = float(numbers(medium.depth)[0])
        self._cuts = [Truncated.of(part, len(self.truncated.moments)) for part in parts(phase)]
        forward = [cut.forward for cut in self._cuts]
        ends = list(zip(medium.heights, zip(*medium.albedos, strict=True), strict=True))
        self.pieces = [
            Piece(deep * (end - begin), top, bottom, forward)
            for (begin, top), (end, bottom) in pairwise(ends)
        ]
        self.tolerance = max(tolerance, FINEST)

    def slab(self, orders: range, first: int) -> Slab:
        if orders.start >= self.orders:
            return super().slab(orders, first)
        scattering = [self._scattered_by(cut, orders, first) for cut in self._cuts]
        found: Slab | None = None
        for piece in self.pieces:
            slab = self._piece(piece, scattering)
            found = slab if found is None else add(found, slab, OPERATORS)
        assert found is not None
        return found

    def _piece(self, piece: Piece, scattering: Sequence[media.Scattering]) -> Slab:
        lit = [j for j, ends in enumerate(zip(piece.top, piece.bottom, strict=True)) if any(ends)]
        if len(lit) < 2 and piece.top == piece.bottom:
            only = lit[0] if lit else 0
            albedo = piece.albedo(only, 0.0)
            return media.slab(scattering[only], np.array([piece.scaled]), albedo, self.method)
        constituents = [(scattering[j], partial(piece.albedo, j)) for j in lit]
        return riccati.solve(riccati.Gradient(piece.scaled, constituents), self.tolerance)
