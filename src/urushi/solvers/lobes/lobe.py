"""One lobe: its value and its shape.

A lobe is what a mirror of GGX facets would reflect, divided by what such a mirror loses by single scattering: it
integrates to its energy (theory (lobes.12)). Light that is transmitted is a lobe, too, as if reflected: on the other
side, around the refracted direction (Belcour 2018, section 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...interfaces.base import HORIZON, Frame
from ...optics.microfacet import Microfacets
from ...optics.vectors import Array, Vector, at_least, at_most, halfway, mirror
from ..facet_lobe import Lobe as Sampler
from . import tables

#: narrower than this a lobe cannot be told from a direction in single precision
NARROWEST = 1e-4


@dataclass
class Lobe:
    """A lobe for light from one direction.

    Attributes:
        energy: its integral, a fraction of the incident flux; a colour or a number; 0 where it is a delta part.
        axis: unit vector with z > 0: the lobe lies around its mirror image, on its side.
        alpha_x, alpha_y, frame: roughness along the axes of a frame.
        same: True on the side of the light, False on the other.
        layer: number of the interface that sent it.
        kind: "reflected", "forward" (scattered forwards by a medium on the way), "transmitted", or "delayed" (the part
            of that which went to and fro on its way).
        gain: what `gains` would say, where it is known already.
    """

    energy: Array
    axis: Vector
    alpha_x: Array
    alpha_y: Array
    frame: Frame
    same: bool
    layer: int
    kind: str
    gain: Array | None = None

    def value(self, o: Vector, symmetric: bool = False) -> Array:
        """f |cos o| on the side of the lobe, for o mirrored to z > 0."""
        w, o_in = self.frame.enter(self.axis), self.frame.enter(o)
        facets = Microfacets(self.alpha_x, self.alpha_y, "ggx", "correlated")
        visible, masked = facets.weigh(w, o_in, halfway(w, o_in))
        single = dr.select(at_most(w.z, o.z) > HORIZON, 0.25 * visible * masked, 0)
        if not symmetric:
            return self.energy * single * (self.gains() if self.gain is None else self.gain)
        albedo = self._albedo(w)
        # What single scattering loses, as Kulla & Conty 2017 give it back: the same for both directions.
        mean = tables.albedo(None, dr.sqrt(0.5 * (dr.square(self.alpha_x) + dr.square(self.alpha_y))), o.z)
        lost = (1 - albedo) * (1 - self._albedo(o_in)) / (dr.pi * at_least(1 - mean, 1e-4))
        return self.energy * (single + lost * o.z)

    def gains(self) -> Array:
        """What makes up for what a mirror of such facets loses: the reciprocal of what it reflects."""
        return 1 / at_least(self._albedo(self.frame.enter(self.axis)), 1e-3)

    def _albedo(self, w: Vector) -> Array:
        if self.alpha_x is self.alpha_y:
            return tables.albedo(at_most(w.z, 1.0), self.alpha_x, w.z)
        return tables.albedo_towards(w, self.alpha_x, self.alpha_y)

    def sampler(self, share: Array, up: bool) -> Any:
        """The same lobe to sample from, on the upper or the lower side."""
        facets = Microfacets(self.alpha_x, self.alpha_y, "ggx", "separable")
        return Sampler(share, up, self.axis, facets, self.frame)

    def direction(self) -> Vector:
        """Mean direction, on the side z > 0."""
        return -mirror(self.axis)
