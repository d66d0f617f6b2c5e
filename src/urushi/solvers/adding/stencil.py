"""Between the nodes, on Dr.Jit arrays: which nodes a direction is interpolated from, and with what weights.

The scheme is that of `Grid.stencil`: Lagrange's polynomials through some neighbouring nodes of one panel, in the angle
psi of `basis`, where every quantity is smooth; past the upper end of a panel the nodes continue as their mirror images,
and past normal incidence these belong to the opposite azimuth (`flip`). Everything is looked up in flat arrays, one
after another for every panel of the two regions outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, Vector, at_least, root
from ..arrays import number_type
from .basis import SAME, Grid

#: distance between the keys of one panel and the next; psi is at most pi / 2
APART = 4.0


class Lookup:
    """An array of numbers to be looked up by index, in one module and precision; also with plain Python numbers.

    Args:
        values: any shape, flattened.
        number: the type of what is looked up: a Dr.Jit float array, an unsigned integer array, float or int.
    """

    def __init__(self, values: np.ndarray, number: Any) -> None:
        self.number = number
        self.plain = number in (float, int)
        flat = np.ascontiguousarray(values).ravel()
        self.values: Any = flat.tolist() if self.plain else number(flat)
        if not self.plain:
            dr.eval(self.values)

    def __getitem__(self, index: Any) -> Any:
        return self.values[int(index)] if self.plain else dr.gather(self.number, self.values, index)


@dataclass
class Place:
    """Where a direction lies among the nodes.

    Attributes:
        theta, sin: its polar angle, in [0, pi / 2], and the sine of that.
        psi: its coordinate in its panel.
        first: number of the first entry of its stencil.
        cell: number of its set of weights.
        norm: what the weights are to be multiplied with.
        up: on which side.
    """

    theta: Array
    sin: Array
    psi: Array
    first: Any
    cell: Any
    norm: Array
    up: Any


class Stencils:
    """The nodes outside a stack.

    Args:
        grid: of the whole stack.
        regions: those outside, above and below; one of them where the stack is opaque.
        order: nodes per direction.
        module: the Dr.Jit module to compute in.
        double: whether in double precision.
    """

    def __init__(self, grid: Grid, regions: tuple[int, ...], order: int, module: Any, double: bool) -> None:
        self.order = order
        self.upon = 1e-14 if double else 1e-9  # nearer to a node is upon it
        number = number_type(module, double)
        whole = int if number is float else module.UInt
        self.counts = [grid.count(region) for region in regions]
        # Both sides may have the same index, and then one set of everything.
        self.same = len(regions) == 1 or abs(grid.indices[regions[0]] / grid.indices[regions[1]] - 1) < SAME
        self.panels: list[list[tuple[float, float, float, float, float]]] = []
        keys: list[np.ndarray] = []
        psi, node, flip, first, weights = [], [], [], [], []
        entries = 0
        for region in regions[: 1 if self.same else 2]:
            index, before, here = grid.indices[region], 0.0, []
            for p in grid.panels:
                if p.first >= grid.count(region):
                    break
                own_image = int(p.first == 0)  # the node at normal incidence is its own mirror image
                angle = np.arccos(grid.x[p.nodes])
                ext = np.concatenate([-angle[own_image:][::-1], angle])
                number_of = np.arange(p.first, p.first + p.count)
                size = min(order, len(ext))
                starts = np.clip(np.arange(len(ext) + 1) - size // 2, 0, len(ext) - size)
                some = starts[1:, None] + np.arange(size)
                apart = ext[some][:, :, None] - ext[some][:, None, :] + np.eye(size)
                w = np.zeros((len(ext), order))
                w[:, :size] = 1 / apart.prod(axis=2)
                weights.append(w / np.abs(w).max(axis=1, keepdims=True))
                first.append(entries + np.minimum(starts[1:], len(ext) - 1))
                keys.append(ext + APART * len(keys))
                psi.append(ext)
                node.append(np.concatenate([number_of[own_image:][::-1], number_of]))
                mirrored = np.arange(len(ext)) < p.count - own_image
                flip.append((mirrored & bool(own_image)).astype(np.uint32))
                here.append(
                    (p.index / index, float(p.high), before / index, APART * (len(keys) - 1), p.squeeze)
                )
                entries += len(ext)
                before = p.index
            self.panels.append(here)
        pad = np.zeros(order)  # a short panel's stencil reaches past the end of all: with weight 0
        self.entries = entries
        self.keys = Lookup(np.concatenate([*keys, [np.inf]]), number)
        self.psi = Lookup(np.concatenate([*psi, pad]), number)
        self.node = Lookup(np.concatenate([*node, pad]).astype(np.uint32), whole)
        self.flip = Lookup(np.concatenate([*flip, pad]).astype(np.uint32), whole)
        self.first = Lookup(np.concatenate(first).astype(np.uint32), whole)
        self.weights = Lookup(np.concatenate(weights), number)

    def place(self, w: Vector) -> Place:
        """Where a direction lies, on either side."""
        sin, cos = dr.sqrt(dr.square(w.x) + dr.square(w.y)), dr.abs(w.z)
        psi, key = self._coordinate(0, sin, cos)
        if not self.same:
            psi_low, key_low = self._coordinate(1, sin, cos)
            psi, key = dr.select(w.z > 0, psi, psi_low), dr.select(w.z > 0, key, key_low)
        # How many keys lie below: at least one, since the mirror images begin below 0.
        cell = dr.binary_search(1, self.entries, lambda i: self.keys[i] < key) - 1
        place = Place(dr.atan2(sin, cos), sin, psi, self.first[cell], cell, 1.0 + 0 * psi, w.z > 0)
        total = 0 * psi
        for k in range(self.order):
            total = total + self.weight(place, k)
        place.norm = dr.rcp(total)
        return place

    def weight(self, place: Place, k: Any) -> Array:
        """The weight of the k-th node of the stencil."""
        away = place.psi - self.psi[place.first + k]
        # Upon a node its weight is so much larger than all others that these vanish.
        away = dr.select(dr.abs(away) < self.upon, self.upon, away)
        return self.weights[place.cell * self.order + k] / away * place.norm

    def entry(self, place: Place, k: Any) -> tuple[Any, Any]:
        """Number of the k-th node, and 1 if it stands for the opposite azimuth."""
        return self.node[place.first + k], self.flip[place.first + k]

    def _coordinate(self, side: int, sin: Array, cos: Array) -> tuple[Array, Array]:
        """psi in its panel, and the key to search for."""
        psi, key, chosen = 0 * sin, 0 * sin, None
        for ratio, high, before, offset, squeeze in self.panels[side]:
            # All in units of the index of the region: ratio is the panel's own, sin / ratio the sine in its medium.
            own = cos if ratio >= 1 - SAME else root(1 - dr.square(sin * (1 / ratio)))
            rest = (dr.square(sin) - before**2) / (
                ratio**2 * high * (high + own)
            )  # 1 - x^2, without cancellation
            x_sq = own * (1 / high)
            here = dr.atan2(root(rest), squeeze * root(x_sq))
            if chosen is None:
                psi, key, chosen = here, here + offset, sin <= ratio
            else:
                psi, key = dr.select(chosen, psi, here), dr.select(chosen, key, here + offset)
                chosen = chosen | (sin <= ratio)
        return psi, key


def away_and_toward(wi: Vector, wo: Vector) -> tuple[Array, Array]:
    """1 - cos phi and 1 + cos phi to all digits; phi is the azimuth between the ways light travels, 0 straight on.

    Along the normal there is no azimuth, and any will do.
    """

    def azimuth(w: Vector) -> tuple[Array, Array]:
        length = dr.square(w.x) + dr.square(w.y)
        scale = dr.rsqrt(at_least(length, 1e-30))
        return dr.select(length > 1e-30, w.x * scale, 1.0), dr.select(length > 1e-30, w.y * scale, 0.0)

    (ax, ay), (bx, by) = azimuth(wi), azimuth(wo)
    away = 0.5 * (dr.square(ax + bx) + dr.square(ay + by))
    toward = 0.5 * (dr.square(ax - bx) + dr.square(ay - by))
    return away, toward
