"""A stack as lobes, on Dr.Jit arrays: what the Python result and a renderer's plugin both stand on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from ...optics.vectors import Array, Vector, at_least, at_most, mean
from ..bound import BoundStack
from ..direct import direct, direct_is_certain
from ..mixture import Mixture
from ..smooth import has_delta, smooth_energy, straight
from ..tilt import ways
from . import slopes
from . import width as widths
from .exit import Exit
from .lobe import NARROWEST, Lobe
from .moments import is_zero
from .recursion import Answer, Beam, respond
from .through import turned as turned_by

if TYPE_CHECKING:
    from .angular import Side
    from .energies import Energies

#: share of the samples that every side with anything but delta parts gets as a cosine lobe
FLOOR = 0.02


@dataclass
class Found:
    """Everything for light from one direction, on one side.

    Attributes:
        lobes: see `Lobe`.
        first: the lobe of the outermost interface, which is known exactly; None where it is smooth everywhere.
        diffuse, beyond: diffuse energy on the side of the light and on the other; the float 0 where there is none.
        lit, white: of a rough diffuse base that is seen, see `matte.Lit`; else the float 0.
    """

    lobes: list[Lobe]
    first: Lobe | None
    diffuse: Array
    beyond: Array
    lit: Array = 0.0
    white: Array = 0.0

    def energy(self, same: bool) -> Array:
        """All that leaves on one side, without delta parts."""
        parts = [lobe.energy for lobe in self.all() if lobe.same == same]
        return sum(parts, self.diffuse if same else self.beyond)

    def all(self) -> list[Lobe]:
        return ([self.first] if self.first is not None else []) + self.lobes


class LobesCore:
    """A bound stack with everything the method needs to know.

    Args:
        stack: the stack with its numbers.
        spectrum: type of a colour, or of a number where nothing in the stack is coloured.
        radiance: scale transmitted light as radiance (n_wi / n_wo)^2; False for importance (flux).
        symmetric: evaluate reflection in its reciprocal form.
        published: as the paper and its code have it (`published`).
        uniform: whether no number of the stack varies from lane to lane, in a vectorised backend.
        tables: what `angular.tabulate` made of such a stack; the recursion is asked where it has nothing.
        energies: what takes the place of the recursion's; None for these.
    """

    def __init__(
        self,
        stack: BoundStack,
        spectrum: Any,
        radiance: bool = True,
        symmetric: bool = False,
        published: bool = False,
        uniform: bool = False,
        tables: dict[bool, Side] | None = None,
        energies: Energies | None = None,
    ) -> None:
        self.uniform = uniform
        self.tables = tables or {}
        self.energies = energies
        #: the stack with its normals, None where all interfaces are parallel; `stack` has them parallel
        self.tilted = stack if stack.tilted else None
        if stack.tilted:
            stack = slopes.flattened(stack, symmetric)
        self.stack, self.spectrum, self.radiance = stack, spectrum, radiance
        self.symmetric, self.published = symmetric, published
        self.sides = (True,) if stack.opaque else (True, False)
        self.alone = (
            len(stack.interfaces) == 1
            and direct_is_certain(stack)
            and all(medium is None for medium in stack.media)
        )
        scattering = [medium for medium in stack.media if medium is not None and medium.scatters]
        #: whether light that is scattered forwards makes lobes of its own
        self.forward = not published and any(hasattr(medium.phase, "g") for medium in scattering)
        known = {side: table.exit for side, table in self.tables.items()}
        self.exits = {side: known.get(side) or Exit(self, side) for side in self.sides}

    # --- what light does -------------------------------------------------------------------------------------------

    def answer(self, wi: Vector, above: bool, scatters: bool = True) -> Answer:
        """The recursion, in the form that was asked for."""
        if self.published:
            from .published import respond as as_published

            return as_published(self.stack, wi, above)
        if self.energies is None:
            return respond(self.stack, wi, above, scatters)
        whole, still = (respond(self.stack, wi, above, scattered) for scattered in (True, False))
        return self.energies.put(whole, still, self.stack, wi, above)[0 if scatters else 1]

    def find(self, wi: Vector, above: bool, towards: Vector | None = None) -> Found:
        """The lobes for light from wi.

        Args:
            wi: direction; on the side `above`.
            above: which side.
            towards: direction whose difference to wi decides the energies, instead of wi itself (symmetric form).
        """
        seen = wi if towards is None else symmetric_direction(wi, towards)
        turned = None
        if self.tilted is not None:
            seen, turned = slopes.seen(self.tilted, wi, above), ways(self.tilted, wi, above)
        answer = self.answer(seen, above)
        still = self.answer(seen, above, False) if self.forward else None
        axis = type(wi)(wi.x, wi.y, at_least(dr.abs(wi.z), 1e-6))
        outermost = self._outermost(above)
        lobes: list[Lobe] = []
        first: Lobe | None = None
        alone = {} if still is None else {beam.layer: beam for beam in still.reflected}
        for beam in answer.reflected:
            if turned is not None:
                axis = turned.axes[beam.layer]
            unscattered = alone.get(beam.layer, beam)
            if beam.layer == outermost:
                if unscattered.sharp is not True:
                    first = self._lobe(unscattered, axis, True, "reflected")
                continue
            split = still is not None and self._scattered(beam.layer, above)
            lobes += self._split(beam, unscattered if split else None, axis, True, "reflected")
        if answer.through is not None:
            through = axis
            ratio = self.stack.indices[0] / self.stack.indices[-1]
            ratio = ratio if above else 1 / ratio
            sin = dr.sqrt(at_least(dr.square(wi.x) + dr.square(wi.y), 1e-20))
            tilt = at_most(ratio, 0.999999 / sin)
            z = dr.sqrt(at_least(1 - dr.square(sin * tilt), 1e-12))
            through = type(wi)(wi.x * tilt, wi.y * tilt, z)
            if turned is not None and turned.through is not None:
                through = turned.through
            bent = turned_by(through, answer.through.turn)
            unscattered_through = None if still is None else still.through
            lobes += self._split(answer.through, unscattered_through, bent, False, "transmitted")
            if answer.delayed is not None:
                bent = turned_by(through, answer.delayed.turn)
                lobes += self._split(answer.delayed, None, bent, False, "delayed")
        return Found(lobes, first, answer.diffuse, answer.beyond, *(answer.lit or (0.0, 0.0)))

    def look(self, wi: Vector, above: bool) -> Found:
        """What `find` says, from a table where there is one."""
        side = self.tables.get(above)
        return self.find(wi, above) if side is None else side.find(wi)

    def _outermost(self, above: bool) -> int:
        return 0 if above else len(self.stack.interfaces) - 1

    def _scattered(self, layer: int, above: bool) -> bool:
        """Whether light on its way to an interface may be scattered forwards."""
        passed = self.stack.media[1 : layer + 1] if above else self.stack.media[layer + 1 :]
        return any(medium is not None and medium.scatters for medium in passed)

    def first_is_a_lobe(self, above: bool) -> bool:
        """Whether the outermost interface has no closed form, so that a lobe stands for what it reflects."""
        return self.published or bool(self.stack.interfaces[self._outermost(above)].stochastic)

    def _lobe(self, beam: Beam, axis: Vector, same: bool, kind: str) -> Lobe:
        x, y, frame = widths.axes(beam.width, widths.PUBLISHED if self.published else widths.OURS)
        energy = beam.energy if beam.sharp is False else dr.select(beam.sharp, 0, beam.energy)
        wide_x = at_least(x, NARROWEST)
        wide_y = wide_x if x is y else at_least(y, NARROWEST)
        return Lobe(energy, axis, wide_x, wide_y, frame, same, beam.layer, kind)

    def _split(self, beam: Beam, unscattered: Beam | None, axis: Vector, same: bool, kind: str) -> list[Lobe]:
        """The lobe of an interface; with media that scatter forwards, what these did not touch and what they did."""
        if unscattered is None:
            return [] if beam.sharp is True else [self._lobe(beam, axis, same, kind)]
        lobes = [] if unscattered.sharp is True else [self._lobe(unscattered, axis, same, kind)]
        a, b = mean(beam.energy), mean(unscattered.energy)
        share = 1 / at_least(a - b, 1e-9)
        wide = widths.plus(beam.width * (a * share), unscattered.width * (-b * share))
        rest = dr.select(a - b > 1e-9, at_least(beam.energy - unscattered.energy, 0), 0)
        scattered = Beam(rest, widths.at_least_zero(wide), beam.cos, False, beam.layer)
        return [*lobes, self._lobe(scattered, axis, same, "forward")]

    # --- values ----------------------------------------------------------------------------------------------------

    def scale(self, wi: Vector, wo: Vector) -> Array:
        """What turns flux into what was asked for: `BoundStack.scale` for radiance, 1 for importance."""
        return self.stack.scale(wi, wo) if self.radiance else 1.0

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """f |cos wo|."""
        if self.alone:
            return self.spectrum(direct(self.tilted or self.stack, wi, wo) * self.scale(wi, wo))
        value: Array = 0 * wi.x
        for above in self.sides:
            near = wi.z > 0 if above else wi.z < 0
            value = dr.select(near, self._from(wi, wo, above), value)
        return self.spectrum(value * self.scale(wi, wo))

    def _from(self, wi: Vector, wo: Vector, above: bool) -> Array:
        """f |cos wo| for light from one side, in flux."""
        same = wo.z > 0 if above else wo.z < 0
        o = type(wo)(wo.x, wo.y, dr.abs(wo.z))
        found = self.find(wi, above, wo) if self.symmetric else self.look(wi, above)
        value: Array = 0 * wi.x
        for lobe in found.lobes:
            here = same if lobe.same else (wo.z < 0 if above else wo.z > 0)
            value = value + dr.select(here, lobe.value(o, self.symmetric and lobe.same), 0)
        if found.first is not None:
            value = value + dr.select(same, self._first(wi, wo, o, found.first, above), 0)
        for energy, mine in ((found.diffuse, True), (found.beyond, False)):
            if isinstance(energy, float) and energy == 0:
                continue
            here = same if mine else (wo.z < 0 if above else wo.z > 0)
            if self.symmetric and mine:
                spread = self.exits[above].reciprocal(wi, wo)
            else:
                shape = self.exits[above if mine else not above]
                spread = shape.weighed(energy, found, wi, o) * self._leaving(shape.above, o)
            value = value + dr.select(here, spread, 0)
        return value

    def _leaving(self, above: bool, o: Vector) -> Array:
        """The density of diffuse light that leaves on a side, per solid angle, cosine included; o has z > 0."""
        side = self.tables.get(above)
        found = None if side is None else side.leaving(o)
        return self.exits[above].density(o) if found is None else found

    def _first(self, wi: Vector, wo: Vector, o: Vector, lobe: Lobe, above: bool) -> Array:
        """The lobe of the outermost interface: its own where that has a closed form."""
        if self.first_is_a_lobe(above):
            return lobe.value(o, self.symmetric)
        interface = (self.tilted or self.stack).interfaces[self._outermost(above)]
        w = type(wi)(wi.x, wi.y, dr.abs(wi.z))
        return interface.reflect(w, o, above)[0]

    # --- sampling --------------------------------------------------------------------------------------------------

    def mixture(self, wi: Vector) -> Mixture:
        """What to draw directions from."""
        still = dr.detach(wi)
        parts: list[tuple[Array, Any]] = []
        for above in self.sides:
            near = wi.z > 0 if above else wi.z < 0
            found = self.look(still, above)
            for lobe in found.all():
                up = above if lobe.same else not above
                energy = dr.select(near, mean(lobe.energy), 0)
                parts.append((dr.detach(energy), lobe.sampler(0.0, up)))
            scattered = bool(found.all()) or not is_zero(found.diffuse)
            for energy, up in ((found.diffuse, above), (found.beyond, not above)):
                if (scattered or not is_zero(energy)) and up in self.sides:
                    weight = dr.select(near, mean(energy) + FLOOR, 0)
                    parts.append((dr.detach(weight), Exit.sampler(up)))
        if has_delta(self.stack):
            reflected, transmitted = smooth_energy(self.stack, wi)
            return Mixture.build(wi, parts, reflected, transmitted, straight(self.stack, wi))
        return Mixture.build(wi, parts, None, None, None)

    def pdf(self, wi: Vector, wo: Vector) -> Array:
        """Density of `sample`, per solid angle, without the delta parts."""
        return self.mixture(wi).pdf(wo)

    def sample(self, wi: Vector, u: Vector) -> tuple[Vector, Array, Array, Any]:
        """(wo, density or probability, what a delta part carries in flux, mask of delta lanes)."""
        mixture = self.mixture(wi)
        wo, probability, carried, delta = mixture.sample(wi, u)
        return wo, dr.select(delta, probability, mixture.pdf(wo)), carried, delta

    def flux(self, wi: Vector, same: bool) -> Array:
        """All that leaves on the side of the light, or on the other, delta parts included."""
        value: Array = 0 * wi.x
        for above in self.sides:
            near = wi.z > 0 if above else wi.z < 0
            value = dr.select(near, self.find(wi, above).energy(same), value)
        if has_delta(self.stack):
            value = value + smooth_energy(self.stack, wi)[0 if same else 1]
        return self.spectrum(value + 0 * wi.x)


def symmetric_direction(wi: Vector, wo: Vector) -> Vector:
    """The direction from which a facet between both sees either: its cosine, in the azimuth of their difference."""
    h = dr.normalize(wi + wo)
    cos = at_most(dr.abs(dr.dot(h, wo)), 1.0)
    x, y = wi.x - wo.x, wi.y - wo.y
    scale = dr.sqrt(at_least(1 - dr.square(cos), 0)) * dr.rsqrt(at_least(dr.square(x) + dr.square(y), 1e-12))
    return type(wi)(x * scale, y * scale, cos)
