"""Functions of one cosine as a table of rows, several functions beside one another.

Rows are evenly spaced in u, from 0 at the horizon to 1 at the normal. What roughness does goes with the root of the
cosine near the horizon, and Snell's law has a root where total reflection begins:

    c = u^2                                              where no medium is thinner than the one outside
    c = k sin^2(pi u), u < 1/2;  k + (1 - k) (2 u - 1)^2   with the critical cosine k of the thinnest, else

A processor without an instruction for it (and AMD's with one) gathers numbers one by one. Dr.Jit loads up to eight
that lie together as one packet, so rows are made of packets; a short one has the next one beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_least, at_most
from ..arrays import padded

#: numbers of one packet: with twice as many a vector processor runs out of registers
PACKET = 8


def critical(indices: Sequence[float], above: bool) -> float | None:
    """The cosine beyond which the thinnest medium of a stack sees no light from a side, if there is one.

    Args:
        indices: of all regions that light gets into, top to bottom.
        above: the side that the light comes from.
    """
    ratio = min(indices) / indices[0 if above else -1]
    return float(np.sqrt(1 - ratio**2)) if ratio < 1 - 1e-4 else None


def cosines(count: int, critical: float | None) -> np.ndarray:
    """The cosines of evenly spaced rows."""
    u = np.linspace(0, 1, count)
    if critical is None:
        return u**2
    upper = critical + (1 - critical) * np.square(2 * u - 1)
    return np.where(u < 0.5, critical * np.square(np.sin(np.pi * u)), upper)


def along(cos: Array, critical: Array | None) -> Array:
    """u of a cosine."""
    if critical is None:
        return dr.sqrt(at_least(cos, 1e-12))
    upper = 0.5 + 0.5 * dr.sqrt(at_least((cos - critical) / (1 - critical), 1e-12))
    lower = dr.inv_pi * dr.asin(dr.sqrt(at_most(at_least(cos / critical, 1e-12), 1.0)))
    return dr.select(cos < critical, lower, upper)


class Rows:
    """A table.

    Args:
        columns: the functions (cells + 1,) at the ends of the cells.
        number: the type of numbers: single precision, of a vectorised backend.
        critical: the critical cosine, a number of this type; None if there is none.
    """

    def __init__(self, columns: list[np.ndarray], number: Any, critical: Array | None) -> None:
        self.count, self.critical = len(columns), critical
        cells = len(columns[0]) - 1
        # Variables of the compiled code: another number of rows compiles nothing anew.
        self.cells = dr.opaque(number, cells)
        self.last = dr.opaque(dr.uint32_array_t(number), cells - 1)
        self.pack = _pack(self.count)
        self.packs = -(-self.count // self.pack)
        #: whether a row has the next one beside it
        self.beside = 2 * self.pack <= PACKET
        self.table = self._laid_out(columns, number)

    @property
    def bytes(self) -> int:
        return 4 * dr.width(self.table)

    def __call__(self, cos: Array) -> list[Array]:
        """Every function at a cosine from 0 to 1."""
        x = along(cos, self.critical) * self.cells
        i = at_most(type(self.last)(dr.detach(x)), self.last)
        f = x - type(x)(i)
        if self.beside:
            both = self._packet(i, 2 * self.pack)
            low, high = both[: self.pack], both[self.pack :]
        else:
            low, high = (
                [value for p in range(self.packs) for value in self._packet(row * self.packs + p, self.pack)]
                for row in (i, i + 1)
            )
        return [dr.fma(f, high[k] - low[k], low[k]) for k in range(self.count)]

    def _packet(self, index: Any, size: int) -> list[Array]:
        module = sys.modules[type(self.table).__module__]
        return list(dr.gather(module.ArrayXf, self.table, index, shape=(size, dr.width(index))))

    def _laid_out(self, columns: list[np.ndarray], number: Any) -> Any:
        rows = np.zeros((len(columns[0]), self.packs * self.pack), np.float32)
        rows[:, : self.count] = np.stack(columns, axis=1)
        if self.beside:
            rows = np.concatenate([rows[:-1], rows[1:]], axis=1)
        return number(padded(rows, np.float32))


def size(count: int, cells: int) -> int:
    """Bytes of a table."""
    pack = _pack(count)
    return 4 * (2 * pack * cells if 2 * pack <= PACKET else -(-count // pack) * pack * (cells + 1))


def _pack(count: int) -> int:
    """How many numbers of a row are loaded together."""
    return next(n for n in (1, 2, 4, PACKET) if n >= min(count, PACKET))
