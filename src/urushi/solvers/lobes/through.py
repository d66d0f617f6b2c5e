"""What gets through the last interface of a stack, on the far side: how wide it is, and where its middle.

Derivatives of refraction widen a lobe without bounds where it leaves a denser medium; the horizon, total reflection
and masking bound it, in the plane of incidence more than across. By how much is counted (`tables.exit`, made by
tools/lobe_exits.py), so what leaves is an anisotropic lobe, turned towards the normal. What went to and fro in between
leaves in wide tails, which are a lobe of their own.
"""

from __future__ import annotations

import drjit as dr

from ...optics.vectors import Array, Vector, at_least, at_most
from . import tables
from .operators import Boundary
from .width import OURS, Tensor, Width, capped, mean_roughness, plus

#: cosine of what is bent below the horizon
LOWEST = 0.05
#: how much of what one interface turns a lobe by is there beyond the next: what is turned most gets through least
TURNED = 0.7


def leaving(
    boundary: Boundary, cos: Array, beyond: Array, width: Width, turn: Array, wi: Vector
) -> tuple[Width, Array]:
    """The width of what has got through, and by what angle its middle is farther from the normal than Snell's law says.

    Args:
        boundary: that it got through; a dielectric.
        cos, beyond: before and after, of the direction in which light goes through smooth interfaces.
        width: of the light before.
        turn: that angle, before.
        wi: a direction in the plane of incidence.
    """
    thin = dr.select(boundary.eta < 1, beyond, cos)
    before = mean_roughness(width + 0 * cos)
    in_plane, across, by = tables.exit(thin, boundary.eta, boundary.alpha, before)
    factor = OURS.factor(cos / (boundary.eta * beyond))
    first = capped(plus(width * factor, boundary.transmitted(cos, beyond)))
    alpha = mean_roughness(first)
    own = by * alpha
    if not (isinstance(turn, float) and turn == 0):
        # Snell's derivative, in the mean over a lobe as wide as this
        turn = TURNED * turn * cos / (boundary.eta * dr.sqrt(dr.square(beyond) + dr.square(alpha)))
        across = across * at_most(tilted(beyond, own) / tilted(beyond, own + turn), 2.0)
    return stretched(first, OURS.factor(in_plane), OURS.factor(across), wi), own + turn


def wider(left: tuple[Width, Array], thin: Array, wi: Vector) -> tuple[Width, Array]:
    """The lobe of what went to and fro before it got through, by that of what did not (fitted to sheets of glass).

    Args:
        left: that, from `leaving`.
        thin: cosine of its middle in the thinner medium.
    """
    flat = 1 - dr.square(thin)
    return stretched(left[0], OURS.factor(2 - 0.8 * flat), OURS.factor(2 + 0.5 * flat), wi), left[1]


def tilted(cos: Array, angle: Array) -> Array:
    """The cosine farther from the normal by an angle, `LOWEST` at least."""
    s, c = dr.sincos(angle)
    return at_least(cos * c - dr.sqrt(at_least(1 - dr.square(cos), 1e-12)) * s, LOWEST)


def stretched(width: Width, along: Array, across: Array, wi: Vector) -> Tensor:
    """A width times `along` in the plane of incidence of wi, and times `across` at right angles to it."""
    length = dr.rsqrt(at_least(dr.square(wi.x) + dr.square(wi.y), 1e-12))
    x, y = wi.x * length, wi.y * length
    if not isinstance(width, Tensor):
        more = along - across
        return Tensor(
            (across + more * x * x) * width, (more * x * y) * width, (across + more * y * y) * width
        )
    a, b = dr.sqrt(along), dr.sqrt(across)
    more = a - b
    xx, xy, yy = (
        b + more * x * x,
        more * x * y,
        b + more * y * y,
    )  # a symmetric matrix, on both sides of the width
    px, py = xx * width.xx + xy * width.xy, xx * width.xy + xy * width.yy
    qx, qy = xy * width.xx + yy * width.xy, xy * width.xy + yy * width.yy
    return Tensor(px * xx + py * xy, px * xy + py * yy, qx * xy + qy * yy)


def turned(axis: Vector, angle: Array) -> Vector:
    """A unit vector with z > 0, farther from the normal by an angle, in its own plane; never below the horizon."""
    sin = dr.sqrt(at_least(dr.square(axis.x) + dr.square(axis.y), 1e-20))
    s, c = dr.sincos(angle)
    scale = c + axis.z * s / at_least(sin, 1e-3)
    scale = at_least(at_most(scale, 0.999999 / sin), 0)
    return type(axis)(axis.x * scale, axis.y * scale, dr.sqrt(at_least(1 - dr.square(sin * scale), 1e-12)))
