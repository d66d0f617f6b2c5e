"""Light scattered exactly once in the medium next to a smooth or absent interface, in closed form on Dr.Jit arrays.

    k_R = a p mu_o / (mu_i + mu_o) (1 - exp(-tau (1/mu_i + 1/mu_o)))
    k_T = a p tau / mu_i exp(-tau / mu_max) (1 - exp(-x)) / x,       x = tau (1/mu_min - 1/mu_max)

inside (Chandrasekhar 1950; `single` is the same on the nodes), and both ways through the interface by Fresnel. It holds
the peak of the phase function and what is not smooth where both directions graze. Of a medium whose albedo a varies
with depth it is taken with the mean albedo: nearly all of that light, and what is left has no peak to speak of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from ...media import BoundMedium, inverse_cosine
from ...optics.vectors import Array, Vector, at_least, at_most, channels
from ..bound import BoundStack
from ..smooth import snell
from .peak import Peak, forward
from .phase import Phase
from .retro import Retro, backward
from .stencil import Lookup


def covers(stack: BoundStack, from_above: bool, to_above: bool) -> bool:
    """Whether there is such light: the interfaces it crosses are smooth, and it meets one medium, which scatters."""
    if from_above != to_above and len(stack.interfaces) != 2:
        return False
    for above in {from_above, to_above}:
        interface, medium = _outer(stack, above)
        if interface.opaque or interface.delta is not True or medium is None or not medium.scatters:
            return False
    return True


@dataclass
class Once:
    """Such light.

    Attributes:
        stack: the stack with its numbers.
        attenuation: by region, factor on the optical depth: what of the medium's extinction the solver saw (delta-M);
            1 where there is none. A number or one per colour.
        peaks: by region, what is scattered again within a peak, and its values in the module and precision of the
            directions; nothing where a region is missing.
    """

    stack: BoundStack
    attenuation: dict[int, Array]
    peaks: Mapping[int, tuple[Peak | Retro, Lookup]] = field(default_factory=dict)

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """Flux density from wi to wo, on any sides."""
        value: Array = 0 * wi.x
        sides = (True,) if self.stack.opaque else (True, False)
        for from_above in sides:
            for to_above in sides:
                if covers(self.stack, from_above, to_above):
                    here = ((wi.z > 0) if from_above else (wi.z < 0)) & (
                        (wo.z > 0) if to_above else (wo.z < 0)
                    )
                    value = dr.select(here, self._part(wi, wo, from_above, to_above), value)
        return value

    def _part(self, wi: Vector, wo: Vector, from_above: bool, to_above: bool) -> Array:
        _, medium = _outer(self.stack, from_above)
        assert medium is not None
        i, t_i = self._inside(wi, from_above)
        o, t_o = self._inside(wo, to_above)
        region = 1 if from_above else len(self.stack.interfaces) - 1
        left = self.attenuation.get(region, 1.0)
        peak, table = self.peaks.get(region, (None, None))
        depth, albedo = medium.depth * left, medium.albedo * (1 / left)
        mu_i, mu_o = at_least(dr.abs(i.z), 1e-9), at_least(dr.abs(o.z), 1e-9)
        away, toward = dr.squared_norm(i + o), dr.squared_norm(i - o)
        t = depth * (0.5 * (mu_i + mu_o) / (mu_i * mu_o))
        scattered, more = albedo * medium.phase.eval(-i, o), 0.0 * t
        if from_above == to_above:
            # 1 - exp(-x) = x faded(x)
            inv = inverse_cosine(i.z) + inverse_cosine(o.z)
            share = (depth * inv) * faded(depth * inv) / (mu_i + mu_o)
            if isinstance(peak, Retro) and table is not None:
                more = peak.back(toward, away, t, albedo, table)
        else:
            low, high = at_most(mu_i, mu_o), at_least(mu_i, mu_o)
            x = depth * ((high - low) / (low * high))
            share = dr.exp(-depth / high) * faded(x) * depth / (low * high)
            if isinstance(peak, Retro) and table is not None:
                more = peak.on(away, toward, t, albedo, table)
            elif isinstance(peak, Peak) and table is not None:
                once, mean = medium.phase.eval(-i, o), depth * (2 / (mu_i + mu_o))
                scattered = albedo * peak.scattered(once, away, toward, albedo * t, albedo * mean, table)
        index = self.stack.indices
        near, outside = (index[1], index[0]) if to_above else (index[-2], index[-1])
        # mu_o inside cancels against the solid angle outside over that inside.
        whole = scattered * share + more * (2 / (mu_i + mu_o))
        return whole * (t_i * t_o * dr.square(outside / near) * dr.abs(wo.z))

    def _inside(self, w: Vector, above: bool) -> tuple[Vector, Array]:
        """The direction behind the interface on the same side (pointing away), and what it lets through."""
        interface, _ = _outer(self.stack, above)
        index = self.stack.indices
        ratio = index[0] / index[1] if above else index[-1] / index[-2]
        cos = snell(w, ratio)
        through = interface.smooth_energy(dr.abs(w.z), above)[1]
        return type(w)(w.x * ratio, w.y * ratio, cos if above else -cos), through


def faded(x: Array) -> Array:
    """(1 - exp(-x)) / x for x >= 0, to all digits."""
    if channels(x):
        return type(x)(*(faded(c) for c in x))
    half = dr.tanh(0.5 * x)
    # 1 - exp(-x) = 2 t / (1 + t) with t = tanh(x / 2), which loses nothing
    whole = 2 * half / ((1 + half) * at_least(x, 1e-20))
    return dr.select(x > 1e-10, whole, 1 - 0.5 * x)


def _outer(stack: BoundStack, above: bool) -> tuple[Any, BoundMedium | None]:
    """The outermost interface of a side and the medium behind it."""
    last = len(stack.interfaces) - 1
    if last == 0:
        return stack.interfaces[0], None
    return (stack.interfaces[0], stack.media[1]) if above else (stack.interfaces[-1], stack.media[last])


def peaks(stack: BoundStack, phases: Sequence[Phase], terms: dict[int, int]) -> dict[int, Peak | Retro]:
    """What `Solution.peaks` is, of the phase functions of all media and the number of terms taken of them."""
    found: dict[int, Peak | Retro] = {}
    last = len(stack.interfaces) - 1
    for above, region, phase in ((True, 1, phases[:1]), (False, last, phases[-1:])):
        count = terms.get(region)
        if count is None or region in found or not covers(stack, above, above):
            continue
        retro = backward(phase[0], count)
        peak = forward(phase[0], count) if not stack.opaque and covers(stack, True, False) else None
        if retro or peak:
            found[region] = retro or peak  # type: ignore[assignment]
    return found


def attenuation(stack: BoundStack, forward: dict[int, float]) -> dict[int, Array]:
    """1 - a f by region, with f the share of the scattered light that the solver counts as not scattered (delta-M)."""
    found = {}
    for region, share in forward.items():
        medium = stack.media[region]
        if medium is not None and np.any(share):
            found[region] = 1 - medium.albedo * share
    return found
