"""A stack with its numbers: what the description becomes before a solver looks at it.

The structure (which interfaces, which media, what is smooth) is fixed in Python, so that a solver's code is unrolled
over it; the numbers are Dr.Jit values, one for all lanes or one for each, and changing them compiles nothing anew.

    region 0        the exterior above
    interfaces[0]
    region 1        media[1] (or None), of index indices[1]
    interfaces[1]
    ...
    region K        the exterior below, unless interfaces[K-1] is opaque
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import drjit as dr

from ..interfaces import INTERFACES, Interface, Null, key
from ..interfaces.given import Given
from ..interfaces.tilted import Tilted
from ..media import MEDIA, BoundMedium
from ..optics.vectors import Array, Vector

#: chance to go on after a turn through the stack that met nothing but smooth interfaces, where light may be trapped
CALM = 1 - 2.0**-6


@dataclass
class BoundStack:
    """See the module docstring. `still` is the same stack with its numbers detached from derivatives, if any are live;
    `unrolled` tells how to differentiate loops (`walk.derivative`).
    """

    interfaces: list[Interface]
    media: list[BoundMedium | None]
    indices: list[Array]
    still: BoundStack | None = None
    unrolled: bool = False

    @property
    def opaque(self) -> bool:
        return self.interfaces[-1].opaque

    @property
    def tilted(self) -> bool:
        """Whether any interface has a normal of its own, so that directions inside are not those of parallel planes."""
        return any(interface.tilted for interface in self.interfaces)

    @property
    def regions(self) -> range:
        """The regions between two interfaces."""
        return range(1, len(self.interfaces))

    def scale(self, wi: Vector, wo: Vector) -> Array:
        """The factor of radiance: (n_wi / n_wo)^2 where wi and wo lie on different sides, else 1."""
        if self.opaque:
            return 1.0
        ratio = dr.square(self.indices[0] / self.indices[-1])
        return dr.select(wi.z * wo.z > 0, 1.0, dr.select(wi.z > 0, ratio, dr.rcp(ratio)))

    @property
    def traps(self) -> bool:
        """True if light may go round and round between smooth interfaces, which only rounding can make it do for ever.

        What gets in by refraction gets out by it, but at grazing angles single precision may see total reflection on
        the way out. Between tilted interfaces it may in truth, or nearly.
        """
        if self.tilted:
            return True
        smooth = [interface.delta is not False for interface in self.interfaces]
        return any(one and other for one, other in pairwise(smooth))


def bind(stack: Any, values: Mapping[str, Array], fixed: Mapping[str, Any]) -> BoundStack:
    """Give the layers of a description their numbers.

    Args:
        stack: the description.
        values: the number of every continuous parameter by name (``layer_0.alpha``, ...): floats, colours, one or
            one per lane; a pair for an anisotropic roughness.
        fixed: those of them that are known in Python and are no texture, tensor or lane value; they decide what is
            smooth, index-matched or free of scattering, which shapes the code that is compiled.
    """
    interfaces: list[Interface] = []
    media: list[BoundMedium | None] = [None]
    indices: list[Array] = [values.get("exterior", stack.exterior)]
    known_index: list[Any] = [stack.exterior]

    def close(interface: Interface, index: Array, known: Any) -> None:
        interfaces.append(interface)
        media.append(None)
        indices.append(index)
        known_index.append(known)

    pending = False  # a medium that no interface has closed yet
    for i, layer in enumerate(stack.layers):
        given = Given(layer, f"layer_{i}", values, fixed, indices[-1], known_index[-1])
        if layer.kind not in MEDIA:
            interface, index, known = INTERFACES[key(layer)].bind(given)
            interface.known_alpha = given.known_alpha()
            normal = values.get(f"layer_{i}.normal")
            if normal is not None and not isinstance(interface, Null):
                first = all(isinstance(other, Null) for other in interfaces)
                last = all(other.kind in MEDIA for other in stack.layers[i + 1 :])
                interface = Tilted(interface, normal, (first, last))
            close(interface, index, known)
            pending = False
            continue
        if pending or not interfaces:
            close(*Null.bind(given))
        media[-1] = MEDIA[layer.kind].bind(given)
        pending = True
    if pending:
        close(Null(), indices[-1], known_index[-1])
    return BoundStack(interfaces, media, indices)
