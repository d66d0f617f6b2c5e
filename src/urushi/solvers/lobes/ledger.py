"""The ledger of lobes: what the recursion leaves at every layer.

The recursion puts one layer after another below those before. At each it knows the light that arrives, what the layer
sends up and on, and the layers above as they treat what is sent up. So it loses light in two places: in the layer, and
above it, where the light sent up shares itself out as the adding equations say (`urushi.adding.within`). Summed over
all layers, with what gets out, that is all the light there was.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from ...adding import Slab, within
from ...optics.vectors import Array, Vector, at_least
from ..arrays import mapped
from ..ledger import Ledger, alike, coloured, filed, owners
from .flow import FLOWS, Flow, times
from .medium import Particles
from .recursion import respond
from .returns import Step

if TYPE_CHECKING:
    from .result import LobesBSDF

#: (whether it is a medium, number of the interface or region)
Place = tuple[bool, int]
#: ((reflection, transmission), light that meets them), one or more
Passes = tuple[tuple[tuple[Flow, Flow], Flow], ...]


class Tally:
    """What is left where, as `recursion.respond` goes on.

    Attributes:
        kept: by place, energy that a layer keeps.
        shadowed: by number of the opaque interface, how much of that is lost between facets.
    """

    def __init__(self) -> None:
        self.kept: dict[Place, Array] = {}
        self.shadowed: dict[int, Array] = {}
        self._above: list[Place] = []

    def met(self, number: int, step: Step, passes: Passes, *upward: tuple[list[Slab], Flow]) -> None:
        """The next layer, an interface or the medium of a region.

        Args:
            number: of the interface or region.
            step: the layer.
            passes: its reflection and transmission, and the light on its way down that these are for.
            upward: layers above, the nearest first, and light that this layer sends up into them.
        """
        place = isinstance(step.layer, Particles), number
        for (r, t), down in passes:
            self._keep(place, energy(down) - energy(times(r, down)) - energy(times(t, down)))
        for slabs, light in upward:
            if slabs:
                self._share(slabs, light)
        self._above.append(place)

    def based(self, number: int, passes: Passes, unshadowed: tuple[Array, Array]) -> None:
        """The base: its facets absorb what they do not reflect, and of what they do, only a part gets out.

        Args:
            number: of the interface.
            passes: as for `met`.
            unshadowed: what facets that absorb nothing would reflect, of a beam and of diffuse light.
        """
        beam, even = unshadowed
        kept: Array = 0.0
        for (r, _), down in passes:
            kept = kept + (r.beam + r.spread) * down.beam * (1 / at_least(beam, 1e-9) - 1)
            white = times(Flow(0.0, 0.0, even), down).spread
            kept = kept + times(r._replace(scattered=0.0), down).spread * (
                down.spread / at_least(white, 1e-12) - 1
            )
        self.shadowed[number] = kept

    def _share(self, slabs: list[Slab], light: Flow) -> None:
        """What light that is sent up leaves in the layers above."""
        down, up = within([slab.turned_over() for slab in slabs], light, FLOWS)
        for k, place in enumerate(reversed(self._above)):
            back = energy(up[k + 1]) if k + 1 < len(slabs) else 0.0
            self._keep(place, energy(down[k]) + back - energy(up[k]) - energy(down[k + 1]))

    def _keep(self, place: Place, left: Array) -> None:
        self.kept[place] = self.kept.get(place, 0.0) + left


def energy(light: Flow) -> Array:
    """All of what has become of a beam."""
    return light.beam + light.spread


def followed(bsdf: LobesBSDF, wi: np.ndarray, with_error: bool) -> Ledger:
    """The ledger of a stack solved by lobes, in double precision.

    Args:
        wi: (N, 3) directions, checked.
        with_error: whether to give errors, which are 0: how far an approximation is off is not known here.
    """
    stack = bsdf.stack
    interfaces, media = owners(stack)
    core = bsdf._core(bsdf._module, True)[0]
    keys = [(False, k, layer) for k, layer in enumerate(interfaces) if layer is not None]
    keys += [(True, r, layer) for r, layer in enumerate(media) if layer is not None]

    def run(w: Vector) -> tuple[Array, ...]:
        found = [0 * w.x] * (3 + len(keys))  # reflected, transmitted, shadowed, what each layer keeps
        for above in core.sides:
            tally = Tally()
            if core.energies is None:
                answer = respond(core.stack, w, above, tally=tally)
            else:
                answer = core.answer(w, above)
                tally.kept, shadowed = core.energies.left(w, above, core.spectrum(0))
                tally.shadowed = {len(core.stack.interfaces) - 1: shadowed}
            up = sum((beam.energy for beam in answer.reflected), answer.diffuse)
            through = sum((beam.energy for beam in (answer.through, answer.delayed) if beam is not None), 0.0)
            new = [up, through + answer.beyond, sum(tally.shadowed.values(), 0.0)]
            new += [tally.kept[medium, number] for medium, number, _ in keys]
            near = (w.z > 0) if above else (w.z < 0)
            found = [dr.select(near, a, b) for a, b in zip(new, found, strict=True)]
        return tuple(core.spectrum(value) for value in found)

    values = [coloured(x) for x in mapped(run, (wi,), bsdf._module, True)]
    absorbed, lost = {}, {}
    for (medium, k, layer), kept in zip(keys, values[3:], strict=True):
        if medium:
            absorbed[layer] = kept
        elif core.stack.interfaces[k].opaque:
            absorbed[layer], lost[layer] = kept - values[2], values[2]
        else:
            lost[layer] = kept
    found = filed(stack, wi, (values[0], values[1]), absorbed, lost)
    return replace(found, error=alike(found, 0.0)) if with_error else found
