"""How far an answer is from the truth, and how noisy it is."""

from __future__ import annotations

import numpy as np

from urushi.errors import UrushiError
from urushi.solvers import BSDF, solve

from .questions import View
from .reference import Truth
from .report import Error, Flux

#: degrees of the light for which the noise of sampling is measured
NOISE_VIEW = 30.0


def peaks(truth: Truth) -> list[float]:
    return [float(value.max()) for value in truth.value]


def uncertainty_of(truth: Truth) -> float | None:
    relative = [error / peak for error, peak in zip(truth.error, peaks(truth), strict=True) if peak > 0]
    return _rms(relative)


def _rms(parts: list[np.ndarray]) -> float | None:
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(p) for p in parts]))))) if parts else None


def error_of(
    bsdf: BSDF, truth: Truth, asked: list[View]
) -> tuple[Error, list[Flux], list[Flux], float | None]:
    """Of one answer; with its fluxes, and the rms of its own noise, relative to the peak."""
    off, sure, noise, by_view, up, down = [], [], [], {}, [], []
    worst: tuple[float, float, str, list[float], list[float]] = (-1.0, 0.0, "", [], [])
    fluxes = (0.0, 0.0, 0.0)
    for k, (view, peak) in enumerate(zip(asked, peaks(truth), strict=True)):
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
            noise.append(own / peak)
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
        up.append(flux_of(view, r, r_error))
        down.append(flux_of(view, t, t_error))
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
    return error, up, down, _rms(noise)


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


def flux_of(view: View, value: np.ndarray, error: np.ndarray) -> Flux:
    return Flux(view.called(), np.ravel(value).tolist(), np.ravel(error).tolist())


def against_walk(
    single: float | None, error: Error, cost: float, walk: float | None
) -> tuple[float | None, float | None]:
    """The walk's noise in the time of one evaluation, and the samples that bring it down to this error."""
    if single is None or walk is None or error.beyond is None:
        return None, None
    noise = single / np.sqrt(max(cost / walk, 1e-9))
    # An error that the uncertainty explains is none that one could match.
    known = error.beyond > 2 * (error.rms_uncertainty or 0.0)
    return float(noise), float((single / error.beyond) ** 2) if known else None


def render_noise(bsdf: BSDF, draw: float, seed: int) -> float | None:
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
