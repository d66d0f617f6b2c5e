"""A rough base of Lambertian facets (Oren & Nayar's picture, by Heitz et al. 2016, section 5.3).

Light leaves each facet like Lambert's, so the mean over the facets that it may meet has no closed form, and the flux
density is an estimate even for one of them. With `multiple_scattering` False what meets a second facet is lost, as in
the other interfaces; with "walk" it goes on until it gets out.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..optics.bounces import begin, escape, gather
from ..optics.facets import Paper
from ..optics.microfacet import Microfacets
from ..optics.microsurface import Microsurface
from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, at_most
from .base import HORIZON, Frame, Interface, Part, Scatter
from .diffuse import BoundDiffuse
from .given import Given


class RoughDiffuse(Interface):
    """See the module docstring; its density is that of Lambert's base.

    Args:
        smooth: Lambert's base, which smooth lanes are.
        facets: the rough surface.
        delta: mask of the smooth lanes; False if there are none.
        frame: rotation of the tangent frame.
        walks: whether light goes on after one facet.
    """

    opaque = True
    flat = True
    stochastic = True

    def __init__(
        self, smooth: BoundDiffuse, facets: Microfacets, delta: Any, frame: Frame, walks: bool
    ) -> None:
        self.smooth, self.lambert, self.frame, self.walks = smooth, delta, frame, walks
        self.facet = Paper(smooth.reflectance)
        self.surface = Microsurface(facets.alpha_x, facets.alpha_y, "ggx" if facets.ggx else "beckmann")

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        smooth = BoundDiffuse(given["reflectance"])
        facets, delta = given.facets()
        if facets is None:
            return smooth, given.above, given.known_above
        walks = given.layer.multiple_scattering == "walk"
        return cls(smooth, facets, delta, given.frame(), walks), given.above, given.known_above

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        assert rng is not None
        lambert, pdf = self.smooth.reflect(w, o, above)
        surface, facet, w, o = self.surface, self.facet, self.frame.enter(w), self.frame.enter(o)
        lit = at_most(w.z, o.z) > HORIZON
        area, m = surface.area(w), surface.normal(w, rng)
        event = facet.scatter(surface, w, m, area, False, rng)
        seen = self._seen(w, at_least(o.z, HORIZON), o)
        value = event.factor * dr.select(lit, facet.toward_one(m, o)[0] * seen, 0)
        if self.walks:
            way = begin(surface, w, event, event.factor, lit, rng)
            value = value + gather(surface, facet, way, o, rng)
        return (value if self.lambert is False else dr.select(self.lambert, lambert, value)), pdf

    def _seen(self, w: Vector, z: Array, o: Vector) -> Array:
        """What of the facets that w sees o sees, too: (1 + Lambda_w) / (1 + Lambda_w + Lambda_o)."""
        first = self.surface.rate(w, self.surface.area(w))
        return first / (first + self.surface.masking(type(o)(o.x, o.y, z)))

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        return 0 * w.x, 0 * w.x

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        assert rng is not None
        smooth = self.smooth.sample(w, u, above, part)
        surface, facet, w = self.surface, self.facet, self.frame.enter(w)
        lit = w.z > HORIZON
        event = facet.scatter(surface, w, surface.normal(w, rng), surface.area(w), False, rng)
        if self.walks:
            o, weight, _ = escape(surface, facet, begin(surface, w, event, event.factor, lit, rng), rng)
        else:
            o, weight = event.d, event.factor
            weight = weight * dr.select(o.z > HORIZON, self._seen(w, at_least(o.z, HORIZON), o), 0)
        o, weight = self.frame.leave(o), dr.select(lit, weight, 0)
        if self.lambert is not False:
            o, weight = dr.select(self.lambert, smooth.o, o), dr.select(self.lambert, smooth.weight, weight)
        return Scatter(o, weight, at_least(o.z, 0) * dr.inv_pi, False)

    def absorbs(self, w: Vector, event: Scatter) -> Array | None:
        """What the facet of the event took up; what it sends into others is lost, unless it goes on."""
        return None if self.walks else 1 - self.smooth.reflectance + 0 * w.x

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        return self.smooth.smooth_energy(cos, above)

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        return self.smooth.lobe(cos, above)
