"""Rough interfaces as operators.

All four matrices of an interface for some orders come from `columns`; `balance` makes them reciprocal and gives every
node the factor by which its light adds up exactly: to what the columns themselves add up to, or to all of it where
the model says that nothing is lost.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...adding import Slab
from ...interfaces import BoundDielectric, Interface
from ...interfaces.compensated import Compensated
from ...interfaces.walked import Walked
from . import MOST_ORDERS, wide
from .balance import all_reciprocal, scales
from .basis import Grid
from .columns import Side, columns
from .operator import Operator

#: orders computed at once, at least, where they fit in so many bytes
AHEAD, AHEAD_MEMORY = 64, 1 << 28


class RoughLayer:
    """A rough interface of the stack.

    Args:
        interface: the boundary, isotropic, in double precision and with one value per parameter.
        grid: the nodes.
        region: the region above it.
        tolerance: azimuthal orders end where they hold less than this, relative to the largest.
        points: Gauss points per panel of all integrals: 6 are good to 2e-5 of the peak of a stack, 8 to 5e-6, 12 to
            1e-6; None for as many as the tolerance asks for.
        most: orders that anyone will ask for.
        every: whether all of them will be asked for: then they are computed at once, as far as they fit in twice the
            memory.

    Attributes:
        orders: azimuthal orders from this one on are negligible (see `first`).
        error: mean share of the light, over the hemisphere, that reciprocity took from or gave to the nodes before it
            was put right: how far the nodes are from resolving the interface.
    """

    def __init__(
        self,
        interface: Interface,
        grid: Grid,
        region: int,
        tolerance: float = 1e-4,
        points: int | None = None,
        most: int = MOST_ORDERS,
        every: bool = False,
    ) -> None:
        self.grid, self._every = grid, every
        self.points = points or (6 if tolerance >= 5e-5 else 8 if tolerance >= 5e-6 else 12)
        below = region if interface.opaque else region + 1
        self.above, self.below = grid.count(region), 0 if interface.opaque else grid.count(below)
        self.sides = {
            "r_top": Side(interface, grid, region, region, True),
            "t_down": Side(interface, grid, region, below, True),
            "r_bottom": Side(interface, grid, below, below, False),
            "t_up": Side(interface, grid, below, region, False),
        }
        if interface.opaque:
            del self.sides["t_down"], self.sides["r_bottom"], self.sides["t_up"]
        self._widths = np.array(
            [min(side.azimuth(j) for side in self.sides.values()) for j in range(self.above)]
        )
        # (1 + x) exp(-x), the height of order x / width of a lobe of GGX, is below the tolerance from here on.
        self._reach = np.log(1 / tolerance) + np.log(1 + 1.3 * np.log(1 / tolerance))
        self.orders = int(min(np.ceil(self._reach / self._widths.min()), most))
        self._wide: Slab | None = None
        if interface.stochastic:
            self.orders = min(max(self.orders, wide.ORDERS), most)
            self._wide = _four({name: wide.wide(side) for name, side in self.sides.items()})
        elif interface.flat:
            self.orders = 1  # Lambert's base knows no azimuth
        block = range(0, min(self._at_once(0, 0), self.orders))
        raw = self._raw(block, 0)
        zero = Slab(*(matrix[:, :1] for matrix in raw))
        sums = np.concatenate(
            [zero.r_top.sum(2) + zero.t_down.sum(2), zero.r_bottom.sum(2) + zero.t_up.sum(2)], axis=2
        )[:, 0]
        if lossless(interface):
            sums = np.ones_like(sums)
        slab = self._exact(raw, 0)
        # Kept, since only to the last digit of these matrices does the balance hold.
        self._zero = Slab(*(matrix[:, :1] for matrix in slab))
        self._ahead = block, 0, slab
        whole = np.block([[self._zero.r_top, self._zero.t_up], [self._zero.t_down, self._zero.r_bottom]])[
            :, 0
        ]
        self.scale = scales(whole, sums)
        weight = np.concatenate([grid.etendue[: self.above], grid.etendue[: self.below]])
        self.error = float((np.abs(whole.sum(1) - sums) @ weight).max() / weight.sum())

    def first(self, orders: range) -> int:
        """The nodes before this one have nothing of these orders."""
        if orders.start == 0 or self.orders == 1:
            return 0
        lit = np.flatnonzero(self._widths * orders.start < self._reach)
        return int(lit[0]) if len(lit) else self.above

    def _at_once(self, start: int, first: int) -> int:
        """How many orders to compute together, beginning with this one and on the nodes from `first` on."""
        size = 8 * 4 * 3 * (len(self.grid.s) - first) ** 2
        few = max(AHEAD, start)
        left = self.orders - start
        wanted = left if self._every or left <= 1.5 * few else few
        return max(min(wanted, (2 if self._every else 1) * AHEAD_MEMORY // size), 1)

    def _raw(self, orders: range, first: int) -> Slab:
        """The four matrices as columns give them."""
        found = _four({k: columns(side, orders, self.points, first) for k, side in self.sides.items()})
        if self._wide is None or orders.start >= wide.ORDERS:
            return found
        both = []
        for sharp, more in zip(found, self._wide, strict=True):
            part = more[:, orders.start : orders.stop, first:, first:]
            colours = max(len(sharp), len(part))
            total = np.array(np.broadcast_to(sharp, (colours, *sharp.shape[1:])))
            total[:, : part.shape[1]] += part
            both.append(total)
        return Slab(*both)

    def _exact(self, raw: Slab, first: int) -> Slab:
        w = self.grid.etendue
        return all_reciprocal(raw, w[first : self.above], w[first : self.below])

    def _computed(self, orders: range, first: int) -> Slab:
        """The reciprocal matrices of some orders. Many are computed at once, since that costs little more than few."""
        ahead, start, _ = self._ahead
        if not (ahead.start <= orders.start and orders.stop <= ahead.stop and start <= first):
            more = self._at_once(orders.start, first)
            block = range(orders.start, min(max(orders.stop, orders.start + more), self.orders))
            slab = self._exact(self._raw(block, first), first)
            if block.start == 0:
                for matrix, kept in zip(slab, self._zero, strict=True):
                    matrix[:, 0] = kept[:, 0, first:, first:]
            self._ahead = block, first, slab
        block, start, slab = self._ahead
        some, cut = slice(orders.start - block.start, orders.stop - block.start), first - start
        return Slab(*(matrix[:, some, cut:, cut:] for matrix in slab))

    def slab(self, orders: range, first: int = 0) -> Slab:
        """The four operators between the nodes from `first` on, for some orders."""
        n_above, n_below = self.above - first, max(self.below - first, 0)
        shapes = ((n_above, n_above), (n_below, n_above), (n_below, n_below), (n_above, n_below))
        orders = range(orders.start, min(orders.stop, self.orders))
        if len(orders) == 0 or n_above <= 0:
            return Slab(*(Operator(shape) for shape in shapes))
        slab = self._computed(orders, first)
        above = self.scale[:, None, first : self.above]
        below = self.scale[:, None, self.above + first :]
        factors = ((above, above), (below, above), (below, below), (above, below))
        return Slab(
            *(
                Operator(
                    shape, None, matrix * out[..., :, None] * into[..., None, :] if matrix.size else None
                )
                for shape, matrix, (out, into) in zip(shapes, slab, factors, strict=True)
            )
        )


def _four(found: dict[str, Any]) -> Slab:
    """All four matrices, empty ones below an opaque interface."""
    if len(found) == 1:
        c, m, _, n = found["r_top"].shape
        found["t_down"] = np.zeros((c, m, 0, n))
        found |= {"r_bottom": np.zeros((c, m, 0, 0)), "t_up": np.zeros((c, m, n, 0))}
    return Slab(**found)


def lossless(interface: Interface) -> bool:
    """Whether the model says that all light leaves again: nothing is lost between facets, and none absorbs."""
    if isinstance(interface, Compensated):
        single = interface.single
    elif isinstance(interface, Walked):
        single = interface.once
    else:
        return False
    # A conductor of index 0 - i k is the ideal mirror.
    return not interface.opaque or not np.any(np.array(single.eta))


def same_surface(one: Interface, other: Interface) -> bool:
    """Whether two boundaries are known to have the same facets, so that indices are all they can differ in."""
    if not (type(one) is type(other) is BoundDielectric) or one.facets is None or other.facets is None:
        return False
    a, b = one.facets, other.facets
    alphas = (np.array(x) for facets in (a, b) for x in (facets.alpha_x, facets.alpha_y))
    return (a.ggx, a.correlated) == (b.ggx, b.correlated) and len({float(alpha[0]) for alpha in alphas}) == 1
