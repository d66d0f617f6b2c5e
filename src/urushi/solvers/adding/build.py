"""The layers of a described stack on a grid, and how fine a grid they ask for."""

from __future__ import annotations

from typing import Any

import numpy as np

from urushi.stack import GradedMedium, Stack

from ...interfaces import Interface, Null
from ...media import MEDIA, BoundGraded
from ..bound import BoundStack, bind
from ..direct import direct_is_certain
from ..numbers import gather_numbers
from . import MOST_ORDERS
from .basis import Grid
from .graded import GradedLayer, mixture
from .interfaces import RoughLayer, same_surface
from .layers import Layer, MediumLayer, SmoothLayer, TurnedOver, numbers
from .media import METHODS, Method
from .mixture import parts
from .phase import MOST_TERMS, Phase, series, terms
from .resolution import plan

#: nodes in a panel for a medium of g = 0.5, and fewest
HALF, FEWEST = 15, 10


def bind_numbers(stack: Stack) -> tuple[BoundStack, int]:
    """The stack in double precision, and its number of channels.

    Raises:
        UnsupportedStack: a parameter is a texture.
    """
    from drjit.llvm import ad

    return _bound(stack, ad)


def solvable(stack: Stack) -> tuple[BoundStack, int]:
    """The same for the solver alone, which compiles code for interfaces only: media have plain numbers."""
    import drjit.scalar
    from drjit.llvm import ad

    return _bound(stack, drjit.scalar if all(layer.kind in MEDIA for layer in stack.layers) else ad)


def _bound(stack: Stack, module: Any) -> tuple[BoundStack, int]:
    given = gather_numbers(stack, None, module, True, "adding")
    return bind(stack, given.values, given.fixed), 3 if given.coloured else 1


def indices(stack: BoundStack) -> list[float]:
    """Index of every region that light gets to."""
    found = [float(numbers(index)[0]) for index in stack.indices]
    return found[:-1] if stack.opaque else found


def counts(
    stack: BoundStack, phases: list[Phase], accuracy: float, complete: bool = False
) -> tuple[list[int], float]:
    """Nodes per panel that should do, and the `squeeze` of the first panel, which a `complete` stack has not."""
    alphas = [
        None if interface.flat else max(float(numbers(a)[0]) for a in interface.roughness())
        for interface in stack.interfaces
    ]
    said = alphas, indices(stack), stack.opaque, accuracy, not complete and direct_is_certain(stack)
    planned, squeeze = plan(*said)
    found = np.array(planned, float)
    for part in (part for phase in phases for part in parts(phase)):
        mean = abs(float(part.moments(2)[1]))
        found = np.maximum(found, max(HALF * (0.5 / max(1 - mean, 0.03)) ** 0.75, FEWEST))
    return [int(np.ceil(n)) for n in found], squeeze


def phase_functions(stack: Stack) -> list[Phase]:
    """The phase functions of the media, from the top."""
    return [
        mixture(layer) if isinstance(layer, GradedMedium) else series(layer.phase)  # type: ignore[attr-defined]
        for layer in stack.layers
        if layer.is_medium
    ]


def layers(
    stack: BoundStack,
    phases: list[Phase],
    grid: Grid,
    tolerance: float,
    complete: bool = False,
    method: Method = METHODS[0],
) -> list[Layer | None]:
    """All layers on the nodes, from the top: interface (None where there is none), medium where there is one, ...

    Unless `complete`, the outermost interface has no more orders than anything that is not evaluated in closed form.
    Media are solved by `method`.
    """
    remaining = list(phases)[::-1]
    # What a medium alone scatters once has a closed form, and what it scatters again has fewer orders.
    lone = (
        not complete
        and all(isinstance(interface, Null) for interface in stack.interfaces)
        and len(phases) == 1
    )
    found: list[Layer | None] = []
    rough: dict[int, Layer] = {}
    for k in reversed(range(len(stack.interfaces))):
        interface, medium = stack.interfaces[k], stack.media[k + 1]
        if medium is not None:
            phase = remaining.pop(0)
            most = terms(phase, tolerance, times=2) if lone else MOST_TERMS
            if isinstance(medium, BoundGraded):
                found.append(GradedLayer(medium, phase, grid, k + 1, 0.01 * tolerance, method))
            else:
                found.append(
                    MediumLayer(medium, phase, grid, k + 1, 0.01 * tolerance, most=most, method=method)
                )
        if isinstance(interface, Null):
            found.append(None)
            continue
        if interface.delta is True:
            found.append(interface_layer(interface, grid, k, tolerance))
            continue
        # What comes back through it from a base that is no mirror has the orders of what is below alone.
        alone = k == 0 and stack.opaque and bool(found) and stack.interfaces[-1].delta is not True
        few = alone and not complete and direct_is_certain(stack)
        most = max(layer.orders for layer in found if layer is not None) if few else MOST_ORDERS
        again = None if few else _met(stack, grid, k, rough)
        # Nodes close together towards the normal are there for lobes, which take all orders.
        every = complete or grid.panels[0].squeeze != 1
        rough[k] = again or interface_layer(interface, grid, k, tolerance, most=most, every=every)
        found.append(rough[k])
    return found[::-1]


def interface_layer(interface: Interface, grid: Grid, k: int, tolerance: float, **options: Any) -> Layer:
    """An interface below region k, with `RoughLayer`'s options if it is rough."""
    if interface.delta is True:
        return SmoothLayer(interface, grid, k)
    return RoughLayer(interface, grid, k, tolerance, **options)


def _met(stack: BoundStack, grid: Grid, k: int, rough: dict[int, Layer]) -> Layer | None:
    """The same interface further down, upright or upside down; None if there is none."""
    sides = grid.indices[k : k + 2]
    for j, layer in rough.items():
        if same_surface(stack.interfaces[k], stack.interfaces[j]):
            if grid.indices[j : j + 2] == sides:
                return layer
            if grid.indices[j : j + 2] == sides[::-1]:
                return TurnedOver(layer)
    return None
