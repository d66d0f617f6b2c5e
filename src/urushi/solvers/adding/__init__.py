"""Adding: the deterministic solution, to an accuracy that is asked for.

In a fixed set of directions, what a layer does to light is a matrix, and what two layers do together follows from
their matrices by a geometric series (`urushi.adding`). Azimuths decouple into Fourier orders. So a stack is a product
of small matrices, one for each order, without noise; the art lies in the directions.

    basis      the directions, one set for all media            phase, media     a medium: by its modes, or by doubling
    operator   matrices with their delta part kept apart        ordinates, doubling, riccati
    smooth     smooth interfaces: diagonals                     delta_m, single  sharp phase functions
    columns, balance, interfaces   rough interfaces             layers, solver, refine   the whole stack, fine enough
    stencil, warp, table   between the directions               proposal, core, result   all of it, as a BSDF
    spectrum, channels     any number of channels at once

Sources: Stokes 1862; van de Hulst 1963; Grant & Hunt 1969; Stam 2001; Jakob et al. 2014.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

from urushi import llvm
from urushi.errors import UnsupportedStack, UrushiError, close
from urushi.stack import Stack, Texture

#: what `solve` takes besides the stack
OPTIONS = (
    "accuracy",
    "nodes",
    "orders",
    "media",
    "parameters",
    "backend",
    "precision",
    "mode",
    "progress",
    "indices",
)
#: azimuthal orders that may be asked for, at most
MOST_ORDERS = 1 << 14


def reasons_against(stack: Stack) -> list[str]:
    """What of this stack the adding method cannot do; empty if it can."""
    reasons = []
    for i, layer in enumerate(stack.layers):
        alpha = getattr(layer, "alpha", 0.0)
        if isinstance(alpha, tuple) and alpha[0] != alpha[1]:
            reasons.append(
                f"layers[{i}].alpha is {alpha}, and an anisotropic interface mixes azimuthal orders: use one number"
            )
        if getattr(layer, "normal", None) is not None:
            reasons.append(
                f"layers[{i}].normal is given, and a tilted interface mixes azimuthal orders: leave it out"
            )
        if getattr(layer, "slope_variance", None) is not None:
            reasons.append(
                f"layers[{i}].slope_variance is given, which may differ with the azimuth and mix its orders: use alpha"
            )
    for name, value in stack.parameters().items():
        if isinstance(value, Texture):
            reasons.append(f"{name} is a texture, which has values only at points of a surface")
    return reasons


def solve(
    stack: Stack,
    *,
    accuracy: float = 1e-3,
    nodes: int | Sequence[int] | None = None,
    orders: int | None = None,
    media: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    progress: Any = None,
    indices: Sequence[float] = (),
    **options: Any,
) -> Any:
    """Solve a stack.

    Args:
        stack: the description; isotropic.
        accuracy: absolute error allowed of reflectance and transmittance, and of the BSDF relative to its peak for the
            same angle of incidence; nodes are added until two solutions agree to that.
        nodes: fixed numbers of nodes per panel instead, one for all or one for each different index; `diagnostics`
            then tells the error they leave.
        orders: fixed number of azimuthal orders instead, 1 to 16384: 1 leaves of all that has no closed form the mean
            over the azimuth. Energies need no more than that. `diagnostics["left_out"]` is the error it makes.
        media: how media are solved, all to the same result: "ordinates" (None: their modes), "doubling", or "riccati"
            (the continuous adding equation, which goes through them in steps; slow).
        parameters: values in place of those of the description, by name (``layer_0.alpha``): numbers, colours, or any
            number C of channels: (C,) values for albedo, depth, eta and so on, which then give values (N, C).
        progress: called with (nodes, error) after each refinement.
        indices: for a result to be put on or under another by `add`: indices of refraction that the nodes are to know
            besides those of the stack, 1 to 5 (one of its own will do). Results with the same indices and `nodes` have
            the same nodes, and add up without error.
        **options: `backend`, `precision`, `mode`: see `urushi.solvers.adding.result.AddingBSDF`.

    Returns:
        An `AddingBSDF`, or with other channels than 1 or 3 a `ChannelsBSDF`. Its `diagnostics` hold "nodes", "orders",
        "estimated_error", "accuracy", "seconds" and "history".

    Raises:
        UnsupportedStack: with the reasons; textures are for the Mitsuba plugin.
        UrushiError: an option out of range, or an accuracy that cannot be reached.
    """
    if not _within(accuracy, 1e-9, 0.5):
        raise UrushiError(f"accuracy: found {accuracy!r}; allowed: a number from 1e-9 to 0.5")
    if not (np.iterable(indices) and all(_within(n, 1, 5) for n in indices)):
        raise UrushiError(f"indices: found {indices!r}; allowed: numbers from 1 to 5, such as (1, 1.5)")
    check_orders(orders)
    method = media_method(media)
    if "drjit" not in sys.modules:
        llvm.prepare()  # before Dr.Jit takes the first LLVM it finds
    from .channels import ChannelsBSDF
    from .result import AddingBSDF
    from .spectrum import Spectrum
    from .whole import solution

    spectrum = Spectrum.of(stack, parameters)
    for own in spectrum.stacks:
        reasons = reasons_against(own)
        if reasons:
            raise UnsupportedStack("adding", reasons)
    found = solution(spectrum, float(accuracy), nodes, progress, tuple(indices), orders=orders, media=method)
    if spectrum.channels is None:
        return AddingBSDF(spectrum.stacks[0], found, **options)
    return ChannelsBSDF(spectrum, found, **options)


def _within(value: Any, low: float, high: float) -> bool:
    return isinstance(value, Real) and low <= float(value) <= high


def check_orders(orders: Any) -> None:
    """Refuse what is no number of azimuthal orders."""
    if orders is None:
        return
    whole = isinstance(orders, Integral) and not isinstance(orders, bool)
    if not whole or not 1 <= orders <= MOST_ORDERS:
        raise UrushiError(f"orders: found {orders!r}; allowed: a whole number from 1 to {MOST_ORDERS}")


def media_method(name: Any) -> Any:
    """The name of a solution for media; the usual one for None."""
    from .media import METHODS

    if name is None:
        return METHODS[0]
    if name not in METHODS:
        raise UrushiError(f"media: found {name!r}; {close(name, METHODS)}allowed: {', '.join(METHODS)}")
    return name
