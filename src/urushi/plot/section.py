"""The stack as a cross-section, its layers labelled."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Polygon

from urushi.cross_section import Drawing, Shape, draw
from urushi.errors import UrushiError

from . import style
from .subjects import stacks

MOST = 8
INCH = 95.0
"""Pixels of the drawing an inch."""


@style.styled
def section(materials: Any) -> style.Figure:
    """Cross-sections, one below the other; more than four in two columns.

    Rough surfaces are as rough as their facets, media have the colour that white light is left with after crossing
    them once, particles stand for scattering, bases have their colour, and light enters from the upper left, bent by
    Snell's law. Heights are not to scale (`urushi.cross_section`).

    Args:
        materials: one to eight: `Stack`, path, ``preset:NAME``, or solved `BSDF`, of which the description is drawn.

    Raises:
        UrushiError: nothing or too much to draw, or something that has no description.
    """
    shown = stacks(materials)
    if len(shown) > MOST:
        raise UrushiError(f"materials: found {len(shown)} to draw; allowed: at most {MOST} in one figure")
    drawings = [draw(stack) for stack, _ in shown]
    columns = 2 if len(shown) > 4 else 1
    rows = -(-len(shown) // columns)
    heights = [max(d.height for d in drawings[row * columns : (row + 1) * columns]) for row in range(rows)]
    width = columns * drawings[0].width / INCH
    figure = style.figure(width + 0.2, sum(heights) / INCH + 0.32 * rows + 0.1)
    grid = figure.subplots(rows, columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for i, (axes, drawing) in enumerate(zip(grid.flat, drawings, strict=False)):
        _paint(axes, drawing, heights[i // columns])
        axes.set_title(shown[i][1])
    return figure


def _paint(axes: Axes, drawing: Drawing, height: float) -> None:
    axes.set_xlim(0, drawing.width)
    axes.set_ylim(height, 0)
    axes.set_aspect("equal")
    axes.axis("off")
    for place, shape in enumerate(drawing.shapes):
        _add(axes, shape, 1 + place)


def _add(axes: Axes, shape: Shape, order: int) -> None:
    points = 72.0 / INCH  # of type, a pixel of the drawing
    if shape.kind == "area":
        axes.add_patch(Polygon(shape.points, facecolor=shape.colour, edgecolor="none", zorder=order))
    elif shape.kind == "dots":
        for centre in shape.points:
            axes.add_patch(Circle(centre, shape.width, facecolor=shape.colour, alpha=0.7, lw=0, zorder=order))
    elif shape.kind == "text":
        look: dict[str, Any] = {"fontsize": shape.width * points, "color": shape.colour, "va": "center"}
        axes.text(
            *shape.points[0], shape.text, weight="bold" if shape.bold else "normal", zorder=order, **look
        )
    else:
        x, y = zip(*shape.points, strict=True)
        line = {"color": shape.colour, "lw": shape.width * points, "zorder": order}
        dashes = (0, (5, 4)) if shape.dashed else "-"
        axes.add_line(Line2D(x, y, linestyle=dashes, solid_joinstyle="round", **line))
        if shape.kind == "arrow":
            ends = {
                "posA": shape.points[-2],
                "posB": shape.points[-1],
                "arrowstyle": "-|>",
                "mutation_scale": 11,
            }
            axes.add_patch(FancyArrowPatch(**ends, shrinkA=0, shrinkB=0, **line))
