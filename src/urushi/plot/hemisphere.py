"""The lobe on the hemisphere as an image: one disc for reflected light, one for transmitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import LogFormatterMathtext, LogLocator
from scipy.ndimage import gaussian_filter

from urushi.errors import UrushiError

from . import disc, style
from .subjects import Subject, arrows, incident, noise, refracted, spread, subjects, values
from .subjects import channel as pick

DECADES = 4
"""Powers of ten that the colours span below the largest value."""
MOST = 4


@style.styled
def hemisphere(
    materials: Any,
    *,
    theta: float = 45.0,
    phi: float = 0.0,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    log: bool = True,
    channel: str = "luminance",
    samples: int = 256,
    pixels: int = 121,
    **options: Any,
) -> style.Figure:
    """The lobe on both hemispheres, seen from above, one row for each material and method.

    The distance from a disc's centre is the angle from the normal (from its far end on the far side); the azimuth is
    that of the surface, x to the right. All discs share one colour scale; what lies below it is drawn in its darkest
    colour. Contours, of the image smoothed over 1.5 pixels, are drawn at powers of ten, and halfway between them in
    dashes. The noise of an estimate is its median standard error, relative to the value.

    Args:
        materials: one to four: `Stack`, path, ``preset:NAME`` or solved `BSDF`.
        theta: degrees of the incident light from the normal, 0 to 89.5.
        phi: degrees by which the plane of incidence is turned from x; light comes from 180 + phi.
        method: one or several; for materials that are not solved yet.
        labels: names of the rows.
        log: logarithmic colour scale over four powers of ten, or a linear one.
        channel: "luminance", "red", "green" or "blue".
        samples: walks per direction, where the walk is the method.
        pixels: of a disc's diameter, 11 to 1001.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, a value out of range, nothing but delta parts.
    """
    if not 11 <= pixels <= 1001:
        raise UrushiError(f"pixels: found {pixels}; allowed: 11 to 1001")
    wi = incident(theta, phi + 180.0)
    shown = subjects(materials, method, labels, samples, MOST, **options)
    sides = (True, False) if any(one.transmits for one in shown) else (True,)
    images = {
        (i, above): image(one, wi, above, pixels, channel)
        for i, one in enumerate(shown)
        for above in sides
        if above or one.transmits
    }
    peak = max(float(np.nanmax(found)) for found, _ in images.values())
    if peak <= 0:
        raise UrushiError(
            "materials: nothing is scattered, all light is in delta parts; allowed: a lobe to draw"
        )
    norm = LogNorm(peak * 10.0**-DECADES, peak) if log else None
    scale = {"norm": norm} if log else {"vmin": 0.0, "vmax": peak}
    figure = style.figure(3.5 * len(sides) + 1.0, 3.4 * len(shown) + 0.9)
    figure.suptitle(f"Lobe on the hemisphere, light from {theta:g}°", x=0.01, ha="left")
    grid = figure.subplots(len(shown), len(sides), squeeze=False)
    for i, one in enumerate(shown):
        parts = arrows(one, wi)
        for k, above in enumerate(sides):
            axes = grid[i, k]
            side = "reflected" if above else "transmitted"
            axes.set_title(f"{one.label}: {side}" if above else side)
            if (i, above) not in images:
                disc.bare(axes)
                axes.text(0, 0, "opaque", ha="center", va="center", color=style.FAINT)
                continue
            painted = _paint(axes, images[i, above][0], scale, log, peak)
            _marks(axes, theta, phi, above, refracted(one, theta))
            here = [part for part in parts if (part.direction[2] > 0) == above]
            words = [f"delta part: {pick(part.energy, channel):.3g} of the light" for part in here]
            words.append(noise(*images[i, above]))
            text = ";  ".join(word for word in words if word)
            axes.text(0, -1.32, text, ha="center", va="top", fontsize=8)
    unit = "f |cos θo|" + ("" if channel == "luminance" else f", {channel}")
    bar = figure.colorbar(painted, ax=grid, shrink=0.8, pad=0.02, extend="min" if log else "neither")
    bar.set_label(f"{unit}  (1/sr)")
    if log:
        bar.ax.yaxis.set_major_locator(LogLocator(10.0))
        bar.ax.yaxis.set_major_formatter(LogFormatterMathtext(10.0))
    bar.outline.set_visible(False)
    handles = [
        Line2D(
            [], [], marker="o", ms=7, mfc="none", mec=style.LIGHT, mew=2, lw=0, label="light comes from here"
        ),
        Line2D([], [], marker="x", ms=7, mec=style.VERMILION, mew=2, lw=0, label="mirror direction"),
    ]
    if len(sides) == 2:
        handles[1].set_label("mirror direction, straight through")
    figure.legend(handles=handles, loc="outside lower left", ncols=2)
    return figure


def image(
    subject: Subject, wi: np.ndarray, above: bool, pixels: int, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors of one side, (pixels, pixels) each, top row y = 1; nan outside the disc."""
    at = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    x, y = np.meshgrid(at, -at)
    radius = np.hypot(x, y)
    inside = radius < 1
    t, p = radius[inside] * np.pi / 2, np.arctan2(y[inside], x[inside])
    z = np.cos(t) if above else -np.cos(t)
    wo = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), z], axis=1)
    found = np.full((2, pixels, pixels), np.nan)
    value, error = values(subject, wi, wo)
    found[:, inside] = pick(value, name), spread(error, name)
    return found[0], found[1]


