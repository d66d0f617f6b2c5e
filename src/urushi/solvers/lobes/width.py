"""How wide a lobe is: a number that adds up.

The roughness of the convolution of two GGX lobes is neither the sum of theirs nor the root of the sum of squares; it
is well given by adding f(alpha) = alpha^1.1 / (1 - alpha^1.1) (Belcour 2018, section 5, to a few per cent below
0.3). An anisotropic interface has one such number along each of its axes, and interfaces turned against one another
have different axes: then a width is a symmetric matrix f(alpha_x) x x^T + f(alpha_y) y y^T (Weier & Belcour 2020;
Yamaguchi et al. 2020). Matrices and numbers mix: a number is a multiple of the unit matrix.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces.base import Frame
from ...optics.vectors import Array, at_least, at_most

Width = Any  # an Array or a Tensor; products have it on the left, since Dr.Jit's arrays know no Tensor

POWER = 1.1
#: the roughest that has a finite width
ROUGHEST = 0.9999


def additive(alpha: Array) -> Array:
    """f(alpha)."""
    x = dr.power(at_least(at_most(alpha, ROUGHEST), 1e-8), POWER)
    return dr.select(alpha > 0, x / (1 - x), 0.0)


def roughness(width: Array) -> Array:
    """The roughness of a width, the inverse of `additive`."""
    return dr.select(
        width > 0, dr.power(at_least(width, 1e-12) / (1 + at_least(width, 1e-12)), 1 / POWER), 0.0
    )


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


def of_interface(alpha_x: Array, alpha_y: Array, frame: Frame, isotropic: bool) -> Width:
    """The width that an interface adds, for roughnesses along the axes of its frame."""
    if isotropic:
        return additive(alpha_x)
    a, b = additive(alpha_x), additive(alpha_y)
    if not frame.turned:
        return Tensor(a, 0.0, b)
    c, s = frame.cos, frame.sin
    return Tensor(a * c * c + b * s * s, (a - b) * s * c, a * s * s + b * c * c)


def axes(width: Width) -> tuple[Array, Array, Frame]:
    """Roughness along two axes, and the frame of these."""
    if not isinstance(width, Tensor):
        alpha = roughness(width)
        return alpha, alpha, Frame(0.0)
    mean, half = 0.5 * (width.xx + width.yy), 0.5 * (width.xx - width.yy)
    if isinstance(width.xy, float) and width.xy == 0:
        return roughness(width.xx), roughness(width.yy), Frame(0.0)
    length = dr.sqrt(at_least(dr.square(half) + dr.square(width.xy), 1e-24))
    turn = 0.5 * dr.atan2(width.xy, half + dr.select(length > 1e-11, 0.0, 1.0))
    return roughness(mean + length), roughness(at_least(mean - length, 0)), Frame(turn * (180 / dr.pi))


def mean_roughness(width: Width) -> Array:
    """One roughness that stands for all directions."""
    return roughness(0.5 * (width.xx + width.yy)) if isinstance(width, Tensor) else roughness(width)
