"""Varnished wood: its relief in the wood under a level varnish, in the varnish only, and in both."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from gallery import directions, look_at, normal_map, photograph, plugin, run, show, style, titled
from PIL import Image
from scipy.ndimage import zoom

import urushi as ur
from urushi.adapters.scene import scene

_, AMBER, WOOD = ur.load("preset:varnished-wood").layers
VARNISH = ur.Dielectric(ior=1.52, alpha=0.04, normal=(0, 0, 1))
BASE = ur.Diffuse(reflectance=[0.5, 0.33, 0.18], normal=(0, 0, 1))  # the wood's mean
DEEP = 0.03  # how far black lies below white, in radii of the ball
WHERE = {"level": (), "relief in the wood": (2,), "relief in the varnish": (0,), "relief in both": (0, 2)}


def relief(finer: int) -> np.ndarray:
    """Slopes (H, W, 2) of the wood's surface: what is dark, pores and late wood, lies deeper."""
    with Image.open(WOOD.reflectance.file) as image:
        height = DEEP * zoom(np.asarray(image.convert("L")) / 255, finer, mode="grid-wrap", grid_mode=True)
    steps = [np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)]
    return np.stack(steps, axis=2) * np.divide(height.shape[::-1], 2 * np.array([2 * np.pi, 3.9]))


def changes(slopes: np.ndarray, layer: int, wo: np.ndarray, samples: int) -> float:
    """How much the light from 45° varies over the relief if it is in one layer: rms, as a share of the mean."""
    few = slopes.reshape(-1, 2)[:: slopes.size // 4000]
    given = {f"layer_{layer}.normal": np.concatenate([-few, np.ones((len(few), 1))], axis=1)}
    stack = ur.Stack(layers=[VARNISH, AMBER, BASE])
    bsdf = ur.solve(stack, "walk", samples=samples, parameters=given)
    seen = bsdf.eval(np.repeat(directions(45), len(few), 0), np.repeat(wo, len(few), 0))[:, 1]
    return float(seen.std() / seen.mean())


def draw(quick: bool) -> style.Figure:
    slopes, figure = relief(1 if quick else 4), style.figure(10, 3.3)
    stack = ur.Stack(layers=[VARNISH, AMBER, WOOD])
    for axes, (name, layers) in zip(figure.subplots(1, 4), WHERE.items(), strict=True):
        with tempfile.TemporaryDirectory() as folder:
            given = {f"layer_{i}.normal": normal_map(slopes, Path(folder, "relief.png")) for i in layers}
            bsdf = plugin(stack.replace(given))
        view = scene(bsdf, size=(40, 40) if quick else (370, 370))
        look_at(view, [0, -7.4, 3.1], [0, 0, 1.15], fov=16.5)
        show(axes, photograph(view, 4 if quick else 192), name)
    n = 64 if quick else 1024
    (a, b), (c, d) = ([changes(slopes, i, directions(out), n) for out in (-45, 0)] for i in (2, 0))
    text = f"Relief in the wood varies the highlight by {a:.0%}, the colour beside it by {b:.0%}"
    return titled(
        figure, text, f"Relief in the varnish varies the highlight by {c:.0%}, the colour by {d:.0%}"
    )


if __name__ == "__main__":
    run(draw)
