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

from ..interfaces import BoundConductor, BoundDielectric, BoundDiffuse, Interface, Null
from ..interfaces.base import Frame
from ..media import BoundMedium
from ..optics.microfacet import Microfacets
from ..optics.phase import PHASE_FUNCTIONS
from ..optics.vectors import Array, at_least

#: index ratios nearer to 1 than this are index-matched: single precision cannot resolve their refraction
MATCHED = 1e-4

#: chance to go on after a turn through the stack that met nothing but smooth interfaces, where light may be trapped
CALM = 1 - 2.0**-6

#: the smallest roughness that is allowed
SMALLEST = 1e-4

#: mean cosines up to which a phase function counts as flat: nowhere more than 6 times its mean
FLAT = 0.5


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
    def regions(self) -> range:
        """The regions between two interfaces."""
        return range(1, len(self.interfaces))

    @property
    def traps(self) -> bool:
        """True if light may go round and round between smooth interfaces, which only rounding can make it do for ever.

        What gets in by refraction gets out by it, but at grazing angles single precision may see total reflection on
        the way out.
        """
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
        name = f"layer_{i}"
        above, known_above = indices[-1], known_index[-1]
        if layer.kind == "medium":
            if pending or not interfaces:
                close(Null(), above, known_above)
            media[-1] = _medium(layer, name, values, fixed)
            pending = True
            continue
        pending = False
        if layer.kind == "dielectric":
            index, known = values[f"{name}.ior"], fixed.get(f"{name}.ior")
            matched = None not in (known, known_above) and abs(known / known_above - 1) < MATCHED
            close(
                Null()
                if matched
                else _dielectric(layer, name, values, fixed, above, None not in (known, known_above)),
                index,
                known,
            )
        elif layer.kind == "conductor":
            close(_conductor(layer, name, values, fixed, above), above, known_above)
        else:
            close(BoundDiffuse(values[f"{name}.reflectance"]), above, known_above)
    if pending:
        close(Null(), indices[-1], known_index[-1])
    return BoundStack(interfaces, media, indices)


def _roughness(
    layer: Any, name: str, values: Mapping[str, Array], fixed: Mapping[str, Any]
) -> tuple[Any, Any]:
    """Microfacets (None when smooth everywhere) and the mask of smooth lanes (True/False where certain)."""
    alpha, known = values[f"{name}.alpha"], fixed.get(f"{name}.alpha")
    x, y = alpha if isinstance(alpha, (tuple, list)) else (alpha, alpha)
    if known is not None:
        delta: Any = max(known if isinstance(known, tuple) else (known,)) == 0
    else:
        delta = (x <= 0) & (y <= 0)
    if delta is True:
        return None, True
    if known is None:  # smooth lanes take the mask, and need numbers that divide
        x, y = at_least(x, SMALLEST), at_least(y, SMALLEST)
    return Microfacets(x, y, layer.distribution, layer.masking), delta


def _dielectric(
    layer: Any, name: str, values: Mapping[str, Array], fixed: Mapping[str, Any], above: Array, differs: bool
) -> Interface:
    """A boundary; `differs` where its two indices are known not to be the same on any lane."""
    facets, delta = _roughness(layer, name, values, fixed)
    eta = values[f"{name}.ior"] / above
    if delta is not True and not differs:
        matched = dr.abs(eta - 1) < MATCHED
        delta = matched if delta is False else delta | matched
    if delta is True:
        facets = None
    return BoundDielectric(eta, facets, delta, _frame(layer, name, values, fixed))


def _conductor(
    layer: Any, name: str, values: Mapping[str, Array], fixed: Mapping[str, Any], above: Array
) -> Interface:
    facets, delta = _roughness(layer, name, values, fixed)
    frame = _frame(layer, name, values, fixed)
    return BoundConductor(values[f"{name}.eta"], values[f"{name}.k"], above, facets, delta, frame)


def _frame(layer: Any, name: str, values: Mapping[str, Array], fixed: Mapping[str, Any]) -> Frame:
    """The rotation, unless the roughness is known to be the same in all directions."""
    isotropic = not isinstance(values[f"{name}.alpha"], (tuple, list))
    known = fixed.get(f"{name}.rotation")
    return Frame(0.0 if isotropic or known == 0 else values[f"{name}.rotation"])


def _medium(layer: Any, name: str, values: Mapping[str, Array], fixed: Mapping[str, Any]) -> BoundMedium:
    phase = PHASE_FUNCTIONS[layer.phase.kind]
    arguments = {key.rsplit(".", 1)[1]: values[key] for key in values if key.startswith(f"{name}.phase.")}
    depth = values.get(f"{name}.depth")
    if depth is None:
        depth = values[f"{name}.thickness"] * values[f"{name}.sigma_t"]
    known = fixed.get(f"{name}.albedo")
    black = known is not None and max(known if isinstance(known, tuple) else (known,)) == 0
    bound = phase(**arguments)
    g = fixed.get(f"{name}.phase.g")
    bound.flat = bound.flat or (g is not None and abs(g) <= FLAT)
    return BoundMedium(depth, values[f"{name}.albedo"], bound, scatters=not black)
