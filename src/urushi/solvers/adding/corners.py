"""Parameters that vary over a surface: tables solved at a few values of each, and linear between them.

A solution is for one value of every parameter. Where one comes from a texture the stack is solved for some values over
its range, and the tables are interpolated by hats in between (Jakob et al. 2014, section 6); what has a closed form is
evaluated with the very values of the place. Two textures make a grid of corners. Wavelengths
are such a parameter, too: a spectral renderer asks for other ones at every place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ...optics.vectors import Array, Vector, at_least, at_most, channels
from ..bound import BoundStack
from .core import AddingCore


def hats(value: Array, samples: Sequence[float]) -> list[Array]:
    """The weight of every sample (ascending) at a value: linear between two, constant beyond the ends."""
    found = []
    for k, here in enumerate(samples):
        weight: Array = 1.0 + 0 * value
        if k > 0:
            weight = at_most(weight, _rise(value, samples[k - 1], here))
        if k + 1 < len(samples):
            weight = at_most(weight, _rise(-value, -samples[k + 1], -here))
        found.append(weight)
    return found


def _rise(value: Array, low: float, high: float) -> Array:
    """0 below `low`, 1 above `high`; colours channel by channel."""
    t = (value - low) * (1 / (high - low))
    if channels(t):
        return type(t)(*(at_most(at_least(c, 0), 1) for c in t))
    return at_most(at_least(t, 0), 1)


class Corners:
    """Several solutions of one stack as one.

    Args:
        cores: one for each corner; all of the same stack but for the values.
        stack: the stack with the values of the place.
        weights: for each core, what each of its channels counts for: numbers, or values in all channels of the result.
        chances: the part of the samples that each core draws; they sum to 1.
    """

    def __init__(
        self,
        cores: Sequence[AddingCore],
        stack: BoundStack,
        weights: Sequence[Sequence[Array]],
        chances: Sequence[Array],
    ) -> None:
        self.cores = [core.at(stack) for core in cores]
        self.stack, self.weights, self.chances = stack, weights, chances
        # A corner where nothing is scattered has no closed form of light scattered once, of which its own is none.
        self.first = next((core for core in self.cores if core.closed.once is not None), self.cores[0])
        self.scale = self.first.scale

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """f |cos wo| without the delta parts."""
        first = self.first
        value = first.closed.eval(wi, wo)
        value = value + self._mixed([core.tabulated(wi, wo) for core in self.cores])
        if any(core.table is not None and core.table.signed for core in self.cores):
            value = at_least(value, 0)
        return first.finished(dr.select((wi.z != 0) & (wo.z != 0), value * first.scale(wi, wo), 0))

    def albedo(self, wi: Vector) -> Array:
        """Directional-hemispherical reflectance, interpolated between the corners."""
        first = self.first
        if not any(core.scatters for core in self.cores):
            return first.reflectance(wi)
        return first.finished(self._mixed([core.fluxes(wi, True) for core in self.cores]))

    def _mixed(self, values: Sequence[Sequence[Array]]) -> Array:
        value: Array = 0.0
        for weights, channels_ in zip(self.weights, values, strict=True):
            for weight, one in zip(weights, channels_, strict=True):
                value = value + weight * one
        return value

    def pdf(self, wi: Vector, wo: Vector) -> Array:
        """Density of `sample`, per solid angle, without the delta parts."""
        density = 0 * wi.x
        for core, chance in zip(self.cores, self.chances, strict=True):
            density = density + chance * core.pdf(wi, wo)
        return density

    def sample(self, wi: Vector, u: Vector) -> tuple[Vector, Array, Array, Any]:
        """(wo, density or probability, what a delta part carries in flux, mask of delta lanes)."""
        wo, carried = type(wi)(0, 0, 1), 0 * wi.x
        is_delta: Any = False
        below = 0 * wi.x
        for core, chance in zip(self.cores, self.chances, strict=True):
            # One number serves twice: which corner, and what is sampled there.
            own = at_most(at_least((u.x - below) / at_least(chance, 1e-20), 0), 1 - 2.0**-24)
            found, _, energy, delta = core.sample(wi, type(u)(own, u.y, u.z))
            here = u.x >= below
            wo, carried = dr.select(here, found, wo), dr.select(here, energy, carried)
            is_delta = dr.select(here, delta, is_delta)
            below = below + chance
        mirror, straight = 0 * wi.x, 0 * wi.x
        for core, chance in zip(self.cores, self.chances, strict=True):
            one, other = core.delta_chances(wi)
            mirror, straight = mirror + chance * one, straight + chance * other
        probability = dr.select(wi.z * wo.z > 0, mirror, straight)
        return wo, dr.select(is_delta, probability, self.pdf(wi, wo)), carried, is_delta
