"""Which of two opposite facets light meets: the one that promises more, as a rule.

Visible normals of a GGX surface are sampled in pairs of opposite azimuths (`Microfacets.opposites`), either of which
alone has the right density. One of them is taken by chance, in proportion to what it promises, and weighs the mean
promise of both over its own (resampling of two candidates, Talbot et al. 2005). Any promise above 0 leaves the mean as
it is; a good one takes noise away for a few multiplications, since only the facet that is taken is evaluated.

Inside, light promises much that is caught, that is, totally reflected by the coat, and little otherwise. Where it
enters and leaves, what counts is how a metal that is hit once sends it from one direction to the other: to first order
in the slopes of the coat's facets, by the density of the metal's.
"""

from __future__ import annotations

import drjit as dr

from ...interfaces.conductor import BoundConductor
from ...interfaces.dielectric import BoundDielectric
from ...optics.microfacet import Microfacets
from ...optics.vectors import Array, Vector, at_least, at_most, root

#: at the metal: 1 over the promise is 1 + LOST x^4, x the squared cosine at the coat over that of total reflection; the
#: coat's facets blur what is caught, so that it falls off slowly
LOST = 0.5
#: most that x may be per squared cosine, where indices hardly differ
FAR = 2.0
#: at the coat: the promise of a facet that does not catch the light, in parts of one that does
ESCAPED = 0.17
#: how much of the slope of what a metal sends at one hit is followed: paths of several hits do not share it
LEAN = 0.6
#: what the promise leans at most
MOST = 0.9

Numbers = tuple[Array, Array, Array]


def paired(facets: Microfacets | None, smooth: bool | Array) -> bool:
    """Whether the facets of an interface can be chosen in pairs: a rough GGX surface on all lanes."""
    return facets is not None and smooth is False and facets.ggx


def metal_facet(base: BoundConductor, coat: BoundDielectric, w: Vector, u: Numbers) -> tuple[Vector, Array]:
    """A normal of the metal and what it weighs: one, as a rule, that sends light from w where the coat catches it.

    Args:
        w: in the frame of the metal, as is the normal.
        u: the last of them chooses.
    """
    assert base.facets is not None
    one, other = base.facets.opposites(w, u[0], u[1])
    limit = _caught_below(coat)
    steep = dr.select(limit > 0, at_most(dr.rcp(at_least(limit, 1e-3)), FAR), 0)
    lost, inverse = [], []
    for m in (one, other):
        inverse.append(dr.rsqrt(dr.squared_norm(m)))
        z = 2 * dr.dot(w, m) * m.z * dr.square(inverse[-1]) - w.z
        lost.append(dr.fma(LOST, dr.square(dr.square(dr.square(z) * steep)), 1))
    # The promises are 1 / lost, so that each is to the other's `lost` what that is to its own.
    first, weight = _choose(lost[1], lost[0], u[2])
    return dr.select(first, one, other) * dr.select(first, inverse[0], inverse[1]), weight


def coat_facet(coat: BoundDielectric, w: Vector, u: Numbers) -> tuple[Vector, Array]:
    """A normal of the coat and what it weighs: one, as a rule, that catches light from w, below it.

    Args:
        w: in the frame of the coat, as is the normal.
        u: the last of them chooses.
    """
    assert coat.facets is not None
    one, other = coat.facets.opposites(w, u[0], u[1])
    limit = _caught_below(coat)
    promises = [
        dr.select(dr.square(dr.dot(w, m)) < limit * dr.squared_norm(m), 1.0, ESCAPED) for m in (one, other)
    ]
    first, weight = _choose(promises[0], promises[1], u[2])
    return dr.normalize(dr.select(first, one, other)), weight


def leaning_facet(coat: BoundDielectric, w: Vector, lean: Vector, u: Numbers) -> tuple[Vector, Array]:
    """A normal of the coat and what it weighs, for light from w, above it: one that leans along `lean`, as a rule.

    Args:
        w: in the frame of the coat, as are the normal and `lean`.
        lean: by how much of itself the promise grows per slope.
        u: the last of them chooses.
    """
    assert coat.facets is not None
    one, other = coat.facets.opposites(w, u[0], u[1])
    # Half the difference of the slopes along `lean`, times the height: x, and 1 + x and 1 - x are the promises. Large
    # ones are bent to MOST |x| / (MOST + |x|), and all is multiplied by the height and MOST + |x|.
    x = 0.5 * ((one.x - other.x) * lean.x + (one.y - other.y) * lean.y)
    both, x = dr.fma(MOST, one.z, dr.abs(x)), MOST * x
    first, weight = _choose(both + x, both - x, u[2])
    return dr.normalize(dr.select(first, one, other)), weight


def leans(coat: BoundDielectric, base: BoundConductor, a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """`lean` for the facets that light crosses at a and at b, both outside, on its way by one hit of the metal.

    The slope of log D(normal half-way between a and b, both refracted), D as if GGX, times what a facet's slope turns
    the refracted direction by, sideways: that it also gets steeper or flatter counts for little.
    """
    assert base.facets is not None
    inv_eta = coat.ratio(False)
    inside, turns = [], []
    for w in (a, b):
        z = root(1 - dr.square(inv_eta) * (1 - dr.square(w.z)))
        inside.append(type(w)(w.x * inv_eta, w.y * inv_eta, z))
        turns.append(z - w.z * inv_eta)
    h = base.frame.enter(inside[0] + inside[1])
    x2, y2, z2 = dr.square(h.x), dr.square(h.y), at_least(dr.square(h.z), 1e-12)
    inv_x2, inv_y2 = dr.square(base.facets.inv_x), dr.square(base.facets.inv_y)
    length, stretched = x2 + y2 + z2, dr.fma(x2, inv_x2, dr.fma(y2, inv_y2, z2))
    scale = 4 * LEAN * dr.rcp(length * stretched)
    slope = type(a)(h.x * (stretched - inv_x2 * length), h.y * (stretched - inv_y2 * length), 0 * h.x)
    slope = coat.frame.enter(base.frame.leave(slope)) * scale
    return slope * turns[0], slope * turns[1]


def _caught_below(coat: BoundDielectric) -> Array:
    """The squared cosine below which light under the coat is totally reflected; negative where none is."""
    return 1 - dr.square(coat.ratio(False))


def _choose(one: Array, other: Array, u: Array) -> tuple[Array, Array]:
    """Whether the first of two promises is chosen, and what the one that is weighs."""
    both = one + other
    first = u * both < one
    return first, 0.5 * both * dr.rcp(dr.select(first, one, other))