def _paint(axes: Axes, found: np.ndarray, scale: dict[str, Any], log: bool, peak: float) -> Any:
    disc.bare(axes, margin=0.3, sides=0.3)
    pixels = len(found)
    floor = peak * 10.0**-DECADES if log else 0.0
    shown = np.where(np.isnan(found), np.nan, np.maximum(found, floor))
    painted = axes.imshow(shown, extent=(-1, 1, -1, 1), cmap=style.IMAGE, interpolation="nearest", **scale)
    painted.set_clip_path(Circle((0, 0), 1, transform=axes.transData))
    at = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    smooth = _smoothed(np.log10(shown) if log else shown)
    if log:
        top = np.log10(peak)
        whole = np.arange(np.ceil(top - DECADES + 0.05), np.floor(top) + 1)
        half = np.arange(np.ceil(top - DECADES - 0.4), np.ceil(top)) + 0.5
        half = half[(half < top - 0.05) & (half > top - DECADES + 0.05)]
        for levels, dashes, width in ((whole, "solid", 0.9), (half, "dashed", 0.5)):
            if len(levels) and np.nanmax(shown) > floor:
                look: dict[str, Any] = {"colors": "white", "linewidths": width, "linestyles": dashes}
                axes.contour(at, -at, smooth, levels=levels, alpha=0.75, **look)
    elif np.nanmax(shown) > 0:
        axes.contour(at, -at, smooth, levels=peak * np.array([0.1, 0.5]), colors="white", linewidths=0.8)
    for degrees in (30, 60):
        axes.plot(
            *disc.point(np.linspace(0, 360, 181), degrees / 90), color="white", lw=0.5, ls=":", zorder=3
        )
        x, y = disc.point(-157.5, degrees / 90)
        axes.text(x, y, f"{degrees}°", color="white", fontsize=7.5, ha="center", va="center", zorder=4)
    axes.plot(*disc.point(np.linspace(0, 360, 361)), color=style.FAINT, lw=0.9, zorder=4)
    names = {"0°": 90, "90°": 0, "180°": -90, "270°": 180}
    for name, angle in names.items():
        x, y = disc.point(angle, 1.05)
        side = "left" if x > 0.5 else "right" if x < -0.5 else "center"
        axes.text(
            x, y, name, ha=side, va="bottom" if y > 0.5 else "top" if y < -0.5 else "center", fontsize=8
        )
    return painted


def _smoothed(shown: np.ndarray, width: float = 1.5) -> np.ndarray:
    """The image without the noise of single pixels, for the contours; nan stays outside."""
    inside = np.isfinite(shown)
    weight = gaussian_filter(inside.astype(float), width)
    mean = gaussian_filter(np.where(inside, shown, 0.0), width) / np.maximum(weight, 1e-9)
    return np.where(inside, mean, np.nan)


def _marks(axes: Axes, theta: float, phi: float, above: bool, straight: float | None) -> None:
    out = np.array([np.cos(np.radians(phi)), np.sin(np.radians(phi))])
    if above:
        x, y = -out * theta / 90
        axes.plot(x, y, "o", ms=8, mfc="none", mec="white", mew=3.4, zorder=5)
        axes.plot(x, y, "o", ms=8, mfc="none", mec=style.LIGHT, mew=2, zorder=6, gid="incident")
    angle = theta if above else straight
    if angle is not None:
        x, y = out * angle / 90
        axes.plot(x, y, "x", ms=8, mec="white", mew=3.2, zorder=5)
        axes.plot(x, y, "x", ms=7, mec=style.VERMILION, mew=1.8, zorder=6, gid="mirror")
