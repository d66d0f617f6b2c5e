"""What the parts of a solved stack have in common: reciprocity, and a stack that is its own mirror image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.solution import Block, Part, Solution


def turned(part: Part, grid: Grid) -> Part:
    """The part that carries light back through the stack."""

    def back(block: Block) -> Block:
        w = grid.etendue[block.first :]
        x = block.values / w[: block.values.shape[2], None]
        return replace(block, values=x.swapaxes(2, 3) * w[: x.shape[3], None])

    return Part(
        part.to_above,
        part.from_above,
        part.delta,
        [back(block) for block in part.blocks],
        [back(block) for block in part.rest],
    )


def joined(part: Part) -> Part:
    """A part whose blocks of consecutive orders on the same nodes are one."""

    def runs(blocks: list[Block]) -> list[Block]:
        found: list[Block] = []
        for block in blocks:
            if found and found[-1].first == block.first and found[-1].orders.stop == block.orders.start:
                orders = range(found[-1].orders.start, block.orders.stop)
                values = np.concatenate([found.pop().values, block.values], axis=1)
                block = Block(orders, block.first, values)
            found.append(block)
        return found

    return replace(part, blocks=runs(part.blocks), rest=runs(part.rest))


def is_mirror(solution: Solution, error: float) -> bool:
    """Whether a stack does from below what it does from above."""
    parts = solution.parts
    if len(parts) < 4 or solution.grid.indices[0] != solution.grid.indices[-1]:
        return False
    pairs = ((parts[True, True], parts[False, False]), (parts[True, False], parts[False, True]))
    return all(
        alike(one.blocks, other.blocks, solution.grid, error)
        and alike(one.rest, other.rest, solution.grid, error)
        and same_delta(one, other)
        for one, other in pairs
    )


def same_delta(one: Part, other: Part) -> bool:
    """Whether two parts leave the same light on its nodes."""
    if one.delta is None or other.delta is None:
        return one.delta is other.delta
    return one.delta.shape == other.delta.shape and np.allclose(one.delta, other.delta, rtol=0, atol=1e-12)


def alike(one: list[Block], other: list[Block], grid: Grid, error: float) -> bool:
    """Whether two lists of blocks differ by less than a thousandth of an error relative to the peaks."""
    if headed(one) != headed(other):
        return False
    for a, b in zip(one, other, strict=True):
        w = grid.etendue[a.first :][: a.values.shape[2], None]
        x, away = np.abs(a.values / w).max(axis=(0, 1)), np.abs((a.values - b.values) / w).max(axis=(0, 1))
        peak = np.minimum(x.max(axis=1, initial=0)[:, None], x.max(axis=0, initial=0))
        if (away > 1e-3 * error * peak).any():
            return False
    return True


def headed(blocks: list[Block]) -> list[list[int]]:
    """Of each block the first order, the end of the orders, and the first node."""
    return [[block.orders.start, block.orders.stop, block.first] for block in blocks]
