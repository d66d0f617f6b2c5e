"""Light that meets the outermost interface and nothing else: in closed form wherever the interface is."""

from __future__ import annotations

import drjit as dr

from ..optics.random import Generator
from ..optics.vectors import Array, Vector, mirror
from .bound import BoundStack


def direct(stack: BoundStack, wi: Vector, wo: Vector, rng: Generator | None = None) -> Array:
    """Flux density of the light that meets one interface only; no randomness in it, unless in the interface itself."""
    top, bottom = stack.interfaces[0], stack.interfaces[-1]
    value = dr.select((wi.z > 0) & (wo.z > 0), top.reflect(wi, wo, above=True, rng=rng)[0], 0)
    if stack.opaque:
        return value
    wi_low, wo_low = mirror(wi), mirror(wo)
    value = dr.select((wi.z < 0) & (wo.z < 0), bottom.reflect(wi_low, wo_low, above=False, rng=rng)[0], value)
    if len(stack.interfaces) == 1:
        value = dr.select((wi.z > 0) & (wo.z < 0), top.transmit(wi, wo, above=True, rng=rng)[0], value)
        value = dr.select(
            (wi.z < 0) & (wo.z > 0), top.transmit(wi_low, wo_low, above=False, rng=rng)[0], value
        )
    return value


def direct_is_certain(stack: BoundStack) -> bool:
    """Whether `direct` needs no random numbers."""
    return not (stack.interfaces[0].stochastic or stack.interfaces[-1].stochastic)
