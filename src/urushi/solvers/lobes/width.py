"""How wide a lobe is: a number that adds up.

The sum of two independent GGX slopes is as wide as the sum of their f says, with f(alpha) = alpha^1.35: a power,
since slopes have no scale, fitted to the medians of such sums (Monte Carlo, to 1 % for two). Variances, the power 2,
do not exist for GGX, whose tails are long. Belcour 2018 adds alpha^1.1 / (1 - alpha^1.1) (section 5), a tenth too
wide for two lobes and more for more; that is `PUBLISHED`. See theory (lobes.1, lobes.2).

An anisotropic interface has one such number along each of its axes, and interfaces turned against one another have
different axes: then a width is a symmetric matrix f(alpha_x) x x^T + f(alpha_y) y y^T (Weier & Belcour 2020;
Yamaguchi et al. 2020). Matrices and numbers mix: a number is a multiple of the unit matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...interfaces.base import Frame
from ...optics.vectors import Array, at_least, at_most

Width = Any  # an Array or a Tensor; products have it on the left, since Dr.Jit's arrays know no Tensor

#: the roughest that has a finite width in the published scale
ROUGHEST = 0.9999


@dataclass(frozen=True)
class Scale:
    """f and its inverse.

    Attributes:
        power: of the roughness.
        published: with the denominator of the paper, which keeps every roughness below 1, and linear factors;
            otherwise what is rougher than 1 counts as 1, the roughest that there is.
    """

    power: float
    published: bool

    def additive(self, alpha: Array) -> Array:
        """f(alpha)."""
        x = dr.power(at_least(at_most(alpha, ROUGHEST) if self.published else alpha, 1e-8), self.power)
        return dr.select(alpha > 0, x / (1 - x) if self.published else x, 0.0)

    def roughness(self, width: Array) -> Array:
        """The roughness of a width, the inverse of `additive`."""
        x = at_least(width, 1e-12)
        x = x / (1 + x) if self.published else at_most(x, 1.0)
        return dr.select(width > 0, dr.power(x, 1 / self.power), 0.0)

    def factor(self, j: Array) -> Array:
        """What a width is multiplied by where a roughness is by j."""
        return j if self.published else dr.power(j, self.power)


OURS, PUBLISHED = Scale(1.35, False), Scale(1.1, True)


def at_least_zero(width: Width) -> Width:
    """Without what rounding, or a difference of approximations, made negative."""
    if isinstance(width, Tensor):
        return Tensor(at_least(width.xx, 0), width.xy, at_least(width.yy, 0))
    return at_least(width, 0)


class Tensor:
    """A width that differs between directions: the symmetric matrix ((xx, xy), (xy, yy))."""

    def __init__(self, xx: Array, xy: Array, yy: Array) -> None:
        self.xx, self.xy, self.yy = xx, xy, yy

    def __add__(self, other: Any) -> Tensor:
        if isinstance(other, Tensor):
            return Tensor(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy)
        return Tensor(self.xx + other, self.xy, self.yy + other)

    __radd__ = __add__

    def __mul__(self, factor: Array) -> Tensor:
        return Tensor(self.xx * factor, self.xy * factor, self.yy * factor)


def plus(*widths: Width) -> Width:
    """The sum, matrices first for the same reason."""
    first, *rest = sorted(widths, key=lambda width: not isinstance(width, Tensor))
    for width in rest:
        first = first + width
    return first


def of_interface(alpha_x: Array, alpha_y: Array, frame: Frame, isotropic: bool, scale: Scale = OURS) -> Width:
    """The width that an interface adds, for roughnesses along the axes of its frame."""
    if isotropic:
        return scale.additive(alpha_x)
    a, b = scale.additive(alpha_x), scale.additive(alpha_y)
    if not frame.turned:
        return Tensor(a, 0.0, b)
    c, s = frame.cos, frame.sin
    return Tensor(a * c * c + b * s * s, (a - b) * s * c, a * s * s + b * c * c)


def axes(width: Width, scale: Scale = OURS) -> tuple[Array, Array, Frame]:
    """Roughness along two axes, and the frame of these."""
    if not isinstance(width, Tensor):
        alpha = scale.roughness(width)
        return alpha, alpha, Frame(0.0)
    mean, half = 0.5 * (width.xx + width.yy), 0.5 * (width.xx - width.yy)
    if isinstance(width.xy, float) and width.xy == 0:
        return scale.roughness(width.xx), scale.roughness(width.yy), Frame(0.0)
    length = dr.sqrt(at_least(dr.square(half) + dr.square(width.xy), 1e-24))
    turn = 0.5 * dr.atan2(width.xy, half + dr.select(length > 1e-11, 0.0, 1.0))
    major, minor = scale.roughness(mean + length), scale.roughness(at_least(mean - length, 0))
    return major, minor, Frame(turn * (180 / dr.pi))


def mean_roughness(width: Width, scale: Scale = OURS) -> Array:
    """One roughness that stands for all directions."""
    return scale.roughness(0.5 * (width.xx + width.yy) if isinstance(width, Tensor) else width)


def capped(width: Width) -> Width:
    """No wider, in the mean over directions, than the roughest there is."""
    if isinstance(width, Tensor):
        return width * (1 / at_least(0.5 * (width.xx + width.yy), 1.0))
    return at_most(width, 1.0)
