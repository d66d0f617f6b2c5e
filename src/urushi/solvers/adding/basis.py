"""The directional basis: quadrature in the cosine, one set of nodes for all media.

Snell's invariant s = n sin(theta) does not change at a smooth interface. So the nodes are placed in s once, and a
region of index n owns those with s < n: a smooth interface maps node j above to node j below, exactly. Panels break at
every index that occurs, so total internal reflection begins on the boundary of a panel. Within a panel the nodes are
those of Gauss & Legendre in the cosine of the rarest medium that light of these s still enters, where everything that
depends on s through any of the cosines is smooth; the first panel has, after Radau, a node at normal incidence.
No node lies at the horizon of any medium.

The flux that crosses a plane in a ring of directions is W = n^2 mu dmu (etendue), the same number in every region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import roots_jacobi, roots_legendre


@dataclass(frozen=True)
class Panel:
    """Consecutive nodes between two breaks of s.

    Attributes:
        index: index of the rarest medium that sees the panel; its cosine is the panel's coordinate.
        low, high: the panel's ends in that cosine.
        first, count: which nodes.
    """

    index: float
    low: float
    high: float
    first: int
    count: int


@dataclass(frozen=True)
class Grid:
    """Nodes of all regions of a stack.

    Attributes:
        indices: index of every region, top to bottom.
        s: (n,) Snell's invariant of the nodes, ascending from 0 (normal incidence).
        etendue: (n,) n^2 mu dmu of the nodes, the same in every region that has them.
        panels: the panels, by ascending s.
    """

    indices: tuple[float, ...]
    s: np.ndarray
    etendue: np.ndarray
    panels: tuple[Panel, ...]
    _panel_mu: np.ndarray

    @classmethod
    def build(cls, indices: Sequence[float], counts: int | Sequence[int]) -> Grid:
        """A grid.

        Args:
            indices: index of every region, top to bottom; those closer than 1e-9 count as one.
            counts: nodes per panel, at least 2; one number gives every panel as many as its share of the cosine
                deserves, at least 8.
        """
        breaks = _distinct(indices)
        before = 0.0
        panels: list[Panel] = []
        mu: list[np.ndarray] = []
        s: list[np.ndarray] = []
        etendue: list[np.ndarray] = []
        first = 0
        for j, index in enumerate(breaks):
            high = np.sqrt(max(1 - (before / index) ** 2, 0.0))
            count = max(int(np.ceil(counts * np.sqrt(high))), 8) if isinstance(counts, int) else counts[j]
            x, w = _radau(count) if j == 0 else roots_legendre(count)
            nodes, weights = 0.5 * high * (1 + x[::-1]), 0.5 * high * w[::-1]
            panels.append(Panel(index, 0.0, high, first, count))
            mu.append(nodes)
            # (1 - mu)(1 + mu) keeps the digits near normal incidence.
            s.append(index * np.sqrt((1 - nodes) * (1 + nodes)))
            etendue.append(index**2 * nodes * weights)
            first += count
            before = index
        return cls(
            tuple(float(n) for n in indices),
            np.concatenate(s),
            np.concatenate(etendue),
            tuple(panels),
            np.concatenate(mu),
        )

    def count(self, region: int) -> int:
        """How many nodes a region has."""
        index = self.indices[region]
        return sum(p.count for p in self.panels if p.index <= index * (1 + 1e-9))

    @cached_property
    def mu(self) -> list[np.ndarray]:
        """(n_r,) cosines of the nodes in every region."""
        found = []
        for region, index in enumerate(self.indices):
            n = self.count(region)
            mu = np.sqrt((index - self.s[:n]) * (index + self.s[:n])) / index
            for p in self.panels:  # the panel's own coordinate, without the rounding of the root
                if abs(p.index - index) <= 1e-9 * index:
                    mu[p.first : p.first + p.count] = self._panel_mu[p.first : p.first + p.count]
            found.append(mu)
        return found

    @cached_property
    def weights(self) -> list[np.ndarray]:
        """(n_r,) quadrature weights dmu of the nodes in every region."""
        return [
            self.etendue[: len(mu)] / (index**2 * mu) for mu, index in zip(self.mu, self.indices, strict=True)
        ]


def _distinct(indices: Sequence[float]) -> list[float]:
    found: list[float] = []
    for index in sorted(float(n) for n in indices):
        if not found or index > found[-1] * (1 + 1e-9):
            found.append(index)
    return found


def _radau(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Radau nodes and weights on [-1, 1] with a node at 1, ascending (exact to degree 2 count - 2)."""
    x, w = roots_jacobi(count - 1, 1.0, 0.0)  # weight function 1 - x
    return np.append(x, 1.0), np.append(w / (1 - x), 2 / count**2)
