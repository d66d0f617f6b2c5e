"""Normalisation: the density of `sample`, with the probabilities of the delta parts, adds up to 1.

A deterministic integral: a chi² test of a million samples misses an error of 1 %.
"""

from __future__ import annotations

import numpy as np

from urushi.solvers import BSDF

from .report import Answers, Report
from .sphere import integrate, patches, views

COSINES = (1.0, 0.7, 0.3, 0.05)
LIMIT = 1e-3


def check(answers: Answers, quick: bool) -> Report:
    """1 minus the integral of `pdf` over the sphere minus the delta parts, from several directions."""
    bsdf = answers(1)
    worst, text = 0.0, ""
    for wi in views(bsdf.stack, COSINES if quick else (*COSINES, 0.9, 0.5, 0.15, 0.01)):
        density, left, delta = total(bsdf, wi, 3e-5 if quick else 3e-6)
        off = abs(density + delta - 1)
        if not off <= worst or not text:
            worst = off
            text = f"the density integrates to {density:.5f} and delta parts have {delta:.5f} at cosine {wi[2]:.2f}"
            if left > LIMIT:
                text += f" (the integral itself is uncertain by {left:.1g})"
        if not np.isfinite(off):
            break
    if not worst <= LIMIT:
        text += f"; look closer with pdf(wi, wo), wi={np.round(wi, 4).tolist()}"
    return Report.of("normalisation", worst, LIMIT, text)


def total(bsdf: BSDF, wi: np.ndarray, tolerance: float) -> tuple[float, float, float]:
    """Integral of the density over the sphere, its uncertainty, and the probability of the delta parts."""
    density = left = 0.0
    for patch in patches(bsdf.stack, wi):
        parts, error = integrate(lambda wo: bsdf.pdf(wi[None], wo), patch, (28, 12), tolerance)
        density, left = density + float(parts.sum()), left + error
    return density, left, sum(delta_parts(bsdf, wi))


def delta_parts(bsdf: BSDF, wi: np.ndarray, n: int = 8192) -> tuple[float, float]:
    """Probability of the delta part on the side of wi and on the other, by going through the first number of u."""
    u = np.full((n, 3), 0.5)
    u[:, 0] = (np.arange(n) + 0.5) / n
    sample = bsdf.sample(np.broadcast_to(wi, (n, 3)), u)
    found = []
    same = sample.wo[:, 2] * wi[2] > 0
    for side in (same, ~same):
        rows = sample.delta & side & (sample.pdf > 0)
        found.append(float(sample.pdf[rows].mean()) if rows.any() else 0.0)
    return found[0], found[1]
