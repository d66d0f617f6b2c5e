"""What a figure is about: materials as they were given, solved, each with the name it goes by in the legend."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from urushi.errors import UrushiError
from urushi.solvers import BSDF, solve
from urushi.stack import Stack

from .style import LINES

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear sRGB (Rec. 709)."""
CHANNELS = ("luminance", "red", "green", "blue")

Material = Any
"""A `Stack`, a path or ``preset:NAME``, or a solved `BSDF`."""


@dataclass(frozen=True)
class Subject:
    """A solved material and its name in the legend."""

    bsdf: BSDF
    label: str

    @property
    def transmits(self) -> bool:
        """Whether light can leave on the far side."""
        stack = getattr(self.bsdf, "stack", None)
        if stack is not None:
            return not stack.layers[-1].opaque
        return bool(np.max(self.bsdf.transmittance(np.array([[0.0, 0.0, 1.0]]))) > 0)


@dataclass(frozen=True)
class Arrow:
    """A delta part: where it goes, and what it carries.

    Attributes:
        direction: (3,) unit vector.
        energy: (C,) fraction of the incident flux.
    """

    direction: np.ndarray
    energy: np.ndarray


def stacks(materials: Any) -> list[tuple[Stack, str]]:
    """The materials as descriptions, each with its name; a solved one gives what was solved.

    Raises:
        UrushiError: nothing to draw, or something that is no material.
    """
    found = []
    for material in _several(materials):
        stack = material if isinstance(material, Stack) else getattr(material, "stack", None)
        if stack is None:
            stack = _loaded(material)
        found.append((stack, _name(material, stack)))
    return found


def subjects(
    materials: Any,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    samples: int = 1024,
    most: int = len(LINES),
    **options: Any,
) -> list[Subject]:
    """Solve what has to be solved: every material by every method.

    Args:
        materials: one or several, each a `Stack`, a path or ``preset:NAME``, or a `BSDF` (taken as it is).
        method: one or several of "walk", "adding", "lobes", "auto"; for materials that are not solved.
        labels: names for the legend, one for each result; else those of the materials and methods.
        samples: walks per evaluation, where the walk is the method.
        most: how many the figure can show.
        **options: of the solver (`urushi.solve`).

    Raises:
        UrushiError: nothing to draw, too many, labels that do not fit, something that is no material; and what
            `urushi.solve` raises.
    """
    methods = [method] if isinstance(method, str) else list(method)
    if not methods:
        raise UrushiError("method: found none; allowed: one or several methods")
    given = _several(materials)
    found = []
    for material in given:
        if isinstance(material, BSDF):
            stack = getattr(material, "stack", None)
            found.append(Subject(material, _name(material, stack)))
            continue
        stack = material if isinstance(material, Stack) else _loaded(material)
        for name in methods:
            mine = {"samples": samples, **options} if name == "walk" else options
            found.append(Subject(solve(stack, method=name, **mine), _name(material, stack)))
    if len(found) > most:
        raise UrushiError(f"materials: found {len(found)} to draw; allowed: at most {most} in one figure")
    if labels is not None:
        if isinstance(labels, str) or len(labels) != len(found):
            count = "one text" if isinstance(labels, str) else str(len(labels))
            raise UrushiError(f"labels: found {count}; allowed: a list of {len(found)}, one for each result")
        return [Subject(one.bsdf, str(label)) for one, label in zip(found, labels, strict=True)]
    return _told_apart(found)


def _several(materials: Any) -> list[Any]:
    one = isinstance(materials, Stack | BSDF | str | os.PathLike)
    found = [materials] if one else list(materials) if isinstance(materials, Sequence) else None
    if found is None:
        raise UrushiError(
            f"materials: found {type(materials).__name__}; allowed: a Stack, a path, preset:NAME, a solved BSDF, "
            "or a list of these"
        )
    if not found:
        raise UrushiError("materials: found an empty list; allowed: at least one material")
    return found


def _loaded(material: Any) -> Stack:
    if not isinstance(material, str | os.PathLike):
        raise UrushiError(
            f"materials: found {type(material).__name__}; allowed: a Stack, a path, preset:NAME, or a solved BSDF"
        )
    from urushi.io import load

    return load(material)


def _name(material: Any, stack: Stack | None) -> str:
    if stack is not None and stack.name:
        return stack.name
    if isinstance(material, str | os.PathLike):
        return Path(str(material).removeprefix("preset:")).stem
    return "unnamed" if stack is not None else type(material).__name__


