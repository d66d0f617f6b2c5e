"""Lobes to sample directions from.

A lobe is the reflection of a rough surface, sampled by visible normals; the part that would end below the horizon is
folded back up, so that every lobe integrates to one.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from ..interfaces.base import Frame
from ..optics.microfacet import Microfacets
from ..optics.vectors import Array, Vector, at_least, cosine_hemisphere, mirror, reflect


@dataclass
class Lobe:
    """One lobe on one side: `share` of the samples, `facets` seen from `axis` (z > 0; None: a cosine lobe)."""

    share: Array
    up: bool
    axis: Vector | None = None
    facets: Microfacets | None = None
    frame: Frame | None = None

    def sample(self, like: Vector, u1: Array, u2: Array) -> Vector:
        if self.facets is None or self.axis is None or self.frame is None:
            o = cosine_hemisphere(u1, u2, like)
        else:
            w = self.frame.enter(self.axis)
            o = self.frame.leave(reflect(w, self.facets.sample(w, u1, u2)))
        z = dr.abs(o.z)
        return type(like)(o.x, o.y, z if self.up else -z)

    def pdf(self, o: Vector) -> Array:
        """Density of `o`, for directions on the side of the lobe."""
        z = dr.abs(o.z)
        if self.facets is None or self.axis is None or self.frame is None:
            return z * dr.inv_pi
        w = self.frame.enter(self.axis)
        up = self.frame.enter(type(o)(o.x, o.y, z))
        scale = dr.rcp(4 * at_least(self.facets.sigma(w), 1e-20))
        folded = dr.normalize(w + mirror(up))
        density = self.facets.density(dr.normalize(w + up))
        density = density + dr.select(folded.z > 0, self.facets.density(folded), 0)
        return density * scale
