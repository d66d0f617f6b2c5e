"""Importance sampling with a density that is known exactly.

A mixture, in proportion to flux (the factor of radiance comes and goes as light enters a material and leaves it): the
delta parts, with probabilities as the luminance they carry; the lobe of the outermost interface, where that has a
closed form; the hats of the two incident nodes around wi (`cells`), each by its distance; and a little of a cosine lobe
on every side, so that no direction is left out. Like f itself the density is continuous on either side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, Vector, at_least, at_most, cosine_hemisphere, root, total
from ..arrays import number_type
from ..facet_lobe import Lobe
from .cells import BINS, LUMINANCE, Cells, hats, squares, steps
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
        self.columns = cells.mass.shape[1]
        self.above = cells.counts[0]
        keys = [theta + APART * k for k, theta in enumerate(cells.theta)]
        self.theta = Lookup(np.concatenate([*keys, [np.inf]]), number)
        self.mass = Lookup(cells.mass.sum(axis=(1, 2)), number)
        self.face = Lookup(face, number)
        self.cdf = Lookup(_running(cells.mass.sum(axis=2)), number)
        self.bins = Lookup(_running(cells.mass), number)
        self.width = Lookup(cells.width, number)
        # The horizon begins no interval: nothing lies beyond it.
        self.points = Lookup(
            np.concatenate([*(np.append(key, key[0] + 2) for key in keys), [np.inf]]), number
        )
        sin, cos = zip(*(squares(theta) for theta in cells.theta), strict=True)
        self.sin, self.cos = Lookup(np.concatenate(sin), number), Lookup(np.concatenate(cos), number)
        before, after = (
            np.concatenate(
                [np.clip(np.arange(len(x)) + d, 0, len(x) - 1) + self._start(k) for k, x in enumerate(sin)]
            )
            for d in (-1, 1)
        )
        left = [0.5 * np.append(0, steps(*pair)) / hats(*pair) for pair in zip(sin, cos, strict=True)]
        self.left = Lookup(np.concatenate(left), number)
        whole = int if number is float else module.UInt
        self.before, self.after = (Lookup(x.astype(np.uint32), whole) for x in (before, after))
        self.inv_hat = Lookup(
            np.concatenate([1 / hats(*pair) for pair in zip(sin, cos, strict=True)]), number
        )

    def _start(self, side: int) -> int:
        return 0 if side == 0 else self.above + 1

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
        cos, sin_sq = dr.abs(wo.z), dr.square(wo.x) + dr.square(wo.y)
        theta = dr.atan2(dr.sqrt(sin_sq), cos)
        key = theta if self.opaque else dr.select(wo.z > 0, theta, theta + APART)
        low = dr.binary_search(1, self.columns, lambda i: self.points[i] <= key) - 1
        high = self.after[low]
        # Where between both, by whichever of sine and cosine is small and knows it to all digits.
        steep = sin_sq < 0.5
        here = dr.select(steep, sin_sq, dr.square(cos))
        start = dr.select(steep, self.sin[low], self.cos[low])
        stop = dr.select(steep, self.sin[high], self.cos[high])
        t = at_most(at_least((here - start) / (stop - start), 0), 1)
        away, toward = away_and_toward(wi, wo)
        roots = dr.sqrt(away), dr.sqrt(toward)
        density = 0 * cos
        for column, hat in ((low, 1 - t), (high, t)):
            hat = hat * self.inv_hat[column]
            for row, share in zip(mixture.rows, mixture.shares, strict=True):
                pair = row * self.columns + column
                width = self.width[pair]
                chance = self._chance(self.cdf, row * self.columns, column)
                # ds / dphi, on both halves of the circle
                slope = width * dr.rcp(at_least(toward * dr.square(width) + away, 1e-30))
                s = dr.atan2(roots[0], width * roots[1]) * (2 * BINS / dr.pi)
                density = density + share * chance * hat * slope * self._around(pair, s)
        density = density * (2 * cos) + mixture.floor * (
            cos * (dr.inv_pi if self.opaque else 0.5 * dr.inv_pi)
        )
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

    def _around(self, pair: Any, s: Array) -> Array:
        """Density of the stretched azimuth, which is s pi / BINS, for a pair."""
        start = pair * (BINS + 1)
        low = at_most(self._whole(s, pair), BINS - 1)
        t = at_most(s - self._number(low, s), 1)
        one, two = self._chance(self.bins, start, low), self._chance(self.bins, start, low + 1)
        # Hats at the ends are halves.
        one, two = dr.select(low == 0, 2 * one, one), dr.select(low == BINS - 1, 2 * two, two)
        return ((1 - t) * one + t * two) * (BINS / dr.pi)

    def _cell(self, row: Any, wi: Vector, u1: Array, u2: Array) -> Vector:
        """A direction from the hats of one incident node."""
        start = row * self.columns
        column, v = self._invert(self.cdf, start, self.columns, u1)
        positive = u2 < 0.5
        u2 = dr.select(positive, 2 * u2, 2 * u2 - 1)
        pair = start + column
        point, w = self._invert(self.bins, pair * (BINS + 1), BINS + 1, u2)
        before, after = self.before[column], self.after[column]
        # The part of the hat on the side of the normal, and the place under it.
        left, near, far = _hat(v, self.left[column])
        sin = root(near * self.sin[column] + far * dr.select(left, self.sin[before], self.sin[after]))
        cos = root(near * self.cos[column] + far * dr.select(left, self.cos[before], self.cos[after]))
        share = dr.select(point == 0, 0.0, dr.select(point == BINS, 1.0, 0.5))
        left, _, far = _hat(w, share)
        place = self._number(point, u1) + dr.select(left, -far, far)
        half_sin, half_cos = dr.sincos((0.5 * dr.pi / BINS) * place)
        a = self.width[pair] * half_sin
        scale = dr.rcp(dr.square(a) + dr.square(half_cos))
        cos_phi, sin_phi = (dr.square(half_cos) - dr.square(a)) * scale, 2 * a * half_cos * scale
        sin_phi = dr.select(positive, sin_phi, -sin_phi)
        length = dr.square(wi.x) + dr.square(wi.y)
        inv = dr.rsqrt(at_least(length, 1e-30))
        # Straight on; along the normal as in `away_and_toward`.
        x, y = dr.select(length > 1e-30, -wi.x * inv, -1.0), dr.select(length > 1e-30, -wi.y * inv, 0.0)
        z = cos if self.opaque else dr.select(column <= self.above, cos, -cos)
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


def _hat(u: Array, share: Array) -> tuple[Any, Array, Array]:
    """A place under a hat of which `share` is on the left: whether it is there, and the weights of middle and end."""
    left = u < share
    v = dr.select(left, u / at_least(share, 1e-30), (1 - u) / at_least(1 - share, 1e-30))
    near = dr.sqrt(at_most(v, 1))
    return left, near, 1 - near


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
