"""Agreement: what `eval`, `sample`, `reflectance` and `transmittance` say of the same light is the same.

Three estimates that share no code where it matters: paths that are followed to where they end (`reflectance`,
`transmittance`), the mean weight of `sample`, and the integral of `eval` over a grid of directions.
"""

from __future__ import annotations

import numpy as np

from urushi.solvers import BSDF

from .chance import numbers, sigmas
from .normalisation import delta_parts, tilted
from .report import Answers, Report, row
from .sphere import Patch, patches, radiance, views

COSINES = (0.95, 0.5, 0.15)
#: relative error of single precision, and of a handful of samples that decide a mean
ROUNDING = 2e-3
#: relative standard error of what claims to have none
SURE = 1e-4


def check(answers: Answers, quick: bool) -> Report:
    """Flux to either side, from several directions, three ways."""
    few, many = answers(1), answers(16384 if quick else 262144)
    stack = few.stack
    wi = views(stack, COSINES)
    fluxes = [many.reflectance(wi, with_error=True)]
    if not stack.layers[-1].opaque:
        fluxes.append(many.transmittance(wi, with_error=True))
    worst, text, closer = -1.0, "", ""
    # An approximation says how well its own answers go together.
    close = float(few.diagnostics.get("consistent_to", ROUNDING))
    limit = sigmas(2 * 3 * len(fluxes) * len(wi))
    scale = 1 if quick else 4
    for i, w in enumerate(wi):
        carried, delta = _sampled(few, w, (1 << 16) * scale**2, 200 + i)
        for k, patch in enumerate(patches(stack, w)):
            flux, error = fluxes[k][0][i], fluxes[k][1][i]
            integral = _integrated(few, w, patch, scale, 300 + i)
            both = {
                "the mean weight of sample": carried[k],
                "the integral of eval": (integral[0] + delta[k][0], np.hypot(integral[1], delta[k][1])),
            }
            for name, (value, value_error) in both.items():
                spread = np.hypot(np.hypot(error, value_error), SURE * np.abs(flux))
                off = np.maximum(
                    np.abs(value - flux) - close * np.maximum(np.abs(flux), np.abs(value)) - 1e-6, 0
                )
                off[~np.isfinite(value)] = np.inf
                z = np.where(off > 0, off / np.maximum(spread, 1e-30), 0)
                c = int(np.argmax(z))
                if not z[c] <= worst:
                    worst = z[c]
                    what = "reflectance" if k == 0 else "transmittance"
                    text = (
                        f"at cosine {w[2]:.2f} {what} is {flux[c]:.5f} and {name} {value[c]:.5f} "
                        f"(± {spread[c]:.1g}); found and limit are standard errors"
                    )
                    closer = f"checks.agreement.compared(bsdf, np.array({row(w)[1:-1]}))"
    if close > ROUNDING:
        text += f"; this form of the BSDF claims to agree with itself to {100 * close:g} % only"
    return Report.of("agreement", worst, limit, text, closer)


def compared(bsdf: BSDF, wi: np.ndarray, scale: int = 4) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The estimates of the flux from one direction wi (3,), by name: values (C,) and standard errors."""
    found = {"reflectance": bsdf.reflectance(wi[None], with_error=True)}
    if not bsdf.stack.layers[-1].opaque:
        found["transmittance"] = bsdf.transmittance(wi[None], with_error=True)
    said = {name: (value[0], error[0]) for name, (value, error) in found.items()}
    carried, delta = _sampled(bsdf, wi, (1 << 16) * scale, 200)
    for k, (patch, name) in enumerate(zip(patches(bsdf.stack, wi), found, strict=True)):
        value, error = _integrated(bsdf, wi, patch, scale, 300)
        said[f"{name}, by the weight of sample"] = carried[k]
        said[f"{name}, by the integral of eval"] = value + delta[k][0], np.hypot(error, delta[k][1])
    return said


def _sampled(
    bsdf: BSDF, wi: np.ndarray, n: int, stream: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[tuple[np.ndarray, np.ndarray]]]:
    """Mean weight with its error, to the side of wi and to the other; and what the delta parts carry, as flux."""
    there = np.broadcast_to(wi, (n, 3))
    sample = bsdf.sample(there, numbers(n, stream))
    weight = sample.weight / radiance(bsdf.stack, there, sample.wo)[:, None]
    same = (sample.wo[:, 2] * wi[2] > 0)[:, None]
    means, deltas = [], []
    probability = delta_parts(bsdf, wi)
    for side, share in zip((same, ~same), probability, strict=True):
        part = np.where(side, weight, 0)
        means.append((part.mean(axis=0), part.std(axis=0) / np.sqrt(n)))
        smooth = sample.delta & side[:, 0]
        carried = weight[smooth] * share if smooth.any() else np.zeros((1, weight.shape[1]))
        if tilted(bsdf):  # where the side is drawn, too, all samples tell how often
            carried = part * sample.delta[:, None]
        deltas.append((carried.mean(axis=0), carried.std(axis=0) / np.sqrt(len(carried))))
    return means, deltas


def _integrated(
    bsdf: BSDF, wi: np.ndarray, patch: Patch, scale: int, stream: int
) -> tuple[np.ndarray, np.ndarray]:
    """Integral of `eval`, as flux, over a hemisphere with its standard error, by random points in a grid's cells."""
    # Two points a cell tell how far it spreads.
    wo, area = patch.stratified((96 * scale, 64 * scale), stream)
    there = np.broadcast_to(wi, (wo.shape[0] * wo.shape[1], 3))
    value = bsdf.eval(there, wo.reshape(-1, 3)) / radiance(bsdf.stack, there, wo.reshape(-1, 3))[:, None]
    value = value.reshape(*area.shape, -1) * area[..., None]
    return value.mean(axis=0).sum(axis=0), np.sqrt(np.square(value[0] - value[1]).sum(axis=0) / 4)
