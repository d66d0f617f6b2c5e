"""Tables on regular grids: multilinear interpolation of a few channels, on Dr.Jit arrays and on plain floats."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import product
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_most
from ..arrays import padded
from .settled import settled


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

    def at(self, places: Sequence[Array], name: Any) -> Grid | None:
        """The table over the remaining axes, for places along the first that are the same for all lanes; else None.

        Args:
            places: along the first axes, u along the last of them.
            name: of this table, to keep the result by.
        """
        number = type(places[-1])
        if number is float:
            return None

        def compute() -> list[Any]:
            size = int(np.prod(self.shape[len(places) :]))
            head = Grid.__new__(Grid)
            head.shape, head.channels, head.packs = self.shape[: len(places)], 1, []
            index, corners = head._corners(places, number)
            found = []
            for (width, _), source in zip(self.packs, self._loaded(number), strict=True):
                lane = dr.arange(dr.uint32_array_t(number), size * width)
                values = number(0)
                for offset, weight in corners:
                    values = values + weight * dr.gather(
                        number, source, (index + offset) * (size * width) + lane
                    )
                found.append(values)
            return found

        sources = settled(name, places, compute)
        if sources is None:
            return None
        part = Grid.__new__(Grid)
        part.shape, part.channels, part.packs = self.shape[len(places) :], self.channels, self.packs
        part._sources = {number: sources}
        return part

    def __call__(self, places: Sequence[Array | int], like: Array) -> list[Array]:
        """Every channel.

        Args:
            places: along each axis u in [0, 1], or a whole number that names a node.
            like: a value whose type the answer has.
        """
        number = type(like)
        index, corners = self._corners(places, number)
        found: list[Array] = [0.0] * self.channels
        for offset, weight in corners:
            values = self._fetch(index + offset, number)
            found = [dr.fma(weight, v, total) for v, total in zip(values, found, strict=True)]
        return found

    def _corners(self, places: Sequence[Array | int], number: Any) -> tuple[Array, list[tuple[int, Array]]]:
        """The first entry of the cell that the places lie in, and the offsets and weights of its corners."""
        scalar = number is float
        whole: Any = int if scalar else dr.uint32_array_t(number)
        index, axes = whole(0), []
        stride = 1
        for n, place in zip(reversed(self.shape), reversed(places), strict=True):
            if isinstance(place, int) or dr.is_unsigned_v(place):
                index = index + place * stride
            else:
                x = place * (n - 1)
                i = at_most(whole(dr.detach(x)), n - 2)
                index = index + i * stride
                axes.append((stride, x - (float(i) if scalar else number(i))))
            stride *= n
        corners = []
        for steps in product((0, 1), repeat=len(axes)):
            weight: Array = 1.0
            for step, (_, f) in zip(steps, axes, strict=True):
                weight = weight * (f if step else 1 - f)
            corners.append((sum(step * s for step, (s, _) in zip(steps, axes, strict=True)), weight))
        return index, corners

    def _loaded(self, number: Any) -> list[Any]:
        """The numbers of each pack, as arrays of this type."""
        if number not in self._sources:
            self._sources[number] = [
                pack if number is float else number(padded(pack, _kind(number))) for _, pack in self.packs
            ]
            if number is not float:
                dr.eval(self._sources[number])
        return self._sources[number]

    def _fetch(self, index: Any, number: Any) -> list[Array]:
        values: list[Array] = []
        for (width, _), source in zip(self.packs, self._loaded(number), strict=True):
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
