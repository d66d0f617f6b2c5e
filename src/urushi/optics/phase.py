"""Phase functions: the density, per solid angle, of the direction after a scattering event.

`eval` takes both propagation directions (the light before and after the event); the angle between them is the
scattering angle, 0 meaning straight on. Each is one class with `eval`, `sample` and `flat`; a new one is another
class and one line in `PHASE_FUNCTIONS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from .vectors import Array, Vector, around, at_least, at_most, float_type, root


class Isotropic:
    """Equal light in all directions: 1 / (4 pi)."""

    flat = True  # never much larger than its mean: sampling it never finds what a connection would miss

    def eval(self, before: Vector, after: Vector) -> Array:
        return dr.inv_four_pi + 0 * before.x

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        return around(before, 1 - 2 * u1, u2)


class HenyeyGreenstein:
    """Henyey & Greenstein 1941, of mean cosine g in (-1, 1); forward scattering for g > 0."""

    def __init__(self, g: Array) -> None:
        self.g = g
        self.sign = dr.select(g < 0, -1.0, 1.0)
        self.spread = dr.abs(g)
        self.least = dr.square(1 - self.spread)
        self.norm = dr.inv_four_pi * (1 - dr.square(g))
        self.flat = False  # whoever knows g to be small may say otherwise

    def eval(self, before: Vector, after: Vector) -> Array:
        # The angle from the peak by the difference of the directions: exact where 1 + g^2 - 2 g cos would cancel.
        away = dr.squared_norm(dr.fma(before, -self.sign, after))
        inv = dr.rsqrt(dr.fma(self.spread, away, self.least))
        return self.norm * (inv * dr.square(inv))

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        # The inverse of the cumulative distribution, as 1 - cos and 1 + cos: nothing cancels, and g = 0 is no
        # special case.
        g, v1 = self.g, 1 - u1
        scale = 2 * dr.rcp(dr.square(dr.fma(2 * self.spread, dr.select(g < 0, v1, u1), 1 - self.spread)))
        one_minus = dr.square(1 - g) * v1 * dr.fma(-g, v1, 1 + g) * scale
        one_plus = dr.square(1 + g) * u1 * dr.fma(g, u1, 1 - g) * scale
        cos = at_most(at_least(1 - one_minus, -1), 1)
        return around(before, cos, u2, dr.sqrt(one_minus * one_plus))


class Rayleigh:
    """Small particles: 3 / (16 pi) (1 + cos^2)."""

    flat = True

    def eval(self, before: Vector, after: Vector) -> Array:
        return 3 / (16 * dr.pi) * (1 + dr.square(dr.dot(before, after)))

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        # The real root of cos^3 + 3 cos = 4 (2 u - 1), after Frisvad 2011.
        a = 2 * (2 * u1 - 1)
        root = dr.cbrt(a + dr.sqrt(dr.square(a) + 1))
        return around(before, at_most(at_least(root - dr.rcp(root), -1), 1), u2)


def normalised(values: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """A tabulated phase function as a density.

    Args:
        values: (N,) at equal steps of the scattering angle from 0 to pi, linear in its cosine between them.

    Returns:
        away: (N,) 1 - cos of those angles; density: (N,) per solid angle, whose integral over all directions is 1.
    """
    away = 2 * np.sin(np.linspace(0, np.pi / 2, len(values))) ** 2
    density = np.asarray(values, float)
    return away, density / (np.pi * np.diff(away) @ (density[1:] + density[:-1]))


class Tabulated:
    """Values at equal steps of the scattering angle, linear in its cosine between them.

    Angles are measured from the nearer one of straight on and straight back, by the difference of the directions: the
    steps there are smaller than what single precision knows of a cosine.
    """

    def __init__(self, values: Sequence[float]) -> None:
        away, density = normalised(values)
        self.steps = len(away) - 1
        self.flat = bool(density.max() <= 6 / (4 * np.pi))
        share = np.pi * np.diff(away) * (density[1:] + density[:-1])
        self.tables = {
            "away": away,
            "density": density,
            "below": np.concatenate([[0], np.cumsum(share)]) / share.sum(),
        }
        self.kept: dict[Any, Any] = {}

    def eval(self, before: Vector, after: Vector) -> Array:
        back = dr.dot(before, after) < 0
        away = 0.5 * dr.squared_norm(dr.fma(before, dr.select(back, 1.0, -1.0), after))
        number, integer = float_type(before), self._integer(before)
        step = dr.asin(at_most(dr.sqrt(0.5 * away), 1)) * (2 * self.steps / dr.pi)
        near = at_most(integer(step), integer(self.steps - 1))
        far = near + 1
        low, high = (self._look("away", number, i) for i in (near, far))
        a, b = (self._look("density", number, dr.select(back, self.steps - i, i)) for i in (near, far))
        return at_least(dr.fma((away - low) / (high - low), b - a, a), 0.0)

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        number, integer = float_type(before), self._integer(before)
        step = integer(0 * u1)
        for k in reversed(range(self.steps.bit_length())):  # the last one below which there is at most u1
            further = step + (1 << k)
            inside = further < self.steps
            found = self._look("below", number, dr.select(inside, further, 0))
            step = dr.select(inside & (found <= u1), further, step)
        low, high = (self._look("below", number, i) for i in (step, step + 1))
        rest = at_most(at_least((u1 - low) / at_least(high - low, 1e-30), 0), 1)
        # The inverse of the integral of a linear function, which nothing cancels in.
        a, b = (self._look("density", number, i) for i in (step, step + 1))
        along = (
            rest
            * (a + b)
            / at_least(a + root(dr.fma(rest, dr.square(b) - dr.square(a), dr.square(a))), 1e-30)
        )
        back = 2 * step >= self.steps
        near = dr.select(back, self.steps - 1 - step, step)
        low, high = (self._look("away", number, i) for i in (near, near + 1))
        away = dr.fma(dr.select(back, 1 - along, along), high - low, low)
        cos = dr.select(back, away - 1, 1 - away)
        return around(before, cos, u2, root(away * (2 - away)))

    @staticmethod
    def _integer(w: Vector) -> Any:
        number = float_type(w)
        return int if number is float else dr.uint32_array_t(dr.detached_t(number))

    def _look(self, table: str, number: Any, index: Array) -> Array:
        if number is float:
            return float(self.tables[table][index])
        key = table, number
        if key not in self.kept:
            self.kept[key] = number(self.tables[table])
        return dr.gather(number, self.kept[key], index)


PHASE_FUNCTIONS: dict[str, Any] = {
    "isotropic": Isotropic,
    "henyey_greenstein": HenyeyGreenstein,
    "rayleigh": Rayleigh,
    "tabulated": Tabulated,
}
