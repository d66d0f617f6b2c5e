"""`compare`: what is asked of every method and contender, and what follows from the answers."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from urushi import llvm
from urushi.errors import UnsupportedStack, UrushiError, close
from urushi.solvers import BSDF, SOLVERS, choose, solve
from urushi.stack import Stack, Texture

from . import clock, reference
from .contenders import Contender, contender, from_stack, named
from .errors import against_walk, error_of, flux_of, render_noise, uncertainty_of
from .questions import View, views
from .reference import Truth
from .report import Report, Row
from .verdict import verdict

METHODS = ("adding", "lobes", "walk")
#: the reference is this many times finer than what is asked of adding, where time allows
FINER = 4.0
#: what a method cannot do, whatever the stack
LIMITS = {
    "adding": ["textures in Python, brushed or tilted interfaces, derivatives"],
    "lobes": ["say how far off they are: the model is an approximation"],
    "walk": ["an answer without noise"],
}

Progress = Callable[[float, str], object]


def compare(
    stack: Stack | str | os.PathLike[str],
    methods: Sequence[str] = METHODS,
    contenders: Sequence[Any] = (),
    *,
    accuracy: float = 1e-3,
    samples: int = 1024,
    reference_samples: int = 1 << 16,
    budget: float = 60.0,
    parameters: Mapping[str, Any] | None = None,
    seed: int = 0,
    figures: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Methods and contenders on one stack, held against a reference, and timed.

    Args:
        stack: the description, a path or ``preset:NAME``.
        methods: of `urushi.solve`, in the order of the report.
        contenders: other BSDFs: a Mitsuba BSDF (instance, dictionary, JSON), a file (``.bsdf``, ``.urushi.npz``,
            ``.json``, ``.xml``), a solved `BSDF`, or the name of a plugin that gets its parameters from the stack
            (`urushi.comparison.contenders`).
        accuracy: asked of adding, 1e-6 to 1e-2.
        samples: of the walk, as it is compared.
        reference_samples: of the walk, where it is the reference.
        budget: seconds that one solve by adding may take; beyond, the reference is coarser, or the walk.
        parameters: values in place of those of the description; textures need one, the same everywhere.
        seed: of all random numbers.
        figures: also draw what `Report.html` shows (needs matplotlib for some of it).
        progress: called with the share that is done and what is being done.

    Returns:
        A `Report`; printed, it is a table.

    Raises:
        UrushiError: an unknown method, an option out of range, a texture that nothing was given for.
        UnsupportedStack: neither adding nor the walk can do the stack, so there is no reference.
    """
    start = time.perf_counter()
    stack = described(stack, parameters)
    methods = [methods] if isinstance(methods, str) else list(dict.fromkeys(methods))
    for method in methods:
        if method not in SOLVERS:
            raise UrushiError(
                f"methods: found {method!r}; {close(method, SOLVERS)}allowed: {', '.join(SOLVERS)}"
            )
    if not 1e-6 <= accuracy <= 1e-2:
        raise UrushiError(f"accuracy: found {accuracy}; allowed: 1e-6 to 1e-2")
    if samples < 2 or reference_samples < 2 * reference.PARTS:
        raise UrushiError(
            f"samples: found {samples} and {reference_samples}; allowed: at least 2, and {2 * reference.PARTS} "
            "for the reference"
        )
    told: Progress = progress or (lambda share, what: None)
    llvm.ensure()
    given = [one if named(one) else contender(one) for one in contenders]
    asked = views(stack)
    solved, build, cannot = _solve(stack, methods, accuracy, samples, seed, budget, told)
    truth = _truth(stack, asked, solved, accuracy, budget, reference_samples, seed, told)
    told(0.6, "contenders")
    rivals = [one if isinstance(one, Contender) else from_stack(one, stack, truth.bsdf) for one in given]
    rivals = _told_apart(rivals, methods)
    bsdfs = solved | {rival.name: rival.bsdf for rival in rivals}
    told(0.65, "errors")
    errors = {name: error_of(bsdf, truth, asked) for name, bsdf in bsdfs.items()}
    single = errors["walk"][3] if "walk" in errors else None
    if single is not None:
        single *= samples**0.5  # of one sample
    told(0.72, "times")
    timed = _times(stack, bsdfs, seed, lambda share: told(0.72 + 0.26 * share, "times"))
    rows = []
    for name in [*methods, *(rival.name for rival in rivals)]:
        rival = next((one for one in rivals if one.name == name), None)
        if name not in bsdfs:
            rows.append(Row(name, "method", "", None, cannot=cannot[name]))
            continue
        error, up, down, _ = errors[name]
        cost, draw = timed[0][name], timed[1][name]
        noise, match = (
            against_walk(single, error, cost, timed[0].get("walk")) if name != "walk" else (None, None)
        )
        rows.append(
            Row(
                name,
                "contender" if rival else "method",
                rival.said if rival else _settings(name, bsdfs[name]),
                error,
                up,
                down,
                None if rival else build[name],
                cost,
                draw,
                noise,
                match,
                render_noise(bsdfs[name], draw, seed),
                rival.bytes if rival else _bytes(name, bsdfs[name], stack),
                [] if rival else LIMITS[name],
            )
        )
    choice = choose(stack, SOLVERS)
    report = Report(
        stack.name or "unnamed stack",
        stack.description,
        stack.describe(),
        truth.said,
        truth.method,
        uncertainty_of(truth),
        [flux_of(view, flux[0], flux[1]) for view, flux in zip(asked, truth.fluxes, strict=True)],
        [flux_of(view, flux[2], flux[3]) for view, flux in zip(asked, truth.fluxes, strict=True)],
        rows,
        verdict(rows),
        choice.why,
        _machine(timed[0]["yardstick"]),
        time.perf_counter() - start,
    )
    if figures:
        from .figures import draw as drawn

        told(0.98, "figures")
        report.figures.update(drawn(stack, bsdfs))
    told(1.0, "done")
    return report


