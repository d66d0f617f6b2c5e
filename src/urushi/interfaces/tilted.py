"""An interface whose normal is not that of the surface: one pixel of a normal map.

The layer below goes on as if flat (the layers stay parallel on average); light meets the interface in the frame of
its own normal n. Two sides then disagree, that of n and that of the surface, and light that would be between the
two is *folded*:

    light from outside the stack that comes from behind the tilted plane is mirrored in that plane, and meets its front
    light from inside the stack that does is mirrored in an upright wall across the tilt instead
    light that leaves on the wrong side of the surface is mirrored in the plane of the surface

Light from behind that a mirror reflects leaves as from the level surface by the plane, and back to where it came from
by the wall, that of Schuessler et al. 2017. Seen from outside the wall makes a glowing rim, lit from the viewer's side;
inside it keeps light from being caught between two smooth interfaces for ever. Nothing is lost: an interface that keeps
all light keeps it with any normal (theory (walk.15, walk.16)). Elsewhere (nearly everywhere, at small tilts) it is
classical normal mapping, f cos(n, o), as in Mitsuba's `normalmap`. As that it is not reciprocal: what a fixed normal
reflects from w to o and from o to w differs by the ratio of cosines to n and to the surface. Guo et al. 2018 (section
4.4 and their code) drop the light in between.

A solver that follows light backwards needs `towards`: from where light came into a direction.

Sources: Guo, Hasan & Zhao 2018; Schuessler et al. 2017 (what classical normal maps lose; the mirroring wall).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..optics.random import Generator, uniform
from ..optics.vectors import Array, Vector, at_least, mirror, negate, root
from .base import Frame, Interface, Part, Scatter
from .given import Given

#: a cosine to the tilted plane below which its inverse is cut off
GRAZING = 1e-7


@dataclass
class Came:
    """Where light came from that leaves along o, sampled.

    Attributes:
        w: the direction back to it (w.z > 0 on the side of o, w.z < 0 if it came through).
        weight: flux density from w to o over the density of sampling w.
        pdf: that density, all ways to sample w together (`Tilted.back`).
        through: mask of what came through.
        bent: solid angle at w over solid angle at o, for a smooth interface.
    """

    w: Vector
    weight: Array
    pdf: Array
    through: Any
    bent: Array


@dataclass
class Folded(Scatter):
    """A sampled event, and the same in the frame of the normal: what was met, and what came of it."""

    met: Vector
    inner: Scatter


class Tilted(Interface):
    """An interface with a normal of its own.

    Args:
        inner: the interface in the frame of its normal.
        normal: towards the upper side, of any length, z > 0: three numbers, one or one per lane. Its x axis is that of
            the surface, made perpendicular to the normal, as in Mitsuba.
        outside: whether the outside of the stack is above it, and below it.
    """

    tilted = True

    def __init__(self, inner: Interface, normal: Any, outside: tuple[bool, bool] = (True, True)) -> None:
        self.inner, self.outside = inner, outside
        self.opaque, self.flat, self.delta = inner.opaque, inner.flat, inner.delta
        self.stochastic = inner.stochastic
        self.frame = getattr(inner, "frame", Frame(0.0))
        x, y, z = (normal[i] for i in range(3))
        scale = dr.rsqrt(x * x + y * y + z * z)
        x, y, z = x * scale, y * scale, z * scale
        d = dr.sqrt(y * y + z * z)
        self.normal = (x, y, z)
        across = dr.rsqrt(at_least(x * x + y * y, 1e-20))
        self._wall = (x * across, y * across)
        self._rows = ((d, -x * y / d, -x * z / d), (0.0, z / d, -y / d), self.normal)

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        raise TypeError("a tilted interface is made of another one: see urushi.solvers.bound")

    def _axes(self, above: bool) -> Any:
        """The axes of its frame; seen from below, all is mirrored: that of the caller and its own."""
        if above:
            return self._rows
        s, t, n = self._rows
        return (s[0], s[1], -s[2]), (t[0], t[1], -t[2]), (-n[0], -n[1], n[2])

    def enter(self, w: Vector, above: bool) -> Vector:
        """A direction in the frame of the normal."""
        return type(w)(*(a * w.x + b * w.y + c * w.z for a, b, c in self._axes(above)))

    def leave(self, w: Vector, above: bool) -> Vector:
        s, t, n = self._axes(above)
        return type(w)(*(w.x * a + w.y * b + w.z * c for a, b, c in zip(s, t, n, strict=True)))

    def met(self, w: Vector, above: bool) -> Vector:
        """A direction that light comes from, as the interface meets it: mirrored where it lies behind."""
        straight = self.enter(w, above)
        if self.outside[0 if above else 1]:
            return _sided(straight, False)
        turned = self.enter(self._turned(w, above, above), above)
        front = straight.z > 0
        return _sided(
            type(w)(*(dr.select(front, a, b) for a, b in zip(straight, turned, strict=True))), False
        )

    def _turned(self, w: Vector, above: bool, side: bool) -> Vector:
        """`w`, of the frame of `above`, mirrored in the tilted plane or the wall, as light on that side is."""
        if self.outside[0 if side else 1]:
            return self.leave(mirror(self.enter(w, above)), above)
        x, y = self._wall
        twice = 2 * (w.x * x + w.y * y)
        return type(w)(w.x - twice * x, w.y - twice * y, w.z)

    def _twice(self, front: Vector, above: bool, through: bool) -> tuple[Vector, Any]:
        """The direction from behind that is met as `front` is, and whether there is such."""
        behind = self._turned(front, above, above != through)
        back = self.enter(behind, above).z
        return behind, (back > 0) & (behind.z < 0) if through else (back < 0) & (behind.z > 0)

    def _images(self, o: Vector, above: bool, through: bool) -> list[tuple[Any, Vector]]:
        """The directions of its frame that leave along o, the second by folding, and where there are such."""
        found = []
        for way in (o, mirror(o)):
            inside = self.enter(way, above)
            found.append((inside.z < 0 if through else inside.z > 0, _sided(inside, through)))
        return found

    def _ask(
        self, w: Vector, o: Vector, above: bool, through: bool, part: Part, rng: Generator | None
    ) -> tuple[Array, Array]:
        """The inner interface, in its own frame."""
        ask = self.inner.transmit if through else self.inner.reflect
        return ask(w, o, above, part, rng)

    def _both(
        self, w: Vector, o: Vector, above: bool, through: bool, part: Part, rng: Generator | None
    ) -> tuple[Array, Array]:
        met = self.met(w, above)
        value: Array = 0 * w.x
        pdf: Array = 0 * w.x
        right = (o.z < 0) if through else (o.z > 0)
        for there, image in self._images(o, above, through):
            one, density = self._ask(met, image, above, through, part, rng)
            value = value + dr.select(there & right, one, 0)
            pdf = pdf + dr.select(there & right, density, 0)
        return value, pdf

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        return self._both(w, o, above, False, part, rng)

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        return self._both(w, o, above, True, part, rng)

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        met = self.met(w, above)
        event = self.inner.sample(met, u, above, part, rng)
        raw = self.leave(event.o, above)
        right = dr.select(event.through, raw.z < 0, raw.z > 0)
        o = type(w)(raw.x, raw.y, dr.select(right, raw.z, -raw.z))
        if self.delta is True:
            return Folded(o, event.weight, event.pdf, event.through, met, event)
        # The other direction that folds onto the same one is as likely as the interface sends light there.
        pdf, other = event.pdf, self.enter(mirror(raw), above)
        for through in (False,) if self.opaque or part == "reflect" else (False, True):
            if part == "transmit" and not through:
                continue
            there = other.z < 0 if through else other.z > 0
            if part == "both":
                there = there & (event.through if through else negate(event.through))
            more = self._ask(met, _sided(other, through), above, through, part, rng)[1]
            pdf = pdf + dr.select(there, more, 0)
        return Folded(o, event.weight, pdf, event.through, met, event)

    def absorbs(self, w: Vector, event: Scatter) -> Array | None:
        assert isinstance(event, Folded)
        return self.inner.absorbs(event.met, event.inner)

    # --- backwards -------------------------------------------------------------------------------------------------

    def back(
        self, o: Vector, w: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        """Flux density from w (on the other side) to o, and the density with which `towards` samples w.

        Args:
            o: where the light goes, o.z > 0 in the frame of the side `above`.
            w: where it comes from, w.z < 0 in the same frame.
        """
        image = mirror(self.met(mirror(w), not above))
        ways = self._images(o, above, False)
        count = _count(ways[0][0], o) + _count(ways[1][0], o)
        share = dr.rcp(at_least(count * self._origins(image, above), 1.0))
        # Light that goes back the way it came: Helmholtz reciprocity in the frame of the normal.
        turn = dr.rcp(dr.square(self.inner.ratio(above)) * at_least(dr.abs(image.z), GRAZING))
        value: Array = 0 * o.x
        pdf: Array = 0 * o.x
        for there, way in ways:
            one, density = self.inner.transmit(way, image, above, part, rng)
            value = value + dr.select(there, one * (turn * way.z), 0)
            pdf = pdf + dr.select(there, density * share, 0)
        right = (o.z > 0) & (w.z < 0)
        return dr.select(right, value, 0), dr.select(right, pdf, 0)

    def towards(
        self, o: Vector, u: tuple[Array, Array, Array], above: bool, part: Part, rng: Generator
    ) -> Came:
        """Sample a direction from which light leaves along o (o.z > 0 in the frame of the side `above`)."""
        (first, way), (second, other) = self._images(o, above, False)
        count = _count(first, o) + _count(second, o)
        take = first & (negate(second) | (uniform(rng, o) < 0.5))
        way = type(o)(*(dr.select(take, a, b) for a, b in zip(way, other, strict=True)))
        event = self.inner.sample(way, u, above, part, rng)
        # What is met as this direction came straight from it, or from behind.
        front = self.leave(event.o, above)
        behind, two = self._twice(front, above, False)
        if not self.opaque:
            across, more = self._twice(front, above, True)
            behind, two = dr.select(event.through, across, behind), dr.select(event.through, more, two)
        origins = dr.select(dr.select(event.through, front.z < 0, front.z > 0), 1 + _count(two, o), 0)
        turn = two & (uniform(rng, o) < 0.5)
        w = type(o)(*(dr.select(turn, a, b) for a, b in zip(behind, front, strict=True)))
        eta = 1.0 if self.opaque else self.inner.ratio(above)
        bent = way.z / (at_least(dr.abs(event.o.z), GRAZING) * dr.square(eta))
        turned = dr.select(event.through, bent, way.z / at_least(dr.abs(event.o.z), GRAZING))
        alive = (first | second) & (origins > 0) & (o.z > 0)
        weight = dr.select(alive, event.weight * (turned * count * origins), 0)
        pdf = event.pdf
        if self.delta is not True and part == "transmit":
            pdf = self.back(o, type(o)(w.x, w.y, -dr.abs(w.z)), above, part, rng)[1]
        return Came(w, weight, pdf, event.through, bent)

    def _origins(self, image: Vector, above: bool) -> Array:
        """How many directions on the other side of the surface are met as this one."""
        front = self.leave(image, above)
        return dr.select(front.z < 0, 1 + _count(self._twice(front, above, True)[1], image), 0)

    # --- what planning needs -------------------------------------------------------------------------------------

    def roughness(self) -> tuple[Array, Array]:
        return self.inner.roughness()

    def ratio(self, above: bool) -> Array:
        return self.inner.ratio(above)

    def stretch(self, w: Vector, o: Vector, above: bool) -> Array:
        """By Snell's law, since o may have been folded."""
        cos, eta = self.met(w, above).z, self.inner.ratio(above)
        beyond = root(1 - (1 - dr.square(cos)) / dr.square(eta))
        return dr.square(eta) * beyond / at_least(cos, 1e-20)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        return self.inner.smooth_energy(cos, above)

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        return self.inner.lobe(cos, above)


def _sided(w: Vector, below: bool) -> Vector:
    """`w` on the upper or the lower side, mirrored where it was on the other."""
    z = dr.abs(w.z)
    return type(w)(w.x, w.y, -z if below else z)


def _count(mask: Any, like: Vector) -> Array:
    return dr.select(mask, 1.0 + 0 * like.x, 0.0 * like.x)
