"""What one facet of a microsurface does to light: mirrors of metal, panes of a dielectric, matte ones.

In the frame of the side that the light is on, w points back to where it came from, on either side of the horizon but in
front of the facet; what goes through a facet is seen from here, too.

    scatter   one event at a facet of normal m that light from w meets
    toward    density of scattering from w into o by all facets that do it, per solid angle of o, and a factor

A dielectric has two `sides`: `inside` masks the lanes that are on the other side than the first. `estimated` facets
know the density for one facet m only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .fresnel import fresnel_conductor, fresnel_dielectric
from .microsurface import Microsurface
from .random import Generator, uniform
from .vectors import Array, Vector, around, at_least, at_most, halfway, reflect, refract, root


@dataclass
class Event:
    """One facet met.

    Attributes:
        d: direction after it, in the frame of the side before it.
        factor: what is left of the light.
        through: mask of the lanes that went through.
        density: of `d`, per solid angle.
    """

    d: Vector
    factor: Array
    through: Any
    density: Array


def _cosine(w: Vector, m: Vector) -> Array:
    return at_most(at_least(dr.dot(w, m), 0), 1)


@dataclass
class Metal:
    """Facets of a conductor of index eta - i k, relative to what lies before it."""

    eta: Array
    k: Array
    sides, lossless, estimated = False, False, False

    def scatter(
        self, surface: Microsurface, w: Vector, m: Vector, area: Array, inside: Any, rng: Generator
    ) -> Event:
        fresnel = fresnel_conductor(_cosine(w, m), self.eta, self.k)
        return Event(reflect(w, m), fresnel, False, 0.25 * surface.visible(m, area))

    def toward(
        self, surface: Microsurface, w: Vector, o: Vector, area: Array, through: Any, inside: Any
    ) -> tuple[Array, Array]:
        h = halfway(w, o)
        return 0.25 * surface.visible(h, area), fresnel_conductor(_cosine(w, h), self.eta, self.k)


@dataclass
class Pane:
    """Facets between two dielectrics; `eta` is the index beyond over the index before, seen from the first side."""

    eta: Array
    inv_eta: Array
    sides, lossless, estimated = True, True, False

    def ratio(self, inside: Any) -> tuple[Array, Array]:
        """(index beyond over index before, its inverse), on the side that the light is on."""
        if inside is False:
            return self.eta, self.inv_eta
        return dr.select(inside, self.inv_eta, self.eta), dr.select(inside, self.eta, self.inv_eta)

    def reflectance(self, w: Vector, m: Vector, inside: Any) -> tuple[Array, Array, Array]:
        """(Fresnel's reflectance, cosine of incidence, cosine of refraction)."""
        cos_w = _cosine(w, m)
        fresnel, cos_t = fresnel_dielectric(cos_w, *self.ratio(inside))
        return fresnel, cos_w, cos_t

    def scatter(
        self,
        surface: Microsurface,
        w: Vector,
        m: Vector,
        area: Array,
        inside: Any,
        rng: Generator,
        u: Array | None = None,
    ) -> Event:
        """`u` in [0, 1) chooses between reflection and refraction, if given."""
        eta, inv_eta = self.ratio(inside)
        fresnel, cos_w, cos_t = self.reflectance(w, m, inside)
        through = (uniform(rng, w) if u is None else u) >= fresnel
        d = dr.select(through, refract(w, m, cos_w, cos_t, inv_eta), reflect(w, m))
        bent = (1 - fresnel) * cos_w * cos_t
        bent = bent * dr.square(eta / at_least(dr.abs(cos_w - eta * cos_t), 1e-10))
        return Event(d, 1.0, through, surface.visible(m, area) * dr.select(through, bent, 0.25 * fresnel))

    def toward(
        self, surface: Microsurface, w: Vector, o: Vector, area: Array, through: Any, inside: Any
    ) -> tuple[Array, Array]:
        eta, inv_eta = self.ratio(inside)
        # w + eta o = (cos_w - eta cos_o) h by Snell's law, and its length is in the Jacobian.
        h = dr.fma(o, dr.select(through, eta, 1.0), w)
        inv_length = dr.rsqrt(at_least(dr.squared_norm(h), 1e-20))
        h = h * dr.select(h.z < 0, -inv_length, inv_length)
        cos_w, cos_o = dr.dot(w, h), dr.select(through, -dr.dot(o, h), dr.dot(o, h))
        fresnel, _ = fresnel_dielectric(at_most(at_least(cos_w, 0), 1), eta, inv_eta)
        bent = (1 - fresnel) * cos_w * cos_o * dr.square(eta * inv_length)
        density = dr.select(through, bent, 0.25 * fresnel) * surface.visible(h, area)
        return dr.select(at_most(cos_w, cos_o) > 0, density, 0), 1.0


@dataclass
class Paper:
    """Facets that reflect like Lambert's surface, the share `reflectance`."""

    reflectance: Array
    sides, lossless, estimated = False, False, True

    def scatter(
        self, surface: Microsurface, w: Vector, m: Vector, area: Array, inside: Any, rng: Generator
    ) -> Event:
        u = uniform(rng, w)
        d = around(m, root(1 - u), uniform(rng, w), root(u))
        density, factor = self.toward_one(m, d)
        return Event(d, factor + 0 * w.x, False, density)

    def toward_one(self, m: Vector, o: Vector) -> tuple[Array, Array]:
        """`toward`, from the one facet m."""
        return at_least(dr.dot(o, m), 0) * dr.inv_pi, self.reflectance
