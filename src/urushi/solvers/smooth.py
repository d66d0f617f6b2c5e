"""The delta parts of a stack: light that meets nothing but smooth interfaces and is scattered nowhere.

Between parallel smooth interfaces the mirror direction and Snell's direction are the only ones, so the infinite
series of bounces sums exactly, by the adding equations on plain numbers.
"""

from __future__ import annotations

import drjit as dr

from ..adding import Slab, add
from ..media import inverse_cosine
from ..optics.vectors import Array, Vector, at_most, root
from .bound import BoundStack


def has_delta(stack: BoundStack) -> bool:
    """False where no light leaves without being scattered: the outermost interfaces are rough."""
    ends = stack.interfaces[:1] if stack.opaque else [stack.interfaces[0], stack.interfaces[-1]]
    return any(interface.delta is not False for interface in ends)


def cosines(stack: BoundStack, wi: Vector, above: bool) -> list[Array]:
    """The cosine of Snell's direction in every region; 0 where total reflection keeps the light out."""
    outside = stack.indices[0 if above else -1]
    return [snell(wi, outside / index) for index in stack.indices]


def snell(wi: Vector, ratio: Array) -> Array:
    """The cosine of refraction, for the index outside over the index inside; exact at grazing angles, too."""
    return root(dr.fma(dr.square(ratio), dr.square(wi.z), (1 - ratio) * (1 + ratio)))


def smooth_energy(stack: BoundStack, wi: Vector) -> tuple[Array, Array]:
    """Reflectance and transmittance (of flux) of the delta parts, for light from wi on either side."""
    down = _series(stack, cosines(stack, wi, above=True))
    up = down if stack.opaque else _series(stack, cosines(stack, wi, above=False))
    above, below = wi.z > 0, (wi.z < 0) & (not stack.opaque)
    r = dr.select(above, down.r_top, dr.select(below, up.r_bottom, 0))
    t = dr.select(above, down.t_down, dr.select(below, up.t_up, 0))
    return r, t


def straight(stack: BoundStack, wi: Vector) -> Vector:
    """Snell's direction on the far side."""
    if stack.opaque:
        return -wi
    above = wi.z > 0
    ratio = dr.select(above, stack.indices[0] / stack.indices[-1], stack.indices[-1] / stack.indices[0])
    z = snell(wi, ratio)
    return type(wi)(-ratio * wi.x, -ratio * wi.y, dr.select(above, -z, z))


def _series(stack: BoundStack, cos: list[Array]) -> Slab:
    first, *others = layers(stack, cos)
    whole = first
    for slab in others:
        whole = add(whole, slab)
    return whole


def layers(stack: BoundStack, cos: list[Array]) -> list[Slab]:
    """What each interface and each medium does to unscattered light, top down, a medium below its interface.

    Args:
        cos: the cosine in every region (`cosines`).
    """
    found = []
    for k, interface in enumerate(stack.interfaces):
        r_top, t_down = interface.smooth_energy(cos[k], above=True)
        if interface.opaque:
            r_bottom = t_up = 0.0
        else:
            r_bottom, t_up = interface.smooth_energy(cos[k + 1], above=False)
            # Where total reflection keeps light out of the region below, nothing bounces; and rounding must not make
            # anything bounce there for ever.
            r_bottom = dr.select(cos[k + 1] > 0, at_most(r_bottom, 1 - 2e-7), 0)
        medium = stack.media[k]
        if medium is not None:
            passed = medium.transmittance(1.0, inverse_cosine(cos[k]))
            found.append(Slab(0.0, passed, 0.0, passed))
        found.append(Slab(r_top, t_down, r_bottom, t_up))
    return found
