"""Rough interfaces whose light bounces between the facets until it gets out: `multiple_scattering="walk"`.

Heitz, Hanika, d'Eon & Dachsbacher 2016. A lossless interface gives back all light. `sample` follows the walk to its
end; the flux density has one facet in closed form and an estimate of the rest. Lanes that are smooth, or whose indices
match, are those of the single-scattering interface inside.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..optics.bounces import begin, escape, gather
from ..optics.facets import Metal, Pane
from ..optics.microsurface import Microsurface, seen_through
from ..optics.random import Generator, uniform
from ..optics.vectors import Array, Vector, at_least, at_most, negate
from .base import HORIZON, Interface, Part, Scatter
from .conductor import BoundConductor
from .dielectric import BoundDielectric
from .given import Given
from .standin import mirrors, panes, single_share


class Walked(Interface):
    """What both have in common: a rough interface with single scattering inside."""

    stochastic = True

    def __init__(self, once: Any) -> None:
        self.once = once
        self.opaque, self.delta, self.frame = once.opaque, once.delta, once.frame
        facets = once.facets
        self.surface = Microsurface(facets.alpha_x, facets.alpha_y, "ggx" if facets.ggx else "beckmann")

    def _rough(self, mask: Any) -> Any:
        return mask if self.delta is False else mask & negate(self.delta)

    def _smooth(self, event: Scatter, rough: Scatter) -> Scatter:
        """`rough`, but `event` on the smooth lanes."""
        delta = self.delta
        through = rough.through
        if event.through is not rough.through:
            through = dr.select(delta, event.through, rough.through)
        return Scatter(
            dr.select(delta, event.o, rough.o),
            dr.select(delta, event.weight, rough.weight),
            rough.pdf,
            through,
        )

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.once.smooth_energy(cos, above)
        return found

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        found: tuple[Array, Array, Array] = self.once.lobe(cos, above)
        return found

    def certain(self, w: Vector, o: Vector, above: bool, through: bool) -> Array:
        """Light that meets one facet."""
        return self.once.transmit(w, o, above)[0] if through else self.once.reflect(w, o, above)[0]

    def roughness(self) -> tuple[Array, Array]:
        found: tuple[Array, Array] = self.once.roughness()
        return found

    def ratio(self, above: bool) -> Array:
        return self.once.ratio(above)


class WalkedConductor(Walked):
    """A rough metal.

    Args:
        once: the same with single scattering, height-correlated.
    """

    def __init__(self, once: BoundConductor) -> None:
        super().__init__(once)
        self.facet = Metal(once.eta, once.k)

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        once, index, known = BoundConductor.bind(given)
        return (once if once.delta is True else cls(once)), index, known  # type: ignore[arg-type]

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        assert rng is not None
        value = self.certain(w, o, above, False)
        w, o = self.frame.enter(w), self.frame.enter(o)
        lit = self._rough(at_most(w.z, o.z) > HORIZON)
        surface = self.surface
        event = self.facet.scatter(surface, w, surface.normal(w, rng), surface.area(w), False, rng)
        way = begin(surface, w, event, event.factor, lit, rng)
        value = value + gather(self.surface, self.facet, way, o, rng)
        return value, dr.select(lit, mirrors(self.surface, w, o), 0)

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
        from_, w = w, self.frame.enter(w)
        surface, lit = self.surface, self._rough(w.z > HORIZON)
        first = self.facet.scatter(surface, w, surface.sample(w, u[1], u[2]), surface.area(w), False, rng)
        o, weight, _ = escape(surface, self.facet, begin(surface, w, first, first.factor, lit, rng), rng)
        pdf = dr.select(lit, mirrors(surface, w, o), 0)
        event = Scatter(self.frame.leave(o), dr.select(lit, weight, 0), pdf, False)
        if self.delta is False:
            return event
        return self._smooth(self.once.sample(from_, u, above, part), event)


class WalkedDielectric(Walked):
    """A rough boundary of two dielectrics.

    Args:
        once: the same with single scattering, height-correlated.
    """

    def __init__(self, once: BoundDielectric) -> None:
        super().__init__(once)
        self.facet_above, self.facet_below = (
            Pane(once.ratio(above), once.ratio(not above)) for above in (True, False)
        )

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        once, index, known = BoundDielectric.bind(given)
        return (once if once.delta is True else cls(once)), index, known  # type: ignore[arg-type]

    def certain(self, w: Vector, o: Vector, above: bool, through: bool) -> Array:
        if not through:
            return super().certain(w, o, above, through)
        value, _ = self.once.transmit(w, o, above)
        # Refracted once, light is at one height for both sides: what is seen of it there is no product of chances.
        w, o = self.frame.enter(w), self.frame.enter(o)
        a, b = (self.surface.masking(type(o)(v.x, v.y, at_least(z, 0))) for v, z in ((w, w.z), (o, -o.z)))
        return value * (seen_through(a, b) * (1 + a + b))

    def _facet(self, above: bool) -> Pane:
        return self.facet_above if above else self.facet_below

    def _more(self, w: Vector, o: Vector, facet: Pane, lit: Any, rng: Generator) -> Array:
        """An estimate of the light that meets two facets or more."""
        surface = self.surface
        event = facet.scatter(surface, w, surface.normal(w, rng), surface.area(w), False, rng)
        return gather(surface, facet, begin(surface, w, event, 1 + 0 * w.x, lit, rng), o, rng)

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        assert rng is not None
        value = self.certain(w, o, above, False)
        w, o, facet = self.frame.enter(w), self.frame.enter(o), self._facet(above)
        lit = self._rough(at_most(w.z, o.z) > HORIZON)
        value = value + self._more(w, o, facet, lit, rng)
        return value, dr.select(lit, panes(self.surface, facet, w, o, part), 0)

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        assert rng is not None
        value = self.certain(w, o, above, True)
        w, o, facet = self.frame.enter(w), self.frame.enter(o), self._facet(above)
        lit = self._rough(at_most(w.z, -o.z) > HORIZON)
        value = value + self._more(w, o, facet, lit, rng)
        return value, dr.select(lit, panes(self.surface, facet, w, o, part), 0)

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        assert rng is not None
        from_, w, facet = w, self.frame.enter(w), self._facet(above)
        surface, lit = self.surface, self._rough(w.z > HORIZON)
        m = surface.sample(w, u[1], u[2])
        fresnel, _, _ = facet.reflectance(w, m, False)
        choice, weight = self._choose(fresnel, w, u[0], part, rng)
        first = facet.scatter(surface, w, m, surface.area(w), False, rng, choice)
        o, weight, through = escape(surface, facet, begin(surface, w, first, weight, lit, rng), rng)
        if part != "both":
            weight = dr.select(through ^ (part == "reflect"), weight, 0)
        pdf = dr.select(lit, panes(self.surface, facet, w, o, part), 0)
        event = Scatter(self.frame.leave(o), dr.select(lit, weight, 0), pdf, through)
        if self.delta is False:
            return event
        return self._smooth(self.once.sample(from_, u, above, part), event)

    def _choose(self, fresnel: Array, w: Vector, u: Array, part: Part, rng: Generator) -> tuple[Array, Array]:
        """What the first facet does, as the number in [0, 1) that chooses it, and the weight of that.

        Where one part is asked for the facet seldom takes the other way, which ends there by further facets only.
        """
        if part == "both":
            return u, 1 + 0 * w.x
        # By trial; the root of how likely light is to come round, which is less likely for what went through.
        rare = dr.sqrt(1 - single_share(self.surface, w)) * (0.5 if part == "reflect" else 1.0)
        wanted = fresnel if part == "reflect" else 1 - fresnel
        whole = wanted + rare * (1 - wanted)
        as_wanted = uniform(rng, w) * whole < wanted
        through = as_wanted ^ (part == "reflect")
        return dr.select(through, fresnel, -1.0), dr.select(as_wanted, whole, whole / rare)
