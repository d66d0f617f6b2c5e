"""At which end a path begins: at wi, or, by reciprocity, at wo.

What a metal under a coat sends far from the mirror direction comes, as a rule, of several hits of the metal, of
which one scatters far and the others are nearly mirrors. To connect a path to its exit at the last hit is good if that
is the one: what is rare is then evaluated, and what is common is sampled. If the first hit is the one, the path should
begin at the exit and be connected to the entrance. So the end is drawn by chance for each path, and what can be made
either way is shared by a balance heuristic (Veach 1997, section 9.2): with p the chance to begin at the end that was
drawn, a connection weighs

    1 / (p + (1 - p) q),    q = D(normal of the last hit) / D(normal of the first hit).

q is nearly the density of the same path made from the other end over that made from this one: of facets that are
sampled by visible normals D / (4 sigma) is the density of a hit, all hits but the first and the last have one either
way, and of the projected areas sigma nothing much depends. Any q that turns into its inverse with the path is unbiased.
Of a path with one hit both ways are alike, and it weighs 1.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces.conductor import BoundConductor
from ...interfaces.dielectric import BoundDielectric
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, at_least
from ..bound import BoundStack

#: cosines below this do not lower the chance of an end any more
GRAZING = 1e-6


def either_way(stack: BoundStack) -> bool:
    """Whether paths may begin at either end: between a coat and a rough metal, with nothing that scatters between."""
    if len(stack.interfaces) != 2 or any(medium is not None and medium.scatters for medium in stack.media):
        return False
    coat, base = stack.interfaces
    return isinstance(coat, BoundDielectric) and isinstance(base, BoundConductor) and base.delta is False


def begin(wi: Vector, wo: Vector, rng: Generator) -> tuple[Any, Array]:
    """Draw the end.

    Light at grazing angles is caught more easily, so that a path begins there more often.

    Returns:
        mask of the paths that begin at wo, and the chance for the other end over that for the one that was drawn.
    """
    a, b = at_least(wi.z, GRAZING), at_least(wo.z, GRAZING)
    turned = uniform(rng, wi) * (a + b) >= b
    return turned, dr.select(turned, b, a) * dr.rcp(dr.select(turned, a, b))


def weight(first: Array, last: Array) -> Array:
    """What a connection at the metal weighs, times the chance for the end that was drawn.

    Args:
        first: 1 / D of the normal of the first hit, times the odds of the other end that `begin` returned.
        last: 1 / D of the normal of the last hit, in the same unit.
    """
    return last * dr.rcp(at_least(last + first, 1e-30))
