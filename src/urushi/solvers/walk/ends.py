"""At which end a path begins: at wi, or, by reciprocity, at wo.

What a metal under a coat sends far from the mirror direction comes, as a rule, of several hits of the metal, of
which one scatters far and the others are nearly mirrors. To connect a path to its exit at the last hit is good if that
is the one: what is rare is then evaluated, and what is common is sampled. If the first hit is the one, the path should
begin at the exit and be connected to the entrance. So the end is drawn by chance for each path, and what can be made
either way is shared by a balance heuristic (Veach 1997, section 9.2): with p the chance to begin at the end that was
drawn, a connection weighs

    1 / (p + (1 - p) q),    q = D(normal of the last hit) / D(normal of the first hit).

That is nearly the density of the same path made from the other end over that made from this one: of facets that are
sampled by visible normals D / (4 sigma) is the density of a hit, all hits but the first and the last have one either
way, and of the projected areas sigma nothing much depends. Any q that turns into its inverse with the path is unbiased.
Of a path with one hit both ways are alike, and it weighs 1.
"""

from __future__ import annotations

import drjit as dr

from ...interfaces import Interface
from ...interfaces.conductor import BoundConductor
from ...interfaces.dielectric import BoundDielectric
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, at_least
from ..bound import BoundStack
from .exit import DELTA

#: what stands for 1 / D(normal of the first hit) before there is one; as an integer, where that is known in Python
NONE_YET = -1


def either_way(stack: BoundStack) -> bool:
    """Whether paths may begin at either end: between a coat and a rough metal, with nothing that scatters between."""
    if len(stack.interfaces) != 2 or any(medium is not None and medium.scatters for medium in stack.media):
        return False
    coat, base = stack.interfaces
    return isinstance(coat, BoundDielectric) and isinstance(base, BoundConductor) and base.delta is False


def begin(wi: Vector, wo: Vector, rng: Generator) -> tuple[Vector, Vector, Array, Array]:
    """Draw the end.

    Light at grazing angles is caught more easily, so that a path begins there more often.

    Returns:
        where the path begins and where it ends, the chance for that, and what brings its flux density back to that of
        light from wi to wo.
    """
    a, b = dr.abs(wi.z), dr.abs(wo.z)
    share = b / at_least(a + b, 1e-30)
    turned = uniform(rng, wi) >= share
    flux = dr.select(turned, b / at_least(a, 1e-30), 1.0)
    return dr.select(turned, wo, wi), dr.select(turned, wi, wo), dr.select(turned, 1 - share, share), flux


def hit(first: Array, base: Interface, w: Vector, pdf: Array) -> Array:
    """1 / D(normal of the first hit), after a hit by light from w whose direction was sampled with this density."""
    this = dr.rcp(at_least(_normals(base, w, pdf), 1 / DELTA))
    return this if isinstance(first, int) else dr.select(first < 0, this, first)


def weight(first: Array, share: Array, base: Interface, w: Vector, pdf: Array) -> Array:
    """What a connection at the base weighs, for light from w and this density of sampling its direction.

    Args:
        first: what `hit` returned.
        share: the chance for this end.
    """
    if isinstance(first, int):
        return 1.0
    other = first * _normals(base, w, pdf)
    return dr.select(first < 0, 1.0, dr.rcp(dr.fma(1 - share, other, share)))


def _normals(base: Interface, w: Vector, pdf: Array) -> Array:
    """D / 4 of the normal, from the density of sampling a reflection of w by visible normals.

    Detached: the weights of both ends sum to 1, whatever the parameters.
    """
    assert isinstance(base, BoundConductor) and base.facets is not None
    return dr.detach(pdf * base.facets.sigma(base.frame.enter(w)))
