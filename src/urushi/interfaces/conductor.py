"""A metal, smooth or rough (Cook & Torrance 1982 with the microfacets of `optics.microfacet`)."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..optics.fresnel import fresnel_conductor
from ..optics.microfacet import Microfacets
from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, at_most, halfway, negate, reflect
from .base import HORIZON, Frame, Interface, Part, Scatter
from .given import Given


class BoundConductor(Interface):
    """A conductor under a medium of index `exterior`.

    Args:
        eta, k: absolute complex index eta - i k; a number or a colour, one or one per lane.
        exterior: absolute index of what lies above.
        facets: the rough surface, or None when smooth.
        delta: True when smooth, False when rough, or a mask of smooth lanes.
        frame: rotation of the tangent frame.
    """

    opaque = True

    def __init__(
        self, eta: Array, k: Array, exterior: Array, facets: Microfacets | None, delta: Any, frame: Frame
    ) -> None:
        self.eta = eta / exterior
        self.k = k / exterior
        self.facets = facets
        self.delta = delta
        self.frame = frame

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        facets, delta = given.facets()
        conductor = cls(given["eta"], given["k"], given.above, facets, delta, given.frame())
        return conductor, given.above, given.known_above

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        if self.facets is None:
            return 0 * w.x, 0 * w.x
        w, o = self.frame.enter(w), self.frame.enter(o)
        m = halfway(w, o)
        visible, _ = self.facets.weigh(w, o, m)
        seen = at_most(w.z, o.z) > HORIZON
        if self.delta is not False:
            seen &= negate(self.delta)
        pdf = dr.select(seen, 0.25 * visible, 0)
        fresnel = fresnel_conductor(dr.dot(w, m), self.eta, self.k)
        return fresnel * dr.select(seen, 0.25 * self.facets.single(w, o, m), 0), pdf

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
        if self.facets is None:
            o = type(w)(-w.x, -w.y, w.z)
            return Scatter(o, fresnel_conductor(w.z, self.eta, self.k), 0 * w.x, False)
        w = self.frame.enter(w)
        return self.at_facet(w, self.facets.sample(w, u[1], u[2]))

    def at_facet(self, w: Vector, m: Vector) -> Scatter:
        """`sample` of a rough surface with the visible normal that was drawn; w and m in the interface's own frame."""
        assert self.facets is not None
        o = reflect(w, m)
        visible, masked = self.facets.weigh(w, o, m)
        fresnel = fresnel_conductor(at_least(dr.dot(w, m), 0), self.eta, self.k)
        return Scatter(self.frame.leave(o), fresnel * dr.select(o.z > 0, masked, 0), 0.25 * visible, False)

    def absorbs(self, w: Vector, event: Scatter) -> Array | None:
        """What the facet of the event took up; what it reflects into others is lost."""
        if self.facets is None:
            return None
        w, o = self.frame.enter(w), self.frame.enter(event.o)
        cos = at_most(at_least(dr.dot(w, halfway(w, o)), 0), 1)
        return 1 - fresnel_conductor(cos, self.eta, self.k)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        fresnel = fresnel_conductor(cos, self.eta, self.k)
        return dr.select(self.delta, fresnel, 0), 0 * cos

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        alpha = at_least(*self.roughness()) + 0 * cos
        return fresnel_conductor(cos, self.eta, self.k), 0 * cos, alpha

    def roughness(self) -> tuple[Array, Array]:
        return (0.0, 0.0) if self.facets is None else (self.facets.alpha_x, self.facets.alpha_y)
