"""How diffuse light leaves a stack: weighed, direction by direction, by what the layers above it let out.

By reciprocity that is what they let in. Light from a diffuse base under a coat has the shape T(mu) mu, where T is
what a beam that comes from there, crosses every layer down to where light becomes diffuse, and is neither reflected
nor absorbed on the way, has left. Divided by its integral, it carries the energy that the recursion says (theory
(lobes.13)).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ...interfaces import BoundDiffuse, RoughDiffuse
from ...interfaces.tilted import Tilted
from ...optics.vectors import Array, Vector, at_least, channels
from ..facet_lobe import Lobe
from . import slopes
from .matte import Matte, clear
from .medium import Particles
from .operators import GRAZING, Boundary, leaning
from .quadrature import gauss

if TYPE_CHECKING:
    from .core import Found, LobesCore

#: nodes of the integral over the cosine
NODES = 8


class Exit:
    """The shape on one side of a stack.

    Args:
        core: the stack.
        above: which side.
    """

    def __init__(self, core: LobesCore, above: bool) -> None:
        self.core, self.above = core, above
        base = core.tilted is not None and core.tilted.interfaces[-1].tilted
        scattering = any(medium is not None and medium.scatters for medium in core.stack.media)
        #: a tilted base that is diffuse, and is seen through what does not scatter
        diffuse = isinstance(core.stack.interfaces[-1], (BoundDiffuse, RoughDiffuse))
        self._shaded = core.tilted if base and diffuse and above and not scattering else None
        base_of_all: Any = core.stack.interfaces[-1]
        rough = above and isinstance(base_of_all, RoughDiffuse) and clear(core.stack)
        #: a rough diffuse base that is seen through what does not scatter
        self.matte = Matte(base_of_all) if rough else None
        #: averages by name, as far as they are the same for all that may be asked
        self._known: dict[str, Array] = {}

    def density(self, o: Vector) -> Array:
        """Per solid angle, cosine included; integrates to 1 over the side. o has z > 0."""
        whole = self._average("passing", o, self._passing)
        found = self._passing(o) * o.z / (dr.pi * at_least(whole, 1e-6))
        return found if self._shaded is None else found * slopes.shade(self._shaded, o)

    def weighed(self, energy: Array, found: Found, wi: Vector, o: Vector) -> Array:
        """What `density` is multiplied by: the energy, and what a rough diffuse base does with directions.

        Light that it sends out the first time hangs on where it came from; what it sends out later is even.
        """
        if self.matte is None:
            return energy
        return found.white * self._seen(wi, o) + (energy - found.lit)

    def reciprocal(self, wi: Vector, wo: Vector) -> Array:
        """The diffuse part of f |cos o| in its symmetric form: m(wi) m(wo) / (pi mean m), m the diffuse energy."""
        mean = self._average("energy", wi, self._energy)
        even = self._energy(wi) * self._energy(wo) / at_least(mean, 1e-9)
        if self.matte is not None:
            white = self._average("lit", wi, self._lit)
            even = even + self._lit(wi) * self._lit(wo) / at_least(white, 1e-9) * self._seen(wi, wo)
        return even * dr.abs(wo.z) * dr.inv_pi

    def _seen(self, wi: Vector, wo: Vector) -> Array:
        """`Matte.value` for directions outside."""
        assert self.matte is not None
        return self.matte.value(self._within(wi), self._within(wo))

    def _within(self, w: Vector) -> Vector:
        """A direction outside as it is at the base, in its frame."""
        core = self.core
        ratio = core.stack.indices[0] / core.stack.indices[-2]
        x, y = w.x * ratio, w.y * ratio
        within = type(w)(x, y, dr.sqrt(at_least(1 - dr.square(x) - dr.square(y), 1e-6)))
        base: Any = (core.tilted or core.stack).interfaces[-1]
        if isinstance(base, Tilted):
            within = base.enter(within, True)
        return type(w)(within.x, within.y, at_least(within.z, 1e-3))

    def _average(self, name: str, like: Vector, term: Any) -> Array:
        """The mean of a function of directions, by cosine; once for all lanes where the stack is the same for them.

        Nothing is kept of what a symbolic loop or call records: outside, it has no value.
        """
        if name in self._known:
            return self._known[name]
        if dr.flag(dr.JitFlag.SymbolicScope):
            return self._sum(like, term)
        self._known[name] = self._once(like, term) if self.core.uniform else self._sum(like, term)
        return self._known[name]

    def _sum(self, like: Vector, term: Any) -> Array:
        return sum(w * term(_direction(like, c)) for c, w in _RULE)

    def _once(self, like: Vector, term: Any) -> Array:
        number = type(like.x)
        cos, weight = (number([row[k] for row in _RULE]) for k in (0, 1))
        sin = dr.sqrt((1 - cos) * (1 + cos) / 2)
        found = weight * term(type(like)(sin, sin, cos))
        found = type(found)(*(dr.sum(c) for c in found)) if channels(found) else dr.sum(found)
        dr.eval(found)
        return found

    def _energy(self, w: Vector) -> Array:
        answer = self.core.answer(w, self.above)
        return answer.diffuse if answer.lit is None else answer.diffuse - answer.lit.energy

    def _lit(self, w: Vector) -> Array:
        lit = self.core.answer(w, self.above).lit
        assert lit is not None
        return lit.white + 0 * w.x

    @staticmethod
    def sampler(up: bool) -> Any:
        """To sample from: a cosine lobe."""
        return Lobe(0.0, up)

    def _passing(self, o: Vector) -> Array:
        stack, above = self.core.stack, self.above
        cos = at_least(o.z, GRAZING)
        passed: Array = 1.0
        last = len(stack.interfaces) - 1
        for k in range(last + 1) if above else range(last, -1, -1):
            lean = leaning(stack.interfaces[k], k == (0 if above else last))
            boundary = Boundary(stack.interfaces[k], above, o, lean=lean)
            if boundary.opaque:
                break
            passed = passed * boundary.beam(cos, None)[1]
            cos = at_least(boundary.refracted(cos), GRAZING)
            medium = stack.media[k + 1] if above else stack.media[k]
            if medium is not None:
                if medium.scatters:
                    break
                passed = passed * Particles(medium, False).passed(cos)
        return passed


def _direction(like: Vector, cos: float) -> Vector:
    """A direction of this cosine, as wide as need be and no wider; its azimuth is that of neither axis."""
    sin = float(np.sqrt((1 - cos * cos) / 2))
    return type(like)(sin, sin, cos)


_RULE = tuple((c, 2 * c * weight) for c, weight in gauss(NODES))
