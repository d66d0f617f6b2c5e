"""A medium whose albedo varies with depth, as a layer: piece by piece by the continuous adding equation.

Between two of its albedos the medium varies smoothly, which `riccati` solves; the pieces are added. Where the series of
the phase function is cut, a share f of the scattered light counts as not scattered (`delta_m`), more of it where the
albedo a is higher. The optical depth then counts for 1 - a f of itself: over a piece of depth h, from a to a + d,

    tau' = h ((1 - a f) s - d f s^2 / 2),        a' = a (1 - f) / (1 - a f),        0 <= s <= 1,

and the piece is solved in tau', where that share does not exist. Light scattered once, which has a closed
form elsewhere, has that of the mean albedo here (`MediumLayer.once`); the difference is solved with the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...adding import Slab, add
from ...media.graded import BoundGraded
from . import media, riccati
from .basis import Grid
from .layers import MediumLayer, numbers
from .operator import OPERATORS
from .phase import Phase

#: the steps of `riccati` are not asked for more than this
FINEST = 1e-11


@dataclass(frozen=True)
class Piece:
    """A stretch with an albedo linear in the optical depth.

    Attributes:
        depth: optical depth, > 0.
        top, bottom: albedo at both ends.
        forward: share of the scattered light that counts as not scattered.
    """

    depth: float
    top: float
    bottom: float
    forward: float

    @property
    def scaled(self) -> float:
        """Optical depth without that share."""
        return self.depth * (1 - self.forward * 0.5 * (self.top + self.bottom))

    def albedo(self, t: float) -> np.ndarray:
        """(1,) the albedo without that share, at the part t of the scaled depth from the top."""
        linear, square = 1 - self.forward * self.top, 0.5 * self.forward * (self.bottom - self.top)
        passed = t * (linear - square)  # = linear s - square s^2
        s = 2 * passed / (linear + np.sqrt(linear**2 - 4 * square * passed))
        here = self.top + (self.bottom - self.top) * s
        return np.atleast_1d(here * (1 - self.forward) / (1 - here * self.forward))


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
        each = float(numbers(medium.depth)[0]) / (len(medium.albedos) - 1)
        forward = self.truncated.forward
        self.pieces = [Piece(each, above, below, forward) for above, below in pairwise(medium.albedos)]
        self.tolerance = max(tolerance, FINEST)

    def slab(self, orders: range, first: int) -> Slab:
        if orders.start >= self.orders:
            return super().slab(orders, first)
        scattering = self._scattering(orders, first)
        found: Slab | None = None
        for piece in self.pieces:
            slab = self._piece(piece, scattering)
            found = slab if found is None else add(found, slab, OPERATORS)
        assert found is not None
        return found

    def _piece(self, piece: Piece, scattering: media.Scattering) -> Slab:
        if piece.top == piece.bottom:
            return media.slab(scattering, np.array([piece.scaled]), piece.albedo(0.0), self.method)
        gradient = riccati.Gradient(piece.scaled, [(scattering, piece.albedo)])
        return riccati.solve(gradient, self.tolerance)
