"""The recursion tabulated over the angle: for a stack that is the same for all lanes, and in all azimuths.

All that `LobesCore.find` says of such a stack depends on one number, the cosine of wi: energies, roughnesses, what
mirrors as rough reflect, how far transmitted light is bent; and how diffuse light leaves, on the cosine of wo. So
that is computed once, at some hundred angles, and looked up: a few packets of a table (`rows`), instead of the
recursion with all its tables in every lane.

How many rows there are is found by trying: as few as keep all that is between them near to the recursion (`LIMITS`).
Single precision only: who asks for double gets the recursion, and so does who wants derivatives in its numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ...interfaces.base import Frame
from ...optics.vectors import Array, Vector, at_least, channels
from ..arrays import padded
from . import rows
from .kernels import values as plain
from .lobe import Lobe

if TYPE_CHECKING:
    from .core import Found, LobesCore
    from .exit import Exit

#: cells of the tables that are tried, the coarsest first
CELLS = (112, 224, 448, 896)
#: bytes that the tables of one side may take
BYTES = 1 << 16
#: errors allowed between rows: of energies; of roughnesses and gains, relative. How far light is bent asks for no more
#: rows: it is nearly Snell's ratio, and a hundredth of a roughness off at most but where the recursion jumps.
LIMITS = {"energy": 2e-4, "shape": 3e-3}
#: the share of angles at which errors may be larger: where the recursion jumps, a table has a ramp of one cell
EDGES = 0.01
#: the shape of a lobe with less energy may be off in inverse proportion
FAINT = 0.01


def tabulate(core: LobesCore, vector: Any) -> dict[bool, Side]:
    """The sides of a stack as tables, by whether the light comes from above; without those that keep the recursion.

    Args:
        core: a stack of numbers that are the same for all lanes, and that no derivatives are wanted of.
        vector: the type of directions: single precision, of a vectorised backend.
    """
    stack = core.stack
    pairs = [interface.roughness() for interface in stack.interfaces]
    plain = all(x is y or (isinstance(x, float) and x == y) for x, y in pairs)
    clear = not any(medium is not None and medium.scatters for medium in stack.media)
    smooth = clear and all(interface.delta is True or interface.flat for interface in stack.interfaces)
    if not plain or smooth or core.symmetric or core.published or core.tilted is not None:
        return {}
    sides = {above: Side.of(core, above, vector) for above in core.sides}
    return {above: side for above, side in sides.items() if side is not None}


class Side:
    """The lobes for light that comes from one side, over the cosine of its direction.

    Attributes:
        table: all numbers, but for the shape of diffuse light.
        exit: of this side, which has computed already what is the same for all lanes.
    """

    def __init__(
        self, found: Found, parts: list[Part], even: dict[str, list[int]], table: rows.Rows, exit: Exit
    ) -> None:
        self._found, self._parts, self._even, self.table = found, parts, even, table
        self.exit = exit
        #: how diffuse light leaves on this side: a number or colour of the type, and the table over the cosine of wo
        self._leaving: tuple[Array, rows.Rows] | None = None

    @classmethod
    def of(cls, core: LobesCore, above: bool, vector: Any) -> Side | None:
        """None where no table of the size allowed is good enough."""
        number, stack = dr.value_t(vector), core.stack
        seen = stack.indices[:-1] if stack.opaque else stack.indices
        limit = rows.critical([float(plain(index)[0]) for index in seen], above)
        cos = np.maximum(rows.cosines(2 * CELLS[-1] + 1, limit), 1e-6)
        columns = Columns(cos, number)
        z = columns.cos
        found = core.find(vector(columns.sin, number(0), z if above else -z), above)
        parts = [columns.part(lobe) for lobe in found.lobes]
        even = {
            field.name: columns.add("energy", getattr(found, field.name))
            for field in fields(found)
            if field.name not in ("lobes", "first") and not isinstance(getattr(found, field.name), float)
        }
        if found.first is not None:
            parts.append(columns.part(found.first, core.first_is_a_lobe(above)))
        exit, o, shape = core.exits[above], vector(columns.sin, number(0), z), None
        if even:
            shape = exit.density(o) / z
            dr.eval(exit.weighed(found.diffuse, found, o, o))
        values = columns.values(shape)
        cells = columns.enough(values)
        if cells is None:
            return None
        every = (len(cos) - 1) // cells
        critical = None if limit is None else dr.opaque(number, limit)
        kept = {name: _empty(getattr(found, name)) for name in even}
        found = replace(found, lobes=[], **kept)
        table = rows.Rows([v[::every] for v in values[: columns.count]], number, critical)
        side = cls(found, parts, even, table, exit)
        if shape is not None:
            last = [v[::every] for v in values[columns.count :]]
            side._leaving = _empty(shape), rows.Rows(last, number, critical)
        return side

    @property
    def bytes(self) -> int:
        """Memory that the tables take."""
        return self.table.bytes + (0 if self._leaving is None else self._leaving[1].bytes)

    def leaving(self, o: Vector) -> Array | None:
        """What `Exit.density` says of this side; None if diffuse light does not leave here."""
        if self._leaving is None:
            return None
        like, table = self._leaving
        values = table(o.z)
        return _picked(like, values, list(range(len(values)))) * o.z

    def find(self, wi: Vector) -> Found:
        """What `LobesCore.find` says for light from wi, on this side."""
        cos = dr.abs(wi.z)
        values = self.table(cos)
        axis = type(wi)(wi.x, wi.y, at_least(cos, 1e-6))
        lobes = [part.at(values, axis) for part in self._parts]
        first = None if self._found.first is None else lobes.pop()
        even = {
            name: _picked(getattr(self._found, name), values, where) for name, where in self._even.items()
        }
        return replace(self._found, lobes=lobes, first=first, **even)


@dataclass
class Part:
    """A lobe whose numbers stand in columns.

    Attributes:
        lobe: as it is at the rows; what has no column holds at all angles.
        energy: columns of its channels.
        alphas: of its roughness in the plane of incidence and across; one if they are the same; none if it holds.
        gain: of the reciprocal of what a mirror as rough reflects; None where nobody asks for it.
        bend: of its sine over that of wi, if it is transmitted.
    """

    lobe: Lobe
    energy: list[int]
    alphas: list[int]
    gain: int | None
    bend: int | None

    def at(self, values: list[Array], axis: Vector) -> Lobe:
        """The lobe for light from `axis`."""
        lobe = self.lobe
        energy = _picked(lobe.energy, values, self.energy)
        x = y = lobe.alpha_x
        frame = lobe.frame
        if self.alphas:
            x, y = values[self.alphas[0]], values[self.alphas[-1]]
        if len(self.alphas) > 1:
            frame = _along(axis)
        if self.bend is not None:
            bent = values[self.bend]
            bx, by = axis.x * bent, axis.y * bent
            axis = type(axis)(bx, by, dr.sqrt(at_least(1 - dr.square(bx) - dr.square(by), 1e-12)))
        gain = None if self.gain is None else values[self.gain]
        return replace(lobe, energy=energy, axis=axis, alpha_x=x, alpha_y=y, frame=frame, gain=gain)


class Columns:
    """Everything that depends on the angle, at the rows and between them.

    Args:
        cos: cosines (M,) of evenly spaced rows.
        number: the type of numbers.
    """

    def __init__(self, cos: np.ndarray, number: Any) -> None:
        # Never quite 0: what is bent is told as a ratio of sines.
        sin = np.sqrt(np.maximum((1 - cos) * (1 + cos), 1e-6))
        self.cos, self.sin = (number(padded(v, np.float32)) for v in (cos, sin))
        self._values: list[Array] = []
        #: what each is, of `LIMITS` or "bend", and the columns of the energy that go with it
        self._kinds: list[tuple[str, list[int]]] = []

    @property
    def count(self) -> int:
        return len(self._values)

    def add(self, kind: str, value: Array, energy: list[int] | None = None) -> list[int]:
        """Another number or colour; its columns."""
        parts = _parts(value)
        first = len(self._values)
        self._values += parts
        self._kinds += [(kind, energy or [])] * len(parts)
        return list(range(first, first + len(parts)))

    def part(self, lobe: Lobe, weighed: bool = True) -> Part:
        """A lobe; `weighed` if its value will be asked for."""
        energy = self.add("energy", lobe.energy)
        along, across = lobe.alpha_x, lobe.alpha_y
        alphas: list[int] = []
        if lobe.alpha_x is not lobe.alpha_y:
            if lobe.frame.turned:
                upright = dr.abs(lobe.frame.cos) > 0.5
                along, across = (dr.select(upright, a, b) for a, b in ((along, across), (across, along)))
            alphas = [k for value in (along, across) for k in self.add("shape", value, energy)]
        elif dr.width(along) > 1:
            alphas = self.add("shape", along, energy)
        gain = self.add("shape", lobe.gains(), energy)[0] if weighed else None
        bend = None if lobe.same else self.add("bend", lobe.axis.x / self.sin)[0]
        if not alphas:
            # One number, whatever it was computed beside: that may have given it as many lanes.
            alpha = dr.opaque(type(along), float(np.ravel(np.array(along))[0]))
            lobe = replace(lobe, alpha_x=alpha, alpha_y=alpha)
        kept = replace(lobe, energy=_empty(lobe.energy), axis=None, frame=Frame(0.0))
        if alphas:
            kept = replace(kept, alpha_x=None, alpha_y=None)
        return Part(kept, energy, alphas, gain, bend)

    def values(self, last: Array | None) -> list[np.ndarray]:
        """All columns (M,), and after them those of what is no part of the table: the shape of diffuse light."""
        found = [*self._values, *([] if last is None else _parts(last))]
        found = [value + 0 * self.cos for value in found]
        dr.eval(found)
        return [np.array(value, dtype=np.float64) for value in found]

    def enough(self, values: list[np.ndarray]) -> int | None:
        """The fewest cells with which interpolation is as good as `LIMITS` say; None if there are none."""
        if not all(np.isfinite(v).all() for v in values):
            return None
        kinds = [*self._kinds, *[("shape", [])] * (len(values) - self.count)]
        limited = [(values[k], *kind) for k, kind in enumerate(kinds) if kind[0] in LIMITS]
        counts = [count for count in (self.count, len(values) - self.count) if count]
        allowed = [n for n in CELLS if sum(rows.size(count, n) for count in counts) <= BYTES]
        for cells in allowed:
            if all(np.max(_error(cells, values, *one)) <= 1 for one in limited):
                return cells
        for one in limited if allowed else []:
            if np.mean(_error(allowed[-1], values, *one) > 1) > EDGES:
                return None
        return allowed[-1] if allowed else None


def _error(
    cells: int, values: list[np.ndarray], value: np.ndarray, kind: str, energy: list[int]
) -> np.ndarray:
    """How far interpolation is off in one of the columns, in what is allowed."""
    every = (len(value) - 1) // cells
    cell = np.minimum(np.arange(len(value)) // every, cells - 1)
    f = np.arange(len(value)) / every - cell
    ends = value[::every]
    error = np.abs(ends[cell] * (1 - f) + ends[cell + 1] * f - value)
    if kind == "shape":
        error = error / np.maximum(np.abs(value), 1e-9)
    if energy:
        error = error * np.minimum(np.mean([values[e] for e in energy], axis=0) / FAINT, 1)
    return np.asarray(error / LIMITS[kind])


def _empty(value: Array) -> Array:
    """A number or colour of this type."""
    return type(value)(0)


def _parts(value: Array) -> list[Array]:
    size = channels(value)
    return [value[c] for c in range(size)] if size else [value]


def _picked(like: Array, values: list[Array], where: list[int]) -> Array:
    picked = [values[k] for k in where]
    return type(like)(*picked) if channels(like) else picked[0]


def _along(w: Vector) -> Frame:
    """The frame whose first axis lies in the plane of incidence."""
    square = dr.square(w.x) + dr.square(w.y)
    inverse = dr.rsqrt(at_least(square, 1e-12))
    frame = Frame(0.0)
    frame.turned = True
    frame.cos = dr.select(square > 1e-12, w.x * inverse, 1.0)
    frame.sin = dr.select(square > 1e-12, w.y * inverse, 0.0)
    return frame
