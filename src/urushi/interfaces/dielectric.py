"""The boundary of two dielectrics, smooth or rough, from both sides (Walter et al. 2007; theory (walk.1, walk.2)).

The index ratio, its inverse from below, and the squared ratio in the Jacobian of refraction are handled here and
nowhere else.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..optics.fresnel import fresnel_between, fresnel_dielectric
from ..optics.microfacet import Microfacets
from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, at_most, halfway, negate, reflect, refract
from .base import HORIZON, Frame, Interface, Part, Scatter
from .given import Given
from .null import Null

#: index ratios nearer to 1 than this are index-matched: single precision cannot resolve their refraction
MATCHED = 1e-4


class BoundDielectric(Interface):
    """A dielectric boundary.

    Args:
        eta: absolute index below over absolute index above.
        facets: the rough surface, or None when smooth.
        delta: True when smooth, False when rough, or a mask of the lanes that are smooth or index-matched.
        frame: rotation of the tangent frame.
    """

    def __init__(self, eta: Array, facets: Microfacets | None, delta: Any, frame: Frame) -> None:
        self.eta = eta
        self.inv_eta = 1 / eta
        self.facets = facets
        self.delta = delta
        self.frame = frame

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        ior, known = given["ior"], given.known("ior")
        certain = known is not None and given.known_above is not None
        if certain and abs(known / given.known_above - 1) < MATCHED:
            return Null(), given.above, given.known_above  # no light is bent: one index above and below
        facets, delta = given.facets()
        eta = ior / given.above
        if not certain and delta is not True:
            matched = dr.abs(eta - 1) < MATCHED
            delta = matched if delta is False else delta | matched
            facets = None if delta is True else facets
        return cls(eta, facets, delta, given.frame()), ior, known

    def ratio(self, above: bool) -> Array:
        """Index beyond the boundary over the index on the incident side."""
        return self.eta if above else self.inv_eta

    def _rough(self, mask: Any) -> Any:
        return mask if self.delta is False else mask & negate(self.delta)

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        if self.facets is None:
            return 0 * w.x, 0 * w.x
        w, o = self.frame.enter(w), self.frame.enter(o)
        m = halfway(w, o)
        seen = self._rough(at_most(w.z, o.z) > HORIZON)
        visible = dr.select(seen, 0.25 * self.facets.weigh(w, o, m)[0], 0)
        fresnel, _ = fresnel_dielectric(dr.dot(w, m), self.ratio(above), self.ratio(not above))
        value = fresnel * dr.select(seen, 0.25 * self.facets.single(w, o, m), 0)
        return value, visible if part == "reflect" else fresnel * visible

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        if self.facets is None:
            return 0 * w.x, 0 * w.x
        w, o, eta = self.frame.enter(w), self.frame.enter(o), self.ratio(above)
        # w + eta o = (cos_w - eta cos_o) m by Snell's law: its length is in the Jacobian, too.
        m = dr.fma(o, eta, w)
        inv_length = dr.rsqrt(at_least(dr.squared_norm(m), 1e-20))
        m = m * dr.select(m.z < 0, -inv_length, inv_length)
        cos_w, cos_o = dr.dot(w, m), -dr.dot(o, m)
        crossed = self._rough((w.z > 0) & (o.z < 0) & (cos_w > 0) & (cos_o > 0))
        visible, masked = self.facets.weigh(w, type(o)(o.x, o.y, at_least(-o.z, 0)), m)
        visible = dr.select(crossed, visible * cos_w * cos_o * dr.square(eta * inv_length), 0)
        fresnel = fresnel_between(dr.select(crossed, cos_w, 1.0), at_least(cos_o, 0), eta)
        value = (1 - fresnel) * visible * masked
        return value, visible if part == "transmit" else (1 - fresnel) * visible

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        w = self.frame.enter(w)
        m = type(w)(0, 0, 1) if self.facets is None else self.facets.sample(w, u[1], u[2])
        return self.at_facet(w, m, u[0], above, part)

    def at_facet(self, w: Vector, m: Vector, u: Array, above: bool, part: Part) -> Scatter:
        """`sample` with the visible normal that was drawn; w and m in the interface's own frame."""
        facets, eta, inv_eta = self.facets, self.ratio(above), self.ratio(not above)
        cos_w = w.z if facets is None else at_least(dr.dot(w, m), 0)
        fresnel, cos_t = fresnel_dielectric(cos_w, eta, inv_eta)
        through: Any = part == "transmit"
        weight = 1.0 + 0 * w.x
        if part == "both":
            through = u >= fresnel
        else:
            weight = 1 - fresnel if through else fresnel
        if part == "both":
            o = dr.select(through, refract(w, m, cos_w, cos_t, inv_eta), reflect(w, m))
        else:
            o = refract(w, m, cos_w, cos_t, inv_eta) if through else reflect(w, m)
        if facets is None:
            return Scatter(o, weight, 0 * w.x, through)
        visible, kept = facets.weigh(w, type(o)(o.x, o.y, dr.abs(o.z)), m)
        right = dr.select(through, o.z < 0, o.z > 0)
        refracted = dr.square(eta) * cos_w * cos_t / at_least(dr.square(cos_w - eta * cos_t), 1e-20)
        pdf = visible * dr.select(through, refracted, 0.25)
        if part == "both":
            pdf = pdf * dr.select(through, 1 - fresnel, fresnel)
        if self.delta is not False:
            # An index-matched boundary is invisible: nothing shadows anything there.
            kept = dr.select(self.delta, 1.0, kept)
            right = right | self.delta
        return Scatter(self.frame.leave(o), dr.select(right, weight * kept, 0), pdf, through)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        fresnel, _ = fresnel_dielectric(cos, self.ratio(above), self.ratio(not above))
        return dr.select(self.delta, fresnel, 0), dr.select(self.delta, 1 - fresnel, 0)

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        fresnel, _ = fresnel_dielectric(cos, self.ratio(above), self.ratio(not above))
        alpha = at_least(*self.roughness()) + 0 * cos
        return fresnel, 1 - fresnel, alpha

    def roughness(self) -> tuple[Array, Array]:
        return (0.0, 0.0) if self.facets is None else (self.facets.alpha_x, self.facets.alpha_y)
