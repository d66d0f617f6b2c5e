"""Every answer is a finite number, and none is negative: in all directions, at the horizon and at the poles."""

from __future__ import annotations

import numpy as np

from .chance import numbers
from .report import Answers, Report
from .sphere import direction, mirrored

#: cosines where formulas divide by what vanishes
EDGES = np.array([1.0, -1.0, 0.0, -0.0, 1e-6, -1e-6, 1e-3, -1e-3, 1e-30, -1e-30, 1 - 1e-7, -1 + 1e-7])


def check(answers: Answers, quick: bool) -> Report:
    """`eval`, `pdf`, `sample`, `reflectance` and `transmittance` at random and at extreme directions."""
    bsdf = answers(1)
    wi, wo, u = directions(4096 if quick else 1 << 18)
    found: dict[str, np.ndarray] = {"eval": bsdf.eval(wi, wo), "pdf": bsdf.pdf(wi, wo)}
    sample = bsdf.sample(wi, u)
    found |= {"sample weight": sample.weight, "sample pdf": sample.pdf}
    found |= {"reflectance": bsdf.reflectance(wi), "transmittance": bsdf.transmittance(wi)}
    length = np.linalg.norm(sample.wo, axis=1)
    # A void sample has no direction; everything else has one of length 1.
    found["sample direction"] = np.where((np.abs(length - 1) < 1e-3) | (sample.pdf <= 0), 1.0, np.nan)
    bad = {
        name: ~(np.isfinite(value) & (value >= 0)).reshape(len(wi), -1).all(axis=1)
        for name, value in found.items()
    }
    count = sum(int(np.count_nonzero(rows)) for rows in bad.values())
    text = f"{len(wi)} pairs of directions, {np.count_nonzero(np.abs(wi[:, 2]) < 1e-2)} of them grazing"
    for name, rows in bad.items():
        if rows.any():
            i = int(np.argmax(rows))
            values = np.ravel(found[name][i]).tolist()
            text += (
                f"; {name} is {values} at wi={wi[i].tolist()}, wo={wo[i].tolist()}, u={u[i].tolist()}, "
                f"and wrong in {np.count_nonzero(rows)} places"
            )
    return Report.of("finite and not negative", count, 0, text)


def directions(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi, wo and random numbers: every pair of extreme cosines in several azimuths, then random ones."""
    phi = np.array([0.0, 0.4, np.pi])
    a, b, turn = (grid.ravel() for grid in np.meshgrid(EDGES, EDGES, phi, indexing="ij"))
    u, v, w = numbers(n, 3), numbers(n, 4), numbers(n + len(a), 5)
    # Half of the random ones are grazing; log-uniform there.
    cos = np.where(np.arange(n) % 2 == 0, 2 * u[:, 0] - 1, np.sign(u[:, 0] - 0.5) * 10.0 ** (-8 * u[:, 2]))
    far = np.where(np.arange(n) % 4 < 2, 2 * v[:, 0] - 1, np.sign(v[:, 0] - 0.5) * 10.0 ** (-8 * v[:, 2]))
    wi = np.concatenate([direction(a, 0.4), direction(cos, 2 * np.pi * u[:, 1])])
    wo = np.concatenate([direction(b, 0.4 + turn), direction(far, 2 * np.pi * v[:, 1])])
    # Some exactly in the mirror direction, and some exactly back.
    wo[len(a) :: 8] = mirrored(wi[len(a) :: 8])
    wo[len(a) + 1 :: 8] = wi[len(a) + 1 :: 8]
    wo[len(a) + 2 :: 8] = -wi[len(a) + 2 :: 8]
    # Random numbers at the ends of their range, too.
    w[: len(a)] = np.round(w[: len(a)]) * (1 - 2.0**-24)
    return wi, wo, w
