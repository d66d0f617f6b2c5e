"""Where to send samples: to every lobe as often as it has energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...optics.vectors import Array, Vector, at_least, channels, total
from ..facet_lobe import Lobe


@dataclass
class Mixture:
    """Lobes for one wi; their shares and those of the delta parts sum to 1, or are all 0 where no light goes.

    Attributes:
        lobes: to sample from.
        mirror, straight: probability of the delta parts; None if there are none.
        reflected, transmitted: what these carry.
        onward: direction of the transmitted one.
    """

    lobes: list[Lobe]
    mirror: Array | None = None
    straight: Array | None = None
    reflected: Array = 0.0
    transmitted: Array = 0.0
    onward: Vector | None = None

    @classmethod
    def build(
        cls, wi: Vector, parts: list[tuple[Array, Lobe]], reflected: Any, transmitted: Any, onward: Any
    ) -> Mixture:
        """From lobes and their energies; delta parts may be None."""
        delta = [0 * wi.x if e is None else _mean(e) + 0 * wi.x for e in (reflected, transmitted)]
        whole = delta[0] + delta[1]
        for energy, _ in parts:
            whole = whole + energy
        scale = dr.select(whole > 0, dr.rcp(at_least(whole, 1e-20)), 0)
        for energy, lobe in parts:
            lobe.share = energy * scale
        lobes = [lobe for _, lobe in parts]
        if reflected is None:
            return cls(lobes)
        return cls(lobes, delta[0] * scale, delta[1] * scale, reflected, transmitted, onward)

    def pdf(self, wo: Vector) -> Array:
        """Density per solid angle of everything but the delta parts."""
        density = 0 * wo.x
        for lobe in self.lobes:
            here = wo.z > 0 if lobe.up else wo.z < 0
            density = density + dr.select(here, lobe.share * lobe.pdf(wo), 0)
        return density

    def sample(self, wi: Vector, u: Vector) -> tuple[Vector, Array, Array, Any]:
        """(wo, probability of the delta part chosen, what it carries, mask of delta lanes)."""
        wo, below = type(wi)(0, 0, 0), 0 * wi.x
        for lobe in self.lobes:
            wo = dr.select((u.x >= below) & (lobe.share > 0), lobe.sample(wi, u.y, u.z), wo)
            below = below + lobe.share
        if self.mirror is None or self.straight is None:
            return wo, 0 * wi.x, 0 * wi.x, False
        mirrored = (u.x >= below) & (self.mirror > 0)
        wo = dr.select(mirrored, type(wi)(-wi.x, -wi.y, wi.z), wo)
        onward = (u.x >= below + self.mirror) & (self.straight > 0)
        wo = dr.select(onward, self.onward, wo)
        probability = dr.select(onward, self.straight, dr.select(mirrored, self.mirror, 0))
        carried = dr.select(onward, self.transmitted, dr.select(mirrored, self.reflected, 0))
        return wo, probability, carried, mirrored | onward


def _mean(value: Array) -> Array:
    return total(value) * (1 / max(channels(value), 1))
