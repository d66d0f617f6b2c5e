"""Every answer is a finite number: in all directions, at the horizon and at the poles. A hunt for what is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from urushi.solvers import BSDF

from .chance import numbers
from .report import Answers, Report, row
from .sphere import direction, mirrored

#: cosines where formulas divide by what vanishes
EDGES = np.array([1.0, -1.0, 0.0, -0.0, 1e-6, -1e-6, 1e-3, -1e-3, 1e-30, -1e-30, 1 - 1e-7, -1 + 1e-7])
#: the least cosine that a BSDF from elsewhere is asked for: renderers do not meet less, and Mitsuba's own plugins give
#: a density that is none at 0
GRAZING = 1e-6


def check(answers: Answers, quick: bool) -> Report:
    """`eval`, `pdf`, `sample`, `reflectance` and `transmittance` at random and at extreme directions."""
    return hunt("finite", np.isfinite, answers(1), quick)


def hunt(name: str, right: Callable[[np.ndarray], np.ndarray], bsdf: BSDF, quick: bool) -> Report:
    """Ask everywhere, and count the answers that are not right."""
    foreign = bsdf.stack.layers[0].kind == "bsdf"
    wi, wo, u = directions(4096 if quick else 1 << 18, GRAZING if foreign else 0.0)
    found: dict[str, np.ndarray] = {"eval": bsdf.eval(wi, wo), "pdf": bsdf.pdf(wi, wo)}
    sample = bsdf.sample(wi, u)
    found |= {"sample weight": sample.weight, "sample pdf": sample.pdf}
    found |= {"reflectance": bsdf.reflectance(wi), "transmittance": bsdf.transmittance(wi)}
    length = np.linalg.norm(sample.wo, axis=1)
    # A void sample has no direction; everything else has one of length 1.
    found["sample direction"] = np.where((np.abs(length - 1) < 1e-3) | (sample.pdf <= 0), 1.0, np.nan)
    count, closer = 0, ""
    text = f"{len(wi)} pairs of directions, {np.count_nonzero(np.abs(wi[:, 2]) < 1e-2)} of them grazing"
    for what, value in found.items():
        bad = ~right(value).reshape(len(wi), -1).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            count += int(np.count_nonzero(bad))
            text += (
                f"; {what} is {np.ravel(value[i]).tolist()} at wi={wi[i].tolist()}, wo={wo[i].tolist()}, "
                f"u={u[i].tolist()}, and wrong in {np.count_nonzero(bad)} places"
            )
            other = u[i] if what.startswith("sample") else wo[i]
            arguments = row(wi[i]) if what.endswith("tance") else f"{row(wi[i])}, {row(other)}"
            closer = closer or f"bsdf.{what.split()[0]}({arguments})"
    return Report.of(name, count, 0, text, closer)


def directions(n: int, least: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi, wo and random numbers: every pair of extreme cosines in several azimuths, then random ones.

    No cosine is below `least`.
    """
    edges, decades = EDGES[np.abs(EDGES) >= least], -np.log10(max(least, 1e-8))
    phi = np.array([0.0, 0.4, np.pi])
    a, b, turn = (grid.ravel() for grid in np.meshgrid(edges, edges, phi, indexing="ij"))
    u, v, w = numbers(n, 3), numbers(n, 4), numbers(n + len(a), 5)
    # Half of the random ones are grazing; log-uniform there.
    cos = np.where(
        np.arange(n) % 2 == 0, 2 * u[:, 0] - 1, np.sign(u[:, 0] - 0.5) * 10.0 ** (-decades * u[:, 2])
    )
    far = np.where(
        np.arange(n) % 4 < 2, 2 * v[:, 0] - 1, np.sign(v[:, 0] - 0.5) * 10.0 ** (-decades * v[:, 2])
    )
    wi = np.concatenate([direction(a, 0.4), direction(cos, 2 * np.pi * u[:, 1])])
    wo = np.concatenate([direction(b, 0.4 + turn), direction(far, 2 * np.pi * v[:, 1])])
    # Some exactly in the mirror direction, and some exactly back.
    wo[len(a) :: 8] = mirrored(wi[len(a) :: 8])
    wo[len(a) + 1 :: 8] = wi[len(a) + 1 :: 8]
    wo[len(a) + 2 :: 8] = -wi[len(a) + 2 :: 8]
    # Random numbers at the ends of their range, too.
    w[: len(a)] = np.round(w[: len(a)]) * (1 - 2.0**-24)
    return wi, wo, w
