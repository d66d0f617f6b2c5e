"""A skin-like stack taken apart: what each layer does alone, what all do together, and what the surface adds."""

from __future__ import annotations

from typing import Any

import numpy as np
from gallery import directions, labelled, run, style, titled

import urushi as ur
from urushi.plot.colour import code

COLOURS = {"red": style.VERMILION, "green": style.GREEN, "blue": style.BLUE}
NAMES = ("surface", "epidermis", "dermis", "fat below")


def bars(axes: Any, at: int, heights: np.ndarray, start: Any = (0, 0, 0), **look: Any) -> None:
    """Three bars side by side, one for each colour."""
    for j, (word, hue) in enumerate(COLOURS.items()):
        own = {"color": hue, "label": None if at else word, "edgecolor": hue, **look}
        axes.bar(at + 0.26 * (j - 1), heights[j], 0.24, start[j], **own)


def draw(quick: bool) -> style.Figure:
    skin, wi, built = ur.load("preset:skin"), directions(0), []
    options = {"method": "adding", "accuracy": 1e-2 if quick else 1e-3}
    (alone, stacked), (together, lobes) = (figure := style.figure(10, 6.8)).subplots(2, 2)
    for k, layer in enumerate(skin.layers):
        index = 1.4 if k else 1.0  # inside, tissue lies on both sides
        bsdf = ur.solve(ur.Stack(exterior=index, layers=[layer]), **options)
        r, t = bsdf.reflectance(wi)[0], bsdf.transmittance(wi)[0]
        bars(alone, k, r, label=None)
        bars(alone, k, t, r, color="white", hatch="////", label=None)
        built.append(ur.solve(ur.Stack(exterior=index, layers=skin.layers[k:]), **options).reflectance(wi)[0])
        bars(stacked, 3 - k, built[k], label=None)
        stacked.plot(3 - k, 0.91, "s", ms=26, color=code(built[k]))
    book = ur.solve(skin, **options).absorption(wi)
    for k, share in enumerate((book.reflected, book.lost[0], *book.absorbed[1:])):
        bars(together, k, share[0])
    exits = np.linspace(-85, 85, 35 if quick else 171)
    for alpha, dash in zip((0.15, 0.35, 0.6), style.DASHES, strict=False):
        rough = ur.solve(skin.replace({"layer_0.alpha": alpha}), **options)
        red = rough.eval(directions(-60), directions(exits))[:, 0]
        lobes.plot(exits, red, color=style.VERMILION, ls=dash, label=f"alpha {alpha}")
    alone.set_xticks(range(4), NAMES)
    stacked.set_xticks(range(4), [NAMES[3], *(f"+ {name}" for name in NAMES[2::-1])])
    together.set_xticks(range(5), ["reflected", "lost at\nsurface", *(f"absorbed,\n{n}" for n in NAMES[1:])])
    look = {"y": "share of the light", "ylim": (0, 1.03)}
    labelled(alone, "each layer alone: reflected (filled), transmitted (hatched)", **look)
    labelled(stacked, "put together from below: reflected, and its colour", **look)
    labelled(together, "all together: where the light goes", **look)
    labelled(lobes, "roughness of the surface, light from 60°", "exit angle (degrees)", "f cos θ, red (1/sr)")
    red, green, _ = (f"{x:.0%}" for x in book.absorbed[2, 0])
    text = f"Skin apart: the dermis with its blood absorbs {green} of green and {red} of red light"
    below = f"The surface sends light back in: with it {built[0][0]:.0%} of red comes out, without {built[1][0]:.0%}"
    return titled(figure, text, below)


if __name__ == "__main__":
    run(draw)
