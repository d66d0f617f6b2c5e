"""Reciprocity: light that goes one way could have come the other (Helmholtz).

Without the eta^2 of radiance, f(wi, wo) / n_o^2 is the same both ways, so f as radiance sees it, which carries
(n_i / n_o)^2, differs between the ways by n_i^2 / n_o^2. On one side of the surface that is 1.
"""

from __future__ import annotations

import numpy as np

from .chance import numbers, sigmas
from .report import Answers, Report, row
from .sphere import direction, mirrored, radiance, straight

#: relative rounding of single precision, near the sharpest lobes
ROUNDING = 3e-3
#: relative standard error of what claims to have none
SURE = 3e-4


def check(answers: Answers, quick: bool) -> Report:
    """f(wi, wo) against f(wo, wi) at random pairs of directions, on one side and across."""
    bsdf = answers(4096 if quick else 65536)
    wi, wo = _pairs(bsdf.stack, 32 if quick else 128)
    there, there_error = bsdf.eval(wi, wo, with_error=True)
    back, back_error = bsdf.eval(wo, wi, with_error=True)
    cos_o, cos_i = np.abs(wo[:, 2:]), np.abs(wi[:, 2:])
    # f(wi, wo) = f(wo, wi) n_i^2 / n_o^2, both as radiance.
    factor = radiance(bsdf.stack, wi, wo)[:, None]
    one, one_error = there / cos_o, there_error / cos_o
    other, other_error = factor * back / cos_i, factor * back_error / cos_i
    largest = np.maximum(np.abs(one), np.abs(other))
    error = np.hypot(np.hypot(one_error, other_error), SURE * largest)
    off = np.maximum(np.abs(one - other) - ROUNDING * largest - 1e-7, 0)
    off[~np.isfinite(one - other)] = np.inf
    z = np.where(off > 0, off / np.maximum(error, 1e-30), 0)
    limit = sigmas(z.size)
    i, c = np.unravel_index(np.argmax(z), z.shape)
    way = "reflected" if wi[i, 2] * wo[i, 2] > 0 else "transmitted"
    text = (
        f"worst of {len(wi)} pairs, {way}: f is {one[i, c]:.4g} one way and {other[i, c]:.4g} the other "
        f"(± {error[i, c]:.1g}); found and limit are standard errors"
    )
    a, b = row(wi[i]), row(wo[i])
    scale = ", n_wi^2 / n_wo^2 apart" if factor[i, 0] != 1 else ""
    closer = f"bsdf.eval({a}, {b}) / {abs(wo[i, 2]):.6g}, bsdf.eval({b}, {a}) / {abs(wi[i, 2]):.6g}"
    closer += f"  # f both ways{scale}"
    claimed = bsdf.diagnostics.get("reciprocal") is not False
    if not claimed:
        text += "; this form of the BSDF does not claim to be reciprocal"
    return Report.of("reciprocity", z[i, c], limit, text, closer, claimed)


def _pairs(stack: object, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Half of them anywhere, half near the mirror or the straight direction; on all sides that light gets to."""
    u, v = numbers(n, 1), numbers(n, 2)
    wi = direction(0.05 + 0.95 * u[:, 0], 2 * np.pi * u[:, 1])
    wo = direction(0.05 + 0.95 * v[:, 0], 2 * np.pi * v[:, 1])
    near = np.arange(n) % 2 == 0
    if stack.layers[-1].opaque:  # type: ignore[attr-defined]
        return wi, np.where(near[:, None], _beside(mirrored(wi), v), wo)
    kind = np.arange(n) // 2 % 4  # above to above, above to below, below to below, below to above
    wi[kind >= 2, 2] *= -1
    crosses = (kind % 2 == 1)[:, None]
    wo[:, 2] *= np.sign(wi[:, 2]) * np.where(crosses[:, 0], -1, 1)
    through = np.stack([straight(stack, w) for w in wi])  # type: ignore[arg-type]
    centre = np.where(crosses, through, mirrored(wi))
    return wi, np.where(near[:, None], _beside(centre, v), wo)


def _beside(w: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Directions beside `w`, at most about three degrees away, and never nearer to the horizon than that."""
    sign = np.where(w[:, 2] < 0, -1, 1)
    moved = w + 0.1 * (u - 0.5)
    moved[:, 2] = sign * np.maximum(np.abs(moved[:, 2]), 0.05)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)
