"""Tables on regular grids: multilinear interpolation of a few channels, on Dr.Jit arrays and on plain floats."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import product
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_most


class Grid:
    """A table.

    Args:
        values: (n_1, ..., n_d, C): C channels on d axes whose nodes are evenly spaced in u, from 0 to 1.
    """

    def __init__(self, values: np.ndarray) -> None:
        self.shape, self.channels = values.shape[:-1], values.shape[-1]
        self.packs: list[tuple[int, np.ndarray]] = []  # channels that one gather fetches, and their numbers
        first = 0
        while first < self.channels:
            width = next(w for w in (4, 2, 1) if first + w <= self.channels)
            self.packs.append((width, np.ascontiguousarray(values[..., first : first + width]).ravel()))
            first += width
        self._sources: dict[type, list[Any]] = {}

    def __call__(self, places: Sequence[Array | int], like: Array) -> list[Array]:
        """Every channel.

        Args:
            places: along each axis u in [0, 1], or a whole number that names a node.
            like: a value whose type the answer has.
        """
        number = type(like)
        scalar = number is float
        whole: Any = int if scalar else dr.uint32_array_t(number)
        index, corners = whole(0), []
        stride = 1
        for n, place in zip(reversed(self.shape), reversed(places), strict=True):
            if isinstance(place, int):
                index = index + (place if place >= 0 else n + place) * stride
            else:
                x = place * (n - 1)
                i = at_most(whole(dr.detach(x)), n - 2)
                index = index + i * stride
                f = x - (float(i) if scalar else number(i))
                corners.append((stride, f))
            stride *= n
        found: list[Array] = [0.0] * self.channels
        for steps in product((0, 1), repeat=len(corners)):
            weight: Array = 1.0
            for step, (_, f) in zip(steps, corners, strict=True):
                weight = weight * (f if step else 1 - f)
            at = index + sum(step * stride for step, (stride, _) in zip(steps, corners, strict=True))
            values = self._fetch(at, number)
            found = [dr.fma(weight, v, total) for v, total in zip(values, found, strict=True)]
        return found

    def _fetch(self, index: Any, number: Any) -> list[Array]:
        if number not in self._sources:
            self._sources[number] = [
                pack if number is float else number(np.asarray(pack, _kind(number))) for _, pack in self.packs
            ]
            if number is not float:
                dr.eval(self._sources[number])
        values: list[Array] = []
        for (width, _), source in zip(self.packs, self._sources[number], strict=True):
            if number is float:
                values += [float(source[index * width + c]) for c in range(width)]
            elif width == 1:
                values.append(dr.gather(number, source, index))
            else:
                module = sys.modules[number.__module__]
                suffix = "f64" if _kind(number) is np.float64 else "f"
                values += list(dr.gather(getattr(module, f"Array{width}{suffix}"), source, index))
        return values


def _kind(number: Any) -> Any:
    return np.float64 if dr.type_v(number) == dr.VarType.Float64 else np.float32
