"""Chi²: where `sample` sends its directions is what `pdf` says."""

from __future__ import annotations

import numpy as np

from urushi.solvers import BSDF, Sample

from .chance import chi2_p_value, numbers, significance
from .normalisation import delta_parts
from .report import Answers, Report, row
from .sphere import INNERMOST, SKEW, integrate, patches, views

COSINES = (0.95, 0.4, 0.05)
SHAPE = (14, 12)


def check(answers: Answers, quick: bool) -> Report:
    """Pearson's test in bins that follow the lobes, from several directions; a sample where the density is 0 fails."""
    bsdf = answers(1)
    views_here = views(bsdf.stack, COSINES if quick else (*COSINES, 1.0, 0.7, 0.15))
    limit = -np.log10(significance(len(views_here)))
    worst, text, closer = -1.0, "", ""
    for i, wi in enumerate(views_here):
        number, said = _one(bsdf, wi, 1 << (16 if quick else 20), 100 + i)
        if not number <= worst:
            worst, text = number, f"{said} at cosine {wi[2]:.2f}"
            closer = f"checks.chi2.bins(bsdf, np.array({row(wi)[1:-1]}))"
    return Report.of("chi²", worst, limit, f"{text}; found and limit are -log10 of the probability", closer)


def _one(bsdf: BSDF, wi: np.ndarray, n: int, stream: int) -> tuple[float, str]:
    """-log10 of the p-value for light from wi (3,)."""
    there = np.broadcast_to(wi, (n, 3))
    sample = bsdf.sample(there, numbers(n, stream))
    rough = ~sample.delta & (sample.pdf > 0)
    length = np.linalg.norm(sample.wo, axis=1, keepdims=True)
    # A void sample may have no direction.
    wo = np.where(
        (length > 0.5) | (sample.pdf > 0)[:, None], sample.wo / np.maximum(length, 1e-30), (0, 0, 1)
    )
    density = bsdf.pdf(there, wo)
    if (density < 0).any() or (sample.pdf < 0).any():
        return np.inf, "the density is negative"
    if ((sample.pdf <= 0) & (sample.weight > 0).any(axis=1)).any():
        return np.inf, "samples of no density carry light"
    if (density[rough] <= 0).any():
        return np.inf, f"{np.count_nonzero(density[rough] <= 0)} samples lie where the density is 0"
    # A sample on the very horizon may round to the other side; one in a thousand may not.
    differs = np.abs(density[rough] / sample.pdf[rough] - 1) > 0.05
    if np.mean(differs) > 1e-3 if differs.size else False:
        return np.inf, f"sample and pdf give different densities for {np.count_nonzero(differs)} samples"
    found, wanted = _counted(bsdf, wi, sample)
    # What is void, and what the innermost ring leaves out.
    found = np.append(found, n - found.sum())
    wanted = np.append(wanted, max(n - wanted.sum(), 1e-9 * n))
    p = chi2_p_value(found, wanted)
    return -np.log10(max(p, 1e-300)), f"lowest p-value {p:.3g} in {len(found)} bins of {n} samples"


def bins(bsdf: BSDF, wi: np.ndarray, n: int = 1 << 18) -> np.ndarray:
    """The ten bins that are furthest off for light from wi (3,): direction of their middle, counts, what was expected.

    Returns:
        (10, 5): x, y, z, found, expected.
    """
    sample = bsdf.sample(np.broadcast_to(wi, (n, 3)), numbers(n, 100))
    found, wanted = _counted(bsdf, wi, sample)
    s, phi = (x.ravel() for x in np.meshgrid(*_middles(), indexing="ij"))
    middles = []
    for patch in patches(bsdf.stack, wi):
        middles += [patch.directions(s, phi)[0], np.array([patch.axis])]  # the last is that of the delta part
    worst = np.argsort(-np.square(found - wanted) / np.maximum(wanted, 1))[:10]
    return np.column_stack([np.concatenate(middles)[worst], found[worst], wanted[worst]])


def _counted(bsdf: BSDF, wi: np.ndarray, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Samples in each bin and those expected: for each hemisphere the bins of `SHAPE` and one of its delta part."""
    n, rough = len(sample.pdf), ~sample.delta & (sample.pdf > 0)
    counts, expected = [], []
    for patch, probability in zip(patches(bsdf.stack, wi), delta_parts(bsdf, wi), strict=False):
        side = (sample.wo[:, 2] > 0) == patch.up
        counts.append(np.bincount(patch.bins(sample.wo[rough & side], SHAPE), minlength=SHAPE[0] * SHAPE[1]))
        expected.append(n * integrate(lambda wo: bsdf.pdf(wi[None], wo), patch, SHAPE)[0])
        counts.append(np.array([np.count_nonzero(sample.delta & side)]))
        expected.append(np.array([n * probability]))
    return np.concatenate(counts), np.concatenate(expected)


def _middles() -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the middles of the bins (`sphere.Patch.bins`)."""
    i, j = ((np.arange(n) + 0.5) / n for n in SHAPE)
    return INNERMOST * (1 - i) ** SKEW, 2 * np.pi * (j - 0.5)
