"""The directional basis: quadrature in the cosine, one set of nodes for all media.

Snell's invariant s = n sin(theta) does not change at a smooth interface. So the nodes are placed in s once, and a
region of index n owns those with s < n: a smooth interface maps node j above to node j below, exactly. Panels break at
every index that occurs, so total internal reflection begins on the boundary of a panel.

Within a panel the cosine of its medium (the rarest that light of these s still enters) is mu = high x^2, and x has
the nodes of Gauss & Jacobi for the weight x dx. Light that leaves a medium under a grazing angle depends on it like
mu log mu, and on x smoothly enough: at the same number of nodes a hundred times more accurate than nodes in mu. The
first panel has, after Radau, a node at normal incidence; no node lies at the horizon of any medium.

Between nodes, quantities are smooth in the angle psi = arccos x: towards normal incidence psi goes like theta, and an
azimuthal order m like theta^m, even or odd; at the upper end of any other panel, where total reflection begins,
everything on this side is smooth in mu, thus even in psi. So the nodes continue as their mirror images at psi < 0.

The flux that crosses a plane in a ring of directions is W = n^2 mu dmu (etendue), the same number in every region:
theory (basis.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import roots_jacobi

from ...errors import UrushiError

#: indices closer than this, relatively, count as one
SAME = 1e-9


@dataclass(frozen=True)
class Panel:
    """Consecutive nodes between two breaks of s.

    Attributes:
        index: index of the rarest medium that sees the panel; its cosine is mu = high x^2.
        low, high: the panel's ends in that cosine.
        first, count: which nodes.
        squeeze: c of x = y / sqrt(y^2 + c^2 (1 - y^2)), y at the nodes of Gauss: 1 leaves x itself, and less brings
            nodes closer together towards normal incidence, by that factor.
    """

    index: float
    low: float
    high: float
    first: int
    count: int
    squeeze: float = 1.0

    @property
    def nodes(self) -> slice:
        """The panel's nodes."""
        return slice(self.first, self.first + self.count)

    def coordinate(self, mu: np.ndarray) -> np.ndarray:
        """y of cosines in the panel's medium."""
        square = np.clip(mu / self.high, 0, 1)
        if self.squeeze == 1:
            return np.sqrt(square)
        scaled = self.squeeze**2 * square
        return np.sqrt(scaled / (1 - square + scaled))

    def cosine(self, y: np.ndarray) -> np.ndarray:
        """The cosine in the panel's medium."""
        return self.high * (y**2 / self._spread(y))

    def density(self, y: np.ndarray) -> np.ndarray:
        """dmu / d(y^2)."""
        return self.high * (self.squeeze / self._spread(y)) ** 2

    def _spread(self, y: np.ndarray) -> np.ndarray:
        found: np.ndarray = (
            y**2 + self.squeeze**2 * ((1 - y) * (1 + y)) if self.squeeze != 1 else np.ones_like(y)
        )
        return found


@dataclass(frozen=True)
class Stencil:
    """How to interpolate between nodes: value = sum over k of weight[:, k] * values[node[:, k]].

    Attributes:
        node: (N, K) numbers of nodes; a node may occur twice.
        even, odd: (N, K) weights for azimuthal orders that are even or odd. They differ near normal incidence only,
            beyond which the nodes of the opposite azimuth follow, where odd orders have the other sign.
    """

    node: np.ndarray
    even: np.ndarray
    odd: np.ndarray


