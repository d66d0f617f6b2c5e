"""A disc of directions: circles and spokes with their labels, on ordinary axes of equal scale and radius 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from . import style

PAD = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.8}


def bare(axes: Axes, low: float = -1.0, margin: float = 0.22, sides: float = 0.22) -> None:
    """No frame and no ticks; the unit disc from `low` up, and room for labels around it."""
    axes.set_aspect("equal")
    axes.set_xlim(-1 - sides, 1 + sides)
    axes.set_ylim(low - margin, 1 + margin)
    axes.axis("off")


def point(angle: Any, radius: Any = 1.0) -> tuple[Any, Any]:
    """x, y of an angle in degrees, clockwise from the top."""
    t = np.radians(angle)
    return radius * np.sin(t), radius * np.cos(t)


def rings(axes: Axes, radii: Sequence[float], last: float) -> None:
    """Circles, from -`last` to `last` degrees of the top; the rim darker."""
    t = np.linspace(-last, last, 361)
    for radius in radii:
        axes.plot(*point(t, radius), color=style.HAIR, lw=0.6, zorder=1)
    axes.plot(*point(t), color=style.FAINT, lw=0.9, zorder=2)


def spokes(axes: Axes, angles: Sequence[float], names: Sequence[str]) -> None:
    """Lines from the centre, named outside the rim."""
    for angle, name in zip(angles, names, strict=True):
        axes.plot(*zip((0.0, 0.0), point(angle), strict=True), color=style.HAIR, lw=0.6, zorder=1)
        x, y = point(angle, 1.05)
        side = "left" if x > 0.05 else "right" if x < -0.05 else "center"
        upright = "bottom" if y > 0.3 else "top" if y < -0.3 else "center"
        axes.text(x, y, name, ha=side, va=upright, fontsize=8)


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str, dashes: Any = "-"
) -> None:
    """An arrow in the coordinates of the axes."""
    look = {"arrowstyle": "-|>,head_width=0.26,head_length=0.5", "color": colour, "lw": 1.7}
    look |= {"shrinkA": 0, "shrinkB": 0, "linestyle": dashes}
    axes.annotate("", xy=end, xytext=start, arrowprops=look, zorder=5)
