"""What every interface promises to the solvers, and the rotation of its tangent frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import drjit as dr

from ..optics.random import Generator
from ..optics.vectors import Array, Vector, at_least, rotate

if TYPE_CHECKING:
    from .given import Given

Part = Literal["both", "reflect", "transmit"]

#: directions nearer to the horizon than this see nothing of a rough surface: two of them have no normal half-way
HORIZON = 1e-14


@dataclass
class Scatter:
    """One sampled event at an interface.

    Attributes:
        o: outgoing direction (o.z > 0 reflected, o.z < 0 transmitted).
        weight: flux density over sampling density; 0 where the sample is void.
        pdf: density of `o` per solid angle, the choice between reflection and transmission included when both were
            possible; meaningless on delta lanes.
        through: mask of the transmitted lanes (a plain bool where that is certain).
    """

    o: Vector
    weight: Array
    pdf: Array
    through: Any


class Interface(ABC):
    """One boundary with its numbers. See the package docstring for frames and units."""

    opaque: bool = False
    flat: bool = False
    delta: Any = False
    stochastic: bool = False
    #: whether its normal is not that of the surface (`tilted.Tilted`)
    tilted: bool = False
    #: its roughness, along one axis or two, where that is known in Python
    known_alpha: tuple[float, ...] | None = None
    #: the same boundary without what its facets send to one another, if this adds it as a lobe
    single: Any = None

    @classmethod
    @abstractmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        """The interface of a described layer, and the index below it: as a number, and in Python if it is known."""

    @abstractmethod
    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        """Flux density of reflection from w to o (both z > 0), and the density of sampling o with `part` allowed."""

    @abstractmethod
    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        """Flux density of transmission from w (z > 0) to o (z < 0), and the density of sampling o."""

    @abstractmethod
    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        """Sample an outgoing direction; `u` are three numbers in [0, 1), the first chooses what happens."""

    def certain(self, w: Vector, o: Vector, above: bool, through: bool) -> Array:
        """The part of the flux density of transmission (`through`) or reflection that needs no random numbers."""
        if self.stochastic:
            return 0 * w.x
        return self.transmit(w, o, above)[0] if through else self.reflect(w, o, above)[0]

    def absorbs(self, w: Vector, event: Scatter) -> Array | None:
        """The share of the light from w that an opaque boundary took up in a sampled event.

        What else `event.weight` lacks is lost between facets that scatter once. None where nothing is.
        """
        return None

    def roughness(self) -> tuple[Array, Array]:
        """Roughness along x and y of the interface's own frame."""
        return 0.0, 0.0

    def ratio(self, above: bool) -> Array:
        """Index beyond the boundary over the index on the incident side."""
        return 1.0

    def stretch(self, w: Vector, o: Vector, above: bool) -> Array:
        """Solid angle at w over solid angle at o, transmitted by a smooth interface."""
        return dr.square(self.ratio(above)) * dr.abs(o.z) / at_least(w.z, 1e-20)

    @abstractmethod
    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        """Reflectance and transmittance of the delta parts at this cosine of incidence; (0, 0) where rough."""

    @abstractmethod
    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        """A rough guess of (reflectance, transmittance, roughness) for planning importance sampling."""


class Frame:
    """The tangent frame of an anisotropic interface: turned by an angle about the normal.

    Args:
        degrees: rotation of the x axis of the roughness towards y; a number or one per lane.
    """

    def __init__(self, degrees: Array) -> None:
        self.turned = not (isinstance(degrees, (int, float)) and degrees == 0)
        if self.turned:
            self.sin, self.cos = dr.sincos(degrees * (dr.pi / 180))

    def enter(self, w: Vector) -> Vector:
        return rotate(w, self.cos, -self.sin) if self.turned else w

    def leave(self, w: Vector) -> Vector:
        return rotate(w, self.cos, self.sin) if self.turned else w
