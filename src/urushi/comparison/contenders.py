"""Contenders: BSDFs that are no method of Urushi's, given as they are, or by the name of a Mitsuba plugin.

A bare name gets its parameters from the stack: what has the same meaning is taken over, and the colour is the one that
reflects as much as the reference at normal incidence. What came out is said in the report.

    diffuse         reflectance
    plastic, roughplastic   the coat's index and alpha, diffuse_reflectance, nonlinear
    roughconductor  the base's alpha, or the coat's where there is no metal; specular_reflectance
    principled      metallic for a metal (base_color, roughness, and a clearcoat for the coat); else roughness and eta
                    of the coat; spec_trans for what transmits
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from urushi.adapters.answer import answer, is_answer
from urushi.errors import UrushiError
from urushi.solvers import BSDF
from urushi.stack import Stack

#: steps of the search for a colour
STEPS = 8
UP = np.array([[0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Contender:
    """A BSDF with its name in the report, what it was made from, and what that takes on disk (None if unknown)."""

    name: str
    bsdf: BSDF
    said: str
    bytes: int | None


def named(given: Any) -> bool:
    """Whether it is the name of a plugin whose parameters come from the stack."""
    return isinstance(given, str) and given in FITTED


def from_stack(plugin: str, stack: Stack, reference: BSDF) -> Contender:
    """A plugin of `FITTED` with parameters for a stack; its colour is that of the solved stack `reference`."""
    description = fitted(plugin, stack, reference.reflectance(UP)[0])
    text = json.dumps(description)
    return Contender(plugin, answer(description), f"parameters from the stack: {text}", len(text))


def contender(given: Any) -> Contender:
    """What was given, as a BSDF: anything that `urushi.adapters.answer.answer` takes.

    Raises:
        UrushiError: nothing that it takes, or other channels than a colour's.
    """
    if isinstance(given, str) and not is_answer(given) and not Path(given).suffix:
        raise UrushiError(
            f"contender: found {given!r}; allowed: {', '.join(FITTED)}, a Mitsuba BSDF as JSON, or a file"
        )
    from urushi.solvers.adding.channels import ChannelsBSDF

    bsdf = answer(given)
    if isinstance(bsdf, ChannelsBSDF):
        raise UrushiError(f"contender: found {bsdf.channels} channels; allowed: one or three")
    if isinstance(given, dict) or (isinstance(given, str) and given.lstrip().startswith("{")):
        text = given if isinstance(given, str) else json.dumps(given, default=str)
        return Contender(_named(bsdf), bsdf, text, len(text))
    if isinstance(given, (str, os.PathLike)):
        path = Path(given)
        return Contender(path.name, bsdf, path.name, path.stat().st_size)
    return Contender(_named(bsdf), bsdf, "an instance", None)


def _named(bsdf: BSDF) -> str:
    return str(getattr(bsdf.stack, "name", "") or bsdf.diagnostics.get("method", "") or type(bsdf).__name__)


def fitted(plugin: str, stack: Stack, colour: np.ndarray) -> dict[str, Any]:
    """Parameters of a plugin for a stack.

    Args:
        plugin: one of `FITTED`.
        stack: without textures.
        colour: (3,) reflectance at normal incidence to match.
    """
    make = FITTED[plugin]
    found = np.clip(colour, 0.0, 1.0)
    best, least = found, np.inf
    for _ in range(STEPS):
        description = make(stack, [round(float(c), 6) for c in found])
        off = colour - answer(description).reflectance(UP)[0]
        if np.abs(off).max() < least:
            best, least = found, float(np.abs(off).max())
        if least < 1e-3:
            break
        found = np.clip(found + off, 0.0, 1.0)
    return make(stack, [round(float(c), 6) for c in best])


def _coat(stack: Stack) -> Any:
    return next((layer for layer in stack.layers if layer.kind == "dielectric"), None)


def _alpha(layer: Any) -> float:
    """One roughness for a layer; brushed ones get the one of equal area."""
    alpha = getattr(layer, "alpha", 0.0)
    return float(np.sqrt(alpha[0] * alpha[1])) if isinstance(alpha, tuple) else float(alpha)


def _diffuse(stack: Stack, colour: list[float]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": colour}


def _plastic(stack: Stack, colour: list[float]) -> dict[str, Any]:
    coat = _coat(stack)
    alpha = _alpha(coat)
    found: dict[str, Any] = {"type": "roughplastic" if alpha > 0 else "plastic", "nonlinear": True}
    found |= {"int_ior": _relative(stack, coat), "ext_ior": 1.0, "diffuse_reflectance": colour}
    return found | ({"alpha": max(alpha, 0.01), "distribution": _distribution(coat)} if alpha > 0 else {})


def _conductor(stack: Stack, colour: list[float]) -> dict[str, Any]:
    base = stack.layers[-1]
    metal = base if base.kind == "conductor" else _coat(stack)
    found: dict[str, Any] = {"type": "roughconductor", "material": "none", "specular_reflectance": colour}
    return found | {"alpha": max(_alpha(metal), 1e-3), "distribution": _distribution(metal)}


def _principled(stack: Stack, colour: list[float]) -> dict[str, Any]:
    coat, base = _coat(stack), stack.layers[-1]
    found: dict[str, Any] = {"type": "principled", "base_color": colour}
    if base.kind == "conductor":
        found |= {"metallic": 1.0, "roughness": round(max(_alpha(base), 1e-3) ** 0.5, 6)}
        if coat is not None:
            gloss = (0.1 - _alpha(coat)) / 0.099  # Mitsuba: alpha of the clearcoat is 0.1 to 0.001
            found |= {"clearcoat": 1.0, "clearcoat_gloss": round(float(np.clip(gloss, 0, 1)), 6)}
        return found
    found["roughness"] = round(max(_alpha(coat), 1e-3) ** 0.5, 6) if coat is not None else 1.0
    if coat is not None:
        found["eta"] = max(_relative(stack, coat), 1.001)
    return found | ({} if base.opaque else {"spec_trans": 1.0})


def _relative(stack: Stack, coat: Any) -> float:
    return round(float(coat.ior) / stack.exterior, 6) if coat is not None else 1.5


def _distribution(layer: Any) -> str:
    return str(getattr(layer, "distribution", "ggx"))


#: plugin -> its description, of a stack and a colour
FITTED: dict[str, Callable[[Stack, list[float]], dict[str, Any]]] = {
    "diffuse": _diffuse,
    "plastic": _plastic,
    "roughplastic": _plastic,
    "roughconductor": _conductor,
    "principled": _principled,
}
