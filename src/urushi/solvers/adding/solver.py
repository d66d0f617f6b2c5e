"""From a stack to its operators: all layers on one set of nodes, added from the bottom up, a few orders at a time.

Azimuthal orders know nothing of one another. So the stack is solved for the first orders, then for the next, until
what they hold is too small to matter or no layer has any more. What the BSDF evaluates in closed form (one meeting
with the outermost interface, or one collision behind a smooth one) is taken off before anything is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...adding import Slab, add, from_above
from ..bound import BoundStack
from ..direct import direct_is_certain
from . import once
from .basis import Grid
from .layers import Layer, MediumLayer, SmoothLayer
from .operator import OPERATORS, Operator
from .phase import Phase
from .solution import Block, Part, Solution

#: bytes that the dense arrays of one layer may take at a time
MEMORY = 1 << 26
#: the search ends after so many orders in a row that hold next to nothing
QUIET = 4
#: more orders than this are not looked for
MOST_ORDERS = 1 << 14

#: what makes the layers of a stack on a grid
Prepare = Callable[[Grid], Sequence[Layer]]


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
    layers: Sequence[Layer],
    colours: int,
    tolerance: float,
    complete: bool = False,
) -> Solution:
    """Solve a stack on given nodes.

    Args:
        stack: with its numbers.
        grid: the nodes.
        layers: top to bottom, as `bound` orders them: interface, medium (where there is one), interface, ...
        colours: C.
        tolerance: orders that hold less than this, relative to the largest of their kind, end the search.
        complete: look for orders of what has a closed form as well: the BSDF needs none, but other layers on or below
            this stack do.

    Returns:
        the solution; its diagnostics name the sizes only.
    """
    sides = [(True, True)] if stack.opaque else [(a, b) for a in (True, False) for b in (True, False)]
    blocks: dict[tuple[bool, bool], list[Block]] = {side: [] for side in sides}
    rest: dict[tuple[bool, bool], list[Block]] = {side: [] for side in sides}
    delta: dict[tuple[bool, bool], np.ndarray | None] = {}
    most = max(layer.orders for layer in layers)
    heights = np.zeros(0)
    for orders in _chunks(most, grid, colours):
        found = _solve_orders(stack, layers, orders, _first(layers, orders))
        weight = _heights(grid, stack, found.first)
        height = np.zeros(len(orders))
        for side in sides:
            operator = _side(found.whole, side)
            if side not in delta:
                delta[side] = _coloured(operator.delta, colours)
            dense = operator.dense
            closed = found.closed.get(side)
            if closed is not None and closed.dense is not None:
                rest[side].append(_block(orders, found.first, closed.dense, colours))
                dense = closed.dense * -1 if dense is None else dense - closed.dense
            if dense is not None:
                blocks[side].append(_block(orders, found.first, dense, colours))
                counted = operator.dense if complete and operator.dense is not None else dense
                some = np.abs(counted * weight[side]).max(axis=(0, 2, 3), initial=0.0)
                height[: len(some)] = np.maximum(height[: len(some)], some)
        heights = np.append(heights, height)
        if len(_loud(heights, tolerance)) + QUIET <= len(heights):
            break
    used = len(heights) if complete else max(len(_loud(heights, tolerance)), 1)
    for every in (blocks, rest):
        for side in sides:
            every[side] = [_cut(block, used) for block in every[side] if block.orders.start < used]
    parts = {side: Part(*side, delta.get(side), blocks[side], rest[side]) for side in sides}
    sizes = {"nodes": len(grid.s), "orders": used, "complete": complete}
    return Solution(grid, parts, closed_form(stack), colours, sizes)


def _first(layers: Sequence[Layer], orders: range) -> int:
    """The first node that any layer has something of these orders for."""
    return min((layer.first(orders) for layer in layers if layer.orders > orders.start), default=0)


def _loud(heights: np.ndarray, tolerance: float) -> range:
    """Orders up to the last that is above the tolerance, relative to the highest."""
    found = np.flatnonzero(heights > tolerance * heights.max(initial=0.0))
    return range(int(found[-1]) + 1 if len(found) else 0)


def _cut(block: Block, stop: int) -> Block:
    """A block without its orders from `stop` on."""
    orders = range(block.orders.start, min(block.orders.stop, stop))
    return Block(orders, block.first, block.values[:, : len(orders)])


def _chunks(most: int, grid: Grid, colours: int) -> Iterator[range]:
    """Ranges of orders, short ones first: many stacks need but a few."""
    if most == 0:
        yield range(0, 1)
        return
    fit = max(MEMORY // (8 * colours * len(grid.s) ** 2), 1)
    start, size = 0, min(4, fit)
    while start < min(most, MOST_ORDERS):
        stop = min(start + size, most)
        yield range(start, stop)
        start, size = stop, min(max(4, stop // 2), fit)


def _solve_orders(stack: BoundStack, layers: Sequence[Layer], orders: range, first: int) -> Found:
    slabs = [layer.slab(orders, first) for layer in layers]
    there = [
        slab
        for slab, layer in zip(slabs, layers, strict=True)
        if not (isinstance(layer, SmoothLayer) and layer.absent)
    ] or slabs[:1]
    below = there[-1]
    for slab in reversed(there[:-1]):
        if stack.opaque:
            below = Slab(*from_above(slab, below, OPERATORS), below.r_bottom, below.t_up)
        else:
            below = add(slab, below, OPERATORS)
    return Found(orders, first, below, _closed(stack, layers, slabs, orders, first))


def _closed(
    stack: BoundStack, layers: Sequence[Layer], slabs: Sequence[Slab], orders: range, first: int
) -> dict[tuple[bool, bool], Operator]:
    """What has a closed form: the outermost interface alone, or one collision behind it where it is smooth."""
    found: dict[tuple[bool, bool], Operator] = {}
    if direct_is_certain(stack):
        found[True, True] = slabs[0].r_top
        if not stack.opaque:
            found[False, False] = slabs[-1].r_bottom
        if len(stack.interfaces) == 1 and not stack.opaque:
            found[True, False], found[False, True] = slabs[0].t_down, slabs[0].t_up
    if len(layers) < 2:
        return found
    for above in (True, False):
        medium = layers[1 if above else -2]
        if not isinstance(medium, MediumLayer):
            continue
        sides = [(above, to) for to in (above, not above) if once.covers(stack, above, to)]
        light = medium.once(orders, first) if sides else None
        for side in sides:
            assert light is not None
            found[side] = _once(light, (slabs[0], slabs[-1]), side)
    return found


def _once(light: tuple[Operator, Operator], ends: tuple[Slab, Slab], side: tuple[bool, bool]) -> Operator:
    """Light scattered once (reflected, transmitted) through the outer interfaces: `ends`, the upper one first."""
    top, bottom = ends if side[0] else (ends[1].turned_over(), ends[0].turned_over())
    r, t = light
    found: Operator = top.t_up @ (r @ top.t_down) if side[0] == side[1] else bottom.t_down @ (t @ top.t_down)
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
    layer = MediumLayer(medium, phases[0 if side[0] else -1], grid, region, terms=solution.terms[region])
    outer = {k: SmoothLayer(stack.interfaces[k], grid, k) for k in {0 if above else last for above in side}}
    found = []
    for orders, first in blocks:
        slabs = {k: smooth.slab(orders, first) for k, smooth in outer.items()}
        ends = slabs.get(0, slabs[max(slabs)]), slabs.get(last, slabs[min(slabs)])
        operator = _once(layer.once(orders, first), ends, side)
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


def _heights(grid: Grid, stack: BoundStack, first: int) -> dict[tuple[bool, bool], np.ndarray]:
    """What turns operators into values that can be compared: flux density over the cosine."""
    found = {}
    for side in ((True, True), (True, False), (False, True), (False, False)):
        region_i, region_o = (0 if above else -1 for above in side)
        mu_o, weight = grid.mu[region_o][first:], grid.weights[region_o][first:]
        mu_i = grid.mu[region_i][first:]
        found[side] = (mu_o[:, None] + mu_i) / (mu_o * weight)[:, None]
    return found


def _block(orders: range, first: int, dense: np.ndarray, colours: int) -> Block:
    present = range(orders.start, orders.start + dense.shape[1])
    return Block(present, first, np.broadcast_to(dense, (colours, *dense.shape[1:])))


def _coloured(delta: np.ndarray | None, colours: int) -> np.ndarray | None:
    return None if delta is None else np.broadcast_to(delta, (colours, delta.shape[1]))


def closed_form(stack: BoundStack) -> str | None:
    """What the BSDF of a stack adds exactly: see `Solution.closed_form`."""
    if any(once.covers(stack, above, above) for above in ((True,) if stack.opaque else (True, False))):
        return "single"
    return "interface" if direct_is_certain(stack) else None