def _told_apart(found: list[Subject]) -> list[Subject]:
    """The method in the name where several methods, or several of one name, are shown; then a number."""
    methods = [str(getattr(one.bsdf, "diagnostics", {}).get("method", "")) for one in found]
    names = [one.label for one in found]
    if len(set(names)) < len(names) or len(set(methods)) > 1:
        names = [f"{name}, {method}" if method else name for name, method in zip(names, methods, strict=True)]
    names = [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]
    return [Subject(one.bsdf, name) for one, name in zip(found, names, strict=True)]


# ------------------------------------------------------------------------------------------- questions


def incident(theta: float, phi: float = 0.0) -> np.ndarray:
    """wi as (1, 3): `theta` degrees from the normal, in the plane turned by `phi` degrees from x.

    Raises:
        UrushiError: light along the surface or from below.
    """
    if not 0.0 <= theta <= 89.5:
        raise UrushiError(f"theta: found {theta:g}; allowed: 0 to 89.5 degrees from the normal")
    if not np.isfinite(phi):
        raise UrushiError(f"phi: found {phi}; allowed: a number of degrees")
    t, p = np.radians(theta), np.radians(phi)
    return np.array([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]])


def channel(values: np.ndarray, name: str) -> np.ndarray:
    """One number of a colour: (..., 3) -> (...)."""
    if name not in CHANNELS:
        raise UrushiError(f"channel: found {name!r}; allowed: {', '.join(CHANNELS)}")
    if values.shape[-1] != 3:
        raise UrushiError(f"materials: found {values.shape[-1]} channels; allowed: a colour, three channels")
    if name == "luminance":
        return values @ LUMINANCE
    return values[..., CHANNELS.index(name) - 1]


def spread(errors: np.ndarray, name: str) -> np.ndarray:
    """The standard error of `channel`: at worst, as the channels of one path are not independent."""
    return channel(np.abs(errors), name)


def values(subject: Subject, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f |cos theta_o| and its standard error (0 where nothing is left to chance): (N, 3) each."""
    if estimated(subject):
        return subject.bsdf.eval(wi, wo, with_error=True)
    value = subject.bsdf.eval(wi, wo)
    return value, np.zeros_like(value)


def estimated(subject: Subject) -> bool:
    """Whether its values are estimates that know their standard error: the walk's, of two samples or more."""
    said = getattr(subject.bsdf, "diagnostics", {})
    return said.get("method") not in ("adding", "lobes") and said.get("samples", 2) > 1


def noise(value: np.ndarray, error: np.ndarray) -> str:
    """The median standard error relative to the value, in words; empty where nothing is left to chance."""
    lit = np.isfinite(value) & (value > 0) & (error > 0)
    return f"noise ±{100 * np.median(error[lit] / value[lit]):.2g} %" if lit.any() else ""


def arrows(subject: Subject, wi: np.ndarray, tries: int = 2048) -> list[Arrow]:
    """The delta parts for light from `wi` (1, 3), as `sample` finds them; of a chance under 1 / `tries` it may not."""
    u = np.full((tries, 3), 0.5)
    u[:, 0] = (np.arange(tries) + 0.5) / tries
    sample = subject.bsdf.sample(np.repeat(wi, tries, axis=0), u)
    found: list[Arrow] = []
    for i in np.flatnonzero(sample.delta):
        wo = sample.wo[i]
        if all(wo @ arrow.direction < 0.999999 for arrow in found):
            energy = sample.weight[i] * sample.pdf[i] / _scale(subject.bsdf, wi[0, 2], wo[2])
            if energy.max() > 0:
                found.append(Arrow(wo, energy))
    return found


def _scale(bsdf: BSDF, zi: float, zo: float) -> float:
    """The factor (n_wi / n_wo)^2 of radiance in transmitted light, which flux does not have."""
    if zi * zo > 0 or getattr(bsdf, "mode", "importance") != "radiance":
        return 1.0
    return _indices(bsdf) ** (2 if zi > 0 else -2)


def refracted(subject: Subject, theta: float) -> float | None:
    """Degrees from the normal at which light leaves on the far side by Snell's law; None if none does."""
    sine = float(np.sin(np.radians(theta))) * _indices(subject.bsdf)
    return float(np.degrees(np.arcsin(sine))) if subject.transmits and sine < 1 else None


def _indices(bsdf: BSDF) -> float:
    """The index above over the index below; 1 for what has no description."""
    stack = getattr(bsdf, "stack", None)
    if stack is None:
        return 1.0
    below = stack.exterior
    given = getattr(bsdf, "parameters", {})
    for i, layer in enumerate(stack.layers):
        below = given.get(f"layer_{i}.ior", getattr(layer, "ior", below))
    return float(stack.exterior / below)
