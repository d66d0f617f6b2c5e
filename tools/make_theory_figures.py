"""Draw the figures of the chapters on theory: docs/theory/*.svg.

    python tools/make_theory_figures.py [FOLDER]

Drawings, not measurements: what they show is computed where a law gives it (Snell's directions, nodes), sketched
where none does.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "theory"
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#666666"  # Okabe & Ito, for any eye
GLASS = "#e8f1f8"


def canvas(width: float, height: float) -> tuple[Any, Any]:
    """A figure and its axes, one unit an inch, nothing drawn."""
    figure = plt.figure(figsize=(width, height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.axis("off")
    return figure, axes


def arrow(axes: Any, start: Any, end: Any, colour: str = BLUE, width: float = 1.6, **how: Any) -> None:
    """A ray of light."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, **how}
    axes.annotate("", end, start, arrowprops=style)


def adding() -> Any:
    """Two layers, and all that happens between them."""
    figure, axes = canvas(7.2, 3.3)
    for low, high, name in ((1.75, 2.25, "layer 1"), (0.55, 1.05, "layer 2")):
        axes.axhspan(low, high, color=GLASS)
        axes.text(0.12, (low + high) / 2, name, va="center", color=GREY)
    x = 1.5
    arrow(axes, (x - 0.45, 3.1), (x, 2.25))
    axes.text(x - 0.55, 3.05, "$x$", ha="right", va="top", color=BLUE)
    for turn in range(3):
        here, there = x + 1.6 * turn, x + 1.6 * turn + 0.8
        width = 1.6 * 0.8**turn
        arrow(axes, (here, 2.25), (here + 0.45, 3.1), ORANGE, width)
        names = ("$R_1$", "$T'_1R_2T_1$", "$T'_1R_2R'_1R_2T_1$")
        axes.text(here + 0.5, 3.02, names[turn], va="center", color=ORANGE)
        arrow(axes, (here + 0.05, 1.75), (there, 1.05), BLUE, width)
        arrow(axes, (there, 0.55), (there + 0.4, 0.08), GREEN, width)
        names = ("$T_2T_1$", "$T_2R'_1R_2T_1$", "")
        axes.text(there + 0.45, 0.15, names[turn], va="center", color=GREEN)
        arrow(axes, (there, 1.05), (there + 0.75, 1.75), BLUE, width * 0.9)
        if turn == 0:
            axes.text(here + 0.3, 1.32, "$d$", ha="right", color=BLUE)
            axes.text(there + 0.42, 1.32, "$u$", ha="left", color=BLUE)
    axes.text(6.75, 1.4, "...", fontsize=16, va="center", ha="center", color=BLUE)
    return figure


def basis() -> Any:
    """Nodes in Snell's invariant: partners on both sides of a smooth interface."""
    figure, axes = canvas(7.2, 4.3)
    n, centre, radius = 1.5, (2.3, 2.15), 1.75
    axes.axhspan(0, centre[1], color=GLASS)
    axes.plot((0, 7.2), (centre[1], centre[1]), color=GREY, lw=1)
    axes.text(0.1, 4.15, "air", va="top", color=GREY)
    axes.text(0.1, 0.12, "glass, index 1.5", color=GREY)
    x = (np.polynomial.legendre.leggauss(5)[0] + 1) / 2
    inner = np.sqrt(1 - 1 / n**2)
    panels = (np.sqrt(1 - (1 - x**4)), inner * x[1:] ** 2)
    shared, own = np.sqrt(np.clip(1 - panels[0] ** 2, 0, 1)), n * np.sqrt(1 - panels[1] ** 2)
    for s in shared:
        up, down = np.arcsin(s), np.arcsin(s / n)
        top = centre[0] - radius * np.sin(up), centre[1] + radius * np.cos(up)
        bottom = centre[0] + radius * np.sin(down), centre[1] - radius * np.cos(down)
        axes.plot((top[0], centre[0], bottom[0]), (top[1], centre[1], bottom[1]), color=BLUE, lw=1.2)
        axes.plot(*top, "o", color=BLUE, ms=5)
        axes.plot(*bottom, "o", color=BLUE, ms=5)
    for s in own:
        down = np.arcsin(s / n)
        bottom = centre[0] + radius * np.sin(down), centre[1] - radius * np.cos(down)
        axes.plot((centre[0], bottom[0]), (centre[1], bottom[1]), color=ORANGE, lw=1.2)
        axes.plot(*bottom, "s", color=ORANGE, ms=5)
    critical = np.arcsin(1 / n)
    edge = centre[0] + 1.97 * np.sin(critical), centre[1] - 1.97 * np.cos(critical)
    axes.plot((centre[0], edge[0]), (centre[1], edge[1]), "--", color=GREY, lw=1)
    axes.text(edge[0] + 0.05, edge[1], "critical angle", va="center", color=GREY)
    left, wide = 5.0, 1.25
    axes.plot((left, left + 1.5 * wide), (2.65, 2.65), color=GREY, lw=1)
    for value, name in ((0, "0"), (1, "1"), (1.5, "1.5")):
        axes.plot((left + value * wide,) * 2, (2.55, 2.75), color=GREY, lw=1)
        axes.text(left + value * wide, 2.48, name, ha="center", va="top", color=GREY)
    axes.plot(left + wide * shared, 0 * shared + 2.65, "o", color=BLUE, ms=5)
    axes.plot(left + wide * own, 0 * own + 2.65, "s", color=ORANGE, ms=5)
    axes.text(left, 3.0, r"$s = n\,\sin\theta$", color="black")
    axes.text(left, 3.6, "nodes that both media have", color=BLUE)
    axes.text(left, 3.35, "nodes of the glass alone", color=ORANGE)
    return figure


