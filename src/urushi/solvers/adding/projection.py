"""Sharp phase functions between the nodes, projected on the polynomials that the nodes carry (the method of Galerkin).

A series is usually taken at the nodes. Sums over nodes are exact up to some degree, and light scattered twice has
products of two terms: with more than half as many terms as nodes resolve, high degrees come back as low ones, which
shows where least light goes. Here every element is an integral instead, of the series times the basis functions L of
the grid at both ends,

    p_m[o, i] = integral of L_o(mu) p_m(mu, mu') L_i(mu') dmu dmu' / (w_o w_i)

by as many points as that takes. Nothing comes back, whatever the number of terms: those that the nodes do not carry,
which are fewer towards the horizon, where nodes are dense, than along the normal, are left out. And no light is
scattered that is not there: a projection lengthens nothing.
"""

from __future__ import annotations

import numpy as np

from .basis import SAME, Grid
from .phase import harmonics, products

#: points for a term, and for a node
FOR_TERM, FOR_NODE, MORE = 0.65, 0.7, 8
#: orders at a time
GROUP = 16


class Projection:
    """The polynomials of one region.

    Args:
        grid: the nodes.
        region: which.
        terms: of the series to come.
    """

    def __init__(self, grid: Grid, region: int, terms: int) -> None:
        index, nodes = grid.indices[region], grid.count(region)
        panels = [panel for panel in grid.panels if panel.index <= index * (1 + SAME)]
        finer = FOR_TERM * terms / nodes + FOR_NODE
        fine = Grid.build([p.index for p in panels], [int(np.ceil(finer * p.count)) + MORE for p in panels])
        self.mu, weights = fine.mu[-1], fine.weights[-1]
        self._shares = np.zeros((2, len(self.mu), nodes))
        for own, points in zip(panels, fine.panels, strict=True):
            at = points.high * fine.x[points.nodes] ** 2
            for odd in (False, True):
                self._shares[int(odd), points.nodes, own.nodes] = grid.functions(own, at, odd)
        self._shares *= weights[:, None] / grid.weights[region]

    def between(self, moments: np.ndarray, orders: range, last: int) -> tuple[np.ndarray, np.ndarray]:
        """What `phase.between` gives, projected: between so many of the last nodes."""
        first = self._shares.shape[2] - last
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for start in range(orders.start, orders.stop, GROUP):
            some = range(start, min(start + GROUP, orders.stop))
            y = harmonics(self.mu, len(moments), some)
            carried = np.empty((*y.shape[:2], last))
            for k, order in enumerate(some):
                carried[:, k] = y[:, k] @ self._shares[order % 2, :, first:]
            found.append(products(carried, moments, some))
        even, odd = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return even, odd
