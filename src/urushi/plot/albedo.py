"""Where the light goes: directional albedo against the angle, with what every layer absorbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from urushi.errors import UrushiError
from urushi.solvers import BSDF

from . import style
from .subjects import Subject, estimated, spread, subjects
from .subjects import channel as pick

MOST = 6
GRAZING = 88.0
ABSORBED = (style.ORANGE, style.VERMILION, style.PURPLE, style.YELLOW, style.BLUE, "#6b6b6b")
"""Colours of what layers absorb, from the top down; then again, hatched."""
HATCHES = ("", "////", "....", "xxxx")
MARKS = "os^DvPX"


@dataclass(frozen=True)
class Share:
    """One entry of a ledger against the angle: value and standard error, (N,) each."""

    name: str
    colour: str
    hatch: str
    value: np.ndarray
    error: np.ndarray


@style.styled
def albedo(
    materials: Any,
    *,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    ledger: bool | None = None,
    channel: str = "luminance",
    samples: int = 4096,
    steps: int = 23,
    **options: Any,
) -> style.Figure:
    """Reflected, transmitted, absorbed in each layer and lost between facets, against the angle of incidence.

    With the ledger: one panel of stacked areas for each material, in the order of the stack, which add up to 1.
    Without: curves of reflectance and transmittance of all materials in one panel. Bands are two standard errors wide
    to each side; below several areas those of the entries are added in quadrature.

    Args:
        materials: one or several: `Stack`, path, ``preset:NAME`` or solved `BSDF`.
        method: one or several; for materials that are not solved yet.
        labels: names of the panels or curves.
        ledger: areas or curves; None for areas of one material that has layers, and curves of several.
        channel: "luminance", "red", "green" or "blue".
        samples: walks per angle, where the walk is the method.
        steps: angles from 0 to 88 degrees, at least 2.
        **options: of the solver.

    Raises:
        UrushiError: nothing or too much to draw, or a BSDF that knows nothing of its inside.
    """
    if steps < 2:
        raise UrushiError(f"steps: found {steps}; allowed: at least 2")
    shown = subjects(materials, method, labels, samples, **options)
    if ledger is None:
        ledger = len(shown) == 1 and type(shown[0].bsdf).absorption is not BSDF.absorption
    if ledger and len(shown) > MOST:
        raise UrushiError(f"materials: found {len(shown)}; allowed: at most {MOST} with ledger=True")
    degrees = np.linspace(0.0, GRAZING, steps)
    t = np.radians(degrees)
    wi = np.stack([np.sin(t), 0 * t, np.cos(t)], axis=1)
    return (_areas if ledger else _curves)(shown, degrees, wi, channel)


def shares(subject: Subject, wi: np.ndarray, name: str = "luminance") -> list[Share]:
    """The entries of the ledger that are not 0, from the top of the figure down: reflected ... transmitted."""
    book = subject.bsdf.absorption(wi, with_error=estimated(subject))
    zero = np.zeros_like(book.reflected)
    errors = book.error
    out, lost, through = zero, zero, zero
    inside = np.zeros_like(book.absorbed)
    if errors is not None:
        out, through, inside = errors.reflected, errors.transmitted, errors.absorbed
        lost = np.sqrt((errors.lost**2).sum(axis=0))

    def share(what: str, colour: str, hatch: str, value: np.ndarray, error: np.ndarray) -> Share:
        return Share(what, colour, hatch, pick(value, name), spread(error, name))

    found = [share("reflected", style.SKY, "", book.reflected, out)]
    found.append(share("lost between facets", "#e4e4e4", "\\\\\\", book.lost.sum(axis=0), lost))
    dark = [k for k in range(len(book.names)) if np.abs(book.absorbed[k]).max() > 1e-9]
    for i, k in enumerate(dark):
        colour, hatch = ABSORBED[i % len(ABSORBED)], HATCHES[i // len(ABSORBED) % len(HATCHES)]
        found.append(share(f"absorbed in {book.names[k]}", colour, hatch, book.absorbed[k], inside[k]))
    found.append(share("transmitted", style.GREEN, "", book.transmitted, through))
    return [one for one in found if np.abs(one.value).max() > 1e-6]


def _areas(shown: list[Subject], degrees: np.ndarray, wi: np.ndarray, name: str) -> style.Figure:
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    books = [shares(one, wi, name) for one in shown]
    longest = max(len(book) for book in books)
    figure = style.figure(4.0 * columns + 1.0, rows * (3.0 + 0.2 * longest) + 0.5)
    figure.suptitle("Where the light goes", x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes, one, book in zip(grid.flat, shown, books, strict=False):
        base, variance = np.zeros(len(degrees)), np.zeros(len(degrees))
        for share in book[::-1]:
            look = {"facecolor": share.colour, "hatch": share.hatch, "edgecolor": "white", "lw": 0.8}
            axes.fill_between(degrees, base, base + share.value, gid=share.name, **look)
            base, variance = base + share.value, variance + share.error**2
            if share is not book[0] and variance.any():
                error = 2 * np.sqrt(variance)
                axes.fill_between(
                    degrees, base - error, base + error, color=style.INK, alpha=0.35, lw=0, zorder=3
                )
        _frame(axes, name)
        axes.set_title(one.label)
        handles = [
            Patch(facecolor=share.colour, hatch=share.hatch, edgecolor="white", label=_said(share))
            for share in book
        ]
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.0, -0.17), handlelength=1.6)
    return figure


def _curves(shown: list[Subject], degrees: np.ndarray, wi: np.ndarray, name: str) -> style.Figure:
    both = any(one.transmits for one in shown)
    figure = style.figure(6.4, 3.6 + 0.19 * (len(shown) + 2))
    figure.suptitle("Directional albedo", x=0.01, ha="left")
    axes = figure.subplots()
    handles = []
    for i, one in enumerate(shown):
        look = {"color": style.LINES[i], "marker": MARKS[i], "ms": 4, "markevery": (i % 3, 4)}
        for reflected in (True, False):
            if not reflected and not one.transmits:
                continue
            value, error = flux(one, wi, reflected, name)
            dashes = "-" if reflected else style.DASHES[1]
            axes.plot(degrees, value, linestyle=dashes, gid=f"curve-{i}-{'r' if reflected else 't'}", **look)
            if error.any():
                axes.fill_between(
                    degrees, value - 2 * error, value + 2 * error, color=style.LINES[i], alpha=0.3, lw=0
                )
        handles.append(Line2D([], [], color=style.LINES[i], marker=MARKS[i], ms=4, label=one.label))
    if both:
        handles.append(Line2D([], [], color=style.INK, label="reflected"))
        handles.append(Line2D([], [], color=style.INK, linestyle=style.DASHES[1], label="transmitted"))
    _frame(axes, name)
    axes.set_ylabel(("share of the light" if both else "reflected share of the light") + _of(name))
    axes.grid(True)
    figure.legend(handles=handles, loc="outside lower left")
    return figure


def flux(subject: Subject, wi: np.ndarray, reflected: bool, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance or transmittance and its standard error, (N,) each."""
    ask = subject.bsdf.reflectance if reflected else subject.bsdf.transmittance
    if estimated(subject):
        value, error = ask(wi, with_error=True)
        return pick(value, name), spread(error, name)
    value = pick(ask(wi), name)
    return value, np.zeros_like(value)


def _frame(axes: Axes, name: str) -> None:
    axes.set_xlim(0, GRAZING)
    axes.set_ylim(0, 1)
    axes.set_xticks([0, 15, 30, 45, 60, 75, GRAZING], ["0°", "15°", "30°", "45°", "60°", "75°", "88°"])
    axes.set_xlabel("angle of incidence θi")
    axes.set_ylabel("share of the light" + _of(name))


def _of(name: str) -> str:
    return "" if name == "luminance" else f", {name}"


def _said(share: Share) -> str:
    return f"{share.name}: {share.value[0]:.3f} at 0°"
