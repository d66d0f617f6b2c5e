"""How every figure looks: sizes, fonts, colours, units; and how one is saved so that it is the same each time.

The settings hold inside `look()` only: matplotlib's own are never changed. Colours of lines and areas are those of
Okabe and Ito (2008), which readers of any colour vision tell apart; lines differ in their dashes as well. Images
use cividis (Nunez et al. 2018). Figures are matplotlib's objects without `pyplot`: nothing is kept, nothing pops up.
"""

from __future__ import annotations

import functools
import io
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import matplotlib
import matplotlib.figure
from matplotlib.backends.backend_agg import FigureCanvasAgg

from urushi.errors import UrushiError

FORMATS = (".png", ".svg", ".pdf")
DPI = 150
"""Pixels an inch of a saved picture; a figure is made for the width that it has."""

INK = "#222222"
FAINT = "#8a8a8a"
HAIR = "#d9d9d9"
LIGHT = "#c77700"
"""The colour of incident light, wherever it is drawn; darker than the orange of the palette."""

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW, BLACK = "#56B4E9", "#CC79A7", "#F0E442", "#000000"
LINES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of curves, in order; as many can be told apart in one figure."""
DASHES: tuple[Any, ...] = (
    "-",
    (0, (6, 2)),
    (0, (2, 1.4)),
    (0, (7, 2, 1.5, 2)),
    (0, (1, 1)),
    (0, (9, 3)),
    (0, (4, 2, 1, 2, 1, 2)),
)
IMAGE = "cividis"

_LOOK = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.titlelocation": "left",
    "axes.grid": False,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "grid.color": HAIR,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 3.0,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.6,
    "figure.titlesize": 11.0,
    "figure.facecolor": "white",
    "figure.dpi": 100.0,
    "savefig.dpi": DPI,
    "savefig.facecolor": "white",
    "svg.fonttype": "path",
    "svg.hashsalt": "urushi",
    "pdf.fonttype": 42,
    "mathtext.fontset": "dejavusans",
}

F = TypeVar("F", bound=Callable[..., Any])


@contextmanager
def look() -> Iterator[None]:
    """Matplotlib's settings for Urushi's figures, inside this block; nothing of the user's own gets in."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_LOOK)
        yield


def styled(function: F) -> F:
    """The function, run inside `look`."""

    @functools.wraps(function)
    def inside(*args: Any, **options: Any) -> Any:
        with look():
            return function(*args, **options)

    return inside  # type: ignore[return-value]


class Figure(matplotlib.figure.Figure):
    """A matplotlib figure that shows itself in a notebook without `pyplot`."""

    def _repr_png_(self) -> bytes:
        return encoded(self, "png")


def figure(width: float, height: float) -> Figure:
    """An empty figure, `width` by `height` inches, with a canvas and a layout that keeps things apart."""
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    made.get_layout_engine().set(w_pad=0.06, h_pad=0.06, wspace=0.04, hspace=0.04)
    return made


def encoded(figure: matplotlib.figure.Figure, format: str = "png", dpi: float = DPI) -> bytes:
    """The figure as a file's contents ("png", "svg" or "pdf"); the same figure gives the same bytes."""
    undated: dict[str, dict[str, Any]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    out = io.BytesIO()
    with look():
        figure.savefig(out, format=format, dpi=dpi, metadata=undated[format])
    return out.getvalue()


def save(figure: matplotlib.figure.Figure, path: str | os.PathLike[str], dpi: float = DPI) -> None:
    """Write a figure: `.png`, `.svg` or `.pdf`. The file appears complete or not at all.

    Args:
        figure: what a function of `urushi.plot` returned.
        path: where to; the folder must exist.
        dpi: pixels an inch of a `.png`.

    Raises:
        UrushiError: another ending, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise UrushiError(f"cannot write {str(path)!r}: the name must end in {' or '.join(FORMATS)}")
    data = encoded(figure, path.suffix.lower()[1:], dpi)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", dir=path.parent)
    except OSError as error:
        raise UrushiError(f"cannot write {str(path)!r}: {error.strerror}") from None
    mask = os.umask(0o077)
    os.umask(mask)
    with os.fdopen(handle, "wb") as file:
        file.write(data)
    os.chmod(name, 0o666 & ~mask)  # a temporary file is private; a result is an ordinary file
    os.replace(name, path)
