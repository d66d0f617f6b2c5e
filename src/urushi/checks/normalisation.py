"""Normalisation: the density of `sample`, with the probabilities of the delta parts and of no sample, adds up to 1.

A deterministic integral: a chi² test of a million samples misses an error of 1 %. Only how often there is no sample
(density 0) is counted, where that happens at all.
"""

from __future__ import annotations

import numpy as np

from urushi.solvers import BSDF

from .chance import numbers, sigmas
from .report import Answers, Report, row
from .sphere import integrate, patches, views

COSINES = (1.0, 0.7, 0.3, 0.05)
LIMIT = 1e-3


def check(answers: Answers, quick: bool) -> Report:
    """1 minus the integral of `pdf` over the sphere, the delta parts and the void, from several directions."""
    bsdf = answers(1)
    worst, limit, text, closer = 0.0, LIMIT, "", ""
    tolerance = 3e-5 if quick else 3e-6
    cosines = COSINES if quick else (*COSINES, 0.9, 0.5, 0.15, 0.01)
    every = views(bsdf.stack, cosines)
    for i, wi in enumerate(every):
        density, left, delta = total(bsdf, wi, tolerance)
        void, error = nothing(bsdf, wi, 400 + i)
        off, allowed = abs(density + delta + void - 1), LIMIT + sigmas(len(every)) * error
        if tilted(bsdf):  # lobes that are no mirror images of wi are hard to integrate
            allowed = allowed + left
        if not off / allowed <= worst / limit or not text:
            worst, limit = off, allowed
            text = f"the density integrates to {density:.5f} and delta parts have {delta:.5f}"
            text += f", no sample {void:.5f}" * (void > 0) + f" at cosine {wi[2]:.2f}"
            if left > LIMIT:
                text += f" (the integral itself is uncertain by {left:.1g})"
            closer = f"checks.normalisation.total(bsdf, np.array({row(wi)[1:-1]}), {tolerance:g})"
        if not np.isfinite(off):
            break
    return Report.of("normalisation", worst, limit, text, closer)


def nothing(bsdf: BSDF, wi: np.ndarray, stream: int, n: int = 1 << 15) -> tuple[float, float]:
    """Probability that there is no sample at all, and its standard error."""
    void = bsdf.sample(np.broadcast_to(wi, (n, 3)), numbers(n, stream)).pdf <= 0
    share = float(np.mean(void))
    return share, float(np.sqrt(share * (1 - share) / n))


def total(bsdf: BSDF, wi: np.ndarray, tolerance: float) -> tuple[float, float, float]:
    """Integral of the density over the sphere, its uncertainty, and the probability of the delta parts."""
    density = left = 0.0
    for patch in patches(bsdf.stack, wi):
        parts, error = integrate(lambda wo: bsdf.pdf(wi[None], wo), patch, (28, 12), tolerance)
        density, left = density + float(parts.sum()), left + error
    return density, left, sum(delta_parts(bsdf, wi))


def delta_parts(bsdf: BSDF, wi: np.ndarray, n: int = 8192) -> tuple[float, float]:
    """Probability of the delta part on the side of wi and on the other, by going through the first number of u.

    Smooth interfaces with normals of their own draw the side at random, with one probability for both: there it counts.
    """
    n = n << 5 if tilted(bsdf) else n
    u = np.full((n, 3), 0.5)
    u[:, 0] = (np.arange(n) + 0.5) / n
    sample = bsdf.sample(np.broadcast_to(wi, (n, 3)), u)
    found = []
    same = sample.wo[:, 2] * wi[2] > 0
    for side in (same, ~same):
        rows = sample.delta & side & (sample.pdf > 0)
        probability = (
            float(rows.mean()) if tilted(bsdf) else float(sample.pdf[rows].mean()) if rows.any() else 0.0
        )
        found.append(probability)
    return found[0], found[1]


def tilted(bsdf: BSDF) -> bool:
    """Whether any interface is described with a normal of its own."""
    return any(getattr(layer, "normal", None) is not None for layer in getattr(bsdf.stack, "layers", ()))
