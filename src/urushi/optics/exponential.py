"""exp(-x) and -log(x) as a slab needs them: one sign of the argument, single precision, no special cases.

Dr.Jit's own functions cover every argument; these cost a vector unit a third less (exp) and 60 % less (log), and a walk
through a medium does little else. Polynomials are Chebyshev fits; the relative error is about 2e-7, for the exponential
(1 + x / 10) times that. Values of other types (double precision, plain floats) go to Dr.Jit, and so must whatever is to
be differentiated: bits have no derivative.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from .vectors import Array, at_most, channels, polynomial

_EXP = (1.0, -0.693147207, 0.240226512, -0.0555032721, 0.0096180256, -0.00134004322, 0.00015469732)
_LOG = (
    0.999999974, -0.49999987, 0.333341833, -0.250021535, 0.199569775, -0.16560696, 0.149490955, -0.143773306,
    0.0874394535,
)  # fmt: skip
_LOG2_E, _LN_2 = 1.44269504, 0.693147181
_ONE = 0x3F800000
_SQRT_HALF = 0x3F3504F3


def decay(x: Array) -> Array:
    """exp(-x) for x >= 0; 87 and more (infinity too) give 1.6e-38."""
    if channels(x):
        return type(x)(*(decay(c) for c in x))
    if not _single(x):
        return dr.exp(-x)
    x = at_most(x, 87.0)
    whole = dr.floor(dr.fma(x, _LOG2_E, 0.5))
    shift = dr.int32_array_t(type(x))(whole) << 23
    return polynomial(dr.fma(x, _LOG2_E, -whole), _EXP) * dr.reinterpret_array(type(x), _ONE - shift)


def minus_log(x: Array) -> Array:
    """-log(x) for normal x > 0."""
    if channels(x):
        return type(x)(*(minus_log(c) for c in x))
    if not _single(x):
        return -dr.log(x)
    integer = dr.int32_array_t(type(x))
    bits = dr.reinterpret_array(integer, x)
    exponent = (bits - _SQRT_HALF) >> 23
    f = dr.reinterpret_array(type(x), bits - (exponent << 23)) - 1
    return -(f * polynomial(f, _LOG)) - type(x)(exponent) * _LN_2


def _single(x: Any) -> bool:
    return dr.is_array_v(x) and dr.type_v(x) == dr.VarType.Float32
