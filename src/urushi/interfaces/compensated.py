"""Rough interfaces that give back what single scattering loses, as a wide lobe: `multiple_scattering="compensated"`.

Kulla & Conty 2017 (Revisiting Physically Based Shading at Imageworks): with m(w) the part of the light from w that one
scattering among perfect mirrors loses and M its mean, the lobe m(w) m(o) cos / (pi M) returns exactly m(w), in no time
and without noise, and is reciprocal. A metal multiplies it by the colour of light that met two facets or more; a
dielectric loses m1 to its own side and m2 to the other, and shares what is lost between

    reflection     r1 m1(w) m1(o) cos / (pi M1)
    transmission   t1 m1(w) m2(o) cos / (pi M2)        r1 + t1 = 1

as `Missing.exchanged` says. The directions of multiply scattered light are only guessed by this, its energy is not.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..optics.fresnel import fresnel_conductor
from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, at_most, azimuth, mirror, negate, peak, root
from .base import HORIZON, Interface, Part, Scatter
from .conductor import BoundConductor
from .dielectric import BoundDielectric
from .given import Given
from .missing import Missing, number_of

#: least n of the density n cos^(n - 1) / (2 pi) of the lobe's samples
FLATTEST = 0.3
#: cosines and weights of Gauss's rule for means by cosine (Jacobi polynomials): 1e-3 at worst for a metal's Fresnel
MEAN_COSINES = (0.13975986, 0.41640957, 0.72315699, 0.94289580)
MEAN_WEIGHTS = (0.06236194, 0.25969510, 0.40692914, 0.27101383)


class Compensated(Interface):
    """What both have in common: single scattering and a lobe, mixed by what single scattering loses.

    The directions of the lobe are sampled by a power of the cosine, with the mean that they have: where the lobe is
    concentrated at grazing angles a cosine itself would be a poor guess, and worse at every bounce of a stack.

    Args:
        single: the interface with single scattering.
        missing: what it loses.
    """

    def __init__(self, single: Any, missing: Missing) -> None:
        self.single = single
        self.missing = missing
        self.opaque, self.delta, self.frame = single.opaque, single.delta, single.frame
        self._sharpness: dict[bool, Array] = {}
        for above in (True,) if self.opaque else (True, False):
            # The mean cosine of the density ~ cos^(n - 1) per solid angle is n / (n + 1).
            cosine = (
                dr.detach(missing.cosine(above))
                if dr.is_array_v(single.facets.alpha_x)
                else missing.cosine(above)
            )
            self._sharpness[above] = at_least(cosine / (1 - cosine), FLATTEST)

    def _power(self, above: bool, through: Any) -> Array:
        """The n of the density n cos^(n - 1) / (2 pi) of the lobe's samples, on this side or the other."""
        if self.opaque:
            return self._sharpness[True]
        if through is False:
            return self._sharpness[above]
        if through is True:
            return self._sharpness[not above]
        return dr.select(through, self._sharpness[not above], self._sharpness[above])

    def _scale(self, above: bool, through: Any) -> Array:
        """The factor of m(w) m(o) cos in the lobe on this side, or through the surface (a bool or a mask)."""
        raise NotImplementedError

    def _share(self, above: bool, through: Any) -> Array:
        """How much of what light from this side loses comes back here, or goes through."""
        return 1.0

    def _lost(self, w: Vector, above: Any) -> Array:
        """What single scattering loses of the light from w, on the side `above` (a bool or a mask)."""
        lost = self.missing(w if self.missing.even else self.frame.enter(w), above)
        return lost if self.delta is False else dr.select(self.delta, 0, lost)

    def _complete(
        self,
        single: tuple[Array, Array],
        lost: Array,
        w: Vector,
        o: Vector,
        above: bool,
        part: Part,
        through: Any,
    ) -> tuple[Array, Array]:
        """(flux density, density of sampling) with the lobe, from those of single scattering."""
        value, pdf = single
        cosine = dr.select(through, -o.z, o.z)
        lit = at_most(w.z, cosine) > HORIZON
        beyond = self._lost(o, through ^ above)
        more = self._scale(above, through) * (lost * beyond * cosine)
        n = self._power(above, through)
        density = n * (0.5 * dr.inv_pi) * dr.power(at_least(cosine, HORIZON), n - 1)
        if part == "both":
            density = density * self._share(above, through)
        kept = self._kept(w, o, lit) if self._accepts(part) else 1 - lost
        return value + dr.select(lit, more, 0), dr.fma(lost, dr.select(lit, density, 0), kept * pdf)

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        single = self.single.reflect(w, o, above, part)
        return self._complete(single, self._lost(w, above), w, o, above, part, False)

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        if self.opaque:
            return 0 * w.x, 0 * w.x
        single = self.single.transmit(w, o, above, part)
        return self._complete(single, self._lost(w, above), w, o, above, part, True)

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        lost = self._lost(w, above)
        accepts = self._accepts(part)
        through: Any = part == "transmit"
        if accepts:
            # What a facet keeps is its chance to be taken, and what is then not taken is just what is lost: no sample
            # is void, and of a lossless surface each has weight 1. The digits that chose the facet hardly notice.
            event = self.single.sample(w, u, above, part)
            kept = self._kept(w, event.o, peak(event.weight) > 0)
            choice = _digits(u[1])
            wide = choice >= kept
            if self.delta is not False:
                wide &= negate(self.delta)
            second, third = (choice - kept) / at_least(1 - kept, 1e-7), _digits(u[2])
            if not self.opaque:
                through = dr.select(wide, _digits(u[0]) >= self._share(above, False), event.through)
        else:
            # The first number may be the same on all lanes; the second decides, and is stretched over what it decided.
            kept = 1 - lost
            wide = u[1] >= kept
            second = dr.select(wide, (u[1] - kept) / at_least(lost, 1e-7), u[1] / at_least(kept, 1e-7))
            second, third = at_most(second, 1 - 2.0**-24), u[2]
            event = self.single.sample(w, (u[0], second, third), above, part)
        cos = dr.power(at_least(1 - second, 1e-7), dr.rcp(self._power(above, through)))
        sin_phi, cos_phi = azimuth(third)
        sin = root((1 - cos) * (1 + cos))
        up = type(w)(sin * cos_phi, sin * sin_phi, cos)
        o = dr.select(wide, dr.select(through, mirror(up), up), event.o)
        single = self._single(w, o, above, part, through)
        # The weight of a facet's own event is surer than the flux density in its direction.
        value = dr.select(wide, single[0], event.weight * event.pdf)
        pdf = dr.select(wide, single[1], event.pdf)
        value, pdf = self._complete((value, pdf), lost, w, o, above, part, through)
        # Where a facet sends light to where it cannot go, there is no direction, and so no density of it.
        void = negate(wide) & (peak(event.weight) <= 0)
        weight = dr.select(void, 0, value / at_least(pdf, 1e-30))
        pdf = dr.select(void, 0, pdf)
        if self.delta is not False:
            weight = dr.select(self.delta, event.weight, weight)
        return Scatter(o, weight, pdf, through)

    def _accepts(self, part: Part) -> bool:
        """Whether facets are taken by the chance that they keep the light, which takes all that they may do with it."""
        return self.opaque or part == "both"

    def _kept(self, w: Vector, o: Vector, valid: Any) -> Array:
        """How much of what facets send from w to o, on either side, is not masked by others; 0 where not valid."""
        w, o = self.frame.enter(w), self.frame.enter(o)
        facets = self.single.facets
        kept = facets.masked(w, type(o)(o.x, o.y, dr.abs(o.z)), facets.sigma(w))
        return dr.select(valid, kept, 0)

    def _single(self, w: Vector, o: Vector, above: bool, part: Part, through: Any) -> tuple[Array, Array]:
        """Single scattering from w to o, on the side that `through` says."""
        if through is True:
            return self.single.transmit(w, o, above, part)
        reflected = self.single.reflect(w, o, above, part)
        if through is False:
            return reflected
        passed = self.single.transmit(w, o, above, part)
        return dr.select(through, passed[0], reflected[0]), dr.select(through, passed[1], reflected[1])

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.single.smooth_energy(cos, above)
        return found

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        found: tuple[Array, Array, Array] = self.single.lobe(cos, above)
        return found

    def roughness(self) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.single.roughness()
        return found

    def ratio(self, above: bool) -> Array:
        return self.single.ratio(above)


