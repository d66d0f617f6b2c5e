"""From a stack to its operators: all layers on one set of nodes, added from the bottom up, a few orders at a time.

Azimuthal orders know nothing of one another. So the stack is solved for the first orders, then for the next, until
what they hold is too small to matter or no layer has any more. What the BSDF evaluates in closed form (one meeting
with the outermost interface, or one collision behind a smooth one) is taken off before anything is stored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...adding import Slab, add, from_above
from ...interfaces import Null
from ..bound import BoundStack
from ..direct import direct_is_certain
from . import MOST_ORDERS, once, through
from .basis import Grid
from .layers import Layer, MediumLayer, SmoothLayer
from .operator import OPERATORS, Operator
from .phase import Phase
from .smooth import nothing
from .solution import Block, Part, Solution
from .table import SIDES

#: bytes that the dense arrays of one layer may take at a time; and those of the first orders, where it is the calls
#: that take time, not the numbers
MEMORY, CACHE = 1 << 26, 1 << 17
#: the search ends after so many orders in a row that hold next to nothing
QUIET = 4
#: cosine of incidence from which on each node's own light counts, and how much more of it may be left out
GRAZING, OWN = 0.06, 2


@dataclass(frozen=True)
class Found:
    """The operators of a whole stack for some orders, and what of them has a closed form."""

    orders: range
    first: int
    whole: Slab
    closed: dict[tuple[bool, bool], Operator]


def solve_on(
    stack: BoundStack,
    grid: Grid,
    layers: Sequence[Layer | None],
    colours: int,
    tolerance: float,
    complete: bool = False,
    count: int | None = None,
) -> Solution:
    """Solve a stack on given nodes.

    Args:
        stack: with its numbers.
        grid: the nodes.
        layers: top to bottom, as `bound` orders them: interface (None for no interface), medium (where there is one),
            interface, ...
        colours: C.
        tolerance: orders that hold less than this, relative to the largest of their kind, end the search.
        complete: look for orders of what has a closed form as well: the BSDF needs none, but other layers on or below
            this stack do.
        count: how many orders to solve instead, as far as they hold anything.

    Returns:
        the solution; its diagnostics name the sizes only.
    """
    sides = SIDES[:1] if stack.opaque else SIDES
    there = [layer for layer in layers if layer is not None]
    gathered = {side: _Gathered(side, grid, colours, complete) for side in sides}
    distinct: Sequence[tuple[bool, bool]] = sides
    most = max((layer.orders for layer in there), default=0)
    if count is not None:
        most, tolerance = min(most, count), 0.0
    heights = np.zeros((0, 2))
    for orders in _chunks(most, grid, colours):
        found = _solve_orders(stack, grid, layers, orders, _first(there, orders), not complete)
        if found.whole.symmetric:
            distinct = SIDES[:2]  # from below it looks as from above
        heights = np.append(heights, np.max([gathered[side].add(found) for side in distinct], axis=0), axis=0)
        if len(_loud(heights, tolerance)) + QUIET <= len(heights):
            break
    used = len(heights) if complete and count is None else max(len(_loud(heights, tolerance)), 1)
    for side in distinct:
        gathered[side].cut(used)
    parts = {
        side: gathered[side if side in distinct else (True, side[0] == side[1])].part(side) for side in sides
    }
    sizes = {"nodes": len(grid.s), "orders": used, "complete": complete}
    return Solution(grid, parts, closed_form(stack, not complete), colours, sizes)


def cut(solution: Solution, stop: int) -> Solution:
    """A solution without its orders from `stop` on; what has a closed form keeps all of them in the BSDF."""
    lists = {id(blocks): blocks for part in solution.parts.values() for blocks in (part.blocks, part.rest)}
    few = {
        k: [_cut(block, stop) for block in blocks if block.orders.start < stop] for k, blocks in lists.items()
    }
    parts = {
        side: replace(part, blocks=few[id(part.blocks)], rest=few[id(part.rest)])
        for side, part in solution.parts.items()
    }
    return replace(solution, parts=parts)


class _Gathered:
    """What is found of one side, group by group of orders.

    Args:
        side: (from above, to above).
        grid, colours, complete: see `solve_on`.
    """

    def __init__(self, side: tuple[bool, bool], grid: Grid, colours: int, complete: bool) -> None:
        self.side, self.grid, self.colours, self.complete = side, grid, colours, complete
        self.delta: np.ndarray | None = None
        self.blocks: list[Block] = []
        self.rest: list[Block] = []
        self.highest = np.zeros(len(grid.mu[0 if side[0] else -1]))

    def add(self, found: Found) -> np.ndarray:
        """Take some orders; returns how high each is, at most and, for light from any node, relative to its own.

        Lobes of grazing light are narrow in azimuth, but not as high as others.
        """
        operator, closed = _side(found.whole, self.side), found.closed.get(self.side)
        if found.orders.start == 0:
            self.delta = _coloured(operator.delta, self.colours)
        dense, height = operator.dense, np.zeros((len(found.orders), 2))
        if closed is not None and closed.dense is not None:
            self.rest.append(_block(found.orders, found.first, closed.dense, self.colours))
            dense = closed.dense * -1 if dense is None else dense - closed.dense
        if dense is not None:
            self.blocks.append(_block(found.orders, found.first, dense, self.colours))
            counted = operator.dense if self.complete and operator.dense is not None else dense
            some = np.abs(counted * self._scale(found.first)).max(axis=(0, 2), initial=0.0)
            own = self.highest[found.first :]
            np.maximum(own, some.max(axis=0, initial=0.0), out=own)
            seen = self.grid.mu[0 if self.side[0] else -1][found.first :] > GRAZING
            relative = some / np.maximum(own, 1e-6 * self.highest.max(initial=1e-300)) * seen
            height[: len(some), 0] = some.max(axis=1, initial=0.0)
            height[: len(some), 1] = relative.max(axis=1, initial=0.0)
        return height

    def _scale(self, first: int) -> np.ndarray:
        """What turns operators into values that can be compared: flux density over the cosine."""
        i, o = (0 if above else -1 for above in self.side)
        mu_i, mu_o, weight = self.grid.mu[i][first:], self.grid.mu[o][first:], self.grid.weights[o][first:]
        found: np.ndarray = (mu_o[:, None] + mu_i) / (mu_o * weight)[:, None]
        return found

    def cut(self, stop: int) -> None:
        """Leave out the orders from `stop` on."""
        self.blocks = [_cut(block, stop) for block in self.blocks if block.orders.start < stop]
        self.rest = [_cut(block, stop) for block in self.rest if block.orders.start < stop]

    def part(self, side: tuple[bool, bool]) -> Part:
        """All of it, as the part of a side that looks like this one."""
        return Part(*side, self.delta, self.blocks, self.rest)


def _first(layers: Sequence[Layer], orders: range) -> int:
    """The first node that any layer has something of these orders for."""
    return min((layer.first(orders) for layer in layers if layer.orders > orders.start), default=0)


def _loud(heights: np.ndarray, tolerance: float) -> range:
    """Orders up to the last above the tolerance, relative to the highest; or, for some node, above `OWN` times it."""
    every, own = heights.T
    found = np.flatnonzero((every > tolerance * every.max(initial=0.0)) | (own > OWN * tolerance))
    return range(int(found[-1]) + 1 if len(found) else 0)


def _cut(block: Block, stop: int) -> Block:
    """A block without its orders from `stop` on."""
    if block.orders.stop <= stop:
        return block
    orders = range(block.orders.start, min(block.orders.stop, stop))
    return Block(orders, block.first, block.values[:, : len(orders)])


def _chunks(most: int, grid: Grid, colours: int) -> Iterator[range]:
    """Ranges of orders, short ones first: many stacks need but a few."""
    if most == 0:
        yield range(0, 1)
        return
    bytes_each = 8 * colours * len(grid.s) ** 2
    fit = max(MEMORY // bytes_each, 1)
    start, size = 0, min(max(4, CACHE // bytes_each), fit)
    while start < min(most, MOST_ORDERS):
        stop = min(start + size, most)
        yield range(start, stop)
        start, size = stop, min(max(4, stop // 2), fit)


def _solve_orders(
    stack: BoundStack, grid: Grid, layers: Sequence[Layer | None], orders: range, first: int, more: bool
) -> Found:
    slabs = [None if layer is None else layer.slab(orders, first) for layer in layers]
    there = [slab for slab in slabs if slab is not None] or [nothing(len(grid.s) - first)]
    below = there[-1]
    for slab in reversed(there[:-1]):
        if stack.opaque:
            below = Slab(*from_above(slab, below, OPERATORS), below.r_bottom, below.t_up)
        else:
            below = add(slab, below, OPERATORS)
    return Found(orders, first, below, _closed(stack, layers, slabs, orders, first, more))


def _closed(
    stack: BoundStack,
    layers: Sequence[Layer | None],
    slabs: Sequence[Slab | None],
    orders: range,
    first: int,
    more: bool,
) -> dict[tuple[bool, bool], Operator]:
    """What has a closed form: the outermost interface alone, or one collision behind it where it is smooth; and, if
    `more`, one rough interface behind smooth ones.
    """
    found: dict[tuple[bool, bool], Operator] = {}
    top, bottom = slabs[0], slabs[-1]
    if direct_is_certain(stack):
        if top is not None:
            found[True, True] = top.r_top
        if bottom is not None and not stack.opaque:
            found[False, False] = bottom.r_bottom
        if len(stack.interfaces) == 1 and not stack.opaque and top is not None:
            found[True, False], found[False, True] = top.t_down, top.t_up
    if len(layers) < 2:
        return found
    light: dict[int, tuple[Operator, Operator]] = {}
    for above, to_above in SIDES:
        number = 1 if above else len(layers) - 2
        medium = layers[number]
        if not isinstance(medium, MediumLayer) or not once.covers(stack, above, to_above):
            continue
        if number not in light:
            light[number] = medium.once(orders, first)
        found[above, to_above] = _once(light[number], (top, bottom), (above, to_above))
    for side in SIDES if more else ():
        behind = through.operator(stack, slabs, side)
        if behind is not None:
            found[side] = found[side] + behind if once.covers(stack, *side) else behind
    return found


def _once(
    light: tuple[Operator, Operator], ends: tuple[Slab | None, Slab | None], side: tuple[bool, bool]
) -> Operator:
    """Light scattered once (reflected, transmitted) through the outer interfaces: `ends`, the upper one first."""
    from_above, to_above = side
    into, out = (ends[0 if above else 1] for above in side)
    found = light[0] if from_above == to_above else light[1]
    if into is not None:
        found = found @ (into.t_down if from_above else into.t_up)
    if out is not None:
        found = (out.t_up if to_above else out.t_down) @ found
    return found


def scattered_once(
    stack: BoundStack,
    phases: Sequence[Phase],
    solution: Solution,
    side: tuple[bool, bool],
    blocks: Sequence[tuple[range, int]],
) -> list[Block]:
    """What `Part.rest` has where a stack covers light scattered once, out of its closed form.

    Args:
        stack: with its numbers; `once.covers` its `side`.
        phases: those of its media.
        solution: its grid, terms and colours.
        side: (from above, to above).
        blocks: orders and first node of each block.
    """
    grid, last = solution.grid, len(stack.interfaces) - 1
    region = 1 if side[0] else last
    medium = stack.media[region]
    assert medium is not None
    scattering = MediumLayer(medium, phases[0 if side[0] else -1], grid, region, terms=solution.terms[region])
    used = {0 if above else last for above in side}
    outer = [
        SmoothLayer(interface, grid, k) if k in used and not isinstance(interface, Null) else None
        for k, interface in ((0, stack.interfaces[0]), (last, stack.interfaces[-1]))
    ]
    found = []
    for orders, first in blocks:
        top, bottom = (None if layer is None else layer.slab(orders, first) for layer in outer)
        operator = _once(scattering.once(orders, first), (top, bottom), side)
        if operator.dense is not None:
            found.append(_block(orders, first, operator.dense, solution.colours))
    return found


def _side(slab: Slab, side: tuple[bool, bool]) -> Operator:
    operator: Operator = {
        (True, True): slab.r_top,
        (True, False): slab.t_down,
        (False, False): slab.r_bottom,
        (False, True): slab.t_up,
    }[side]
    return operator


def _block(orders: range, first: int, dense: np.ndarray, colours: int) -> Block:
    present = range(orders.start, orders.start + dense.shape[1])
    return Block(
        present,
        first,
        dense if len(dense) == colours else np.broadcast_to(dense, (colours, *dense.shape[1:])),
    )


def _coloured(delta: np.ndarray | None, colours: int) -> np.ndarray | None:
    return None if delta is None else np.broadcast_to(delta, (colours, delta.shape[1]))


def closed_form(stack: BoundStack, more: bool = False) -> str | None:
    """What the BSDF of a stack adds exactly: see `Solution.closed_form`; with one rough interface behind smooth ones if
    `more`.
    """
    behind = more and through.anywhere(stack)
    if any(once.covers(stack, above, above) for above in ((True,) if stack.opaque else (True, False))):
        return "single, through" if behind else "single"
    if not direct_is_certain(stack):
        return None
    return "through" if behind else "interface"
