"""Densities that stand in for those of the walks among facets, which have no closed form.

They are what one facet would do, plus a cosine lobe for the rest: positive wherever light may go, and one where summed
over all directions. A facet that would send light to a side that is not asked for sends it to the mirror image there.
"""

from __future__ import annotations

import drjit as dr

from ..optics.facets import Pane
from ..optics.microsurface import Microsurface
from ..optics.vectors import Array, Vector, at_least, at_most, halfway, mirror
from .base import Part

#: smallest share of the cosine lobe
LEAST = 0.02


def single_share(surface: Microsurface, w: Vector) -> Array:
    """About how much of the light from w meets one facet only; fitted by eye to reflectances of GGX."""
    alpha = at_least(surface.alpha_x, surface.alpha_y)
    steep = dr.square(alpha)
    steep = 1.25 * steep / (1 + 0.8 * steep)
    masking = surface.masking(type(w)(w.x, w.y, at_least(w.z, 0)))
    grazing = masking / (1 + 2 * masking)
    return 1 - at_least(steep / (1 + masking) + grazing * (1 - steep), LEAST)


def _cosine(share: Array, o: Vector) -> Array:
    return (1 - share) * dr.abs(o.z) * dr.inv_pi


def _reflected(surface: Microsurface, w: Vector, o: Vector, area: Array) -> tuple[Array, Vector]:
    """Density of reflection at one facet into o, on either side, and the facet's normal."""
    h = halfway(w, o)
    return 0.25 * surface.visible(h, area), h


def mirrors(surface: Microsurface, w: Vector, o: Vector) -> Array:
    """Density over the directions o above, for w above and facets that only reflect."""
    share, area = single_share(surface, w), surface.area(w)
    single = _reflected(surface, w, o, area)[0] + _reflected(surface, w, mirror(o), area)[0]
    return share * single + _cosine(share, o)


def panes(surface: Microsurface, facet: Pane, w: Vector, o: Vector, part: Part) -> Array:
    """Density over the directions o of both sides, or of the side of `part`, for w above."""
    if part == "reflect":
        return mirrors(surface, w, o)
    share, area = single_share(surface, w), surface.area(w)
    single = _pane(surface, facet, w, o, area, part)
    if part == "both":
        return share * single + 0.5 * _cosine(share, o)
    return share * (single + _pane(surface, facet, w, mirror(o), area, part)) + _cosine(share, o)


def _pane(surface: Microsurface, facet: Pane, w: Vector, o: Vector, area: Array, part: Part) -> Array:
    reflected, h = _reflected(surface, w, o, area)
    fresnel, _, cos_t = facet.reflectance(w, h, False)
    # Where only transmission counts, a facet reflects for want of anything else.
    reflected = reflected * (fresnel if part == "both" else dr.select(cos_t > 0, 0.0, 1.0))
    h = dr.fma(o, facet.eta, w)
    inv_length = dr.rsqrt(at_least(dr.squared_norm(h), 1e-20))
    h = h * dr.select(h.z < 0, -inv_length, inv_length)
    cos_w, cos_o = dr.dot(w, h), -dr.dot(o, h)
    bent = surface.visible(h, area) * cos_w * cos_o * dr.square(facet.eta * inv_length)
    if part == "both":
        fresnel, _, _ = facet.reflectance(w, h, False)
        bent = bent * (1 - fresnel)
    return reflected + dr.select((at_most(cos_w, cos_o) > 0), bent, 0)
