"""The atomic operators: what one layer does to the energy, the mean direction and the width of a lobe.

    reflection      energy R(c, width)            direction mirrored     width + f(alpha)
    refraction      energy T(c, width)            Snell's                width / j + f(s alpha)
    absorption      energy exp(-depth / c)        unchanged              unchanged
    scattering      forwards: `medium`; else the light becomes diffuse
    total reflection  is in R and T, which are averages over the lobe (`tables`)
    diffuse         energy to the diffuse light   none left              none left

s = |1 - c / (n c')| / 2, with c before and c' beyond the boundary of index ratio n: tilting a facet turns a
refracted ray by so much of what it turns a reflected one (Belcour 2018, section 4). See theory (lobes.3 to lobes.6).
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces import BoundConductor, BoundDielectric, BoundDiffuse, Interface, Null, RoughDiffuse
from ...interfaces.base import Frame
from ...optics.fresnel import fresnel_conductor, fresnel_dielectric
from ...optics.vectors import Array, Vector, at_least, negate, root
from . import mixing, tables
from .matte import Matte
from .moments import EVEN, Mixing, Moments
from .quadrature import gauss
from .settled import settled
from .width import OURS, Scale, Width, mean_roughness, of_interface

#: (reflectance, transmittance)
Pair = tuple[Array, Array]
#: what is left of light from one visit to the next in the means of `tables.round_trip`
KEPT = (0.5, 0.9)
#: how far energies of an outermost metal go with its roughness in the plane of incidence, instead of the mean one
LEAN = 0.5
#: lowest cosine of a mean direction: widths are in proportion to its inverse
GRAZING = 1e-3


class Boundary:
    """An interface, seen from one side.

    Args:
        interface: any that `supports`.
        above: the side that the light comes from.
        wi: direction of the light outside, whose azimuth decides what roughness an anisotropic interface shows.
        scale: of widths.
        mixes: whether diffuse light is told by its moments, as it is where a medium scatters.
        lean: 1 if energies go with the roughness in the plane of incidence, 0 if with the root mean square of all.
    """

    def __init__(
        self,
        interface: Interface,
        above: bool,
        wi: Vector,
        scale: Scale = OURS,
        mixes: bool = False,
        lean: float = 1.0,
    ) -> None:
        self.lean = lean
        self.interface, self.wi, self.scale, self.mixes = interface, wi, scale, mixes
        self.full = interface.single is not None
        self.inner: Any = interface.single if self.full else interface
        self.opaque, self.above = interface.opaque, above
        self.delta = interface.delta
        #: a rough diffuse base, else None
        self.matte = Matte(self.inner) if isinstance(self.inner, RoughDiffuse) else None
        facets = getattr(self.inner, "facets", None)
        self.smooth = facets is None
        self.eta = self.inner.ratio(above)
        self.isotropic = True
        self.frame: Frame = getattr(self.inner, "frame", Frame(0.0))
        if facets is None:
            self.alpha: Array = 0.0
            self.around: Array = 0.0
            self.reflected: Width = 0.0
            self._widths = (0.0, 0.0)
            return
        self.kind = "ggx" if facets.ggx else "beckmann", "correlated" if facets.correlated else "separable"
        x, y = facets.alpha_x, facets.alpha_y
        if self.delta is not False:
            x, y = (dr.select(self.delta, 0, alpha) for alpha in (x, y))
        self.isotropic = facets.alpha_x is facets.alpha_y
        self._widths = x, x if self.isotropic else y
        self.alpha = x if self.isotropic else shown(x, y, self.frame.enter(wi), lean)
        #: for light that comes from all azimuths
        self.around = x if self.isotropic else shown(x, y, self.wi, 0.0)
        self.reflected = self.width(1.0)

    @property
    def turned(self) -> Boundary:
        """The same interface for light from its other side."""
        return Boundary(
            self.interface,
            not self.above,
            self.wi,
            self.scale,
            self.mixes,
            0.0 if self.scale is OURS else self.lean,
        )

    def width(self, scale: Array) -> Width:
        """The width that facets of `scale` times its roughness add."""
        if self.smooth:
            return 0.0
        x, y = self._widths
        return of_interface(x * scale, y * scale, self.frame, self.isotropic, self.scale)

    def refracted(self, cos: Array) -> Array:
        """Cosine of Snell's direction beyond; 0 where there is none."""
        eta = self.eta
        return root((dr.square(cos) + (eta - 1) * (eta + 1)) / dr.square(eta))

    def beyond(self, cos: Array, width: Array | None, after: Width) -> Array:
        """The cosine around which lies what is transmitted, as a lobe of the width `after`.

        Facets that face the light are seen more than others, and those that would reflect it totally transmit nothing.
        """
        snell = self.refracted(cos)
        if not isinstance(self.inner, BoundDielectric) or (self.smooth and width is None):
            return snell
        mean = tables.mean_cosine(self._kind(), cos, self.eta, self.alpha, width, True)
        # Narrow as they still are, the lobes of refraction have longer tails than those of reflection: their mean is
        # the better centre.
        found = mean if width is None else tables.centre(mean, mean_roughness(after))
        return found if self.delta is False or width is not None else dr.select(self.delta, snell, found)

    def back(self, cos: Array, width: Array | None, after: Width) -> Array:
        """The same of what is reflected."""
        if not isinstance(self.inner, BoundDielectric) or (self.smooth and width is None):
            return cos
        mean = tables.mean_cosine(self._kind(), cos, self.eta, self.alpha, width, False)
        found = tables.centre(mean, mean_roughness(after))
        return found if self.delta is False or width is not None else dr.select(self.delta, cos, found)

    def _kind(self) -> tuple[str, str]:
        """Which tables; those of a smooth interface are the same in all."""
        return ("ggx", "correlated") if self.smooth else self.kind

    def transmitted(self, cos: Array, beyond: Array) -> Width:
        """The width that crossing from the cosine `cos` to `beyond` adds."""
        return self.width(0.5 * dr.abs(1 - cos / (self.eta * at_least(beyond, GRAZING))))

    def round_trip(self, cos: Array, width: Array, kept: Array) -> tuple[Pair, Pair, Array, Array]:
        """What happens to light that entered here under the cosine `cos`, when it comes back from below.

        Args:
            width: roughness of the lobe that it then is.
            kept: what is left of light from one later visit to the next.

        Returns:
            (reflectance, transmittance) the first time, and in the mean over all later times; the mean cosine of what
            is sent back down; and the roughness of what gets out in terms of what derivatives say.
        """
        r, t, *means, down, narrower = tables.round_trip(cos, self.eta, self.around, width)
        # The more is left, the more of what is trapped is still there at late visits.
        low, high, at = (_lasting(x) for x in (*KEPT, kept))
        share = (at - low) / (high - low)
        later = [at_least(a + share * (b - a), 0) for a, b in zip(means[:2], means[2:], strict=True)]
        pairs = (r, t), (later[0], later[1])
        first, rest = (tables.complete(*pair) for pair in pairs) if self.full else pairs
        return first, rest, down, narrower

    def backs(self, cos: Array, width: Array) -> Moments:
        """Moments per energy of what is sent back down the first time, for arguments as `round_trip` has them."""
        return mixing.backs(cos, self.eta, self.around, width)

    def sheet(self, cos: Array, other: Boundary) -> list[tuple[Array, Array]]:
        """(Reflectance, transmittance) in a sheet of glass that light enters here and that ends at the other interface:
        of that for what arrives first, and for all that comes again; of this one for what that sends back, likewise."""
        found = tables.sheet(cos, self.eta, self.around, other.around)
        pairs = list(zip(found[::2], found[1::2], strict=True))
        full = other.full, other.full, self.full, self.full
        return [tables.complete(*pair) if whole else pair for pair, whole in zip(pairs, full, strict=True)]

    def beam(self, cos: Array, width: Array | None) -> tuple[Array, Array]:
        """Reflectance and transmittance of a lobe of mean cosine `cos` and roughness `width` (None: one direction)."""
        if isinstance(self.inner, Null):
            return 0.0, 1.0
        if self.scatters():
            return 0.0, 0.0
        sharp = self.smooth and width is None
        if isinstance(self.inner, BoundConductor):
            if sharp:
                return fresnel_conductor(cos, self.inner.eta, self.inner.k), 0.0
            kind = self._kind()
            return tables.metal(kind, cos, self.inner.eta, self.inner.k, self.alpha, width, self.full), 0.0
        fresnel, _ = fresnel_dielectric(cos, self.eta, 1 / self.eta)
        if sharp:
            return fresnel, 1 - fresnel
        kind = self._kind()
        r, t = tables.dielectric(kind, cos, self.eta, self.alpha, width)
        if self.full:
            r, t = tables.complete(r, t)
        if self.delta is not False and width is None:
            r, t = dr.select(self.delta, fresnel, r), dr.select(self.delta, 1 - fresnel, t)
        return r, t

    def complete(self, cos: Array, alpha: Array) -> Array:
        """Reflectance from one direction were the interface as rough as `alpha`, nothing lost among its facets."""
        kind = self._kind()
        if isinstance(self.inner, BoundConductor):
            return tables.metal(kind, cos, self.inner.eta, self.inner.k, alpha, None, True)
        return tables.complete(*tables.dielectric(kind, cos, self.eta, alpha, None))[0]

    def escaping(self, cos: Array, alpha: Array) -> Array:
        """How much of a lobe of roughness `alpha` is not totally reflected, were all smooth."""
        return tables.escaping(cos, self.eta, alpha)

    def even(self, like: Array) -> tuple[Any, Any]:
        """Reflectance and transmittance of diffuse light, which is even unless it `mixes`."""
        if isinstance(self.inner, Null):
            return 0.0, 1.0
        if self.mixes:
            return self._mixing(like)
        if self.matte is not None:
            return self.matte.even(like), 0.0
        if isinstance(self.inner, BoundDiffuse):
            return self.inner.reflectance + 0 * like, 0.0
        kind = self._kind()
        if isinstance(self.inner, BoundConductor):
            return tables.metal_diffuse(kind, self.inner.eta, self.inner.k, self.around, self.full, like), 0.0
        if self.smooth:
            r = settled("even", (self.eta,), lambda: even_fresnel(self.eta))
            r = even_fresnel(self.eta + 0 * like) if r is None else r
            return r, 1 - r
        r, t = tables.dielectric_diffuse(kind, self.eta, self.around, like)
        return tables.complete(r, t) if self.full else (r, t)

    def _mixing(self, like: Array) -> tuple[Any, Any]:
        kind, inner = self._kind(), self.inner
        if self.matte is not None:
            return Mixing.evened(self.matte.even(like)), 0.0
        if isinstance(inner, BoundDiffuse):
            return Mixing.evened(inner.reflectance + 0 * like), 0.0
        if isinstance(inner, BoundConductor):
            return mixing.metal(kind, inner.eta, inner.k, self.around, self.full, like), 0.0
        return mixing.dielectric(kind, self.eta, self.around, self.full or self.smooth, like)

    def unshadowed(self, cos: Array, width: Array | None) -> tuple[Any, Any]:
        """What facets that reflect everything would send out, of a lobe and of diffuse light; 1 where none is lost."""
        if self.matte is not None:
            return self.matte.unshadowed(cos)
        if not isinstance(self.inner, BoundConductor) or self.smooth or self.full:
            return 1.0, 1.0
        ideal = 0 * cos, 1 + 0 * cos
        kind = self._kind()
        diffuse = mixing.metal if self.mixes else tables.metal_diffuse
        return (
            tables.metal(kind, cos, *ideal, self.alpha, width, False),
            diffuse(kind, *ideal, self.around, False, cos),
        )

    def scatters(self) -> bool:
        """Whether a beam becomes diffuse here."""
        return isinstance(self.inner, (BoundDiffuse, RoughDiffuse))

    def diffused(self, cos: Array) -> Any:
        """How much of a beam becomes diffuse light that is sent back."""
        if not self.scatters():
            return 0.0
        found = self.matte.albedo(cos) if self.matte is not None else self.inner.reflectance
        return Moments(*EVEN) * found if self.mixes else found

    def still(self) -> Any:
        """Mask of the lanes where it is smooth: a beam stays a direction."""
        return self.delta if self.delta is not False else False

    def rough(self) -> Any:
        return negate(self.still())


