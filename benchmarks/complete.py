"""What scattering between the facets costs: each complete interface beside single scattering, alone and as a coat.

Evaluation and sampling of the same directions, in turn, as in `evaluation`. What single scattering loses is the part of
uniform diffuse light that a lossless interface neither reflects nor transmits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clock import in_turn, spread
from evaluation import directions

TITLE = "Scattering between the facets"
ALPHAS = (0.1, 0.3, 1.0)
HOW: tuple[Any, ...] = (False, "compensated", "walk")


def stacks(alpha: float, how: Any) -> dict[str, Any]:
    """The three cases at one roughness."""
    import urushi as ur

    metal = ur.Conductor(material="Au", alpha=alpha, multiple_scattering=how)
    glass = ur.Dielectric(ior=1.5, alpha=alpha, multiple_scattering=how)
    return {
        "gold": ur.Stack(layers=[metal]),
        "glass": ur.Stack(layers=[glass]),
        "coat over diffuse 0.5": ur.Stack(layers=[glass, ur.Diffuse(reflectance=0.5)]),
    }


def measure(quick: bool) -> dict[str, Any]:
    """Core-nanoseconds, ratios to single scattering, and the light that single scattering loses."""
    import drjit as dr
    import mitsuba as mi

    import urushi as ur

    pairs, rounds = (200_000, 3) if quick else (1_000_000, 11)
    wi, wo = directions(mi, pairs, 1), directions(mi, pairs, 2)
    u = mi.Point3f(np.random.default_rng(3).random((3, pairs)).astype(np.float32))
    dr.eval(wi, wo, u)
    scale = dr.thread_count() / pairs * 1e9
    found: dict[str, Any] = {"pairs": pairs, "rounds": rounds, "cases": {}}
    for alpha in ALPHAS:
        runs: dict[str, Any] = {}
        for how in HOW:
            for name, stack in stacks(alpha, how).items():
                bsdf = ur.solve(stack, method="walk", samples=1)
                runs[f"{name}/{how}/eval"] = lambda bsdf=bsdf: bsdf.eval(wi, wo)
                runs[f"{name}/{how}/sample"] = lambda bsdf=bsdf: tuple(vars(bsdf.sample(wi, u)).values())[:3]
        times = in_turn(runs, rounds)
        for name in stacks(alpha, False):
            for how in HOW:
                for what in ("eval", "sample"):
                    key = f"{name}/{how}/{what}"
                    middle, low, high = spread(times[key] / times[f"{name}/False/{what}"])
                    found["cases"][f"{key}/{alpha:g}"] = {
                        "ns": float(np.median(times[key])) * scale,
                        "ratio": middle,
                        "quartiles": [low, high],
                    }
    found["lost"] = lost()
    return found


def lost() -> dict[str, list[float]]:
    """Part of uniform diffuse light that single scattering loses, for a perfect mirror and for glass."""
    import urushi as ur

    u = (np.arange(64) + 0.5) / 64
    cos = np.sqrt(u)  # cosine-distributed
    wi = np.stack([np.sqrt(1 - u), 0 * cos, cos], axis=1)
    found: dict[str, list[float]] = {"mirror": [], "glass": []}
    for alpha in ALPHAS:
        mirror = ur.solve(ur.Stack(layers=[ur.Conductor(material="none", alpha=alpha)]), "walk", samples=4096)
        glass = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=alpha)]), "walk", samples=4096)
        found["mirror"].append(1 - float(np.mean(mirror.reflectance(wi))))
        found["glass"].append(1 - float(np.mean(glass.reflectance(wi) + glass.transmittance(wi))))
    return found


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    lines = [
        f"One sample over {found['pairs']:,} pairs of directions; the median of {found['rounds']} rounds. In times the "
        "cost of single scattering, whose own core-ns stand in the first row of each group.",
        "",
        "| case | α | lost by single scattering | | eval | sample |",
        "|---|---:|---:|---|---:|---:|",
    ]
    for name in stacks(0.1, False):
        for i, alpha in enumerate(ALPHAS):
            loss = found["lost"]["mirror" if name == "gold" else "glass"][i]
            for how in HOW:
                one = [found["cases"][f"{name}/{how}/{what}/{alpha:g}"] for what in ("eval", "sample")]
                first = how is False
                cells = [f"{x['ns']:.1f} ns" if first else f"{x['ratio']:.2f} ×" for x in one]
                head = f"| {name} | {alpha:g} | {100 * loss:.1f} % |" if first else "| | | |"
                lines.append(f"{head} {'single' if first else how} | {cells[0]} | {cells[1]} |")
    return lines
