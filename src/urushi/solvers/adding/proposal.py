"""Importance sampling with a density that is known exactly.

A mixture: the delta parts, with probabilities as the luminance they carry; the lobe of the outermost interface, where
that has a closed form; the cells of the two incident nodes around wi (`cells`), each by its distance; and a little of
a cosine lobe on every side, so that no direction is left out. Probability is spread evenly over the square of the
cosine in a cell, and over the stretched azimuth in a bin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, Vector, at_least, at_most, cosine_hemisphere, root, total
from ..arrays import number_type
from ..facet_lobe import Lobe
from .cells import BINS, LUMINANCE, Cells
from .stencil import APART, Lookup, away_and_toward

#: share of the cosine lobes among all that is not a delta part
FLOOR = 0.02


@dataclass
class Delta:
    """The delta parts for one wi: flux, mirror direction and Snell's direction; `straight` None for opaque stacks."""

    reflected: Array
    transmitted: Array
    mirrored: Vector
    straight: Vector | None


@dataclass
class Mixture:
    """Everything `Proposal` knows for one wi; shares sum to 1, or to 0 where nothing is scattered.

    Attributes:
        rows: the two incident nodes around wi; `shares` are those of their cells.
        faces: lobes of the outermost interfaces.
    """

    rows: tuple[Any, Any]
    shares: tuple[Array, Array]
    floor: Array
    faces: list[Lobe]
    mirror: Array
    straight: Array


