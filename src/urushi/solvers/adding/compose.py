"""One solved stack on another: the adding equations on what both already are.

The light between them must have the same nodes in both. Results that were solved with the same `indices` and `nodes`
have; others are interpolated onto nodes that serve both, which costs about what their own errors are, and
`diagnostics` tell it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from urushi.errors import UrushiError
from urushi.stack import Stack

from ...adding import Slab, add, from_above
from ..bound import BoundStack
from ..direct import direct_is_certain
from . import build
from .basis import SAME, Grid
from .channels import ChannelsBSDF
from .once import covers
from .operator import OPERATORS, Operator
from .result import AddingBSDF
from .solution import Block, Part, Solution
from .solver import closed_form
from .spectrum import Spectrum
from .threads import one_thread

#: (from above, to above) in the order of the operators of a `Slab`, which is not that of `table.SIDES`
OF_SLAB = ((True, True), (True, False), (False, False), (False, True))
#: the closed forms of a solution for some orders, by (from above, to above)
Rests = dict[tuple[bool, bool], Operator]
#: orders that are added at a time
CHUNK = 16
#: what can be put on one another
Solved = AddingBSDF | ChannelsBSDF


def put_on(coat: Solved, base: Solved, **options: Any) -> Solved:
    """A solved coat on a solved base, without solving either anew.

    Args:
        coat: a stack that transmits.
        base: a stack whose `exterior` is the index at the coat's lower end.
        **options: `backend`, `precision`, `mode`, `order`: see `AddingBSDF`.

    Returns:
        The BSDF of the joined stack, of as many channels as either has. Its diagnostics have "estimated_error", the
        sum of both and of what interpolation added, which alone is "interpolation_error": by how much it changed
        energies.

    Raises:
        UrushiError: results that were solved without `indices`, an opaque coat, indices that differ
            where both meet, or other channels.
    """
    start = time.perf_counter()
    for name, bsdf in (("coat", coat), ("base", base)):
        if not isinstance(bsdf, Solved):
            raise UrushiError(
                f"{name}: found a {type(bsdf).__name__}; allowed: what solve(stack, 'adding') gives"
            )
    a, b = coat.solution, base.solution
    if (True, False) not in a.parts:
        raise UrushiError("coat: found an opaque stack; allowed: one that transmits")
    for name, solution in (("coat", a), ("base", b)):
        if not solution.diagnostics.get("complete"):
            raise UrushiError(
                f"{name}: found a result without the orders that only other layers need; allowed: one that was solved "
                f"with indices=({solution.grid.indices[0]:g}, ...)"
            )
    below, above = a.grid.indices[-1], b.grid.indices[0]
    if abs(below - above) > SAME * above:
        raise UrushiError(
            f"found a coat that ends with the index {below:g} on a base whose exterior is {above:g}; allowed: the same"
        )
    if a.colours != b.colours and 1 not in (a.colours, b.colours):
        raise UrushiError(f"found {a.colours} channels on {b.colours}; allowed: the same, or one")
    spectra = [spectrum(bsdf) for bsdf in (coat, base)]
    both = Spectrum.joined(joined(coat.stack, base.stack), *spectra)
    every = both.bind(build.bind_numbers)
    bound, colours = every.whole, every.channels
    grid = _common(a.grid, b.grid, tuple(build.indices(bound)))
    (a, error_a), (b, error_b) = _moved(a, grid), _moved(b, grid)
    form = closed_form(bound)
    alone = [one.bind(build.bind_numbers).whole for one in spectra]
    exact = all(map(direct_is_certain, (bound, *alone))) and all(
        solution.closed_form == closed_form(own) for solution, own in zip((a, b), alone, strict=True)
    )
    with one_thread():
        parts = _added(a, b, bound.opaque, colours, _Closed(bound, *alone) if exact else None)
    media = [region for region, medium in enumerate(bound.media) if medium is not None]
    own = [
        (solution, region)
        for solution, one in zip((a, b), alone, strict=True)
        for region, medium in enumerate(one.media)
        if medium is not None
    ]
    known = [float(s.diagnostics.get("estimated_error", np.nan)) for s in (a, b)]
    diagnostics = {
        "nodes": len(grid.s),
        "orders": max([1, *(block.orders.stop for part in parts.values() for block in part.whole())]),
        "estimated_error": sum(known) + error_a + error_b,
        "complete": True,
        "interpolation_error": error_a + error_b,
        "accuracy": max(float(s.diagnostics.get("accuracy", 1e-3)) for s in (a, b)),
        "seconds": time.perf_counter() - start,
    }
    pairs = list(zip(media, own, strict=True))
    forward = {new: part.forward[old] for new, (part, old) in pairs if old in part.forward}
    terms = {new: part.terms[old] for new, (part, old) in pairs if old in part.terms}
    solution = Solution(grid, parts, form if exact else None, colours, diagnostics, forward, terms)
    return (
        AddingBSDF(both.stack, solution, **options)
        if both.channels is None
        else ChannelsBSDF(both, solution, **options)
    )


def spectrum(bsdf: Solved) -> Spectrum:
    """The description of a result, and the channels beside it."""
    return bsdf.spectrum if isinstance(bsdf, ChannelsBSDF) else Spectrum.of(bsdf.stack)


def joined(coat: Stack, base: Stack) -> Stack:
    """The description of both."""
    name = " on ".join(part.name for part in (coat, base) if part.name)
    return Stack(name=name[:200], exterior=coat.exterior, layers=(*coat.layers, *base.layers))


@dataclass(frozen=True)
class _Closed:
    """What of the joined stack has a closed form, from what of the two has."""

    bound: BoundStack
    coat: BoundStack
    base: BoundStack

    def of(
        self, side: tuple[bool, bool], upper: Slab, lower: Slab, of_a: Rests, of_b: Rests
    ) -> Operator | None:
        """That of one part, from both layers and the closed forms of both, by part."""
        once_here = covers(self.bound, *side)
        deltas = {k: Operator(o.shape, o.delta) for k, o in (("down", upper.t_down), ("up", upper.t_up))}
        low = {k: Operator(o.shape, o.delta) for k, o in (("down", lower.t_down), ("up", lower.t_up))}
        if side == (True, True):
            if once_here and not covers(self.coat, *side):
                return deltas["up"] @ (of_b[side] @ deltas["down"])
            return of_a[side]
        if side == (False, False):
            if once_here and not covers(self.base, *side):
                return low["down"] @ (of_a[side] @ low["up"])
            return of_b[side]
        if not once_here:
            return None
        if covers(self.coat, *side):
            return low["down"] @ of_a[side] if side[0] else of_a[side] @ low["up"]
        return of_b[side] @ deltas["down"] if side[0] else deltas["up"] @ of_b[side]


def _added(
    a: Solution, b: Solution, opaque: bool, colours: int, closed: _Closed | None
) -> dict[tuple[bool, bool], Part]:
    """The parts of the whole."""
    sides = OF_SLAB[:1] if opaque else OF_SLAB
    blocks: dict[Any, list[Block]] = {side: [] for side in sides}
    rest: dict[Any, list[Block]] = {side: [] for side in sides}
    delta: dict[Any, np.ndarray | None] = {}
    every = [block for s in (a, b) for part in s.parts.values() for block in part.whole()]
    for start in range(0, max([1, *(block.orders.stop for block in every)]), CHUNK):
        orders = range(start, start + CHUNK)
        first = min((block.first for block in every if _meet(block.orders, orders)), default=0)
        upper, lower = _slab(a, orders, first), _slab(b, orders, first)
        if opaque:
            whole = Slab(*from_above(upper, lower, OPERATORS), lower.r_bottom, lower.t_up)
        else:
            whole = add(upper, lower, OPERATORS)
        known = [] if closed is None else [_rests(s, orders, first) for s in (a, b)]
        for side, operator in zip(OF_SLAB, whole, strict=True):
            if side not in sides:
                continue
            if side not in delta:
                found = operator.delta
                delta[side] = None if found is None else np.broadcast_to(found, (colours, found.shape[1]))
            exact = None
            if closed is not None:
                exact = closed.of(side, upper, lower, *known)
            dense = operator.dense
            if exact is not None and exact.dense is not None:
                rest[side].append(_block(orders, first, exact.dense, colours))
                dense = -exact.dense if dense is None else dense - exact.dense
            if dense is not None:
                blocks[side].append(_block(orders, first, dense, colours))
    return {side: Part(*side, delta.get(side), blocks[side], rest[side]) for side in sides}


def _rests(solution: Solution, orders: range, first: int) -> Rests:
    return {side: _operator(solution, side, orders, first, ("rest",), False) for side in OF_SLAB}


def _slab(solution: Solution, orders: range, first: int) -> Slab:
    return Slab(*(_operator(solution, side, orders, first, ("blocks", "rest"), True) for side in OF_SLAB))


def _operator(
    solution: Solution,
    side: tuple[bool, bool],
    orders: range,
    first: int,
    kinds: tuple[str, ...],
    delta: bool,
) -> Operator:
    """One part of a solution for some orders, between the nodes from `first` on; nothing where it has no such part."""
    n_in, n_out = (max(len(solution.grid.mu[0 if above else -1]) - first, 0) for above in side)
    part = solution.parts.get(side)
    if part is None:
        return Operator((n_out, n_in))
    dense = None
    for block in (block for kind in kinds for block in getattr(part, kind)):
        shared = _meet(block.orders, orders)
        if not shared:
            continue
        if dense is None:
            dense = np.zeros((solution.colours, len(orders), n_out, n_in))
        skip = block.first - first
        here = slice(shared.start - block.orders.start, shared.stop - block.orders.start)
        dense[:, shared.start - orders.start : shared.stop - orders.start, skip:, skip:] += block.values[
            :, here
        ]
    kept = part.delta[:, first:] if delta and part.delta is not None else None
    return Operator((n_out, n_in), kept, dense)


def _meet(one: range, other: range) -> range:
    return range(max(one.start, other.start), max(min(one.stop, other.stop), max(one.start, other.start)))


def _block(orders: range, first: int, dense: np.ndarray, colours: int) -> Block:
    return Block(orders, first, np.broadcast_to(dense, (colours, *dense.shape[1:])))


# --- nodes -----------------------------------------------------------------------------------------------------------


def _common(a: Grid, b: Grid, indices: tuple[float, ...]) -> Grid:
    """Nodes that serve both: all panels of either, with as many nodes as the finer has."""
    counts: dict[float, int] = {}
    for panel in sorted((*a.panels, *b.panels), key=lambda panel: panel.index):
        near = next((n for n in counts if abs(n - panel.index) <= SAME * n), panel.index)
        counts[near] = max(counts.get(near, 0), panel.count)
    return replace(Grid.build(list(counts), list(counts.values())), indices=indices)


def _moved(solution: Solution, grid: Grid) -> tuple[Solution, float]:
    """The solution on the nodes of another grid, and by how much that changed the energies."""
    old, new = solution.grid, replace(grid, indices=solution.grid.indices)
    if [p.count for p in old.panels] == [p.count for p in new.panels]:
        return replace(solution, grid=new), 0.0
    regions = len(old.indices)
    spread = {}
    for region in {0, regions - 1}:
        stencil, rows = old.stencil(region, new.mu[region]), np.arange(len(new.mu[region]))[:, None]
        spread[region] = np.zeros((2, len(new.mu[region]), len(old.mu[region])))
        for matrix, weight in zip(spread[region], (stencil.even, stencil.odd), strict=True):
            np.add.at(matrix, (rows, stencil.node), weight)
    parts, worst = {}, 0.0
    for side, part in solution.parts.items():
        i, o = (0 if above else regions - 1 for above in side)
        blocks, rest = (_carried(some, old, new, (i, o), spread) for some in (part.blocks, part.rest))
        delta = None
        if part.delta is not None:
            rarer = min(i, o, key=lambda region: old.indices[region])
            delta = part.delta @ spread[rarer][0].T
        moved = Part(*side, delta, blocks, rest)
        sums = [_energies(p, solution.colours, len(g.mu[i])) for p, g in ((part, old), (moved, new))]
        worst = max(worst, float(np.abs(sums[0] @ spread[i][0].T - sums[1]).max(initial=0)))
        parts[side] = moved
    return replace(solution, grid=new, parts=parts), worst


def _carried(
    blocks: list[Block], old: Grid, new: Grid, sides: tuple[int, int], spread: dict[int, np.ndarray]
) -> list[Block]:
    i, o = sides
    into = (old.mu[o][:, None] + old.mu[i]) / (old.mu[o] * old.weights[o])[:, None]
    back = (new.mu[o] * new.weights[o])[:, None] / (new.mu[o][:, None] + new.mu[i])
    found = []
    for block in blocks:
        q = block.values * into[block.first :, block.first :]
        values = np.zeros((*q.shape[:2], *back.shape))
        for k, order in enumerate(block.orders):
            out, at = (spread[r][order % 2][:, block.first :] for r in (o, i))
            values[:, k] = (out @ q[:, k] @ at.T) * back
        found.append(Block(block.orders, 0, values))
    return found


def _energies(part: Part, colours: int, count: int) -> np.ndarray:
    """(C, n_in) what arrives of the light of each node."""
    found = np.zeros((colours, count))
    for block in part.whole():
        if 0 in block.orders:
            found[:, block.first :] += block.values[:, block.orders.index(0)].sum(axis=1)
    return found
