"""The lobe in the plane of incidence: reflection in the upper half, transmission in the lower."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from urushi.errors import UrushiError

from . import disc, style
from .subjects import Subject, arrows, channel, incident, refracted, spread, subjects, values

DECADES = 4
"""Powers of ten that a logarithmic radius shows below the largest value."""
STEP = 0.5
"""Degrees between evaluations."""


@style.styled
def polar(
    materials: Any,
    *,
    theta: float = 45.0,
    phi: float = 0.0,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    log: bool | None = None,
    channel: str = "luminance",
    samples: int = 1024,
    **options: Any,
) -> style.Figure:
    """The lobe in the plane of incidence, as a polar curve for each material and method.

    The radius is f |cos theta_o| (1/sr) as `BSDF.eval` gives it. Light comes from the left; the mirror direction is
    on the right. Bands are two standard errors wide to each side. Delta parts are arrows (their length says nothing),
    their energy stands in the legend.

    Args:
        materials: one or several: `Stack`, path, ``preset:NAME`` or solved `BSDF`.
        theta: degrees of the incident light from the normal, 0 to 89.5.
        phi: degrees by which the plane of incidence is turned from x (for anisotropic materials).
        method: one or several; for materials that are not solved yet.
        labels: names for the legend, one for each curve.
        log: logarithmic radius, linear radius, or None for both side by side.
        channel: "luminance", "red", "green" or "blue".
        samples: walks per direction, where the walk is the method.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, an angle out of range, nothing but darkness.
    """
    wi = incident(theta, phi)
    shown = subjects(materials, method, labels, samples, **options)
    curves = [curve(one, wi, phi, channel) for one in shown]
    deltas = [arrows(one, wi) for one in shown]
    if max(value.max() for _, value, _ in curves) <= 0 and not any(deltas):
        raise UrushiError("materials: nothing is reflected or transmitted; allowed: something to draw")
    scales = [False, True] if log is None else [log]
    both = any(one.transmits for one in shown)
    figure = style.figure(4.6 * len(scales) + 0.2, (4.5 if both else 2.7) + 0.19 * (len(shown) + 4))
    figure.suptitle(f"Lobe in the plane of incidence, light from {theta:g}°", x=0.01, ha="left")
    for place, logarithmic in enumerate(scales):
        axes = figure.add_subplot(1, len(scales), place + 1)
        _draw(axes, curves, deltas, logarithmic, both)
        _guides(axes, theta, refracted(shown[0], theta))
        unit = "f |cos θo|  (1/sr)" if channel == "luminance" else f"f |cos θo|, {channel}  (1/sr)"
        axes.set_title(("logarithmic radius: " if logarithmic else "radius: ") + unit)
    handles = [
        Line2D([], [], color=style.LINES[i], linestyle=style.DASHES[i], label=_said(one, parts, channel))
        for i, (one, parts) in enumerate(zip(shown, deltas, strict=True))
    ]
    handles.append(Line2D([], [], color=style.LIGHT, lw=2, label=f"incident light, θi = {theta:g}°"))
    words = "mirror direction" + (" and refraction straight through" if both else "")
    handles.append(Line2D([], [], color=style.FAINT, lw=1, linestyle=":", label=words))
    figure.legend(handles=handles, loc="outside lower left", ncols=1)
    return figure


def curve(
    subject: Subject, wi: np.ndarray, phi: float, name: str = "luminance"
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Degrees from the normal (positive on the mirror's side, beyond 90 below), value, standard error: (N,) each."""
    last = 180.0 if subject.transmits else 90.0
    count = round(2 * last / STEP)
    degrees = np.linspace(-last, last, count + 1)
    t, p = np.radians(degrees), np.radians(phi)
    wo = np.stack([-np.sin(t) * np.cos(p), -np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    wo[np.abs(wo[:, 2]) < 1e-9, 2] = 0.0
    value, error = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    seen = wo[:, 2] != 0.0  # along the surface f |cos theta_o| is 0
    value[seen], error[seen] = values(subject, wi, wo[seen])
    return degrees, channel(value, name), spread(error, name)


def _draw(axes: Axes, curves: list[Any], deltas: list[Any], logarithmic: bool, both: bool) -> None:
    disc.bare(axes, -1.0 if both else 0.0, margin=0.14)
    peak = max(float((value + 2 * error).max()) for _, value, error in curves)
    peak = 1.04 * peak if peak > 0 else 1.0
    radius = scale(peak, logarithmic)
    ticks = decades(peak) if logarithmic else round_numbers(peak)
    disc.rings(axes, [float(radius(np.array(t))) for t in ticks], 180.0 if both else 90.0)
    angles = np.arange(-150, 181, 30) if both else np.arange(-90, 91, 30)
    disc.spokes(axes, list(angles), [f"{90 - abs(abs(a) - 90):g}°" for a in angles])
    axes.plot([-1, 1], [0, 0], color=style.INK, lw=1.1, zorder=2)
    for tick in ticks:
        if radius(np.array(tick)) > 0.95:  # there the angle is written
            continue
        name = f"$10^{{{round(np.log10(tick))}}}$" if logarithmic else f"{tick:g}"
        place = (-float(radius(np.array(tick))), -0.03)
        axes.text(*place, name, fontsize=7.5, ha="center", va="top", bbox=disc.PAD, zorder=6)
    for i, (degrees, value, error) in enumerate(curves):
        line = {"color": style.LINES[i], "zorder": 4}
        axes.plot(*disc.point(degrees, radius(value)), linestyle=style.DASHES[i], gid=f"curve-{i}", **line)
        if error.any():
            x, y = disc.point(
                np.r_[degrees, degrees[::-1]],
                np.r_[radius(value + 2 * error), radius(value - 2 * error)[::-1]],
            )
            axes.fill(x, y, color=style.LINES[i], alpha=0.3, lw=0, zorder=3, gid=f"band-{i}")
    for i, parts in enumerate(deltas):
        for part in parts:
            angle = np.degrees(np.arctan2(np.hypot(*part.direction[:2]), part.direction[2]))
            aside = 0.025 * (i - (len(deltas) - 1) / 2)  # side by side, where several go the same way
            dx, dy = disc.point(angle + 90, aside)
            x, y = disc.point(angle, 0.86)
            disc.arrow(axes, (dx, dy), (x + dx, y + dy), style.LINES[i], style.DASHES[i])


def _guides(axes: Axes, theta: float, straight: float | None) -> None:
    ways = [theta] if straight is None else [theta, 180.0 - straight]
    for angle in ways:
        x, y = disc.point(angle)
        axes.plot([0, x], [0, y], color=style.FAINT, lw=1.0, linestyle=":", zorder=2)
    disc.arrow(axes, disc.point(-theta), (0.0, 0.0), style.LIGHT)


def scale(peak: float, logarithmic: bool) -> Callable[[np.ndarray], np.ndarray]:
    """Values to radii: `peak` is 1; what is below 0, or `DECADES` below the peak, is at the centre."""
    if not logarithmic:
        return lambda values: np.maximum(values, 0.0) / peak
    return lambda values: np.log10(np.maximum(values / peak, 10.0**-DECADES)) / DECADES + 1.0


def decades(peak: float) -> list[float]:
    """The powers of ten up to `peak` that are shown."""
    top = int(np.floor(np.log10(peak)))
    return [10.0**k for k in range(top, top - DECADES, -1) if 10.0**k > peak * 10.0 ** (0.3 - DECADES)]


def round_numbers(peak: float) -> list[float]:
    """Two to four round numbers up to `peak`."""
    size = 10.0 ** np.floor(np.log10(peak))
    step = next(s * size for s in (0.25, 0.5, 1.0, 2.0, 2.5, 5.0) if peak / (s * size) < 5)
    return [float(f"{step * k:.6g}") for k in range(1, int(peak / step * 1.0001) + 1)]


def _said(subject: Subject, parts: list[Any], name: str) -> str:
    words = [
        f"{'mirror' if part.direction[2] > 0 else 'straight through'} {channel(part.energy, name):.3g}"
        for part in parts
    ]
    return subject.label + (f"  (delta: {', '.join(words)} of the light)" if words else "")