def described(stack: Any, parameters: Mapping[str, Any] | None) -> Stack:
    """The stack with the values that were given, and no texture left."""
    if not isinstance(stack, Stack):
        from urushi.io import load

        stack = load(stack)
    given = {
        name: tuple(np.ravel(value).tolist()) if np.ndim(value) else value
        for name, value in (parameters or {}).items()
    }
    stack = stack.replace(given)
    textured = [name for name, value in stack.parameters().items() if isinstance(value, Texture)]
    if textured:
        raise UrushiError(
            f"{' and '.join(textured)}: a texture, which has values only at points of a surface; allowed: a number or "
            f"colour for each, by parameters={{{textured[0]!r}: ...}} or --set {textured[0]}=..."
        )
    return stack


def _solve(
    stack: Stack, methods: list[str], accuracy: float, samples: int, seed: int, budget: float, told: Progress
) -> tuple[dict[str, BSDF], dict[str, float], dict[str, list[str]]]:
    """The methods that can: their BSDFs and seconds; the reasons of those that cannot."""
    solved: dict[str, BSDF] = {}
    build: dict[str, float] = {}
    cannot: dict[str, list[str]] = {}
    for i, method in enumerate(methods):
        told(0.2 * i / len(methods), f"solving by {method}")
        options: dict[str, Any] = {"samples": samples, "seed": seed} if method == "walk" else {}
        try:
            start = time.perf_counter()
            found: BSDF | None
            if method == "adding":
                found = reference.within(stack, accuracy, budget)
            else:
                solve(stack, method, **options)  # what is loaded once is not part of it
                start = time.perf_counter()
                found = solve(stack, method, **options)
        except UnsupportedStack as error:
            cannot[method] = list(error.reasons)
            continue
        build[method] = time.perf_counter() - start
        if found is None:
            cannot[method] = [
                f"it would take longer than {budget:g} s, or too many nodes, to solve this stack to {accuracy:g}"
            ]
            continue
        solved[method] = found
    return solved, build, cannot


def _truth(
    stack: Stack,
    asked: list[View],
    solved: dict[str, BSDF],
    accuracy: float,
    budget: float,
    samples: int,
    seed: int,
    told: Progress,
) -> Truth:
    told(0.2, "reference")
    if not reference.against_adding(stack):
        fine = reference.within(stack, accuracy / FINER, budget)
        coarse = solved.get("adding")
        if coarse is None and fine is None:
            coarse = reference.within(stack, accuracy, budget)
        best = fine if fine is not None else coarse
        if best is not None:
            return reference.by_adding(best, asked)
    return reference.by_walk(stack, asked, samples, seed, lambda share: told(0.2 + 0.4 * share, "reference"))


def _told_apart(rivals: list[Contender], methods: list[str]) -> list[Contender]:
    """Names that differ from one another and from the methods."""
    found: list[Contender] = []
    for rival in rivals:
        taken = {*methods, *(one.name for one in found)}
        name, count = rival.name, 2
        while name in taken:
            name, count = f"{rival.name} ({count})", count + 1
        found.append(Contender(name, rival.bsdf, rival.said, rival.bytes))
    return found


def _times(
    stack: Stack, bsdfs: dict[str, BSDF], seed: int, advance: Callable[[float], object]
) -> tuple[dict[str, float], dict[str, float]]:
    from urushi.adapters.answer import answer

    timed = dict(bsdfs)
    if "walk" in bsdfs:  # as a renderer calls it
        timed["walk"] = solve(stack, "walk", samples=1, seed=seed)
    timed["yardstick"] = answer({"type": "roughplastic", "alpha": 0.1})
    return clock.nanoseconds(timed, seed, advance)


def _bytes(name: str, bsdf: Any, stack: Stack) -> int:
    """Of what has to be kept: the description, or the solved stack."""
    if name == "adding":
        from urushi.adapters.native.file import packed

        return len(packed(bsdf.stack, bsdf.solution, 0.1 * float(bsdf.diagnostics["accuracy"])))
    from urushi.io import dumps

    return len(dumps(stack, "yaml").encode())


def _settings(name: str, bsdf: BSDF) -> str:
    said = bsdf.diagnostics
    if name == "adding":
        return f"accuracy {said['accuracy']:g}, {said['nodes']} nodes, {said['orders']} orders"
    return f"{said['samples']} samples for the error, 1 for the times" if name == "walk" else "closed form"


def _machine(yardstick: float) -> str:
    import drjit as dr

    name = platform.processor() or platform.machine()
    return (
        f"{name}, {dr.thread_count()} threads, {platform.system()}; one evaluation of Mitsuba's roughplastic takes "
        f"{yardstick:.3g} ns"
    )
