"""The walk as a BSDF on Dr.Jit arrays: what the Python result and the Mitsuba plugin both stand on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...optics.random import generator
from ...optics.vectors import Array, Vector, float_type
from ..bound import BoundStack
from ..direct import direct, direct_is_certain
from .proposal import propose
from .sharp import follow
from .stages import may_stage
from .trace import trace
from .walk import estimate


@dataclass
class WalkCore:
    """A bound stack with everything the walk needs to know.

    Attributes:
        stack: the stack with its numbers.
        spectrum: type of a colour, or of a number where nothing in the stack is coloured.
        radiance: scale transmitted light as radiance (n_wi / n_wo)^2; False for importance (flux).
        max_depth: most scattering events inside; None for no limit.
        alike: whether the numbers of the stack are the same for all evaluations.
    """

    stack: BoundStack
    spectrum: Any
    radiance: bool = True
    max_depth: int | None = None
    alike: bool = False

    def scale(self, wi: Vector, wo: Vector) -> Array:
        """What turns flux into what was asked for: `BoundStack.scale` for radiance, 1 for importance."""
        return self.stack.scale(wi, wo) if self.radiance else 1.0

    def eval(
        self, wi: Vector, wo: Vector, key: Sequence[Array], seed: Array, first: Array, count: int
    ) -> Array:
        """f |cos wo|, as the mean of `count` samples numbered from `first`.

        Args:
            key: what identifies this evaluation besides the directions (texture coordinates, ...).
            seed: integer below 2**32.
        """
        value, _ = self.moments(wi, wo, key, seed, first, count)
        return self.spectrum((value + self.certain(wi, wo)) * self.scale(wi, wo))

    def once(self, wi: Vector, wo: Vector, seed: Array) -> Array:
        """One sample of f |cos wo|, what is certain included; of many pairs in `stages`."""
        rng, certain = generator(wi, [*wi, *wo], seed, 0), self.certain(wi, wo)
        staged = self.alike and self.stack.still is None and may_stage(wi, wo)
        value = estimate(self.stack, wi, wo, rng, self.spectrum, self.max_depth, staged, certain)
        return self.spectrum(value * self.scale(wi, wo))

    def certain(self, wi: Vector, wo: Vector) -> Array:
        """What needs no sampling, without the scale of radiance."""
        return direct(self.stack, wi, wo) if direct_is_certain(self.stack) else self.spectrum(0) + 0 * wi.x

    def moments(
        self, wi: Vector, wo: Vector, key: Sequence[Array], seed: Array, first: Array, count: Array
    ) -> tuple[Array, Array]:
        """Mean and mean square of the random part, without the scale of radiance."""
        if len(self.stack.interfaces) == 1 and direct_is_certain(self.stack):
            return self.spectrum(0) + 0 * wi.x, self.spectrum(0) + 0 * wi.x

        def one(i: Array) -> Array:
            rng = generator(wi, [*wi, *wo, *key], seed, i)
            return estimate(self.stack, wi, wo, rng, self.spectrum, self.max_depth)

        if isinstance(count, int) and count == 1:
            value = one(first)
            return value, dr.square(value)
        return self._average(wi, one, first, count, 1)

    def flux(
        self, wi: Vector, key: Sequence[Array], seed: Array, first: Array, count: Array, tally: Any = None
    ) -> tuple[Array, ...]:
        """Mean flux upwards and downwards, and their mean squares; a `ledger.Tally` adds its counts and the sum."""

        def one(i: Array) -> tuple[Array, ...]:
            rng = generator(wi, [*wi, *key], seed, i)
            found = trace(self.stack, wi, rng, self.spectrum, self.max_depth, tally)
            return found if tally is None else (*found, sum(found[1:], found[0]))

        return self._average(wi, one, first, count, 2 if tally is None else tally.size)

    def _average(self, wi: Vector, one: Any, first: Array, count: Array, size: int) -> tuple[Array, ...]:
        uint = dr.uint32_array_t(float_type(wi))
        zero = self.spectrum(0)

        def body(i: Array, *sums: Array) -> tuple[Array, ...]:
            new = one(first + i)
            new = new if size > 1 else (new,)
            mean = tuple(self.spectrum(s + v) for s, v in zip(sums[:size], new, strict=True))
            square = tuple(self.spectrum(s + dr.square(v)) for s, v in zip(sums[size:], new, strict=True))
            return (i + 1, *mean, *square)

        start = (uint(0), *([zero] * (2 * size)))
        if self.stack.still is not None and self.stack.unrolled:
            out = start
            for _ in range(count):
                out = body(*out)
        else:
            # Dr.Jit cannot differentiate a loop within a loop in reverse: with live numbers, one launch a sample.
            mode = None if self.stack.still is None else "evaluated"
            out = dr.while_loop(start, lambda i, *_: i < count, body, label="samples", mode=mode)
        size_inv = 1 / float_type(wi)(count)
        return tuple(value * size_inv for value in out[1:])

    def pdf(self, wi: Vector, wo: Vector) -> Array:
        """Density of `sample`, per solid angle, without the delta parts."""
        return propose(self.stack.still or self.stack, wi).pdf(wo)

    def sample(self, wi: Vector, u: Vector) -> tuple[Vector, Array, Array, Any]:
        """(wo, density or probability, what a delta part carries in flux, mask of delta lanes)."""
        still = self.stack.still or self.stack
        mixture = propose(still, wi)
        wo, probability, carried, delta = mixture.sample(wi, u)
        if still.tilted and mixture.mirror is not None:
            # Where smooth interfaces are not parallel, the delta parts have no closed form.
            rng = generator(wi, [*wi, *u], 0, 0)
            sharp, flux = follow(still, wi, rng, self.spectrum)
            wo = dr.select(delta, sharp, wo)
            probability = dr.select(delta, mixture.mirror + mixture.straight, 0)
            carried = dr.select(delta, flux, 0)
        return wo, dr.select(delta, probability, mixture.pdf(wo)), carried, delta
