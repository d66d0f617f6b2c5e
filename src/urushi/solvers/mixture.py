"""Where to send samples: to every lobe as often as it has energy, a mixture whose density is known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..interfaces.base import Frame
from ..optics.microfacet import Microfacets
from ..optics.vectors import Array, Vector, at_least, mean
from .facet_lobe import Lobe


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
        delta = [0 * wi.x if e is None else mean(e) + 0 * wi.x for e in (reflected, transmitted)]
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
        chosen, below = Chosen(wi), 0 * wi.x
        for lobe in self.lobes:
            chosen.offer(lobe, (u.x >= below) & (lobe.share > 0))
            below = below + lobe.share
        wo = chosen.sample(wi, u.y, u.z)
        if self.mirror is None or self.straight is None:
            return wo, 0 * wi.x, 0 * wi.x, False
        reflected = (u.x >= below) & (self.mirror > 0)
        wo = dr.select(reflected, mirrored(wi), wo)
        onward = (u.x >= below + self.mirror) & (self.straight > 0)
        wo = dr.select(onward, self.onward, wo)
        probability = dr.select(onward, self.straight, dr.select(reflected, self.mirror, 0))
        carried = dr.select(onward, self.transmitted, dr.select(reflected, self.reflected, 0))
        return wo, probability, carried, reflected | onward


class Chosen:
    """The lobe that a lane has chosen, so that one direction is sampled, not one of every lobe.

    Args:
        wi: a direction.
    """

    def __init__(self, wi: Vector) -> None:
        self._any: Any = False
        self._up: Any = False
        self._even: Any = False
        self._axis: Vector | None = None
        self._alphas: tuple[Array, Array] = (0.0, 0.0)
        self._turn: tuple[Array, Array] = (0 * wi.x, 1 + 0 * wi.x)
        self._turned = False

    def offer(self, lobe: Lobe, mask: Any) -> None:
        """Another lobe; lanes in the mask choose it instead of any before."""
        self._any = self._any | mask
        self._up = dr.select(mask, lobe.up, self._up)
        self._even = dr.select(mask, lobe.facets is None, self._even)
        if lobe.facets is None or lobe.axis is None or lobe.frame is None:
            return
        alphas = lobe.facets.alpha_x, lobe.facets.alpha_y
        turn = (lobe.frame.sin, lobe.frame.cos) if lobe.frame.turned else (0.0, 1.0)
        self._turned = self._turned or lobe.frame.turned
        # A lane's own, of the first one too: a sum with 0 or a product with 1 is the variable of the interface itself.
        sin, cos = (dr.select(mask, new, old) for new, old in zip(turn, self._turn, strict=True))
        self._turn = sin, cos
        if self._axis is None:
            self._axis, self._alphas = lobe.axis, alphas
            return
        self._axis = dr.select(mask, lobe.axis, self._axis)
        x, y = (dr.select(mask, new, old) for new, old in zip(alphas, self._alphas, strict=True))
        self._alphas = x, y

    def sample(self, wi: Vector, u1: Array, u2: Array) -> Vector:
        """A direction; the mirror direction, which then has density 0, where nothing was chosen."""
        o = Lobe(0.0, True).sample(wi, u1, u2)
        if self._axis is not None:
            frame = Frame(0.0)
            frame.turned = self._turned
            frame.sin, frame.cos = self._turn
            facets = Microfacets(*self._alphas, "ggx", "separable")
            o = dr.select(self._even, o, Lobe(0.0, True, self._axis, facets, frame).sample(wi, u1, u2))
        return dr.select(self._any, type(wi)(o.x, o.y, dr.select(self._up, o.z, -o.z)), mirrored(wi))


def mirrored(wi: Vector) -> Vector:
    """The mirror direction, on the side of wi."""
    return type(wi)(-wi.x, -wi.y, wi.z)