@dataclass(frozen=True)
class Grid:
    """Nodes of all regions of a stack.

    Attributes:
        indices: index of every region, top to bottom.
        s: (n,) Snell's invariant of the nodes, ascending from 0 (normal incidence).
        etendue: (n,) n^2 mu dmu of the nodes, the same in every region that has them.
        x: (n,) coordinate y of the nodes in their panel, descending from 1 to 0 in each.
        panels: the panels, by ascending s.
    """

    indices: tuple[float, ...]
    s: np.ndarray
    etendue: np.ndarray
    x: np.ndarray
    panels: tuple[Panel, ...]

    @classmethod
    def build(cls, indices: Sequence[float], counts: int | Sequence[int], squeeze: float = 1.0) -> Grid:
        """A grid.

        Args:
            indices: index of every region, top to bottom; those closer than 1e-9 count as one.
            counts: nodes per panel, by ascending index, at least 2; one number gives every panel as many as its share
                of the cosine deserves, at least 8.
            squeeze: that of the first panel (see `Panel`).

        Raises:
            UrushiError: counts that do not fit the panels.
        """
        breaks = _distinct(indices)
        if not isinstance(counts, int) and (len(counts) != len(breaks) or min(counts) < 2):
            raise UrushiError(
                f"grid: found {list(counts)} nodes per panel; allowed: {len(breaks)} numbers, one for each "
                "different index, each at least 2"
            )
        before = 0.0
        panels: list[Panel] = []
        x: list[np.ndarray] = []
        s: list[np.ndarray] = []
        etendue: list[np.ndarray] = []
        first = 0
        for j, index in enumerate(breaks):
            high = np.sqrt((index - before) * (index + before)) / index
            count = max(int(np.ceil(counts * np.sqrt(high))), 8) if isinstance(counts, int) else counts[j]
            nodes, weights = _rule(count, radau=j == 0)
            panel = Panel(index, 0.0, high, first, count, squeeze if j == 0 else 1.0)
            panels.append(panel)
            mu = panel.cosine(nodes)
            x.append(nodes)
            # (1 - mu)(1 + mu) keeps the digits near normal incidence.
            s.append(index * np.sqrt((1 - mu) * (1 + mu)))
            etendue.append(index**2 * mu * (panel.density(nodes) * weights))
            first += count
            before = index
        return cls(
            tuple(float(n) for n in indices),
            np.concatenate(s),
            np.concatenate(etendue),
            np.concatenate(x),
            tuple(panels),
        )

    def count(self, region: int) -> int:
        """How many nodes a region has."""
        index = self.indices[region]
        return sum(p.count for p in self.panels if p.index <= index * (1 + SAME))

    @cached_property
    def mu(self) -> list[np.ndarray]:
        """(n_r,) cosines of the nodes in every region."""
        found: dict[float, np.ndarray] = {}
        for region, index in enumerate(self.indices):
            if index in found:
                continue
            n = self.count(region)
            mu = np.sqrt((index - self.s[:n]) * (index + self.s[:n])) / index
            for p in self.panels:  # the panel's own coordinate, without the rounding of the root
                if abs(p.index - index) <= SAME * index:
                    mu[p.nodes] = p.cosine(self.x[p.nodes])
            found[index] = mu
        return [found[index] for index in self.indices]

    @cached_property
    def weights(self) -> list[np.ndarray]:
        """(n_r,) quadrature weights dmu of the nodes in every region."""
        found: dict[float, np.ndarray] = {}
        for mu, index in zip(self.mu, self.indices, strict=True):
            if index not in found:
                found[index] = self.etendue[: len(mu)] / (index**2 * mu)
        return [found[index] for index in self.indices]

    def stencil(self, region: int, mu: np.ndarray, order: int = 8) -> Stencil:
        """Local Lagrange interpolation in psi at any cosines of a region.

        What is smoothest, and so interpolates best, is A[o, i] / w_o (mu_i + mu_o) / mu_o, less what is known in
        closed form (light scattered once): at 24 nodes and order 8 good to 1e-6 for a phase function of g = 0.5.

        Args:
            region: which.
            mu: (N,) cosines in it, in [0, 1].
            order: nodes per point.

        Raises:
            UrushiError: a cosine out of range.
        """
        mu = np.asarray(mu, float)
        if mu.size and not (mu.min() >= 0 and mu.max() <= 1):
            raise UrushiError(f"grid: found a cosine {mu.min()} to {mu.max()}; allowed: 0 to 1")
        index = self.indices[region]
        sin_sq = (1 - mu) * (1 + mu)
        node = np.zeros((len(mu), order), int)
        even, odd = np.zeros((2, len(mu), order))
        before = -1.0
        for p in self.panels:
            if p.index > index * (1 + SAME):
                break
            own = abs(p.index - index) <= SAME * index
            s = index * np.sqrt(sin_sq)
            here = np.flatnonzero((s > before) if own else (s > before) & (s <= p.index))
            before = p.index
            cos = mu[here] if own else np.sqrt(np.maximum(1 - (index / p.index) ** 2 * sin_sq[here], 0))
            psi = np.arccos(self.x[p.nodes])
            number, sign = np.arange(p.first, p.first + p.count), np.ones(p.count)
            own_image = int(p.first == 0)  # the node at normal incidence
            psi = np.concatenate([-psi[own_image:][::-1], psi])
            number = np.concatenate([number[own_image:][::-1], number])
            sign = np.concatenate([np.full(p.count - own_image, -1.0 if own_image else 1.0), sign])
            at = np.arccos(p.coordinate(cos))
            size = min(order, len(psi))
            start = np.clip(np.searchsorted(psi, at) - size // 2, 0, len(psi) - size)
            some = start[:, None] + np.arange(size)
            weight = _lagrange(psi[some], at)
            node[here[:, None], np.arange(size)] = number[some]
            even[here[:, None], np.arange(size)] = weight
            odd[here[:, None], np.arange(size)] = weight * sign[some]
        return Stencil(node, even, odd)

    def functions(self, panel: Panel, mu: np.ndarray, odd: bool = False) -> np.ndarray:
        """Lagrange's basis functions of all nodes of a panel: smooth, 1 at their own node and 0 at all others.

        Args:
            panel: which.
            mu: (N,) cosines in the medium of the panel.
            odd: True for odd azimuthal orders, which go to 0 like sin(theta) in the first panel.

        Returns:
            (N, count).
        """
        x, at = self.x[panel.nodes], panel.coordinate(mu)
        if not (odd and panel.first == 0):
            return _barycentric(x, at)
        own = panel.cosine(x[1:])
        slope = np.sqrt((1 - mu) * (1 + mu))[:, None] / np.sqrt((1 - own) * (1 + own))
        return np.concatenate([np.zeros((len(at), 1)), slope * _barycentric(x[1:], at)], axis=1)

    def odd_factors(self, panel: Panel, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """What makes `functions` those of odd orders: f (N,) and g (count,), to be multiplied with point by point and
        node by node; None where they are the same.

        A basis function of all nodes but the first is one of all times (x_k - x_0) / (x - x_0).
        """
        if panel.first:
            return None
        x, at = self.x[panel.nodes], panel.coordinate(mu)
        own, away = panel.cosine(x), at - x[0]
        sine = np.sqrt((1 - own) * (1 + own))
        slope = np.sqrt((1 - mu) * (1 + mu))
        # Next to the normal both go to 0: a point upon the first node has no light of odd orders.
        return np.where(away < 0, slope / np.where(away < 0, away, 1), 0), (x - x[0]) / np.where(
            sine > 0, sine, 1
        )


def _distinct(indices: Sequence[float]) -> list[float]:
    found: list[float] = []
    for index in sorted(float(n) for n in indices):
        if not found or index > found[-1] * (1 + SAME):
            found.append(index)
    return found


@lru_cache(maxsize=256)
def _rule(count: int, radau: bool) -> tuple[np.ndarray, np.ndarray]:
    """Nodes x, descending in [0, 1], and weights for integrals over x^2, exact to degree 2 count - 1 in x.

    With `radau` there is a node at 1, and one degree less.
    """
    if radau:
        t, w = roots_jacobi(count - 1, 1.0, 1.0)  # weight function (1 - t)(1 + t)
        w = w / (1 - t)
        t, w = np.append(t, 1.0), np.append(w, 2 - w.sum())
    else:
        t, w = roots_jacobi(count, 0.0, 1.0)
    return 0.5 * (1 + t[::-1]), 0.5 * w[::-1]


def _lagrange(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(N, K) weights of Lagrange's polynomial through nodes (N, K) at the points (N,)."""
    found = np.ones(nodes.shape)
    for j in range(nodes.shape[1]):
        for k in range(nodes.shape[1]):
            if k != j:
                found[:, j] *= (at - nodes[:, k]) / (nodes[:, j] - nodes[:, k])
    return found


def _barycentric(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(N, K) the same through all nodes (K,) at once, which may be hundreds (Berrut & Trefethen 2004)."""
    found = at[:, None] - nodes
    row, column = np.nonzero(found == 0)
    found[row, column] = 1
    np.divide(_shares(nodes.tobytes()), found, out=found)
    found[row] = 0
    found[row, column] = 1
    found /= found.sum(axis=1, keepdims=True)
    return found


@lru_cache(maxsize=64)
def _shares(nodes: bytes) -> np.ndarray:
    """Barycentric weights of nodes, given as their bytes; any common factor is as good."""
    x = np.frombuffer(nodes)
    apart = x[:, None] - x
    np.fill_diagonal(apart, 1)
    size = -np.log(np.abs(apart)).sum(axis=1)
    found: np.ndarray = np.prod(np.sign(apart), axis=1) * np.exp(size - size.max())
    return found
