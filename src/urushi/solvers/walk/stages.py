"""Many paths in stages: those that have ended make room for the others.

A vector unit works on 16 paths or so at a time and is done when the longest of them is, while most end after a turn or
two: over a rough metal two thirds of the work is waiting. Where kernels may be launched, all paths therefore make
`TURNS` turns, those that go on are packed into as many lanes of the next launch, and so on until few are left. Every
path keeps its own random numbers, so its result does not depend on who goes on beside it: the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import numpy as np

from ...optics.random import Generator
from ...optics.vectors import Array, Vector, float_type, module_of

#: turns between two packings
TURNS = 2
#: paths per thread from which on packing costs less than waiting
MANY = 1 << 18
#: numbers that are stored side by side at once
PACKET = 8
#: paths, a power of two, that are packed among themselves: as many as Dr.Jit gives a thread at once, so that threads
#: neither count in the same place nor write next to one another, which would take longer than the walk
SEGMENT = 1 << 14
#: rows, a power of two, in which paths that have ended leave what nobody reads: stores without a mask need no branches
SPARE = 1024
#: lanes in a row that read one segment, a power of two; the last of them may read nothing
CHUNK = 16


def may_stage(*directions: Vector) -> bool:
    """Whether an evaluation of these directions may, and should, be run in stages.

    Not inside a symbolic loop or call, nor a frozen function, where nothing can be launched and counted on the way;
    nor with derivatives, on a GPU or in double precision, whose vectors are short.
    """
    value = float_type(directions[0])
    if value is float or dr.backend_v(value) != dr.JitBackend.LLVM or dr.type_v(value) != dr.VarType.Float32:
        return False
    if dr.flag(dr.JitFlag.SymbolicScope) or dr.flag(dr.JitFlag.FreezingScope):
        return False
    return _many(max(dr.width(w) for w in directions)) and not any(dr.grad_enabled(w) for w in directions)


def in_stages(
    state: dict[str, Any],
    fixed: tuple[Any, ...],
    going: Callable[[dict[str, Any]], Array],
    turn: Callable[[dict[str, Any], tuple[Any, ...]], dict[str, Any]],
    done: int = 0,
) -> Array:
    """The loop `while going(state): state = turn(state, fixed)`; returns `state["light"]` of every lane.

    Args:
        state: numbers, directions, a generator and None, by name; all that a turn changes.
        fixed: what a turn only reads that differs from lane to lane.
        done: turns that the paths have made already.
    """
    module, lanes = module_of(state["d"]), dr.width(state["d"])
    index = dr.arange(module.UInt, lanes)
    valid, result = module.Bool(True), None
    while _many(lanes):
        for _ in range(TURNS - done):
            state = turn(state, fixed)
        done = 0
        if result is None:
            result = state["light"]
        else:
            dr.scatter(result, state["light"], index, valid)
        paths = (state, fixed, index)
        counts, packets = _pack(module, lanes, going(state) & valid, _words(paths, module), result)
        if not counts.any():
            return result
        row, valid = _rows(module, counts)
        lanes = dr.width(row)
        state, fixed, index = _filled(paths, _unpack(module, row, packets))
        state["throughput"] = dr.select(valid, state["throughput"], 0)
    (state,) = dr.while_loop((state,), going, lambda s: (turn(dict(s), fixed),), label="walk")
    dr.scatter(result, state["light"], index, valid)
    return result


def _many(lanes: int) -> bool:
    return lanes >= MANY * dr.thread_count()


def _pack(
    module: Any, lanes: int, alive: Array, words: list[Array], result: Array
) -> tuple[np.ndarray, list[tuple[Array, int]]]:
    """Store the words of the lanes `alive` at the front of their segments, and evaluate `result` in the same launch.

    Returns:
        how many there are in each segment, and buffers with the number of words of each in them.
    """
    words = words + [module.Float(0)] * (-len(words) % (PACKET // 2))
    groups = [words[i : i + PACKET] for i in range(0, len(words), PACKET)]
    packets = [dr.empty(module.Float, (lanes + SPARE) * len(group)) for group in groups]
    counter = dr.zeros(module.UInt, CHUNK * -(-lanes // SEGMENT))  # a cache line each
    dr.eval(counter, packets)
    lane = dr.arange(module.UInt, lanes)
    spare = lanes + ((lane >> 10) & (SPARE - 16)) + (lane & 15)  # few, and for every thread its own
    segment = lane // SEGMENT
    row = dr.select(alive, segment * SEGMENT + dr.scatter_inc(counter, segment * CHUNK, alive), spare)
    for packet, group in zip(packets, groups, strict=True):
        dr.scatter(packet, module.ArrayXf(group), row)
    dr.eval(result, counter, packets)
    return np.array(counter)[::CHUNK], list(zip(packets, map(len, groups), strict=True))


def _rows(module: Any, counts: np.ndarray) -> tuple[Array, Array]:
    """The row that each lane of the next launch reads, and whether there is one for it, from what segments hold."""
    chunks = -(-counts.astype(np.int64) // CHUNK)
    first = np.cumsum(chunks) - chunks
    shift = np.repeat(np.arange(len(counts)) * SEGMENT - CHUNK * first, chunks)
    lane = dr.arange(module.UInt, CHUNK * len(shift))
    row = lane + dr.gather(module.UInt, module.UInt(shift.astype(np.uint32)), lane // CHUNK)
    return row, (row & (SEGMENT - 1)) < dr.gather(module.UInt, module.UInt(counts), row // SEGMENT)


def _unpack(module: Any, row: Array, packets: list[tuple[Array, int]]) -> Iterator[Array]:
    for packet, size in packets:
        yield from dr.gather(module.ArrayXf, packet, row, shape=(size, dr.width(row)))


def _words(tree: Any, module: Any) -> list[Array]:
    """All 32-bit numbers in dicts, tuples, generators, directions and colours, as floats of the same bits."""
    if isinstance(tree, Generator):
        tree = (tree.a, tree.b, tree.c, tree.count)
    if isinstance(tree, dict):
        tree = tuple(tree.values())
    if isinstance(tree, tuple) or (dr.is_array_v(tree) and dr.depth_v(tree) > 1):
        return [word for part in tree for word in _words(part, module)]
    return [dr.reinterpret_array(module.Float, tree)] if dr.is_array_v(tree) else []


def _filled(tree: Any, words: Iterator[Array]) -> Any:
    """The same tree with other numbers."""
    if isinstance(tree, Generator):
        return Generator(*(_filled(part, words) for part in (tree.a, tree.b, tree.c, tree.count)))
    if isinstance(tree, dict):
        return {name: _filled(part, words) for name, part in tree.items()}
    if isinstance(tree, tuple):
        return tuple(_filled(part, words) for part in tree)
    if not dr.is_array_v(tree):
        return tree
    if dr.depth_v(tree) > 1:
        return type(tree)(*(_filled(part, words) for part in tree))
    return dr.reinterpret_array(type(tree), next(words))
