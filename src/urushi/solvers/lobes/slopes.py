"""Interfaces with normals of their own (normal maps), for lobes.

A normal turns the middle of every lobe that its interface reflects or bends: one ray through the stack tells where to
(`solvers.tilt`). Energies and widths are those of the parallel stack, seen under the angle to the outermost normal;
that of a diffuse base follows the cosine to its own. What a pixel does not see of a normal map is roughness
(`Given.widened`), so it enters the operators like any other.

The lobe of the outermost interface is exact; of the others, only the middle is. Interfaces that are tilted and smooth
are refused: what goes to and fro between them has no middle.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr

from urushi.errors import UnsupportedStack

from ...interfaces.tilted import Tilted
from ...optics.vectors import Array, Vector, at_least, mirror
from ..bound import BoundStack
from ..tilt import crossed


def flattened(stack: BoundStack, symmetric: bool) -> BoundStack:
    """The same stack with all interfaces parallel.

    Raises:
        UnsupportedStack: a tilted interface that is smooth, or the reciprocal form, which tilted ones do not have.
    """
    reasons = []
    if symmetric:
        reasons.append(
            "a normal is given, and a fixed normal reflects no light reciprocally: leave out symmetric"
        )
    for k, interface in enumerate(stack.interfaces):
        if interface.tilted and interface.delta is not False:
            reasons.append(
                f"interface {k} from the top has a normal and is smooth, or may be: use an alpha of at least 1e-4, or "
                "a slope_variance"
            )
    if reasons:
        raise UnsupportedStack("lobes", reasons, ["walk"])
    flat = [interface.inner if isinstance(interface, Tilted) else interface for interface in stack.interfaces]
    return replace(stack, interfaces=flat)


def seen(stack: BoundStack, wi: Vector, above: bool) -> Vector:
    """wi as the outermost interface meets it, in the frame of its normal; on the side of wi."""
    outermost = stack.interfaces[0 if above else -1]
    w = type(wi)(wi.x, wi.y, at_least(dr.abs(wi.z), 1e-6))
    if isinstance(outermost, Tilted):
        w = outermost.met(w, above)
    return w if above else mirror(w)


def shade(stack: BoundStack, o: Vector) -> Array:
    """How much more light a tilted diffuse base sends along o, and out of the stack above, than one that is not."""
    base = stack.interfaces[-1]
    w = type(o)(o.x, o.y, at_least(o.z, 1e-6))
    for interface in stack.interfaces[:-1]:
        w = -crossed(interface, w, True)
    if not isinstance(base, Tilted):
        return 1.0 + 0 * o.x
    lit = sum(at_least(base.enter(way, True).z, 0) for way in (w, mirror(w)))
    return lit / at_least(w.z, 1e-3)
