"""Energy: no stack gives back more light than it gets, from any side, in any colour."""

from __future__ import annotations

import numpy as np

from urushi.solvers import BSDF
from urushi.stack import Stack

from .chance import sigmas
from .report import Answers, Report, row
from .sphere import views

COSINES = (1.0, 0.9, 0.7, 0.5, 0.3, 0.15, 0.05, 0.01)
#: rounding of single precision, summed over the bounces of a path
ROUNDING = 2e-5


def check(answers: Answers, quick: bool) -> Report:
    """Reflectance plus transmittance is at most 1, and exactly 1 where nothing absorbs and all is smooth."""
    bsdf = answers(4096 if quick else 65536)
    wi = views(bsdf.stack, COSINES)
    total, error = fluxes(bsdf, wi)
    allowed = sigmas(total.size) * error + ROUNDING
    over = total - 1 - allowed
    kind = lossless(bsdf.stack)
    if kind == "smooth":
        over = np.abs(total - 1) - allowed
    worst = np.unravel_index(np.argmax(np.where(np.isfinite(over), over, np.inf)), over.shape)
    number, limit = total[worst], 1 + allowed[worst]
    cos = wi[worst[0], 2]
    text = f"reflectance + transmittance is {number:.5f} ± {error[worst]:.1g} at cosine {cos:.2f}"
    if kind == "smooth":
        text += "; nothing absorbs, so it must be 1"
        number, limit = abs(number - 1), allowed[worst]
    elif kind == "rough":
        text += (
            f"; nothing absorbs, so what is missing, {100 * (1 - total.mean(axis=1)).max():.2g} % at most, is what "
            "microfacets lose that scatter light only once"
        )
    w = row(wi[worst[0]])
    closer = f"bsdf.reflectance({w}, with_error=True), bsdf.transmittance({w}, with_error=True)"
    return Report.of("energy", number, limit, text, closer)


def fluxes(bsdf: BSDF, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance + transmittance and its standard error, (N, C)."""
    up, up_error = bsdf.reflectance(wi, with_error=True)
    down, down_error = bsdf.transmittance(wi, with_error=True)
    # Both come from the same paths, so their errors may add up.
    return up + down, up_error + down_error


def lossless(stack: Stack) -> str:
    """ "smooth" or "rough" where the description lets nothing absorb, else ""."""
    rough = False
    for layer in stack.layers:
        if layer.kind in ("conductor", "bsdf"):
            return ""
        if layer.kind == "diffuse" and not _all(layer.reflectance, 1):  # type: ignore[attr-defined]
            return ""
        if layer.kind == "medium" and not _all(layer.albedo, 1) and not _all(layer.optical_depth, 0):  # type: ignore[attr-defined]
            return ""
        if layer.kind == "graded" and not _all(layer.albedo, 1) and not _all(layer.depth, 0):  # type: ignore[attr-defined]
            return ""
        rough = rough or not _all(getattr(layer, "alpha", 0), 0)
    return "rough" if rough else "smooth"


def _all(value: object, number: float) -> bool:
    return all(v == number for v in (value if isinstance(value, tuple) else (value,)))
