"""Enamel on engraved gold (basse-taille), thin to thick, between the gold alone and the enamel alone."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from gallery import evenly, look_at, mitsuba, normal_map, photograph, plugin, run, show, style, titled

import urushi as ur
from urushi.adapters import lathe
from urushi.adapters.scene import scene

COAT, GLASS, GOLD = ur.load("preset:enamel-on-gold").layers
THICK = {x: GLASS.model_copy(update={"depth": tuple(x * d for d in GLASS.depth)}) for x in (0.25, 1, 6)}
STACKS = {"gold alone": [GOLD]} | {f"enamel, depth × {x}": [COAT, THICK[x], GOLD] for x in THICK}
STACKS["enamel over black"] = [COAT, GLASS, ur.Diffuse(reflectance=0.0)]


def engraving(n: int) -> np.ndarray:
    """Slopes (n, 2 n, 2) of waves that an engine turns around an egg; they fade towards its ends."""
    v, u = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) / (2 * n), indexing="ij")
    across = 0.28 * np.sin(np.pi * v) * np.sin(2 * np.pi * (30 * u + 0.55 * np.sin(18 * np.pi * v)))
    return np.stack([across, 1.25 * across * np.cos(18 * np.pi * v)], axis=2)


def eggs(folder: Path, size: tuple[int, int]) -> dict[str, object]:
    """The built-in scene with an egg of each material on a stand."""
    theta, to = np.linspace(0, np.pi, 512), mitsuba().ScalarTransform4f()
    egg = np.stack([0.76 * np.sin(theta) * (1 - 0.15 * np.cos(theta)), np.cos(theta)], axis=1)
    lathe.write_ply(folder / "egg.ply", *lathe.revolve(egg))
    normal, made = normal_map(engraving(size[0] * 4 // 5), folder / "map.png"), scene({}, size=size)
    stand, _ = made.pop("stand"), made.pop("hero")
    for i, layers in enumerate(STACKS.values()):
        at = to.translate([0.95 * (i - 2), 0, 0]).scale(0.6)
        bsdf = plugin(ur.Stack(layers=layers).replace({f"layer_{len(layers) - 1}.normal": normal}))
        shape = {"type": "ply", "filename": str(folder / "egg.ply"), "to_world": at.translate([0, 0, 1.12])}
        made |= {f"egg_{i}": shape | {"bsdf": bsdf}, f"stand_{i}": stand | {"to_world": at}}
    look_at(made, [0, -7.4, 2.7], [0, 0, 0.62], fov=13)
    return made


def draw(quick: bool) -> style.Figure:
    with tempfile.TemporaryDirectory() as folder:
        image = photograph(eggs(Path(folder), (124, 43) if quick else (1240, 430)), 4 if quick else 160)
    axes, shares = (figure := style.figure(9.5, 4.4)).add_subplot(), []
    for i, (name, layers) in enumerate(STACKS.items()):
        shares.append(evenly(ur.solve(ur.Stack(layers=layers), "walk", samples=1 << (12 if quick else 16))))
        text, x = "{}\nR {:.0%}, G {:.0%}, B {:.0%}".format(name, *shares[-1]), 0.5 + 0.188 * (i - 2)
        axes.text(x, 0.11, text, ha="center", va="top", transform=axes.transAxes)
    show(axes, image)
    axes.set_ylim(1.17 * len(image), 0)
    (red, green, _), black = shares[2], shares[-1][0]
    text = f"Ruby enamel on gold sends back {red:.0%} of red light and {green:.0%} of green"
    return titled(figure, text, f"Over black it sends back {black:.0%} of red: what glows is the gold below")


if __name__ == "__main__":
    run(draw)
