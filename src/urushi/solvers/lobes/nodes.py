"""Nodes in the cosine, the same for all regions of a stack, for light that is told direction by direction.

Snell's invariant s = n sin(theta) does not change at a smooth interface, so nodes are placed in s, and a region of
index n owns those with s < n. Between two indices that occur, cosines of the thinnest medium that sees them are

    c = c_max cos^2(psi)        psi evenly spaced from 0 to pi/2

dense where total reflection begins and where the thinner medium has its own limit: what interfaces do with light is
nearly linear in psi in between. A direction that is no node is shared by the two nodes beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import at_most, root

#: indices nearer to one another, relatively, count as one: interfaces of such a ratio are invisible
SAME = 1e-4
#: nodes of all panels together, and of one at least and at most
NODES, FEWEST, MOST = 128, 12, 28
#: psi of the last node of a panel over pi/2: at the limit itself light could be reflected totally on both sides
LAST = 1 - 1e-3


class Nodes:
    """Nodes of all regions.

    Args:
        indices: index of every region, top to bottom.
    """

    def __init__(self, indices: Sequence[float]) -> None:
        found: list[float] = []
        for index in sorted(indices):
            if not found or index > found[-1] * (1 + SAME):
                found.append(index)
        self._breaks = np.array(found)
        self.panel = int(np.clip(NODES // len(found), FEWEST, MOST))
        #: of every region: the number of panels it sees
        self._seen = [int(np.sum(self._breaks <= index * (1 + 1e-12))) for index in indices]
        before = np.concatenate([[0.0], self._breaks[:-1]])
        self._high = np.sqrt((self._breaks - before) * (self._breaks + before)) / self._breaks
        place = np.arange(1, self.panel + 1) / self.panel
        place[-1] = LAST
        s = [np.zeros(1)]
        for index, high in zip(self._breaks, self._high, strict=True):
            cos = high * np.cos(0.5 * np.pi * place) ** 2
            s.append(index * np.sqrt((1 - cos) * (1 + cos)))
        self._s = np.concatenate(s)

    def count(self, region: int) -> int:
        """How many nodes a region has."""
        return 1 + self.panel * self._seen[region]

    def index(self, region: int) -> float:
        """The index of a region, as the nodes have it."""
        return float(self._breaks[self._seen[region] - 1])

    def cosines(self, region: int) -> np.ndarray:
        """(n,) cosines of the nodes in a region, descending from 1."""
        index, s = self.index(region), self._s[: self.count(region)]
        return np.asarray(np.sqrt((index - s) * (index + s)) / index)

    def weights(self, region: int) -> np.ndarray:
        """(n,) flux that even light has around the nodes of a region; sums to 1."""
        square = self._s[: self.count(region)] ** 2
        ends = np.concatenate([square[:1], 0.5 * (square[1:] + square[:-1]), [self.index(region) ** 2]])
        return np.asarray(np.diff(ends) / ends[-1])

    def shared(self, region: int, cos: Any, weights: Sequence[Any], each: int) -> np.ndarray:
        """Put light on nodes.

        Args:
            region: where.
            cos: (N * each,) cosines above 0, a Dr.Jit array of double precision.
            weights: C such arrays, how much light has these.
            each: how many belong together.

        Returns:
            (C, n, N): its parts on the nodes.
        """
        number, count = type(cos), self.count(region)
        place, before = number(0), -1.0
        for p in range(self._seen[region]):
            thin, high = (dr.opaque(number, float(x[p])) for x in (self._breaks, self._high))
            own = p == self._seen[region] - 1
            square = dr.square(dr.opaque(number, self.index(region)) / thin) * (1 - cos) * (1 + cos)
            thinnest = cos if own else root(1 - square)
            x = dr.acos(at_most(root(thinnest / high), 1)) * (2 / np.pi)
            place = dr.select(square > before, (p + at_most(x, 1)) * self.panel, place)
            before = dr.square(
                thin / dr.opaque(number, float(self._breaks[min(p + 1, len(self._breaks) - 1)]))
            )
        k = at_most(dr.int32_array_t(number)(place), self.panel * self._seen[region] - 1)
        fraction = place - k
        last = (k + 1) % self.panel == 0
        fraction = dr.select(last, at_most(fraction / (1 - self.panel * (1 - LAST)), 1), fraction)
        parts = [(weight * (1 - fraction), weight * fraction) for weight in weights]
        dr.eval(k, parts)
        size = dr.width(place) // each * count
        flat = (np.arange(dr.width(place) // each)[:, None] * count).repeat(each, axis=1).ravel() + np.array(
            k
        )
        found = [
            np.bincount(flat, _finite(low), size) + np.bincount(flat + 1, _finite(high), size)
            for low, high in parts
        ]
        return np.asarray(np.swapaxes(np.reshape(found, (len(parts), -1, count)), 1, 2))


def _finite(weights: Any) -> np.ndarray:
    """As a numpy array; 0 where facets at grazing angles gave no number."""
    found = np.array(weights)
    found[~np.isfinite(found)] = 0
    return found