def _settle(*values: Any) -> None:
    """Compute what is the same on all lanes once, unless this is recorded to be computed elsewhere."""
    if dr.width(values) == 1 and not dr.flag(dr.JitFlag.SymbolicScope):
        dr.eval(values)


def _digits(u: Array) -> Array:
    """The later digits of a number in [0, 1): almost independent of what the first ones decide."""
    return 1024 * u - dr.floor(1024 * u)


class CompensatedConductor(Compensated):
    """A rough metal whose facets send light on to one another."""

    def __init__(self, single: BoundConductor, even: bool) -> None:
        facets = single.facets
        assert facets is not None
        number = number_of(facets.alpha_x, facets.alpha_y, single.eta, single.k)
        super().__init__(single, Missing(facets, None, even, number))
        once: Any = 0.0
        for cos, weight in zip(MEAN_COSINES, MEAN_WEIGHTS, strict=True):
            once = once + weight * fresnel_conductor(cos + 0 * self.missing.alpha, single.eta, single.k)
        lost = self.missing.mean(True)
        # Light that met two facets at least, of which each further one lets the part 1 - lost go (Hill's series).
        colour = dr.square(once) * (1 - lost) / (1 - once * lost)
        self._factor = colour * (dr.inv_pi / lost)
        _settle(self._factor, self._sharpness)

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        single, index, known = BoundConductor.bind(given)
        if single.delta is True:
            return single, index, known
        assert isinstance(single, BoundConductor)
        return cls(single, given.isotropic()), index, known

    def _scale(self, above: bool, through: Any) -> Array:
        return self._factor


class CompensatedDielectric(Compensated):
    """A rough boundary of two dielectrics whose facets send light on to one another."""

    def __init__(self, single: BoundDielectric, even: bool) -> None:
        facets = single.facets
        assert facets is not None
        number = number_of(facets.alpha_x, facets.alpha_y, single.eta)
        super().__init__(single, Missing(facets, single.eta, even, number))
        self._through = dict(zip((True, False), self.missing.exchanged(), strict=True))
        self._mean = {above: dr.pi * self.missing.mean(above) for above in (True, False)}
        _settle(self._through, self._mean, self._sharpness)

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        single, index, known = BoundDielectric.bind(given)
        if single.delta is True:
            return single, index, known
        assert isinstance(single, BoundDielectric)
        return cls(single, given.isotropic()), index, known

    def _share(self, above: bool, through: Any) -> Array:
        passed = self._through[above]
        if isinstance(through, bool):
            return passed if through else 1 - passed
        return dr.select(through, passed, 1 - passed)

    def _scale(self, above: bool, through: Any) -> Array:
        mean = dr.select(through ^ above, self._mean[True], self._mean[False])
        return self._share(above, through) / mean
