"""Colour patches under daylight, against the angle they are seen from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle

from urushi.errors import UrushiError

from . import style
from .colour import code, encoded
from .subjects import Subject, estimated, noise, subjects, values

MOST = 12
SUNSHINE = 0.8
"""Share of the sun in the light of a clear day that falls on a surface turned towards it; the rest is sky."""


@style.styled
def patches(
    materials: Any,
    *,
    angles: Sequence[float] = (0, 15, 30, 45, 60, 75, 85),
    sun: float | None = 45.0,
    phi: float = 180.0,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    samples: int = 4096,
    **options: Any,
) -> style.Figure:
    """The colours of materials, one row each, as they look from several angles.

    The upper half of a patch is the material under an overcast sky, alike from everywhere: its directional albedo.
    The lower half adds the sun, which gives four fifths of the light. Both are relative to a white diffuse surface
    in the same light, in linear sRGB, whose white is daylight (D65); colours brighter than white end at white. The
    sun's mirror image in a smooth surface is too small to see and left out. Codes below the patches are sRGB. The
    noise of an estimate is the median standard error of the linear colour, relative to it.

    Args:
        materials: one to twelve: `Stack`, path, ``preset:NAME`` or solved `BSDF`.
        angles: degrees from the normal that the surface is seen from, 0 to 89; at most 12.
        sun: degrees of the sun from the normal, 0 to 85; None for the overcast sky alone.
        phi: azimuth of the view from the sun's: 180 looks towards its mirror image, 0 has the sun behind.
        method: one or several; for materials that are not solved yet.
        labels: names of the rows.
        samples: walks per patch, where the walk is the method.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, an angle out of range.
    """
    if not 1 <= len(angles) <= 12 or not all(0 <= angle <= 89 for angle in angles):
        raise UrushiError(f"angles: found {list(angles)}; allowed: 1 to 12 angles, each 0 to 89 degrees")
    if sun is not None and not 0 <= sun <= 85:
        raise UrushiError(f"sun: found {sun:g}; allowed: 0 to 85 degrees, or None")
    shown = subjects(materials, method, labels, samples, MOST, **options)
    figure = style.figure(0.8 * len(angles) + 2.2, 0.98 * len(shown) + 1.35)
    figure.suptitle("Colour under daylight", x=0.01, ha="left")
    axes = figure.subplots()
    names = []
    for row, one in enumerate(shown):
        overcast = sky(one, angles)
        day = overcast if sun is None else daylight(one, angles, sun, phi, overcast)
        words = noise(*day)
        names.append(f"{one.label}\n{words}" if words else one.label)
        for column in range(len(angles)):
            x, y = column * 1.0, row * 1.25
            half = 0.46 if sun is not None else 0.92
            for k, colour in enumerate((overcast[0][column], day[0][column])[: 1 if sun is None else 2]):
                box = Rectangle(
                    (x, y + k * half), 0.96, half, facecolor=encoded(colour), gid=f"{row}-{column}-{k}"
                )
                axes.add_patch(box)
            frame = {"facecolor": "none", "edgecolor": style.HAIR, "lw": 0.6}
            axes.add_patch(Rectangle((x, y), 0.96, 0.92, **frame))
            axes.text(x + 0.48, y + 1.04, code(day[0][column]), ha="center", va="center", fontsize=7)
    axes.set_xlim(-0.02, len(angles))
    axes.set_ylim(1.25 * len(shown) - 0.1, -0.05)
    axes.set_xticks([column + 0.48 for column in range(len(angles))], [f"{angle:g}°" for angle in angles])
    axes.set_yticks([1.25 * row + 0.46 for row in range(len(shown))], names)
    axes.tick_params(length=0)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.set_xlabel("seen from this angle θo from the normal")
    axes.spines[:].set_visible(False)
    words = (
        "overcast sky"
        if sun is None
        else f"upper half: overcast sky; lower half, and code: sun at {sun:g}° and sky"
    )
    figure.supxlabel(words, x=0.01, ha="left", fontsize=8.5)
    return figure


def sky(subject: Subject, angles: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Linear sRGB under light that is alike from everywhere, and its standard error, (N, 3) each.

    What reaches the eye is what the surface would reflect of light from there, since f is reciprocal.
    """
    wi = _view(angles, 0.0)
    if estimated(subject):
        return subject.bsdf.reflectance(wi, with_error=True)
    value = subject.bsdf.reflectance(wi)
    return value, np.zeros_like(value)


def daylight(
    subject: Subject, angles: Sequence[float], sun: float, phi: float, overcast: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Linear sRGB under sun and sky, relative to a white diffuse surface, and its standard error, (N, 3) each."""
    wi = np.repeat(_view([sun], 0.0), len(angles), axis=0)
    wo = _view(angles, phi)
    scale = SUNSHINE * np.pi / wo[:, 2:]
    sunlit, error = values(subject, wi, wo)
    value = scale * sunlit + (1 - SUNSHINE) * overcast[0]
    return value, np.hypot(scale * error, (1 - SUNSHINE) * overcast[1])


def _view(angles: Sequence[float], phi: float) -> np.ndarray:
    t, p = np.radians(np.asarray(angles, float)), np.radians(phi)
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
