"""Catmull-Rom splines over nodes at any distance, as layerlab and pbrt-v3 have them.

Between two nodes the spline is the cubic with the values of both and the slopes of the chords to their neighbours; at
the ends the slope is that of the interval itself, which is the same formula with the end for its own neighbour. Two
equal nodes of equal value, as layerlab has at 0, part what lies on both sides: neither feels the other's values.

Plain arithmetic: for numbers, numpy and Dr.Jit alike. With `h` the width of an interval x0..x1, and x-1, x2 beside it:
left = h / (x1 - x-1), right = h / (x2 - x0).
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any  # a number, a numpy or a Dr.Jit array


def weights(t: Array, left: Array, right: Array) -> tuple[Array, Array, Array, Array]:
    """Weights of the values at x-1, x0, x1, x2 in the value at x0 + t h."""
    square, cube = t * t, t * t * t
    before, after = (cube - 2 * square + t) * left, (cube - square) * right
    rise = 3 * square - 2 * cube
    return -before, 1 - rise - after, rise + before, after


def chords(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`h`, `left` and `right` of every interval between ascending nodes (N,), each (N - 1,); 0 in one without width."""
    nodes = np.asarray(nodes, np.float64)
    width = np.diff(nodes)
    padded = np.concatenate([nodes[:1], nodes, nodes[-1:]])
    return width, width / (padded[2:-1] - padded[:-3]), width / (padded[3:] - padded[1:-2])


def running_integral(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Integral of the spline from the first node to each: nodes (N,), values (..., N) -> (..., N)."""
    width, left, right = chords(nodes)
    values = np.asarray(values, np.float64)
    padded = np.concatenate([values[..., :1], values, values[..., -1:]], axis=-1)
    start, end = values[..., :-1], values[..., 1:]
    slopes = left * (end - padded[..., :-3]) - right * (padded[..., 3:] - start)
    pieces = (slopes / 12 + (start + end) / 2) * width
    return np.concatenate([np.zeros_like(values[..., :1]), np.cumsum(pieces, axis=-1)], axis=-1)
