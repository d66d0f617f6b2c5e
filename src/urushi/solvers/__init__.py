"""Solvers: from a description to a BSDF.

A solver takes a `Stack` and gives a `BSDF` with ``eval``, ``pdf``, ``sample``, ``reflectance`` and ``transmittance``.

    method   what it is                                        error            cost
    walk     position-free Monte Carlo (Guo et al. 2018)       noise, no bias   a few hundred ns a sample
    adding   adding-doubling of matrices (Jakob et al. 2014)   as asked for     seconds once, then microseconds
    lobes    statistical operators (Belcour 2018)              told by compare  that of a few microfacet lobes

``method="auto"`` takes adding where that is done in seconds and the walk elsewhere, and says why in
``diagnostics["auto"]`` (`auto`). A solver is a package beside this file with a function `solve`, and a line in
`SOLVERS`; solvers never import one another.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from urushi.errors import UnsupportedStack, UrushiError, close
from urushi.stack import Stack

from .auto import choose
from .bsdf import BSDF, Sample

#: method -> module with `solve(stack, **options)`, the names of those `OPTIONS`, and `reasons_against(stack)`
SOLVERS = {
    "walk": "urushi.solvers.walk",
    "adding": "urushi.solvers.adding",
    "lobes": "urushi.solvers.lobes",
}

__all__ = ["BSDF", "SOLVERS", "Sample", "add", "choose", "solve"]


def solve(stack: Stack | str | os.PathLike[str], method: str = "auto", **options: Any) -> BSDF:
    """Turn a stack into a BSDF.

    Args:
        stack: the description, or the path or preset name of one.
        method: "walk", "adding", "lobes", or "auto" for the one that suits the stack and the options (`auto`), which
            `diagnostics["auto"]` then names with the reasons.
        **options: see the method. The walk takes `samples`, `seed`, `max_depth`, adding takes `accuracy`, `nodes`,
            `orders`, `media`, `indices`, `progress`, lobes take `published`, `symmetric`, and all `parameters`,
            `backend`, `precision`, `mode`
            (`urushi.solvers.walk.solve`, `urushi.solvers.adding.solve`, `urushi.solvers.lobes.solve`).

    Returns:
        A `BSDF`.

    Raises:
        UnsupportedStack: the method cannot do this stack; says why, and which can.
        UrushiError: an unknown method, or an option out of range.
    """
    if not isinstance(stack, Stack):  # a path, or the name of a preset
        from urushi.io import load

        stack = load(stack)
    if method == "auto":
        known = {option for name in SOLVERS for option in _module(name).OPTIONS}
        for name in options:
            if name not in known:
                _refuse(name, "auto", sorted(known))
        choice = choose(stack, SOLVERS, options)
        found = solve(stack, choice.method, **options)
        found.diagnostics["auto"] = choice.said()
        return found
    if method not in SOLVERS:
        names = [*SOLVERS, "auto"]
        raise UrushiError(f"method: found {method!r}; {close(method, names)}allowed: {', '.join(names)}")
    _check_options(method, options)
    try:
        return _module(method).solve(stack, **options)
    except UnsupportedStack as error:
        if error.alternatives or not _module(method).reasons_against(stack):
            raise  # what the options ask for, the others cannot do either
        able = [name for name in SOLVERS if name != method and not _module(name).reasons_against(stack)]
        raise UnsupportedStack(error.method, error.reasons, able) from None


def add(coat: BSDF, base: BSDF, **options: Any) -> BSDF:
    """A solved coat on a solved base, without solving either anew (method "adding").

    Args:
        coat: the result of a stack that transmits, solved with `indices`.
        base: likewise, of any stack whose exterior is the index at the coat's lower end.
        **options: `backend`, `precision`, `mode`, of the result.

    Returns:
        The BSDF of both (`urushi.solvers.adding.compose.put_on`).

    Raises:
        UrushiError: results of another method or solved without `indices`, an opaque coat, indices or channels that
            do not fit.
    """
    from .adding.compose import put_on

    return put_on(coat, base, **options)  # type: ignore[arg-type]


def _check_options(method: str, options: dict[str, Any]) -> None:
    allowed = _module(method).OPTIONS
    for name in options:
        if name not in allowed:
            _refuse(name, method, allowed)
    given = options.get("parameters")
    if given is not None and not isinstance(given, Mapping):
        raise UrushiError(
            f"parameters: found {given!r:.60}; allowed: a mapping of names such as layer_0.alpha to values"
        )


def _refuse(name: str, method: str, allowed: Sequence[str]) -> NoReturn:
    near = close(name, allowed)
    raise UrushiError(f"unknown option {name!r} of method {method!r}; {near}allowed: {', '.join(allowed)}")


def _module(method: str) -> Any:
    return importlib.import_module(SOLVERS[method])