def lobe(axes: Any, tip: Any, angle: float, length: float, width: float, colour: str) -> None:
    """A lobe from a point: angle from the vertical, half-width in radians."""
    t = np.linspace(-4 * width, 4 * width, 200)
    r = length * np.exp(-0.5 * (t / width) ** 2)
    axes.fill(tip[0] + r * np.sin(angle + t), tip[1] + r * np.cos(angle + t), color=colour, alpha=0.3, lw=0)
    axes.plot(tip[0] + r * np.sin(angle + t), tip[1] + r * np.cos(angle + t), color=colour, lw=1.2)
    arrow(axes, tip, (tip[0] + length * np.sin(angle), tip[1] + length * np.cos(angle)), colour, 1.2)


def lobes() -> Any:
    """Refraction, reflection and the way back of one lobe."""
    figure, axes = canvas(7.2, 3.6)
    axes.axhspan(0.55, 2.1, color=GLASS)
    wave = np.linspace(0, 7.2, 400)
    for height, size in ((2.1, 0.015), (0.55, 0.03)):
        rough = size * (np.sin(23 * wave) + np.sin(31 * wave + 1))
        axes.plot(wave, height + rough, color=GREY, lw=1)
    axes.text(0.1, 1.95, "index $n$", va="top", color=GREY)
    axes.text(7.1, 2.2, r"roughness $\alpha_1$", ha="right", color=GREY)
    axes.text(7.1, 0.3, r"roughness $\alpha_2$", ha="right", va="center", color=GREY)
    outside = np.radians(50)
    inside = np.arcsin(np.sin(outside) / 1.5)
    first = np.array([1.6, 2.1])
    second = first + np.array([1.55 * np.tan(inside), -1.55])
    third = second + np.array([1.55 * np.tan(inside), 1.55])
    arrow(axes, first + 1.5 * np.array([-np.sin(outside), np.cos(outside)]), first, "black")
    lobe(axes, first, outside, 1.35, 0.06, ORANGE)
    axes.text(2.05, 3.45, r"lobe 1: $f(\alpha_1)$", va="top", color=ORANGE)
    lobe(axes, first, np.pi - inside, 1.45, 0.05, BLUE)
    axes.text(1.72, 1.05, r"down: $f(s\alpha_1)$", ha="right", color=BLUE)
    lobe(axes, second, inside, 1.45, 0.15, BLUE)
    axes.text(3.45, 1.0, r"$+\,f(\alpha_2)$", color=BLUE)
    lobe(axes, third, outside, 1.35, 0.23, GREEN)
    axes.text(5.4, 3.1, "lobe 2: up through the\ninterface, wider", va="center", color=GREEN)
    return figure


def walk() -> Any:
    """A path, the exit ray, and both ways to count."""
    figure, axes = canvas(7.2, 3.6)
    axes.axhspan(0.5, 2.4, color=GLASS)
    axes.plot((0, 7.2), (2.4, 2.4), color=GREY, lw=1)
    axes.plot((0, 7.2), (0.5, 0.5), color=GREY, lw=3)
    axes.text(0.1, 2.3, "medium", va="top", color=GREY)
    axes.text(0.1, 0.3, "base", va="center", color=GREY)
    path = [(0.7, 3.4), (1.6, 2.4), (2.25, 1.35), (3.15, 0.5), (4.35, 2.4)]
    for start, end in itertools.pairwise(path):
        arrow(axes, start, end)
    axes.text(0.85, 3.4, "$w_i$", color=BLUE)
    axes.plot(*zip(*path[1:4], strict=True), "o", color=BLUE, ms=5)
    out = np.array([0.62, 1.0])
    exit_ray = np.array([0.36, 1.0])
    for vertex in path[2:4]:
        away = (2.4 - vertex[1]) * exit_ray + np.array(vertex)
        arrow(axes, vertex, away, ORANGE, 1.4, linestyle="--")
        arrow(axes, away, away + 0.95 * out, ORANGE, 1.4)
    arrow(axes, path[4], np.array(path[4]) + 0.95 * out, GREEN, 1.4)
    axes.text(3.3, 3.42, "$w_o$", color=ORANGE)
    axes.text(1.7, 1.35, "collides", ha="right", va="center", color=BLUE)
    axes.text(
        4.95, 1.75, "connect: along the exit ray,\ndrawn backwards from $w_o$", va="center", color=ORANGE
    )
    axes.text(
        4.95,
        1.0,
        "arrive: in a sampled direction,\nweighed by how much of it\nleaves along $w_o$",
        va="center",
        color=GREEN,
    )
    arrow(axes, path[3], path[4], GREEN, 1.6)
    return figure


def main(folder: Path = FOLDER, suffix: str = "svg") -> None:
    """Draw all."""
    plt.rcParams.update({"font.size": 10, "svg.hashsalt": "urushi", "svg.fonttype": "path"})
    for draw in (adding, basis, lobes, walk):
        figure = draw()
        metadata = {"Date": None} if suffix == "svg" else {}
        figure.savefig(folder / f"{draw.__name__}.{suffix}", dpi=110, metadata=metadata)
        plt.close(figure)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
