"""No interface at all: an index-matched boundary, which all light crosses straight on."""

from __future__ import annotations

from ..optics.random import Generator
from ..optics.vectors import Array, Vector
from .base import Interface, Part, Scatter
from .given import Given


class Null(Interface):
    """The boundary of a medium that nothing covers, or between two media of the same index."""

    delta = True

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        return cls(), given.above, given.known_above

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        return 0 * w.x, 0 * w.x

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
        weight = 0 * w.x if part == "reflect" else 1 + 0 * w.x
        through = part != "reflect"
        o = -w if through else type(w)(-w.x, -w.y, w.z)
        return Scatter(o, weight, 0 * w.x, through)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        return 0 * cos, 1 + 0 * cos

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        return 0 * cos, 1 + 0 * cos, 0 * cos
