"""``method="auto"``: which method, and why, from the description and the options alone.

The first of these that says something decides:

    an option that only one method has, such as `samples`           that method
    adding cannot do the stack, or the walk cannot                  the other
    a parameter that is one per evaluation, or a Dr.Jit array       walk: adding solves one stack, without derivatives
    an interface with multiple_scattering="walk"                    walk: adding would hold its noise for the truth
    more than `MOST_INTERFACES`, or lobes narrower than `NARROWEST` walk: adding would take minutes to solve it
    else                                                            adding: no noise, and exact energies

Lobes are an approximation whose error nothing knows beforehand: they are taken where neither of the others can.
The limits are measured: within them every preset is solved in seconds, beyond them in up to minutes.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from urushi.errors import MaterialError, UnsupportedStack
from urushi.stack import Stack, Texture

from .adding.resolution import narrowest

#: interfaces, the base included, of a stack that adding solves in seconds
MOST_INTERFACES = 4
#: half-width, in radians, of the narrowest lobe that adding has nodes for within seconds
NARROWEST = 0.03


@dataclass(frozen=True)
class Choice:
    """A method and the reasons.

    Attributes:
        method: the one to take.
        why: a sentence.
        ruled_out: reasons against each method that was not taken for a reason.
    """

    method: str
    why: str
    ruled_out: dict[str, tuple[str, ...]]

    def said(self) -> dict[str, Any]:
        """As `diagnostics["auto"]` holds it."""
        return {"method": self.method, "why": self.why, "ruled_out": dict(self.ruled_out)}


def choose(stack: Stack, solvers: Mapping[str, str], options: Mapping[str, Any] | None = None) -> Choice:
    """The method for a stack.

    Args:
        stack: the description.
        solvers: method -> module, as `urushi.solvers.SOLVERS`.
        options: those that the solver will get.

    Raises:
        UnsupportedStack: no method can do this stack with these options.
    """
    given = dict(options or {})
    modules = {name: importlib.import_module(path) for name, path in solvers.items()}
    known = {option for module in modules.values() for option in module.OPTIONS}
    asked = [name for name in given if name in known]
    lanes = _lanes(given.get("parameters") or {})
    plain = _with(stack, {} if lanes else given.get("parameters") or {})
    out: dict[str, tuple[str, ...]] = {}
    for name, module in modules.items():
        missing = [option for option in asked if option not in module.OPTIONS]
        reasons = [f"it has no option {option!r}" for option in missing]
        reasons += module.reasons_against(stack if lanes else plain)
        if reasons:
            out[name] = tuple(reasons)
    able = [name for name in modules if name not in out]
    if not able:
        raise UnsupportedStack("auto", [f"{name}: {reason}" for name, all_ in out.items() for reason in all_])
    if "adding" in able and "walk" in able and (slow := [*lanes, *_against(plain)]):
        out["adding"] = tuple(slow)
        able.remove("adding")
    method = next(name for name in ("adding", "walk", "lobes") if name in able)
    if "lobes" in able and method != "lobes":
        out["lobes"] = ("an approximation whose error is not known beforehand",)
        able.remove("lobes")
    return Choice(method, _why(method, out, able), out)


def _why(method: str, out: Mapping[str, tuple[str, ...]], able: list[str]) -> str:
    if method == "adding":
        return (
            "adding: the stack is isotropic and small enough to be solved in seconds, once and for all, "
            "without noise and with exact energies"
            if "walk" in able
            else f"adding: the walk is ruled out ({out['walk'][0]})"
        )
    if method == "walk":
        return f"walk: adding is ruled out ({out['adding'][0]}), and the walk is unbiased for any stack"
    return f"lobes: adding and the walk are ruled out ({out['adding'][0]}; {out['walk'][0]})"


def _lanes(parameters: Mapping[str, Any]) -> list[str]:
    """What speaks against adding in the values given for parameters."""
    found = []
    for name, value in parameters.items():
        if type(value).__module__.startswith(("drjit", "mitsuba")):
            found.append(f"{name} is a Dr.Jit array, whose derivatives adding does not follow")
        elif np.ndim(value) > 1 or (np.ndim(value) == 1 and len(value) > 4):
            found.append(f"{name} is given one per evaluation, and adding solves one stack")
    return found


def _with(stack: Stack, parameters: Mapping[str, Any]) -> Stack:
    """The stack with those values, as far as a description can hold them (channels it cannot)."""
    try:
        return stack.replace({name: _value(value) for name, value in parameters.items()})
    except MaterialError:
        return stack  # the solver knows more (many channels, a metal's eta), or says what is wrong


def _value(value: Any) -> Any:
    return tuple(np.ravel(value).tolist()) if np.ndim(value) else value


def _against(stack: Stack) -> list[str]:
    """What makes adding slow or doubtful on a stack that it can do."""
    alphas: list[float | None] = []
    indices = [stack.exterior]
    reasons = []
    for i, layer in enumerate(stack.layers):
        if layer.is_medium:
            continue
        if getattr(layer, "multiple_scattering", False) == "walk":
            reasons.append(f"layers[{i}] has multiple_scattering='walk', whose noise adding would keep")
        alpha = None if layer.kind == "diffuse" else getattr(layer, "alpha", 0.0)
        alphas.append(
            None if isinstance(alpha, Texture) else float(np.max(alpha)) if alpha is not None else None
        )
        if layer.kind == "dielectric" and isinstance(layer.ior, (int, float)):  # type: ignore[attr-defined]
            indices.append(float(layer.ior))  # type: ignore[attr-defined]
    if len(alphas) > MOST_INTERFACES:
        reasons.append(f"{len(alphas)} interfaces take adding minutes (allowed here: {MOST_INTERFACES})")
    opaque = bool(stack.layers[-1].opaque)
    if len(indices) == len(alphas) + (not opaque):
        width = narrowest(alphas, indices, opaque)
        if width is not None and width < NARROWEST:
            reasons.append(
                f"the narrowest lobe inside is {width:.2g} wide, which takes adding minutes (allowed here: {NARROWEST})"
            )
    return reasons
