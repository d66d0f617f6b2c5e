"""Brushed metal bare and under lacquer: how stretched its highlight is, and what the lacquer does to it."""

from __future__ import annotations

import numpy as np
from gallery import directions, photograph, plugin, run, show, style, titled

import urushi as ur
from urushi.adapters.scene import scene

LACQUER = [ur.Dielectric(ior=1.5), ur.load("preset:brushed-metal-lacquer").layers[1]]
KINDS = {"1 : 1": (1, 0), "3 : 1": (3, 0), "10 : 1": (10, 0), "10 : 1, turned": (10, 90)}
LOOKS = {"bare": (style.BLUE, "-"), "lacquered": (style.VERMILION, style.DASHES[1])}


def stack(ratio: float, turned: float, name: str) -> ur.Stack:
    """Nickel with brush marks along u: rougher across them by the ratio, with the same product of both."""
    alpha = (0.1 / ratio**0.5, 0.1 * ratio**0.5)
    metal = ur.Conductor(material="Ni_palik", alpha=alpha, rotation=turned)
    return ur.Stack(layers=[*(LACQUER if name == "lacquered" else []), metal])


def width(degrees: np.ndarray, values: np.ndarray) -> float:
    """Full width at half of the highest value."""
    top, half = int(values.argmax()), 0.5 * values.max()
    left = np.interp(half, values[: top + 1], degrees[: top + 1])
    return float(np.interp(-half, -values[top:], degrees[top:]) - left)


def draw(quick: bool) -> style.Figure:
    figure = style.figure(10, 8.2)
    grid = figure.add_gridspec(3, 4, height_ratios=(1, 1, 0.95))
    for column, (kind, (ratio, turned)) in enumerate(KINDS.items()):
        for row, name in enumerate(LOOKS):
            axes, size = figure.add_subplot(grid[row, column]), (40, 40) if quick else (330, 330)
            hero = scene(plugin(stack(ratio, turned, name)), size=size)
            show(axes, photograph(hero, 4 if quick else 80), f"{kind}, {name}")
    exits, widths = np.linspace(-85, 85, 171 if quick else 681), []
    for column, (plane, phi) in enumerate({"along": 0, "across": 90}.items()):
        axes, wo = figure.add_subplot(grid[2, 2 * column : 2 * column + 2]), directions(exits)
        wo = wo @ np.array([[np.cos(np.radians(phi)), np.sin(np.radians(phi)), 0], [0, 0, 0], [0, 0, 1]])
        for name, (colour, dash) in LOOKS.items():
            bsdf = ur.solve(stack(10, 0, name), "walk", samples=1 << (8 if quick else 12))
            values = bsdf.eval(directions(0), wo)[:, 0]
            widths.append(width(exits, values))
            axes.plot(exits, values, color=colour, ls=dash, label=f"{name}: {widths[-1]:.1f}° wide")
        axes.set(title=f"10 : 1, light from 0°, in the plane {plane} the marks", ylim=(0, None))
        axes.set(xlabel="exit angle (degrees)", ylabel="" if column else "f cos θ, red (1/sr)")
        axes.legend(loc="upper right")
    along, across = widths[1] / widths[0], widths[3] / widths[2]
    text = f"Lacquer widens the lobe of brushed nickel {along:.2f} times along the marks and {across:.2f} times across"
    below = f"Small angles grow by its index, {LACQUER[0].ior}; so highlights stay stretched, and get softer"
    return titled(figure, text, below)


if __name__ == "__main__":
    run(draw)
