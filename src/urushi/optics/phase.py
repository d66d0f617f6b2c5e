"""Phase functions: the density, per solid angle, of the direction after a scattering event.

`eval` takes both propagation directions (the light before and after the event); the angle between them is the
scattering angle, 0 meaning straight on. Each is one class with `eval`, `sample` and `flat`; a new one is another
class and one line in `PHASE_FUNCTIONS`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from .vectors import Array, Vector, around, at_least, at_most


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


PHASE_FUNCTIONS: dict[str, Any] = {
    "isotropic": Isotropic,
    "henyey_greenstein": HenyeyGreenstein,
    "rayleigh": Rayleigh,
}
