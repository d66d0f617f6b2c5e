"""A slab that varies with depth: what it scatters is linear in the optical depth between the heights that have values.

A collision is placed as in a slab that is everywhere as bright as this one at its brightest, and weighed by how bright
it is there. Which phase function scatters is a matter of chance, in proportion to what each scatters at that height.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..optics.vectors import Array, Vector, at_least, at_most
from .homogeneous import BoundMedium, Flight, bound_phase


class Mixed:
    """Several phase functions, each with its share of the scattering."""

    def __init__(self, phases: Sequence[Any], shares: Sequence[Array]) -> None:
        self.phases, self.shares = phases, shares
        self.flat = all(phase.flat for phase in phases)

    def eval(self, before: Vector, after: Vector) -> Array:
        value: Array = 0 * before.x
        for phase, share in zip(self.phases, self.shares, strict=True):
            value = value + share * phase.eval(before, after)
        return value

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        found, below = before, 0 * u1
        for phase, share in zip(self.phases, self.shares, strict=True):
            # One number serves twice: which of them, and where that scatters to.
            own = at_most(at_least((u1 - below) / at_least(share, 1e-20), 0), 1 - 2.0**-24)
            found = dr.select((u1 >= below) & (share > 0), phase.sample(before, own, u2), found)
            below = below + share
        return found


class BoundGraded(BoundMedium):
    """A slab with its numbers; `albedo` and `phase` are the means over the optical depth.

    Args:
        depth: optical depth of all of it, >= 0.
        heights: (K,) ascending from 0 (the top) to 1.
        phases: J bound phase functions of `optics.phase`.
        albedos: (J, K) what each of them scatters there, as a share of the extinction.
        mean: all of it, averaged over the optical depth.
        shares: (J,) what each of them has of that.
    """

    def __init__(
        self,
        depth: Array,
        heights: Sequence[float],
        phases: Sequence[Any],
        albedos: Sequence[Sequence[float]],
        mean: float,
        shares: Sequence[float],
    ) -> None:
        phase = phases[0] if len(phases) == 1 else Mixed(phases, shares)
        super().__init__(depth, mean, phase, scatters=mean > 0)
        self.heights, self.phases, self.albedos = heights, phases, albedos
        most = max(map(sum, zip(*albedos, strict=True)))
        self._brightest = BoundMedium(depth, most, phase)
        self._relative = [[albedo / most if most else 0.0 for albedo in row] for row in albedos]

    @classmethod
    def bind(cls, given: Any) -> BoundGraded:
        """The medium of a described layer (`interfaces.given.Given`)."""
        layer = given.layer
        scatterers = layer.scatterers
        if isinstance(layer.phase, tuple):
            numbers = [{n: getattr(phase, n) for n in type(phase).model_fields} for phase, _ in scatterers]
            known = [own.get("g") for own in numbers]
        else:
            numbers, known = [given.phase_parameters()], [given.known("phase.g")]
        phases = [
            bound_phase(phase.kind, own, g)
            for (phase, _), own, g in zip(scatterers, numbers, known, strict=True)
        ]
        albedos = [row for _, row in scatterers]
        return cls(given["depth"], layer.heights, phases, albedos, layer.mean_albedo, layer.shares)

    def fly(self, t: Array, w: Vector, throughput: Array, u1: Array, u2: Array, u3: Array) -> Flight:
        """As `BoundMedium.fly`; the weight never exceeds what the brightest part lets live."""
        flight = self._brightest.fly(t, w, throughput, u1, u2, u3)
        share: Array = 0 * t
        for part in self._at(flight.t):
            share = share + part
        return Flight(
            flight.collided,
            flight.t,
            flight.weight * dr.select(flight.collided, share, 1.0),
            flight.scattered * share,
        )

    def phase_at(self, t: Array) -> Any:
        """The phase function of collisions at a position."""
        if len(self.phases) == 1:
            return self.phase
        parts = self._at(t)
        whole: Array = 0 * t
        for part in parts:
            whole = whole + part
        inverse = 1 / at_least(whole, 1e-20)
        return Mixed(self.phases, [part * inverse for part in parts])

    def absorbed(self, gone: Array, flight: Flight) -> Array:
        """What a flight leaves in the medium, in the mean over where it collides."""
        return gone - flight.scattered

    def _at(self, t: Array) -> list[Array]:
        """What each phase function scatters at a position, relative to all of it where most is scattered."""
        begin: Array = self.heights[0]
        inverse: Array = 1 / (self.heights[1] - self.heights[0])
        rows: list[tuple[Array, Array]] = [(row[0], row[1] - row[0]) for row in self._relative]
        for k in range(1, len(self.heights) - 1):
            below = t >= self.heights[k]
            begin = dr.select(below, self.heights[k], begin)
            inverse = dr.select(below, 1 / (self.heights[k + 1] - self.heights[k]), inverse)
            rows = [
                (dr.select(below, row[k], a), dr.select(below, row[k + 1] - row[k], step))
                for (a, step), row in zip(rows, self._relative, strict=True)
            ]
        along = (t - begin) * inverse
        return [at_least(a + along * step, 0) for a, step in rows]  # no less, by rounding