def _lasting(kept: Array) -> Array:
    """What means over visits are nearly linear in."""
    return 1 / (1 - 0.7 * kept)


def supports(interface: Interface) -> bool:
    """Whether there are operators for an interface."""
    inner = interface.single or interface
    return isinstance(inner, (BoundConductor, BoundDielectric, BoundDiffuse, Null, RoughDiffuse))


def leaning(interface: Interface, outermost: bool) -> float:
    """`Boundary.lean`: what is deeper meets light of other azimuths than that of the light outside."""
    if not outermost:
        return 0.0
    return LEAN if isinstance(interface.single or interface, BoundConductor) else 1.0


def shown(x: Array, y: Array, w: Vector, lean: float) -> Array:
    """The roughness along the plane of incidence of w (Heitz 2014), and in the mean where there is none.

    Args:
        lean: as `Boundary` has it.
    """
    a, b = dr.square(x), dr.square(y)
    return dr.sqrt(at_least(0.5 * (a + b + lean * (a - b) * (dr.square(w.x) - dr.square(w.y))), 1e-12))


def even_fresnel(eta: Array) -> Array:
    """Reflectance of a smooth dielectric for light that comes evenly from one side, to 1e-8.

    The mean by 2 c dc over (0, 1) from the thinner side, by Gauss's rule in the root of c; from the denser side it
    follows by reciprocity, total reflection included: 1 - R_i = (1 - R_e) / n^2.
    """
    n = dr.select(eta >= 1, eta, 1 / eta)
    outside: Array = 0.0
    for c, weight in _GAUSS:
        outside = outside + weight * fresnel_dielectric(c + 0 * n, n, 1 / n)[0]
    return dr.select(eta >= 1, outside, 1 - (1 - outside) / dr.square(n))


_GAUSS = tuple((c, 2 * c * weight) for c, weight in gauss(12, 2))
