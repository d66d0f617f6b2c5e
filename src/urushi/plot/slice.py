"""The image slice of Disney's BRDF Explorer (Burley 2012, section 3.1): half and difference angle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from urushi.errors import UrushiError

from . import style
from .colour import encoded
from .subjects import Subject, noise, subjects, values

MOST = 6
TICKS = (0, 15, 30, 45, 60, 75, 90)


@style.styled
def slice(
    materials: Any,
    *,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    root: bool = True,
    exposure: float = 1.0,
    samples: int = 256,
    pixels: int = 128,
    **options: Any,
) -> style.Figure:
    """Colours of the reflected lobe over theta_h and theta_d, at phi_d = 90 degrees, one panel for each material.

    theta_h (Rusinkiewicz 1998) is the angle of the half vector from the normal, theta_d the angle between it and the
    light. The left edge is the highlight, the top edge grazing light, the bottom edge light that returns where it
    came from. The colour is pi f in linear sRGB times `exposure`: a white diffuse surface is white; highlights roll
    off. Delta parts do not appear. The noise of an estimate is its median standard error, relative to the value.

    Args:
        materials: one to six: `Stack`, path, ``preset:NAME`` or solved `BSDF`.
        method: one or several; for materials that are not solved yet.
        labels: names of the panels.
        root: theta_h on a square-root axis, which gives narrow highlights room.
        exposure: factor on the colours, above 0.
        samples: walks per pixel, where the walk is the method.
        pixels: along each axis, 8 to 1024.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, a value out of range.
    """
    if not 8 <= pixels <= 1024:
        raise UrushiError(f"pixels: found {pixels}; allowed: 8 to 1024")
    if not (np.isfinite(exposure) and exposure > 0):
        raise UrushiError(f"exposure: found {exposure:g}; allowed: above 0")
    shown = subjects(materials, method, labels, samples, MOST, **options)
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure = style.figure(max(3.3 * columns + 0.4, 4.4), 3.5 * rows + 0.5)
    figure.suptitle("Reflected colour, π f, at φd = 90° (tone-mapped)", x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes, one in zip(grid.flat, shown, strict=False):
        value, error = image(one, pixels, root)
        colours = encoded(exposure * value, tonemap=True)
        axes.imshow(colours, extent=(0, 1, 0, 1), interpolation="nearest")
        words = noise(value, error)
        axes.set_title(f"{one.label}\n{words}" if words else one.label)
        _ticks(axes, root)
    return figure


def image(subject: Subject, pixels: int, root: bool) -> tuple[np.ndarray, np.ndarray]:
    """pi f in linear sRGB and its standard error, (pixels, pixels, 3) each; theta_h to the right, theta_d upwards."""
    at = (np.arange(pixels) + 0.5) / pixels
    half = np.pi / 2 * (at**2 if root else at)
    difference = np.pi / 2 * at[::-1]
    th, td = (angle.ravel() for angle in np.meshgrid(half, difference))
    wi, wo = pair(th, td)
    scale = np.pi / wo[:, 2:]
    value, error = ((scale * found).reshape(pixels, pixels, 3) for found in values(subject, wi, wo))
    return value, error


def pair(th: np.ndarray, td: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """wi and wo (N, 3) of half and difference angles in radians, at phi_d = 90 degrees; both lie above."""
    # The half vector lies in the xz plane, the difference along y: wi and wo are mirror images in that plane.
    x, z = np.cos(td) * np.sin(th), np.cos(td) * np.cos(th)
    return np.stack([x, np.sin(td), z], axis=1), np.stack([x, -np.sin(td), z], axis=1)


def _ticks(axes: Axes, root: bool) -> None:
    half = [angle for angle in TICKS if not (root and angle == 75)]  # which has no room on a square-root axis
    places = [np.sqrt(angle / 90) if root else angle / 90 for angle in half]
    axes.set_xticks(places, [f"{angle}°" for angle in half])
    axes.set_yticks([angle / 90 for angle in TICKS], [f"{angle}°" for angle in TICKS])
    axes.set_xlabel("half angle θh" + (" (square-root axis)" if root else ""))
    axes.set_ylabel("difference angle θd")
    axes.spines[["top", "right"]].set_visible(True)