class Proposal:
    """See the module docstring.

    Args:
        cells: what is scattered where.
        face: (R,) luminance of the outermost interface's own lobe for light from each incident node.
        module, double: what to compute in.
    """

    def __init__(self, cells: Cells, face: np.ndarray, module: Any, double: bool) -> None:
        number = number_type(module, double)
        self.opaque = cells.counts[1] == 0
        self.rows = sum(cells.counts)
        self.cells = self.rows  # as many cells as nodes, on the same sides
        self.above = cells.counts[0]
        keys = np.concatenate([theta + APART * k for k, theta in enumerate(cells.theta)])
        self.theta = Lookup(np.append(keys, np.inf), number)
        self.mass = Lookup(cells.mass.sum(axis=(1, 2)), number)
        self.face = Lookup(face, number)
        self.cdf = Lookup(_running(cells.mass.sum(axis=2)), number)
        self.bins = Lookup(_running(cells.mass), number)
        self.width = Lookup(cells.width, number)
        self.edges = Lookup(
            np.append(np.concatenate([e[:-1] + APART * k for k, e in enumerate(cells.edges)]), np.inf), number
        )
        sin = [np.sin(e) ** 2 for e in cells.edges]
        cos = [np.cos(e) ** 2 for e in cells.edges]
        for c in cos:
            c[-1] = 0.0
        self.sin_low, self.sin_high = (
            Lookup(np.concatenate([x[part] for x in sin]), number) for part in ENDS
        )
        self.cos_high, self.cos_low = (
            Lookup(np.concatenate([x[part] for x in cos]), number) for part in ENDS
        )

    def around(self, wi: Vector) -> tuple[tuple[Any, Any], Array]:
        """The rows of the two incident nodes around wi, and how far it is from the first to the second, 0 to 1."""
        theta = dr.atan2(dr.sqrt(dr.square(wi.x) + dr.square(wi.y)), dr.abs(wi.z))
        key = theta if self.opaque else dr.select(wi.z > 0, theta, theta + APART)
        below = dr.binary_search(1, self.rows, lambda i: self.theta[i] <= key) - 1
        last = below + 1 == (self.above if self.opaque else dr.select(wi.z > 0, self.above, self.rows))
        after = dr.select(last, below, below + 1)
        low, high = self.theta[below], self.theta[after]
        t = dr.select(last, 0, at_most(at_least((key - low) / at_least(high - low, 1e-12), 0), 1))
        return (below, after), t

    def mixture(self, wi: Vector, delta: Delta, faces: list[Lobe]) -> Mixture:
        """The mixture for light from wi; the shares of `faces` are filled in, 1 or 0 by the side they are for."""
        (below, after), t = self.around(wi)
        lit = (wi.z > 0) if self.opaque else (wi.z != 0)
        one, two = (1 - t) * self.mass[below], t * self.mass[after]
        face = (1 - t) * self.face[below] + t * self.face[after] if faces else 0 * t
        mirror, straight = luminance(delta.reflected), luminance(delta.transmitted)
        floor = FLOOR * (one + two + face)
        sum_ = one + two + face + floor + mirror + straight
        scale = dr.select(lit & (sum_ > 0), dr.rcp(at_least(sum_, 1e-30)), 0)
        for lobe in faces:
            lobe.share = dr.select(lobe.share, face * scale, 0)
        return Mixture(
            (below, after), (one * scale, two * scale), floor * scale, faces, mirror * scale, straight * scale
        )

    def pdf(self, mixture: Mixture, wi: Vector, wo: Vector) -> Array:
        """Density per solid angle of everything but the delta parts."""
        cos = dr.abs(wo.z)
        theta = dr.atan2(dr.sqrt(dr.square(wo.x) + dr.square(wo.y)), cos)
        key = theta if self.opaque else dr.select(wo.z > 0, theta, theta + APART)
        cell = dr.binary_search(1, self.cells, lambda i: self.edges[i] <= key) - 1
        away, toward = away_and_toward(wi, wo)
        spread = 2 * cos * dr.rcp(at_least(self.sin_high[cell] - self.sin_low[cell], 1e-30))
        density = mixture.floor * (cos * (dr.inv_pi if self.opaque else 0.5 * dr.inv_pi))
        for row, share in zip(mixture.rows, mixture.shares, strict=True):
            pair = row * self.cells + cell
            width = self.width[pair]
            s = 2 * dr.atan2(dr.sqrt(away), width * dr.sqrt(toward))
            bin_ = at_most(self._whole(s * (BINS / dr.pi), cell), BINS - 1)
            chance = self._chance(self.cdf, row * self.cells, cell) * self._chance(
                self.bins, pair * BINS, bin_
            )
            # ds / dphi, on both halves of the circle
            slope = 2 * width * dr.rcp(at_least(toward * dr.square(width) + away, 1e-30))
            density = density + share * chance * spread * slope * (0.5 * BINS / dr.pi)
        for lobe in mixture.faces:
            here = (wo.z > 0) if lobe.up else (wo.z < 0)
            density = density + dr.select(here, lobe.share * lobe.pdf(wo), 0)
        return dr.select((wo.z > 0) if self.opaque else (wo.z != 0), density, 0)

    def sample(
        self, mixture: Mixture, wi: Vector, u: Vector, delta: Delta
    ) -> tuple[Vector, Array, Array, Any]:
        """(wo, probability of the delta part chosen, what it carries, mask of delta lanes)."""
        first, second = mixture.shares
        row = dr.select(u.x < first, *mixture.rows)
        wo = self._cell(row, wi, u.y, u.z)
        below = first + second
        chosen = u.x >= below
        # One number serves twice: which side, and where on it.
        half = u.y < 0.5
        v = u.y if self.opaque else dr.select(half, 2 * u.y, 2 * u.y - 1)
        floor = cosine_hemisphere(v, u.z, wi)
        z = floor.z if self.opaque else dr.select(half, floor.z, -floor.z)
        wo = dr.select(chosen, type(wi)(floor.x, floor.y, z), wo)
        below = below + mixture.floor
        for lobe in mixture.faces:
            wo = dr.select((u.x >= below) & (lobe.share > 0), lobe.sample(wi, u.y, u.z), wo)
            below = below + lobe.share
        mirrored = (u.x >= below) & (mixture.mirror > 0)
        wo = dr.select(mirrored, delta.mirrored, wo)
        probability = dr.select(mirrored, mixture.mirror, 0)
        carried = dr.select(mirrored, delta.reflected, 0)
        if delta.straight is None:
            return wo, probability, carried, mirrored
        straight = (u.x >= below + mixture.mirror) & (mixture.straight > 0)
        wo = dr.select(straight, delta.straight, wo)
        probability = dr.select(straight, mixture.straight, probability)
        return wo, probability, dr.select(straight, delta.transmitted, carried), mirrored | straight

    def _cell(self, row: Any, wi: Vector, u1: Array, u2: Array) -> Vector:
        """A direction from the cells of one incident node."""
        start = row * self.cells
        cell, v = self._invert(self.cdf, start, self.cells, u1)
        positive = u2 < 0.5
        u2 = dr.select(positive, 2 * u2, 2 * u2 - 1)
        pair = start + cell
        bin_, w = self._invert(self.bins, pair * BINS, BINS, u2)
        sin_low, cos_low = self.sin_low[cell], self.cos_low[cell]
        sin = root(dr.fma(v, self.sin_high[cell] - sin_low, sin_low))
        cos = root(dr.fma(1 - v, self.cos_high[cell] - cos_low, cos_low))
        half_sin, half_cos = dr.sincos((0.5 * dr.pi / BINS) * (self._number(bin_, u1) + w))
        a = self.width[pair] * half_sin
        scale = dr.rcp(dr.square(a) + dr.square(half_cos))
        cos_phi, sin_phi = (dr.square(half_cos) - dr.square(a)) * scale, 2 * a * half_cos * scale
        sin_phi = dr.select(positive, sin_phi, -sin_phi)
        length = dr.square(wi.x) + dr.square(wi.y)
        inv = dr.rsqrt(at_least(length, 1e-30))
        # Straight on; along the normal as in `away_and_toward`.
        x, y = dr.select(length > 1e-30, -wi.x * inv, -1.0), dr.select(length > 1e-30, -wi.y * inv, 0.0)
        z = cos if self.opaque else dr.select(cell < self.above, cos, -cos)
        return type(wi)(sin * (x * cos_phi - y * sin_phi), sin * (y * cos_phi + x * sin_phi), z)

    def _invert(self, table: Lookup, start: Any, count: int, u: Array) -> tuple[Any, Array]:
        """Which of `count` entries a number falls into, and where in it."""
        found = dr.binary_search(0, count - 1, lambda i: table[start + i] <= u)
        low = self._before(table, start, found)
        high = table[start + found]
        return found, at_most(at_least((u - low) / at_least(high - low, 1e-30), 0), 1)

    def _chance(self, table: Lookup, start: Any, i: Any) -> Array:
        return table[start + i] - self._before(table, start, i)

    def _before(self, table: Lookup, start: Any, i: Any) -> Array:
        return dr.select(i > 0, table[start + i - dr.select(i > 0, 1, 0)], 0)

    def _whole(self, value: Array, like: Any) -> Any:
        return int(value) if isinstance(like, int) else type(like)(value)

    def _number(self, value: Any, like: Array) -> Array:
        return float(value) if isinstance(like, float) else type(like)(value)


#: the lower and the upper ends of cells
ENDS = (slice(None, -1), slice(1, None))


def luminance(value: Array) -> Array:
    """Luminance of a colour; the number itself if it is one."""
    if not dr.is_array_v(value) or dr.size_v(value) == dr.Dynamic:
        return value
    if dr.size_v(value) == 3:
        return (
            value[0] * float(LUMINANCE[0]) + value[1] * float(LUMINANCE[1]) + value[2] * float(LUMINANCE[2])
        )
    return total(value) * (1 / dr.size_v(value))


def _running(mass: np.ndarray) -> np.ndarray:
    """Running sums along the last axis, ending in 1; all 0 where there is nothing."""
    found = np.cumsum(mass, axis=-1)
    whole = found[..., -1:]
    found = np.where(whole > 0, found / np.where(whole > 0, whole, 1), 0)
    found[..., -1:] = whole > 0
    return found
