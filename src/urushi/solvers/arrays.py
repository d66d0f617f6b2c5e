"""Between numpy and Dr.Jit: which backend computes, and batches through it piece by piece."""

from __future__ import annotations

import importlib
from typing import Any

import drjit as dr
import numpy as np

from urushi import llvm
from urushi.errors import UrushiError

from ..optics.vectors import channels

#: lanes of one launch: bounds the memory that a large batch takes
LANES = 1 << 20
#: numbers that LLVM code reads at a time, at most
PACKET = 64
#: the row that is computed where there are none, for the shape of the results; they are cut off it
NONE = np.array([[0.0, 0.0, 1.0]])


def backend_module(name: str) -> Any:
    """The Dr.Jit module of a backend: "llvm", "cuda", "scalar", or "auto" for CUDA where there is one, else LLVM."""
    if name == "auto":
        name = "cuda" if dr.has_backend(dr.JitBackend.CUDA) else "llvm"
    if name == "scalar":
        return importlib.import_module("drjit.scalar")
    if name == "cuda" and not dr.has_backend(dr.JitBackend.CUDA):
        raise UrushiError(
            "backend: found 'cuda', but there is no CUDA device here; allowed: llvm, scalar, auto"
        )
    if name == "llvm":
        llvm.ensure()
    return importlib.import_module(f"drjit.{name}.ad")


def number_type(module: Any, double: bool) -> Any:
    """The type of a number in a Dr.Jit module: an array of floats, or `float`."""
    return float if module.__name__ == "drjit.scalar" else module.Float64 if double else module.Float


def vector_type(module: Any, double: bool) -> Any:
    """The type of a direction, or of a colour, in a Dr.Jit module."""
    return module.Array3f64 if double else module.Array3f


def padded(values: np.ndarray, kind: Any = np.float64) -> np.ndarray:
    """A flat copy that may be read a little beyond its end, and that begins where a packet may.

    Dr.Jit's LLVM backend uses the memory of a numpy array of its own type where it lies, and reads whole packets of it:
    where the next page belongs to nobody, that ends the process. A packet has at most `PACKET` numbers. Where memory
    does not begin at a multiple of their size, Dr.Jit gathers the numbers of a packet one by one, by other code.
    """
    count = np.size(values)
    buffer = np.zeros(count + 2 * PACKET, kind)
    start = -buffer.ctypes.data // buffer.itemsize % PACKET
    buffer[start : start + count] = np.ravel(values)
    return buffer[start : start + count]


def fill(results: list[np.ndarray], parts: list[np.ndarray], rows: int, start: int) -> None:
    """Put a piece of every result into its place; the first piece makes the places."""
    if not results:
        results += [np.empty((rows, *part.shape[1:])) for part in parts]
    for whole_result, part in zip(results, parts, strict=True):
        whole_result[start : start + len(part)] = part


def mapped(run: Any, inputs: tuple[np.ndarray, ...], module: Any, double: bool) -> list[np.ndarray]:
    """Run a function of directions on every row of arrays (N, 3).

    Args:
        run: directions in Dr.Jit -> tuple of numbers, colours and directions.
        inputs: (N, 3) each.
        module, double: what to compute in.

    Returns:
        (N,) or (N, channels) for each.
    """
    n, vector = len(inputs[0]), vector_type(module, double)
    if n == 0:
        return [x[:0] for x in mapped(run, tuple(NONE for _ in inputs), module, double)]
    results: list[np.ndarray] = []
    if module.__name__ == "drjit.scalar":
        for i in range(n):
            out = run(*(vector(*(float(v) for v in array[i])) for array in inputs))
            fill(results, [np.array(x, dtype=np.float64)[None] for x in out], n, i)
        return results
    for start in range(0, n, LANES):
        stop = min(start + LANES, n)
        lanes = [vector(np.ascontiguousarray(array[start:stop].T)) for array in inputs]
        out = tuple(x + 0 * lanes[0].x for x in run(*lanes))
        dr.eval(out)
        fill(results, [np.array(x, dtype=np.float64).T if channels(x) else x.numpy() for x in out], n, start)
    return results


def whole(name: str, value: Any, low: int, high: int) -> None:
    """Refuse an option that is no whole number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise UrushiError(f"{name}: found {value!r}; allowed: a whole number from {low} to {high}")


def choice(name: str, value: Any, allowed: tuple[Any, ...]) -> None:
    """Refuse an option that is none of those allowed."""
    if value not in allowed:
        raise UrushiError(f"{name}: found {value!r}; allowed: {', '.join(map(str, allowed))}")
