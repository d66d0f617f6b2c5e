"""The lobe as a body in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D

from urushi.errors import UrushiError

from . import style
from .polar import DECADES, scale
from .subjects import Arrow, Subject, arrows, incident, noise, spread, subjects, values
from .subjects import channel as pick

MOST = 4


@style.styled
def lobe3d(
    materials: Any,
    *,
    theta: float = 45.0,
    phi: float = 0.0,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    log: bool = True,
    channel: str = "luminance",
    samples: int = 512,
    azimuth: float = -60.0,
    elevation: float = 22.0,
    **options: Any,
) -> style.Figure:
    """The lobe in space: the distance from the origin, and the colour, are f |cos theta_o|.

    With `log` the radius spans four powers of ten below the largest value of all panels; what is below them is at
    the origin. The same scale serves every panel. Delta parts are arrows, their energy stands in the title;
    the noise of an estimate there is its median standard error, relative to the value.

    Args:
        materials: one to four: `Stack`, path, ``preset:NAME`` or solved `BSDF`; a panel each.
        theta: degrees of the incident light from the normal, 0 to 89.5.
        phi: degrees by which the plane of incidence is turned from x; light comes from 180 + phi.
        method: one or several; for materials that are not solved yet.
        labels: names of the panels.
        log: logarithmic radius, or a linear one.
        channel: "luminance", "red", "green" or "blue".
        samples: walks per direction, where the walk is the method.
        azimuth: degrees of the view about z.
        elevation: degrees of the view above the surface.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, an angle out of range, nothing but darkness.
    """
    wi = incident(theta, phi + 180.0)
    shown = subjects(materials, method, labels, samples, MOST, **options)
    deltas = [arrows(one, wi) for one in shown]
    grids = [[grid(one, wi, above, channel) for above in sides(one)] for one in shown]
    peak = max(float(value.max()) for panel in grids for _, value, _ in panel)
    if peak <= 0 and not any(deltas):
        raise UrushiError("materials: nothing is reflected or transmitted; allowed: something to draw")
    peak = peak if peak > 0 else 1.0
    radius = scale(peak, log)
    norm = LogNorm(peak * 10.0**-DECADES, peak) if log else Normalize(0.0, peak)
    colours = colormaps[style.IMAGE]
    figure = style.figure(4.0 * len(shown) + 1.0, 4.6 if any(one.transmits for one in shown) else 4.0)
    title = f"Lobe in space, light from {theta:g}°, {'logarithmic' if log else 'linear'} radius"
    figure.suptitle(title, x=0.01, ha="left")
    panels = []
    for i, one in enumerate(shown):
        axes = figure.add_subplot(1, len(shown), i + 1, projection="3d", computed_zorder=False)
        panels.append(axes)
        below = -1.0 if one.transmits else 0.0
        for k, (wo, value, _) in enumerate(grids[i]):
            body = wo * radius(value)[..., None]
            face = colours(norm(np.maximum(value, peak * 10.0**-DECADES)))
            look: dict[str, Any] = {"facecolors": face, "rstride": 1, "cstride": 1, "linewidth": 0.2}
            look |= {"edgecolor": (1, 1, 1, 0.35), "antialiased": True, "shade": False}
            axes.plot_surface(*np.moveaxis(body, -1, 0), zorder=1 if k else 3, **look)
        _surroundings(axes, wi[0], deltas[i], below)
        axes.view_init(elev=elevation, azim=azimuth)
        axes.set_title(one.label + _said(deltas[i], grids[i], channel))
    unit = "f |cos θo|" + ("" if channel == "luminance" else f", {channel}")
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=panels, shrink=0.65, pad=0.04)
    bar.set_label(f"{unit}  (1/sr)")
    bar.outline.set_visible(False)
    handles = [
        Line2D([], [], color=style.LIGHT, lw=2, label="incident light"),
        Line2D([], [], color=style.FAINT, lw=1, label="the surface, with circles of radius 1/2 and 1"),
    ]
    if any(deltas):
        handles.insert(1, Line2D([], [], color=style.VERMILION, lw=2, label="delta part"))
    figure.legend(handles=handles, loc="outside lower left", ncols=1)
    return figure


def sides(subject: Subject) -> tuple[bool, ...]:
    """The far side first, so that it is drawn below."""
    return (False, True) if subject.transmits else (True,)


def grid(
    subject: Subject, wi: np.ndarray, above: bool, name: str, steps: tuple[int, int] = (61, 121)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions (T, P, 3) of one side, the value (T, P) in each and its standard error; 0 along the surface."""
    t = np.linspace(0.0, np.pi / 2, steps[0])
    p = np.linspace(0.0, 2 * np.pi, steps[1])
    tt, pp = np.meshgrid(t, p, indexing="ij")
    z = np.cos(tt) * (1 if above else -1)
    wo = np.stack([np.sin(tt) * np.cos(pp), np.sin(tt) * np.sin(pp), z], axis=-1)
    value, error = np.zeros(tt.shape), np.zeros(tt.shape)
    found = values(subject, wi, wo[:-1].reshape(-1, 3))
    value[:-1] = np.maximum(pick(found[0], name).reshape(len(t) - 1, len(p)), 0.0)
    error[:-1] = spread(found[1], name).reshape(len(t) - 1, len(p))
    return wo, value, error


def _surroundings(axes: Any, wi: np.ndarray, deltas: list[Arrow], below: float) -> None:
    turn = np.linspace(0, 2 * np.pi, 121)
    for radius in (0.5, 1.0):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), 0 * turn, color=style.FAINT, lw=0.7, zorder=2)
    axes.plot([0, 1.12], [0, 0], [0, 0], color=style.FAINT, lw=0.7, zorder=2)
    axes.plot([0, 0], [0, 1.12], [0, 0], color=style.FAINT, lw=0.7, zorder=2)
    axes.text(1.2, 0, 0, "x", fontsize=8, ha="center", va="center", zorder=0)
    axes.text(0, 1.2, 0, "y", fontsize=8, ha="center", va="center", zorder=0)
    _ray(axes, 1.15 * wi, np.zeros(3), style.LIGHT)
    for part in deltas:
        _ray(axes, np.zeros(3), 0.95 * part.direction, style.VERMILION)
    axes.set_xlim(-0.85, 0.85)
    axes.set_ylim(-0.85, 0.85)
    axes.set_zlim(below * 0.95, 0.95)
    axes.set_box_aspect((1.7, 1.7, 0.95 - 0.95 * below), zoom=1.2)
    axes.set_axis_off()


def _ray(axes: Any, start: np.ndarray, end: np.ndarray, colour: str) -> None:
    axes.quiver(*start, *(end - start), color=colour, lw=1.8, arrow_length_ratio=0.09, zorder=6)


def _said(deltas: list[Arrow], panel: list[Any], name: str) -> str:
    value, error = (np.concatenate([side[k].ravel() for side in panel]) for k in (1, 2))
    energy = ", ".join(f"{pick(part.energy, name):.3g}" for part in deltas)
    words = [f"delta: {energy}" if energy else "", noise(value, error)]
    text = ";  ".join(word for word in words if word)
    return f"\n{text}" if text else ""
