"""What a picture costs: the built-in scene with `layered`, relative to the same with a plugin of Mitsuba's own."""

from __future__ import annotations

from typing import Any

import numpy as np

from clock import in_turn, spread

TITLE = "Renders"
PASS = 8
"""Samples per pixel of one pass."""

PLASTIC = {"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": 0.5}
GLASS = {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.5168, "ext_ior": 1.0, "distribution": "ggx"}
AGAINST = {
    "plastic": "roughplastic",
    "enamel-on-gold": "roughplastic",
    "car-paint": "roughplastic",
    "frosted-glass": "roughdielectric",
}


def measure(quick: bool) -> dict[str, Any]:
    """Seconds and ratios for each preset; every pass of one is followed by a pass of the next."""
    import mitsuba as mi

    import urushi.mitsuba  # noqa: F401 (registers the plugin)
    from urushi.adapters.scene import scene

    size, rounds = (128, 2) if quick else (512, 8)
    materials: dict[str, dict[str, Any]] = {"roughplastic": PLASTIC, "roughdielectric": GLASS}
    materials |= {name: {"type": "layered", "filename": f"preset:{name}"} for name in AGAINST}
    runs = {}
    for name, bsdf in materials.items():
        loaded = mi.load_dict(scene(bsdf, size=(size, size)))
        runs[name] = lambda loaded=loaded: mi.render(loaded, spp=PASS, seed=1)
    times = in_turn(runs, rounds)
    found: dict[str, Any] = {"size": size, "spp": PASS * rounds, "cases": {}}
    found["seconds"] = {name: float(np.sum(value)) for name, value in times.items()}
    for name, other in AGAINST.items():
        middle, low, high = spread(times[name] / times[other])
        found["cases"][name] = {"against": other, "ratio": middle, "quartiles": [low, high]}
    return found


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    lines = [
        f"The built-in scene at {found['size']}×{found['size']}, {found['spp']} samples per pixel in passes of {PASS}, "
        "kernels warm, the passes of all scenes in turn. A pane of frosted glass on a closed ball and a solid ball of "
        "`roughdielectric` are crossed equally often, but light takes other ways through them.",
        "",
        "| preset | seconds | against | ratio (quartiles) |",
        "|---|---:|---|---:|",
    ]
    for name, one in found["cases"].items():
        low, high = one["quartiles"]
        seconds = found["seconds"]
        lines.append(
            f"| {name} | {seconds[name]:.1f} | `{one['against']}`, {seconds[one['against']]:.1f} s | "
            f"{one['ratio']:.2f} ({low:.2f} to {high:.2f}) |"
        )
    return lines
