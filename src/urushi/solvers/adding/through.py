"""Light that meets one rough interface, seen through smooth ones and media, in closed form on Dr.Jit arrays.

    k = A(wi) k'(wi' -> wo') A(wo) n_o^2 mu_o / (n'_o^2 mu'_o)

with k' what the interface does to Snell's directions on its own sides, and A what smooth interfaces let through and
media leave of light on its way there and back. It is what `direct` is for the outermost interface: from one side the
reflection by the first rough one, and what passes where there is but one. Reflection from within a denser medium has a
kink where total reflection begins, and light straight through a weak interface the narrowest of lobes: no nodes hold
either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr

from ...adding import Slab
from ...media import inverse_cosine
from ...optics.vectors import Array, Vector, at_least, mirror
from ..bound import BoundStack
from ..direct import direct_is_certain
from ..smooth import snell
from .operator import Operator
from .table import SIDES


def met(stack: BoundStack, from_above: bool, to_above: bool) -> int | None:
    """The interface that such light meets; None where there is none, or it is the outermost one and has `direct`."""
    if stack.opaque or not direct_is_certain(stack):
        return None
    last = len(stack.interfaces) - 1
    rough = [k for k, interface in enumerate(stack.interfaces) if interface.delta is not True]
    if not rough or (from_above != to_above and (len(rough) > 1 or last == 0)):
        return None
    found, outermost = (rough[0], 0) if from_above else (rough[-1], last)
    if (from_above == to_above and found == outermost) or stack.interfaces[found].stochastic:
        return None
    return found


def anywhere(stack: BoundStack) -> bool:
    """Whether there is such light on any side."""
    return any(met(stack, *side) is not None for side in SIDES)


@dataclass
class Through:
    """Such light.

    Attributes:
        stack: the stack with its numbers.
        attenuation: by region, factor on the optical depth: what of the medium's extinction the solver saw (delta-M);
            1 where there is none. A number or one per colour.
    """

    stack: BoundStack
    attenuation: dict[int, Array]

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """Flux density from wi to wo, on any sides."""
        value: Array = 0 * wi.x
        for from_above, to_above in SIDES:
            k = met(self.stack, from_above, to_above)
            if k is not None:
                here = ((wi.z > 0) if from_above else (wi.z < 0)) & ((wo.z > 0) if to_above else (wo.z < 0))
                value = dr.select(here, self._part(k, wi, wo, from_above, to_above), value)
        return value

    def _part(self, k: int, wi: Vector, wo: Vector, from_above: bool, to_above: bool) -> Array:
        interface, index = self.stack.interfaces[k], self.stack.indices
        i, left_i = self._inside(k, wi, from_above)
        o, left_o = self._inside(k, wo, to_above)
        ask = interface.reflect if from_above == to_above else interface.transmit
        light = ask(i, o, True)[0] if from_above else ask(mirror(i), mirror(o), False)[0]
        outside, near = (index[0], index[k]) if to_above else (index[-1], index[k + 1])
        both = left_i * left_o
        scale = dr.square(outside / near) * dr.abs(wo.z) / at_least(dr.abs(o.z), 1e-9)
        return dr.select(both > 0, both * (light * scale), 0)

    def _inside(self, k: int, w: Vector, above: bool) -> tuple[Vector, Array]:
        """Snell's direction next to interface k (pointing away), and the share of its light that gets there."""
        stack = self.stack
        regions = list(range(k + 1)) if above else list(range(len(stack.interfaces), k, -1))
        outside = stack.indices[regions[0]]
        cos = [snell(w, outside / stack.indices[region]) for region in regions]
        left: Array = 1 + 0 * w.x
        for step, (region, here) in enumerate(zip(regions, cos, strict=True)):
            if step > 0:
                crossed = stack.interfaces[region - 1 if above else region]
                left = left * crossed.smooth_energy(cos[step - 1], above)[1]
            medium = stack.media[region]
            if medium is not None:
                depth = medium.depth * self.attenuation.get(region, 1.0)
                left = left * dr.exp(-depth * inverse_cosine(here))
        ratio = outside / stack.indices[regions[-1]]
        return type(w)(w.x * ratio, w.y * ratio, cos[-1] if above else -cos[-1]), left


def operator(stack: BoundStack, slabs: Sequence[Slab | None], side: tuple[bool, bool]) -> Operator | None:
    """The same on the nodes.

    Args:
        stack: with its numbers.
        slabs: its layers from the top: interface (None for no interface), medium (where there is one), interface, ...
        side: (from above, to above).

    Returns:
        None where there is no such light.
    """
    k = met(stack, *side)
    if k is None:
        return None
    place = k + sum(medium is not None for medium in stack.media[1 : k + 1])
    rough = slabs[place]
    assert rough is not None
    from_above, to_above = side
    if from_above:
        found: Operator = rough.r_top if to_above else rough.t_down
    else:
        found = rough.t_up if to_above else rough.r_bottom
    upper = [slab for slab in reversed(slabs[:place]) if slab is not None]
    lower = [slab for slab in slabs[place + 1 :] if slab is not None]
    for slab in upper if from_above else lower:
        found = found @ _delta(slab.t_down if from_above else slab.t_up)
    for slab in upper if to_above else lower:
        found = _delta(slab.t_up if to_above else slab.t_down) @ found
    return Operator(found.shape, None, found.dense)


def _delta(operator: Operator) -> Operator:
    return Operator(operator.shape, operator.delta)
