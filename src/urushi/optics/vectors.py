"""Directions: small helpers that work alike on Dr.Jit arrays of any backend and on scalars.

Every direction is a three-component Dr.Jit array. The functions only use operations that exist for all of them,
so that one source serves vectors on the CPU, the GPU and plain floats.
"""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr

Array = Any  # a Dr.Jit array or a Python number; Dr.Jit has no common static type for these
Vector = Any  # a Dr.Jit array of three components


def at_least(value: Array, bound: Array) -> Array:
    """The larger of both, in two instructions: Dr.Jit's maximum spends more on passing on what is not a number."""
    return dr.select(value > bound, value, bound)


def at_most(value: Array, bound: Array) -> Array:
    """The smaller of both, likewise."""
    return dr.select(value < bound, value, bound)


def root(value: Array) -> Array:
    """The square root, 0 for what rounding made negative."""
    return dr.sqrt(at_least(value, 0))


def quick_root(value: Array) -> Array:
    """The square root of what is not negative, 1e-15 for 0: by the reciprocal root, which costs a vector unit half."""
    value = at_least(value, 1e-30)
    return value * dr.rsqrt(value)


def mirror(w: Vector) -> Vector:
    """The direction seen in the plane of the surface: z changes sign."""
    return type(w)(w.x, w.y, -w.z)


def rotate(w: Vector, cos: Array, sin: Array) -> Vector:
    """`w` turned about z by the angle whose cosine and sine are given."""
    return type(w)(cos * w.x - sin * w.y, sin * w.x + cos * w.y, w.z)


def reflect(w: Vector, m: Vector) -> Vector:
    """`w` mirrored about the normal `m`; both point away from the surface."""
    return dr.fma(m, 2 * dr.dot(w, m), -w)


def halfway(w: Vector, o: Vector) -> Vector:
    """The unit vector half-way between two; the null vector where they cancel."""
    m = w + o
    return m * dr.rsqrt(at_least(dr.squared_norm(m), 1e-30))


def refract(w: Vector, m: Vector, cos_i: Array, cos_t: Array, inv_eta: Array) -> Vector:
    """`w` refracted through a facet of normal `m` (Snell), pointing away on the far side.

    Args:
        w, m: incident direction and facet normal, on the same side.
        cos_i, cos_t: cosines of incidence (w.m > 0) and of refraction (>= 0).
        inv_eta: index of the near side over the index of the far side.
    """
    return dr.fma(m, dr.fma(cos_i, inv_eta, -cos_t), -w * inv_eta)


def azimuth(u: Array) -> tuple[Array, Array]:
    """Sine and cosine of a uniformly distributed angle, 2 pi (u - 1/2), for u in [0, 1).

    In single precision by polynomials fitted to 1e-8 over the one turn that is needed; a general sine and cosine spend
    most of their time on reducing their argument.
    """
    x = u - 0.5
    if isinstance(u, float) or dr.type_v(u) != dr.VarType.Float32:
        return dr.sincos(2 * dr.pi * x)
    y = dr.square(x)
    return x * polynomial(y, _SIN), polynomial(y, _COS)


_SIN = (6.2831853, -41.3417004, 81.6051314, -76.7030154, 42.025927, -14.8998467, 3.23813751)
_COS = (0.999999989, -19.7392045, 64.9391175, -85.4501395, 60.167631, -25.9675992, 6.52865816)


def polynomial(y: Array, coefficients: tuple[float, ...]) -> Array:
    """c0 + c1 y + c2 y^2 + ... (Horner)."""
    value = coefficients[-1] + 0 * y
    for c in reversed(coefficients[:-1]):
        value = dr.fma(value, y, c)
    return value


def around(axis: Vector, cos: Array, u: Array, sin: Array | None = None) -> Vector:
    """The direction at angle arccos(`cos`) from `axis`, its azimuth about it drawn by u.

    Drawn about z and carried over by mirroring (Householder 1958), which needs no frame: in the plane half-way between
    the axis and z, or -z, whichever is farther from it. Where the angle may be small, `sin` says what `cos` cannot.
    """
    sign = dr.select(axis.z >= 0, 1.0, -1.0)
    sin_phi, cos_phi = azimuth(u)
    if sin is None:
        sin = root((1 - cos) * (1 + cos))
    v = type(axis)(sin * cos_phi, sign * sin * sin_phi, sign * cos)
    n = type(axis)(axis.x, axis.y, axis.z + sign)
    return dr.fma(n, dr.dot(n, v) * dr.rcp(1 + dr.abs(axis.z)), -v)


def cosine_hemisphere(u1: Array, u2: Array, like: Vector) -> Vector:
    """A direction of the upper hemisphere with density cos(theta) / pi."""
    r = dr.sqrt(u1)
    sin, cos = azimuth(u2)
    return type(like)(r * cos, r * sin, dr.sqrt(at_least(1 - u1, 0)))


def float_type(w: Vector) -> type:
    """The type of one component of a direction: a Dr.Jit float array, or `float`."""
    return dr.value_t(type(w))


def module_of(w: Vector) -> Any:
    """The Dr.Jit module (`drjit.llvm.ad`, `drjit.scalar`, ...) that the components of `w` belong to."""
    value = float_type(w)
    return sys.modules["drjit.scalar"] if value is float else sys.modules[value.__module__]


def channels(value: Array) -> int:
    """How many colour channels a value carries; 0 for a plain number (one per lane or one for all)."""
    if not dr.is_array_v(value):
        return 0
    size = dr.size_v(value)
    return 0 if size == dr.Dynamic else size


def total(value: Array) -> Array:
    """The sum over the colour channels; a plain number is its own."""
    return dr.sum(value) if channels(value) else value


def mean(value: Array) -> Array:
    """The mean over the colour channels; a plain number is its own."""
    return total(value) * (1 / max(channels(value), 1))


def peak(value: Array) -> Array:
    """The largest colour channel; a plain number is its own."""
    return dr.max(value) if channels(value) else value


def is_live(value: Array) -> bool:
    """Whether derivatives are wanted in a number or colour, even where they are suspended for now."""
    parts = [value[c] for c in range(channels(value))] if channels(value) else [value]
    return any(getattr(part, "index_ad", 0) for part in parts)


def negate(mask: Array) -> Array:
    """Logical not, for masks of Dr.Jit and for plain bools alike."""
    return mask ^ True
