"""`compare`: what is asked of every method and contender, and what follows from the answers."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from urushi import llvm
from urushi.errors import UnsupportedStack, UrushiError
from urushi.solvers import BSDF, SOLVERS, choose, solve
from urushi.stack import Stack, Texture

from . import clock, reference
from .contenders import Contender, contender
from .questions import View, views
from .reference import Truth
from .report import Error, Flux, Report, Row
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
NOISE_VIEW = 30.0

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
    stack = _described(stack, parameters)
    methods = list(dict.fromkeys(methods))
    for method in methods:
        if method not in SOLVERS:
            raise UrushiError(f"methods: found {method!r}; allowed: {', '.join(SOLVERS)}")
    if not 1e-6 <= accuracy <= 1e-2:
        raise UrushiError(f"accuracy: found {accuracy}; allowed: 1e-6 to 1e-2")
    if samples < 2 or reference_samples < 2 * reference.PARTS:
        raise UrushiError(
            f"samples: found {samples} and {reference_samples}; allowed: at least 2, and {2 * reference.PARTS} "
            "for the reference"
        )
    told: Progress = progress or (lambda share, what: None)
    llvm.ensure()
    asked = views(stack)
    solved, build, cannot = _solve(stack, methods, accuracy, samples, seed, budget, told)
    truth = _truth(stack, asked, solved, accuracy, budget, reference_samples, seed, told)
    told(0.6, "contenders")
    rivals = [contender(given, stack, truth.bsdf) for given in contenders]
    rivals = _told_apart(rivals, methods)
    bsdfs = solved | {rival.name: rival.bsdf for rival in rivals}
    told(0.65, "errors")
    errors = {name: _error(bsdf, truth, asked) for name, bsdf in bsdfs.items()}
    single = _single_noise(solved.get("walk"), truth, asked)
    told(0.72, "times")
    timed = _times(stack, bsdfs, seed, lambda share: told(0.72 + 0.26 * share, "times"))
    rows = []
    for name in [*methods, *(rival.name for rival in rivals)]:
        rival = next((one for one in rivals if one.name == name), None)
        if name not in bsdfs:
            rows.append(Row(name, "method", "", None, cannot=cannot[name]))
            continue
        error, up, down = errors[name]
        cost, draw = timed[0][name], timed[1][name]
        noise, match = (
            _against_walk(single, error, cost, timed[0].get("one walk")) if name != "walk" else (None, None)
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
                _render_noise(bsdfs[name], draw, seed),
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
        _uncertainty(truth, asked),
        [_flux(view, flux[0], flux[1]) for view, flux in zip(asked, truth.fluxes, strict=True)],
        [_flux(view, flux[2], flux[3]) for view, flux in zip(asked, truth.fluxes, strict=True)],
        rows,
        verdict(rows, truth.method, samples),
        choice.why,
        _machine(timed[0]["yardstick"]),
        time.perf_counter() - start,
    )
    if figures:
        from .figures import draw as drawn

        told(0.98, "figures")
        report.figures.update(drawn(report, stack, bsdfs))
    told(1.0, "done")
    return report


def _described(stack: Any, parameters: Mapping[str, Any] | None) -> Stack:
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
            cannot[method] = [f"it would take longer than {budget:g} s to solve this stack to {accuracy:g}"]
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


def _peaks(truth: Truth) -> list[float]:
    return [float(value.max()) for value in truth.value]


def _uncertainty(truth: Truth, asked: list[View]) -> float | None:
    relative = [error / peak for error, peak in zip(truth.error, _peaks(truth), strict=True) if peak > 0]
    return _rms(relative)


def _rms(parts: list[np.ndarray]) -> float | None:
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(p) for p in parts]))))) if parts else None


def _error(bsdf: BSDF, truth: Truth, asked: list[View]) -> tuple[Error, list[Flux], list[Flux]]:
    """Of one answer; with its fluxes."""
    off, sure, by_view, up, down = [], [], {}, [], []
    worst: tuple[float, float, str, list[float], list[float]] = (-1.0, 0.0, "", [], [])
    fluxes = (0.0, 0.0, 0.0)
    for k, (view, peak) in enumerate(zip(asked, _peaks(truth), strict=True)):
        wi = view.wi[None]
        noisy = bsdf.diagnostics["method"] == "walk"
        value = bsdf.eval(wi, view.wo, with_error=noisy)
        value, own = value if noisy else (value, np.zeros_like(value))
        _finite(value, bsdf)
        if peak > 0:
            relative = (value - truth.value[k]) / peak
            uncertain = np.hypot(own, truth.error[k]) / peak
            off.append(relative)
            sure.append(uncertain)
            by_view[view.called()] = float(_rms([relative]) or 0.0)
            i, c = np.unravel_index(np.argmax(np.abs(relative)), relative.shape)
            if abs(relative[i, c]) > worst[0]:
                wo = view.wo[i]
                place = f"light at {view.called()}, leaving at {_angles(wo, view)}"
                worst = (
                    float(abs(relative[i, c])),
                    float(uncertain[i, c]),
                    place,
                    view.wi.tolist(),
                    wo.tolist(),
                )
        r, r_error = (x[0] for x in bsdf.reflectance(wi, with_error=True))
        t, t_error = (x[0] for x in bsdf.transmittance(wi, with_error=True))
        up.append(_flux(view, r, r_error))
        down.append(_flux(view, t, t_error))
        known = truth.fluxes[k]
        fluxes = (
            max(fluxes[0], float(np.abs(r - known[0]).max())),
            max(fluxes[1], float(np.abs(t - known[2]).max())),
            max(fluxes[2], float(np.hypot(r_error, known[1]).max())),
        )
    rms, uncertainty = _rms(off), _rms(sure)
    misplaced, unsure = (
        (None, None) if bsdf.diagnostics["method"] == "walk" else _misplaced(bsdf, truth, asked)
    )
    beyond = None
    if rms is not None and uncertainty is not None:
        beyond = float(np.sqrt(max(rms**2 - uncertainty**2, 0.0)))
    largest, doubt = (worst[0], worst[1]) if off else (None, None)
    error = Error(rms, uncertainty, beyond, largest, doubt, *worst[2:], by_view, misplaced, unsure, *fluxes)
    return error, up, down


def _misplaced(bsdf: BSDF, truth: Truth, asked: list[View]) -> tuple[float | None, float | None]:
    """The largest share of the light that leaves elsewhere, and what noise in the reference makes of none."""
    found: list[tuple[float, float]] = []
    for view, drawn in zip(asked, truth.drawn, strict=True):
        weight = 1 / drawn.pdf[:, None]
        whole = (drawn.value * weight).sum()
        if whole > 0:
            off = np.abs(bsdf.eval(view.wi[None], drawn.wo) - drawn.value)
            # The mean of the absolute value of a normal error is 0.8 of its standard deviation.
            shares = ((part * weight).sum() / (2 * whole) for part in (off, 0.8 * drawn.error))
            found.append((float(next(shares)), float(next(shares))))
    return max(found) if found else (None, None)


def _finite(value: np.ndarray, bsdf: BSDF) -> None:
    if not np.isfinite(value).all():
        raise UrushiError(
            f"{getattr(bsdf.stack, 'name', '')}: eval is not finite somewhere; urushi check finds where"
        )


def _angles(wo: np.ndarray, view: View) -> str:
    theta = np.degrees(np.arccos(min(abs(wo[2]), 1.0)))
    turn = np.degrees(np.arctan2(wo[1], wo[0])) - view.phi
    side = "" if (wo[2] > 0) == view.above else " on the other side"
    # 180 degrees is straight on, away from the light.
    return f"{theta:.0f}° (azimuth {(turn + 360) % 360:.0f}°){side}"


def _flux(view: View, value: np.ndarray, error: np.ndarray) -> Flux:
    return Flux(view.called(), np.ravel(value).tolist(), np.ravel(error).tolist())


def _single_noise(walk: BSDF | None, truth: Truth, asked: list[View]) -> float | None:
    """Rms noise of the walk with one sample, relative to the peak."""
    if walk is None:
        return None
    samples = walk.diagnostics["samples"]
    relative = [
        walk.eval(view.wi[None], view.wo, with_error=True)[1] * np.sqrt(samples) / peak
        for view, peak in zip(asked, _peaks(truth), strict=True)
        if peak > 0
    ]
    return _rms(relative)


def _against_walk(
    single: float | None, error: Error, cost: float, walk: float | None
) -> tuple[float | None, float | None]:
    """The walk's noise in the time of one evaluation, and the samples that bring it down to this error."""
    if single is None or walk is None or error.beyond is None:
        return None, None
    noise = single / np.sqrt(max(cost / walk, 1e-9))
    # An error that the uncertainty explains is none that one could match.
    known = error.beyond > 2 * (error.rms_uncertainty or 0.0)
    return float(noise), float((single / error.beyond) ** 2) if known else None


