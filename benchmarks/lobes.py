"""What lobes cost in a picture and alone, and how much of the walk buys what they are off by.

A picture is the built-in scene, as in `pictures`. Alone, eval is called on random pairs of directions. How far lobes
are off is the relative error, against adding, at directions that lobes sample; there the walk has as much noise with
variance / bias^2 samples. Of both, medians. With a texture on the coat the recursion runs at every point, not at load.
"""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np

from clock import in_turn, spread
from evaluation import directions
from pictures import PASS, PLASTIC

TITLE = "Lobes"
#: what one may cost in a picture, in `roughplastic`
GOALS = {"coat on diffuse": 1.3, "coat on metal": 1.3, "three interfaces, two media": 2.0}
#: the last of them with a texture, of which a picture is made
TEXTURED = "the same, textured"
#: accuracy of the solution by adding
TRUTH = 1e-3
#: samples that the variance of the walk is taken from
SAMPLES = 64


def stacks() -> dict[str, Any]:
    """What is measured, by the names of `GOALS`."""
    import urushi as ur

    coat, metal = ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(eta=0.2, k=3.9, alpha=0.2)
    absorbing = ur.Medium(depth=0.3, albedo=0.0)
    hazy = ur.Medium(depth=0.3, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.7))
    layers: tuple[list[Any], ...] = (
        [coat, ur.Diffuse(reflectance=0.5)],
        [coat, metal],
        [coat, absorbing, ur.Dielectric(ior=1.8, alpha=0.2), hazy, metal],
    )
    return {name: ur.Stack(name=name, layers=one) for name, one in zip(GOALS, layers, strict=True)}


def measure(quick: bool) -> dict[str, Any]:
    """Ratios of pictures, costs of evaluations, and samples of the walk that are as good."""
    found: dict[str, Any] = {name: {} for name in GOALS}
    _pictures(found, quick)
    _evaluations(found, quick)
    for name, stack in stacks().items():
        found[name] |= _worth(stack, 64 if quick else 512)
    return {"cases": found}


def _pictures(found: dict[str, Any], quick: bool) -> None:
    """Renders, in turn with `roughplastic`."""
    import mitsuba as mi

    import urushi as ur
    import urushi.mitsuba
    from urushi.adapters.scene import scene

    size, rounds = (128, 2) if quick else (512, 8)
    runs = {}
    materials: dict[str, dict[str, Any]] = {"roughplastic": PLASTIC}
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, stack) in enumerate(stacks().items()):
            ur.save(stack, f"{folder}/{k}.yaml")
            materials[name] = {"type": "layered", "filename": f"{folder}/{k}.yaml", "method": "lobes"}
        mi.Bitmap(0.05 + 0.2 * np.random.default_rng(1).random((64, 64, 1), "f")).write(f"{folder}/a.exr")
        ur.save(stack.replace({"layer_0.alpha": ur.Texture(f"{folder}/a.exr")}), f"{folder}/t.yaml")
        materials[TEXTURED] = materials[name] | {"filename": f"{folder}/t.yaml"}
        for name, bsdf in materials.items():
            loaded = mi.load_dict(scene(bsdf, size=(size, size)))
            runs[name] = lambda loaded=loaded: mi.render(loaded, spp=PASS, seed=1)
    times = in_turn(runs, rounds)
    for name in (*GOALS, TEXTURED):
        middle, low, high = spread(times[name] / times["roughplastic"])
        found[name] = found.get(name, {}) | {"picture": middle, "quartiles": [low, high]}


def _evaluations(found: dict[str, Any], quick: bool) -> None:
    """Million lobes a second on all threads, and yardsticks of eval by lobes and by the walk."""
    import drjit as dr
    import mitsuba as mi

    import urushi as ur

    pairs, rounds = 2_000_000, 2 if quick else 15
    wi, wo = directions(mi, pairs, 1), directions(mi, pairs, 2)
    si = dr.zeros(mi.SurfaceInteraction3f, pairs)
    si.wi = wi
    dr.eval(si, wo)
    plastic, context = mi.load_dict(PLASTIC), mi.BSDFContext()
    runs = {"yardstick": lambda: plastic.eval(context, si, wo)}
    for name, stack in stacks().items():
        for method in ("lobes", "walk"):
            options = {"samples": 1} if method == "walk" else {}
            bsdf = ur.solve(stack, method=method, **options)
            runs[f"{name} {method}"] = lambda bsdf=bsdf: bsdf.eval(wi, wo)
    times = in_turn(runs, rounds)
    for name, stack in stacks().items():
        count = len(ur.solve(stack, method="lobes").lobes([0.6, 0.0, 0.8]))
        for method in ("lobes", "walk"):
            found[name][method] = float(np.median(times[f"{name} {method}"] / times["yardstick"]))
        found[name] |= {
            "lobes_each": count,
            "million": count * pairs / float(np.median(times[f"{name} lobes"])) / 1e6,
        }


def _worth(stack: Any, pairs: int) -> dict[str, float]:
    """How far lobes are off, and how many samples of the walk are as good."""
    import urushi as ur

    rng = np.random.default_rng(1)
    z, turn = np.sqrt(rng.random(pairs)), 2 * np.pi * rng.random(pairs)
    s = np.sqrt(1 - z**2)
    wi = np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=-1)
    wo = ur.solve(stack, method="lobes").sample(wi, rng.random((pairs, 3))).wo
    truth = ur.solve(stack, method="adding", accuracy=TRUTH).eval(wi, wo)[:, 0]
    lobes = ur.solve(stack, method="lobes").eval(wi, wo)[:, 0]
    _, error = ur.solve(stack, method="walk", samples=SAMPLES).eval(wi, wo, with_error=True)
    bias, variance = np.square(lobes - truth), np.square(error[:, 0]) * SAMPLES
    off = np.median(np.abs(lobes / truth - 1))
    return {"off": float(off), "samples": float(np.median(variance / np.maximum(bias, 1e-12)))}


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    lines = [
        "Pictures in turn with one of `roughplastic`; evaluations in yardsticks. `off` is the median of the "
        "relative error where light goes; the last column says how many samples of the walk have no more.",
        "",
        "| stack | picture (quartiles) | goal | eval | million lobes/s | one sample of the walk | off | samples |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, one in found["cases"].items():
        low, high = one["quartiles"]
        picture = f"| {name} | {one['picture']:.2f} ({low:.2f} to {high:.2f}) |"
        if name not in GOALS:
            lines.append(f"{picture} | | | | | |")
            continue
        met = "met" if one["picture"] <= GOALS[name] else "missed"
        lines.append(
            f"{picture} {GOALS[name]:g}, {met} | {one['lobes']:.1f} | {one['million']:.0f} | {one['walk']:.1f} | "
            f"{100 * one['off']:.0f} % | {one['samples']:.0f} |"
        )
    return lines
