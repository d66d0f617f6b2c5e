"""Rough diffuse bases: what facets that reflect like Lambert's surface send out, from tables.

Light that leaves after one facet has a bidirectional function

    f_1 = rho / pi * j (1 + L_w) (1 + L_o) / (1 + L_w + L_o)        j = integral D <w, m> <o, m> dm / (sigma_w sigma_o)

with L Smith's Lambda and sigma the projected area; j, which has no closed form, is tabulated (tools/lobe_matte.py).
What goes on from facet to facet is in proportion to rho^2 after the second, and to higher powers later:

    f = f_1 + rho^2 f_2 + rho^3 f_3 (1 - q) / (1 - rho q)

of which f_2, f_3 (all the rest of white facets) and q are tabulated, too; it sends back all light where rho is 1.
Energies are integrals of the same tables, so a base alone is what `interfaces.RoughDiffuse` estimates, without noise.

Facets that are not alike in all directions: j depends on their stretched directions, and beyond these on a mean
roughness (`_one`), which energies are taken from, too: to 0.01 for roughnesses 0.2 and 0.5, 0.03 for 0.1 and 0.9.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from ...adding import Slab
from ...interfaces import RoughDiffuse
from ...optics.microsurface import Microsurface
from ...optics.vectors import Array, Vector, at_least, at_most
from ..bound import BoundStack
from . import axes
from .flow import Flow
from .grid import Grid

#: nodes along the roughness, either cosine and the azimuth between: of one facet, and of those after it
ONCE, AGAIN = (11, 17, 17, 7), (11, 9, 9, 5)
#: nodes along the roughness, the cosine, and that of the rim of a cone
CONES = (11, 17, 9)
#: steps of the fixed-point numbers in the file, of j and of all others
COARSE, STEP = 2.0**-11, 2.0**-14


class Lit(NamedTuple):
    """Light that a rough diffuse base sends out of a stack the first time that it meets it.

    Attributes:
        energy: of that.
        white: of that, were the base Lambert's and white.
    """

    energy: Array
    white: Array


class Matte:
    """A rough diffuse base with its numbers."""

    def __init__(self, base: RoughDiffuse) -> None:
        self.reflectance, self.walks, self.frame = base.smooth.reflectance, base.walks, base.frame
        self.kind = "ggx" if base.surface.ggx else "beckmann"
        x, y = base.surface.alpha_x, base.surface.alpha_y
        self.isotropic = x is y
        if base.lambert is not False:
            x, y = (dr.select(base.lambert, 0, a) for a in (x, y))
        self.surface = Microsurface(x, x if self.isotropic else y, self.kind)
        self.alpha = x if self.isotropic else _one(x, y)

    def value(self, w: Vector, o: Vector) -> Array:
        """pi f for light from w to o, in the frame of the base; both have z > 0."""
        w, o = self.frame.enter(w), self.frame.enter(o)
        masked_w, masked_o = (self.surface.masking(v) for v in (w, o))
        seen = (1 + masked_w) * (1 + masked_o) / (1 + masked_w + masked_o)
        a, b = (self._round(v) for v in (w, o))
        flat = dr.sqrt(at_least((1 - dr.square(a.z)) * (1 - dr.square(b.z)), 1e-12))
        apart = at_most(at_least(0.5 - 0.5 * (a.x * b.x + a.y * b.y) / flat, 0), 1)
        places = [self._rough(w.z), along_cosine(a.z), along_cosine(b.z), apart]
        (j,) = _grid(self.kind, "once")(places, w.z)
        if not self.walks:
            return self.reflectance * (seen * j)
        two, more = _grid(self.kind, "again")(places, w.z)
        return self._sum(seen * j, two, more, self._even(w.z)[3])

    def albedo(self, cos: Array, rim: Array | None = None) -> Array:
        """What it reflects of light from a direction of this cosine.

        Args:
            rim: if given, only what leaves at a higher cosine, over 1 - rim^2: the mean of `value` there.
        """
        last: Any = 0 if rim is None else rim + 0 * cos
        found = _grid(self.kind, "cones")([self._rough(cos), along_cosine(cos), last], cos)
        one, two, more = found
        return self._sum(one, two, more, self._even(cos)[3])

    def even(self, like: Array) -> Array:
        """What it reflects of light that comes evenly from all directions."""
        one, two, more, tail = self._even(like)
        return self._sum(one, two, more, tail)

    def unshadowed(self, cos: Array) -> tuple[Array, Array]:
        """What white facets that send light on once would reflect, of a beam and of even light; 1 where all goes on."""
        if self.walks:
            return 1.0, 1.0
        places = [self._rough(cos), along_cosine(cos), 0]
        return _grid(self.kind, "cones")(places, cos)[0], self._even(cos)[0]

    def leaves(self, up: Slab, cos: Array, rim: Array) -> Slab:
        """The layers above, for what it sends up of light from this cosine: that is not even.

        Args:
            up: for even light.
            rim: cosine below which none of it gets out.
        """
        share = self.albedo(cos, rim) / at_least(self.albedo(cos), 1e-6)
        out, back = up.t_up, up.r_bottom
        return up._replace(
            t_up=Flow(out.beam, out.scattered, out.diffuse * share),
            r_bottom=back + Flow(0.0, 0.0, out.diffuse * (1 - share)),
        )

    def _even(self, like: Array) -> list[Array]:
        return _grid(self.kind, "even")([self._rough(like)], like)

    def _sum(self, one: Array, two: Array, more: Array, tail: Array) -> Array:
        rho = self.reflectance
        if not self.walks:
            return rho * one
        return rho * (one + rho * (two + rho * (more * (1 - tail)) / (1 - rho * tail)))

    def _rough(self, like: Array) -> Array:
        return axes.along_square(self.alpha + 0 * like)

    def _round(self, w: Vector) -> Vector:
        """A direction in the frame where facets are as if alike in all directions."""
        if self.isotropic:
            return w
        scale = 1 / at_least(self.alpha, 1e-6)
        x, y = w.x * self.surface.alpha_x * scale, w.y * self.surface.alpha_y * scale
        return dr.normalize(type(w)(x, y, w.z))


def rim(stack: BoundStack) -> Array:
    """Cosine above the base below which nothing gets out of a stack of smooth layers."""
    lowest: Array = 1.0
    for index in stack.indices[:-2]:
        lowest = at_most(lowest, index / stack.indices[-2])
    return dr.select(lowest < 1, dr.sqrt(at_least(1 - dr.square(lowest), 1e-12)), 0.0)


def clear(stack: BoundStack) -> bool:
    """Whether nothing above the base scatters."""
    return not any(medium is not None and medium.scatters for medium in stack.media)


def along_cosine(cos: Array) -> Array:
    """The place of a cosine, in proportion to the sine of half the angle."""
    return 1 - dr.sqrt(at_most(at_least(1 - cos, 1e-10), 1))


def _one(x: Array, y: Array) -> Array:
    """A roughness for two."""
    return (2 * dr.sqrt(0.5 * (dr.square(x) + dr.square(y))) + 0.5 * (x + y)) / 3


@cache
def _grid(kind: str, name: str) -> Grid:
    with np.load(Path(__file__).parent / "data" / "matte.npz") as file:
        values = file[f"{kind}_{name}"] * (COARSE if name == "once" else STEP)
    return Grid(values)