def _times(
    stack: Stack, bsdfs: dict[str, BSDF], seed: int, advance: Callable[[float], object]
) -> tuple[dict[str, float], dict[str, float]]:
    from urushi.adapters.answer import answer

    timed = dict(bsdfs)
    if "walk" in bsdfs:
        timed["one walk"] = solve(stack, "walk", samples=1, seed=seed)
    timed["yardstick"] = answer({"type": "roughplastic", "alpha": 0.1})
    found = clock.nanoseconds(timed, seed, advance)
    # As a renderer calls it, the walk takes one sample.
    for column in found:
        if "one walk" in column:
            column["walk"] = column["one walk"]
    return found


def _render_noise(bsdf: BSDF, draw: float, seed: int) -> float | None:
    """Relative standard deviation of the mean weight of as many samples as a millisecond has room for."""
    t = np.radians(NOISE_VIEW)
    wi = np.broadcast_to([np.sin(t), 0.0, np.cos(t)], (1 << 14, 3))
    u = np.random.default_rng((seed, 77)).random(wi.shape)
    own = bsdf
    if bsdf.diagnostics["method"] == "walk":
        own = solve(bsdf.stack, "walk", samples=1, seed=seed)
    weight = own.sample(wi, u).weight.mean(axis=1)
    mean = float(weight.mean())
    return float(weight.std() / mean * np.sqrt(draw / 1e6)) if mean > 0 else None


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
