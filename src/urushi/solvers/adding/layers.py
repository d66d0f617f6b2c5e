"""The layers of a stack, each ready to give its operators for any azimuthal orders.

Every layer is asked for a few orders at a time, and for the nodes from `first` on: sharp stacks have thousands of
orders, and what they all need together does not fit in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from ...adding import Slab
from ...interfaces import Interface
from ...media import BoundMedium
from . import media, peak, retro, single
from .basis import Grid
from .delta_m import Truncated
from .operator import Operator
from .phase import MOST_TERMS, Phase
from .projection import Projection
from .smooth import smooth


class Layer(Protocol):
    """An interface or a medium on the nodes.

    Attributes:
        orders: azimuthal orders from this one on have no dense part.
    """

    orders: int

    def first(self, orders: range) -> int:
        """The nodes before this one have nothing dense of these orders."""

    def slab(self, orders: range, first: int) -> Slab:
        """The four operators between the nodes from `first` on."""


class SmoothLayer:
    """A smooth interface."""

    orders = 0

    def __init__(self, interface: Interface, grid: Grid, region: int) -> None:
        self._slab = smooth(interface, grid, region)

    def first(self, orders: range) -> int:
        return 0

    def slab(self, orders: range, first: int) -> Slab:
        return Slab(*(_cut(operator, first) for operator in self._slab))


class MediumLayer:
    """A homogeneous medium.

    Args:
        medium: with its numbers, in double precision.
        phase: its phase function as a series.
        grid, region: the nodes.
        tolerance: what of the phase function may be left out, relative to its peak.
        terms: how many terms of it to take instead.
        most: azimuthal orders to look for, at most.
        method: which solution, see `media.slab`.
    """

    def __init__(
        self,
        medium: BoundMedium,
        phase: Phase,
        grid: Grid,
        region: int,
        tolerance: float = 0.0,
        terms: int | None = None,
        most: int = MOST_TERMS,
        method: media.Method = media.METHODS[0],
    ) -> None:
        self.mu, self.weights, self.method = grid.mu[region], grid.weights[region], method
        self.truncated = (
            Truncated.fit(phase, self.mu, self.weights, tolerance)
            if terms is None
            else Truncated.of(phase, terms)
        )
        sharp = self.truncated.sharp
        self.projection = Projection(grid, region, len(self.truncated.moments)) if sharp else None
        depth, albedo = numbers(medium.depth), numbers(medium.albedo)
        self.depth, self.albedo = self.truncated.scale(depth, albedo)
        scatters = medium.scatters and bool(self.albedo.any() and self.depth.any())
        self._last: tuple[range, int, media.Scattering] | None = None
        self.orders = min(len(self.truncated.moments), most) if scatters else 0

    def first(self, orders: range) -> int:
        return 0

    def _scattering(self, orders: range, first: int) -> media.Scattering:
        if self._last is None or self._last[:2] != (orders, first):
            self._last = orders, first, self._scattered_by(self.truncated, orders, first)
        return self._last[2]

    def _scattered_by(self, cut: Truncated, orders: range, first: int) -> media.Scattering:
        return media.Scattering.build(
            self.mu[first:],
            self.weights[first:],
            cut.moments,
            orders,
            cut.backward,
            self.projection if cut.sharp else None,
        )

    def slab(self, orders: range, first: int) -> Slab:
        if orders.start < self.orders:
            return media.slab(self._scattering(orders, first), self.depth, self.albedo, self.method)
        n = len(self.mu) - first
        r, t = Operator((n, n)), Operator((n, n), np.exp(-self.depth[:, None] / self.mu[first:]))
        return Slab(r, t, r, t)

    def once(self, orders: range, first: int) -> tuple[Operator, Operator]:
        """Light scattered once, reflected and transmitted, by the same series; and what else has a closed form."""
        n = len(self.mu) - first
        if orders.start >= self.orders:
            return Operator((n, n)), Operator((n, n))
        r, t = single.operators(self._scattering(orders, first), self.depth, self.albedo)
        cut = self.truncated
        if cut.again:
            again = self._again(range(2, peak.TIMES + 1) if cut.forward else (2, 3, 4), orders, first)
            if cut.forward:
                t += peak.operator(again, self.depth, self.albedo)
            else:
                sent, passed = retro.operators(cut.backward, again, self.depth, self.albedo)
                r, t = r + sent, t + passed
        return Operator((n, n), None, r), Operator((n, n), None, t)

    def _again(self, times: Sequence[int], orders: range, first: int) -> Iterator[media.Scattering]:
        """Light scattered so many times, as far as it is sharp and has a closed form."""
        low = media.Scattering.build(
            self.mu[first:],
            self.weights[first:],
            self.truncated.low,
            orders,
            projection=self.projection,
        )
        return self._scattering(orders, first).powers(times, low, self.truncated.backward)


class TurnedOver:
    """A layer met again upside down, as the lower face of a sheet is its upper one."""

    def __init__(self, layer: Layer) -> None:
        self._layer, self.orders = layer, layer.orders

    def first(self, orders: range) -> int:
        return self._layer.first(orders)

    def slab(self, orders: range, first: int) -> Slab:
        return self._layer.slab(orders, first).turned_over()


def numbers(value: Any) -> np.ndarray:
    """(C,) a number or a colour of a bound stack, out of Dr.Jit."""
    return np.atleast_1d(np.array(value, dtype=float)).reshape(-1)


def _cut(operator: Operator, first: int) -> Operator:
    shape = operator.shape[0] - first, operator.shape[1] - first
    delta = None if operator.delta is None else operator.delta[:, first:]
    dense = None if operator.dense is None else operator.dense[:, :, first:, first:]
    return Operator((max(shape[0], 0), max(shape[1], 0)), delta, dense)
