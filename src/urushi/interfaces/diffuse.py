"""Lambert's base: light leaves in all directions alike, whatever its own came from."""

from __future__ import annotations

import drjit as dr

from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, cosine_hemisphere
from .base import Interface, Part, Scatter
from .given import Given


class BoundDiffuse(Interface):
    """Flux density reflectance * cos / pi.

    Args:
        reflectance: directional-hemispherical reflectance, in [0, 1]; a number or a colour, one or one per lane.
    """

    opaque = True
    flat = True

    def __init__(self, reflectance: Array) -> None:
        self.reflectance = reflectance

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        return cls(given["reflectance"]), given.above, given.known_above

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        pdf = at_least(o.z, 0) * dr.inv_pi
        return self.reflectance * pdf, pdf

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
        o = cosine_hemisphere(u[2], u[1], w)  # azimuth by the first, as facets have it
        return Scatter(o, self.reflectance + 0 * w.x, o.z * dr.inv_pi, False)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        return 0 * cos, 0 * cos

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        return self.reflectance + 0 * cos, 0 * cos, 1 + 0 * cos
