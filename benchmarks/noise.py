"""How noisy one evaluation is, and what that makes of its cost.

The relative standard deviation of one sample at six pairs of directions, beside that of pbrt-v4; and the efficiency,
one over variance times cost, relative to pbrt's, as the geometric mean over the six.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cases import CASES, ROWS

TITLE = "Noise of one evaluation"


def measure(quick: bool) -> dict[str, Any]:
    """Relative standard deviations of every case, and their ratios to pbrt's."""
    import urushi as ur

    samples = 1 << (14 if quick else 18)
    wi, wo = _pairs()
    found: dict[str, Any] = {"samples": samples, "cases": {}}
    for case in CASES:
        bsdf = ur.solve(case.stack(), method="walk", samples=samples)
        value, error = bsdf.eval(wi, wo, with_error=True)
        noise = error[:, 0] * np.sqrt(samples) / value[:, 0]
        found["cases"][case.label] = {
            "noise": [float(x) for x in noise],
            "ratios": [float(x) for x in noise / np.array(case.pbrt_noise)],
        }
    return found


def _pairs() -> tuple[np.ndarray, np.ndarray]:
    theta_i, theta_o, phi = np.radians(np.array(ROWS, dtype=float).T)
    wi = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], axis=1)
    wo = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)], axis=1)
    return wi, wo


def gains(found: dict[str, Any], costs: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Efficiency relative to pbrt's, by core time and by yardsticks.

    Args:
        found: what `measure` returned.
        costs: what `evaluation.measure` returned.
    """
    gained = {}
    for case in CASES:
        variance = float(np.exp(np.mean(2 * np.log(found["cases"][case.label]["ratios"]))))
        cost = costs["cases"][case.label]
        gained[case.label] = {
            "variance": 1 / variance,
            "by_ns": case.pbrt_ns / cost["ns"] / variance,
            "by_yardsticks": case.pbrt_yardsticks / cost["yardsticks"] / variance,
        }
    return gained


def table(found: dict[str, Any], gained: dict[str, Any] | None) -> list[str]:
    """Markdown; the efficiency (of `gains`) only where the cost has been measured."""
    head = "| θi, θo, φ |" + "".join(f" {c.label} | pbrt | ratio |" for c in CASES)
    lines = [
        f"Relative standard deviation of one sample, from {found['samples']:,} of them; φ = 180° is the side of the "
        "mirror direction.",
        "",
        head,
        "|---|" + "---:|---:|---:|" * len(CASES),
    ]
    for i, row in enumerate(ROWS):
        cells = ""
        for case in CASES:
            one = found["cases"][case.label]
            cells += f" {one['noise'][i]:.3f} | {case.pbrt_noise[i]:.3f} | {one['ratios'][i]:.2f} |"
        lines.append(f"| {row[0]}°, {row[1]}°, {row[2]}° |{cells}")
    if gained is None:
        return lines
    lines += [
        "",
        "Efficiency, 1 / (variance × cost), relative to pbrt's; geometric means over the six rows.",
        "",
        "| case | variance alone | with cost in yardsticks | with cost in core-ns (two machines) |",
        "|---|---:|---:|---:|",
    ]
    for case in CASES:
        one = gained[case.label]
        lines.append(
            f"| {case.label} {case.words} | {one['variance']:.1f} × | {one['by_yardsticks']:.0f} × | "
            f"{one['by_ns']:.0f} × |"
        )
    return lines
