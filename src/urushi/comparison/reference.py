"""What is taken for the truth: adding, finer than asked; or a long walk."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from urushi.errors import OutOfReach
from urushi.solvers import BSDF, solve
from urushi.solvers.adding import reasons_against
from urushi.stack import Stack

from .questions import View

#: how much longer the next refinement of adding takes than the last one did, when it doubles its nodes
LONGER = 5.0
#: parts that a long walk is made of, each with its seed
PARTS = 8
#: steps of the additive recurrence of three dimensions (Roberts 2018)
STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


@dataclass(frozen=True)
class Truth:
    """The values that the others are held against.

    Attributes:
        method: "adding" or "walk".
        said: how it was obtained, in words.
        value, error: for each view, (K, C) f |cos| and its uncertainty.
        fluxes: for each view, reflectance, its uncertainty, transmittance, its uncertainty; (C,) each.
        bsdf: the solved stack behind it.
        drawn: for each view, directions for integrals.
    """

    method: str
    said: str
    value: list[np.ndarray]
    error: list[np.ndarray]
    fluxes: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
    bsdf: BSDF
    drawn: list[Drawn]


@dataclass(frozen=True)
class Drawn:
    """Directions in proportion to where the light goes, for integrals over them.

    Attributes:
        wo: (M, 3); none where all light leaves in single directions.
        pdf: (M,) density times the number of draws: a sum over 1 / pdf is an integral.
        value, error: (M, C) of the reference.
    """

    wo: np.ndarray
    pdf: np.ndarray
    value: np.ndarray
    error: np.ndarray


class _Enough(Exception):
    """Adding would take longer than it may."""


def against_adding(stack: Stack) -> list[str]:
    """Why adding is no reference for a stack; empty if it is."""
    reasons = reasons_against(stack)
    for i, layer in enumerate(stack.layers):
        if getattr(layer, "multiple_scattering", False) == "walk":
            reasons.append(f"layers[{i}] has multiple_scattering='walk', whose noise adding would keep")
    return reasons


def within(stack: Stack, accuracy: float, budget: float) -> BSDF | None:
    """Adding to an accuracy, or None where that would take longer than `budget` seconds or more nodes than it may."""
    start = last = time.perf_counter()

    def watch(_nodes: int, error: float) -> None:
        nonlocal last
        now = time.perf_counter()
        if error > accuracy and now - start + LONGER * (now - last) > budget:
            raise _Enough
        last = now

    try:
        return solve(stack, "adding", accuracy=accuracy, progress=watch)
    except (_Enough, OutOfReach):
        return None


def by_adding(bsdf: BSDF, views: list[View]) -> Truth:
    """The values of a stack solved by adding."""
    value, error, fluxes = [], [], []
    for view in views:
        found, uncertain = bsdf.eval(view.wi[None], view.wo, with_error=True)
        value.append(found)
        error.append(uncertain)
        fluxes.append(_fluxes(bsdf, view))
    expected = bsdf.diagnostics["estimated_error"]
    nodes = bsdf.diagnostics["nodes"]
    said = f"adding with {nodes} nodes, error {expected:.1g} of the peak by its own estimate"
    return Truth("adding", said, value, error, fluxes, bsdf, [_drawn(bsdf, view, 4096) for view in views])


def by_walk(
    stack: Stack, views: list[View], samples: int, seed: int, advance: Callable[[float], object]
) -> Truth:
    """The means of long walks."""
    each = max(samples // PARTS, 2)
    parts: list[list[Any]] = [[] for _ in views]
    bsdf = solve(stack, "walk", samples=each, seed=seed)
    for part in range(PARTS):
        one = solve(stack, "walk", samples=each, seed=seed + 1000 + part)
        for found, view in zip(parts, views, strict=True):
            value = one.eval(view.wi[None], view.wo, with_error=True)
            found.append((*value, *_fluxes(one, view)))
        advance((part + 1) / PARTS)
    means = [[np.mean(column, axis=0) for column in zip(*found, strict=True)] for found in parts]
    errors = [
        [np.sqrt(np.mean(np.square(column), axis=0) / PARTS) for column in zip(*found, strict=True)]
        for found in parts
    ]
    return Truth(
        "walk",
        f"a walk of {each * PARTS} samples a direction; the uncertainty is its standard error",
        [mean[0] for mean in means],
        [error[1] for error in errors],
        [(m[2], e[3], m[4], e[5]) for m, e in zip(means, errors, strict=True)],
        bsdf,
        [_drawn(bsdf, view, 512) for view in views],
    )


def _drawn(bsdf: BSDF, view: View, n: int) -> Drawn:
    """Samples of the reference; delta parts are left out."""
    u = (np.arange(n)[:, None] * STEPS + 0.5) % 1.0
    wi = np.broadcast_to(view.wi, (n, 3))
    sample = bsdf.sample(wi, u)
    wo = sample.wo[~sample.delta & (sample.pdf > 0)]
    if not len(wo):
        return Drawn(wo, np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
    value, error = bsdf.eval(view.wi[None], wo, with_error=True)
    return Drawn(wo, n * bsdf.pdf(view.wi[None], wo), value, error)


def _fluxes(bsdf: BSDF, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    up, up_error = bsdf.reflectance(view.wi[None], with_error=True)
    down, down_error = bsdf.transmittance(view.wi[None], with_error=True)
    return up[0], up_error[0], down[0], down_error[0]
