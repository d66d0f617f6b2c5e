"""What one evaluation costs: one walk, one sample, over random pairs of directions.

Both directions are cosine-distributed on the upper hemisphere; arrays stay Dr.Jit's, kernels are warm, results are
written out. Core-nanoseconds are wall time x threads / pairs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cases import CASES
from clock import in_turn, spread

TITLE = "Cost of one evaluation"


def measure(quick: bool) -> dict[str, Any]:
    """Core-nanoseconds and yardsticks of every case."""
    import drjit as dr
    import mitsuba as mi

    import urushi as ur

    pairs, rounds = 4_000_000, 3 if quick else 31
    wi, wo = directions(mi, pairs, 1), directions(mi, pairs, 2)
    plastic = mi.load_dict({"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": 0.5})
    si = dr.zeros(mi.SurfaceInteraction3f, pairs)
    si.wi = wi
    dr.eval(si, wo)
    context = mi.BSDFContext()
    solved = {case.label: ur.solve(case.stack(), method="walk", samples=1) for case in CASES}
    runs = {"yardstick": lambda: plastic.eval(context, si, wo)}
    for label, bsdf in solved.items():
        runs[label] = lambda bsdf=bsdf: bsdf.eval(wi, wo)
    times = in_turn(runs, rounds)
    nanoseconds = dr.thread_count() / pairs * 1e9
    found: dict[str, Any] = {"pairs": pairs, "rounds": rounds, "cases": {}}
    found["yardstick_ns"] = float(np.median(times["yardstick"])) * nanoseconds
    for case in CASES:
        middle, low, high = spread(times[case.label] / times["yardstick"])
        found["cases"][case.label] = {
            "ns": float(np.median(times[case.label])) * nanoseconds,
            "yardsticks": middle,
            "quartiles": [low, high],
        }
    return found


def directions(mi: Any, count: int, seed: int) -> Any:
    """Cosine-distributed on the upper hemisphere."""
    import drjit as dr

    u, v = np.random.default_rng(seed).random((2, count)).astype(np.float32)
    w = mi.warp.square_to_cosine_hemisphere(mi.Point2f(mi.Float(u), mi.Float(v)))
    dr.eval(w)
    return w


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    rows = [
        "| case | core-ns | yardsticks (quartiles) | goal | pbrt-v4, yardsticks |",
        "|---|---:|---:|---:|---:|",
    ]
    for case in CASES:
        one = found["cases"][case.label]
        low, high = one["quartiles"]
        met = "met" if one["yardsticks"] <= case.goal else "missed"
        rows.append(
            f"| {case.label} {case.words} | {one['ns']:.0f} | {one['yardsticks']:.1f} ({low:.1f} to {high:.1f}) "
            f"| {case.goal:g}, {met} | {case.pbrt_yardsticks:g} |"
        )
    return [
        f"One walk over {found['pairs']:,} pairs of directions, both cosine-distributed; the median of "
        f"{found['rounds']} rounds.",
        f"A yardstick, one evaluation of `roughplastic` on the same pairs in turn, took {found['yardstick_ns']:.1f} "
        "core-ns.",
        "",
        *rows,
    ]
