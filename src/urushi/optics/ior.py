"""Complex refractive indices of conductors, by name, without importing Mitsuba.

The names and the spectral tables are those of Mitsuba 3 (its wheel ships them as text; they go back to the SOPRA
database and to Palik's Handbook of Optical Constants). For RGB, Mitsuba turns a table into three numbers by
integrating it against the CIE 1931 matching functions and converting to linear sRGB, which can only be repeated with
the same code: ``data/conductors.csv`` holds what Mitsuba itself computed (``tools/make_conductor_table.py``).

The index is ``eta - i k``: k > 0 absorbs. It is absolute (relative to vacuum).
"""

from __future__ import annotations

import csv
import functools
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING

from urushi.errors import MaterialError, close

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

RGB = tuple[float, float, float]

_TABLE = Path(__file__).parent / "data" / "conductors.csv"


def conductor_names() -> tuple[str, ...]:
    """Names of every conductor, sorted; ``none`` is a perfect mirror (eta 0, k 1)."""
    return tuple(sorted(_rgb_table()))


def conductor_rgb(name: str) -> tuple[RGB, RGB]:
    """Index in linear sRGB, exactly as Mitsuba's ``roughconductor`` has it in an RGB variant.

    A few tables end within the visible range or lie outside the gamut of sRGB; Mitsuba then clamps a channel to 0
    (AlSb: eta of red), and so does this.

    Args:
        name: one of `conductor_names`.

    Returns:
        eta and k, three numbers each, single-precision values.

    Raises:
        MaterialError: an unknown name.
    """
    _check(name)
    return _rgb_table()[name]


def conductor_index(name: str, wavelengths_nm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Index at given wavelengths, linear between the table's entries as in Mitsuba.

    Args:
        name: one of `conductor_names`.
        wavelengths_nm: wavelengths in vacuum in nanometres, any shape.

    Returns:
        eta and k, float64 arrays of the same shape.

    Raises:
        MaterialError: an unknown name, a wavelength outside the table, or no Mitsuba to take the tables from.
    """
    import numpy as np

    _check(name)
    wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
    if name == "none":
        return np.zeros_like(wavelengths), np.ones_like(wavelengths)
    found = []
    for part in ("eta", "k"):
        nodes, values = _spectrum(name, part)
        if wavelengths.size and not bool(np.all((wavelengths >= nodes[0]) & (wavelengths <= nodes[-1]))):
            outside = wavelengths[~((wavelengths >= nodes[0]) & (wavelengths <= nodes[-1]))].flat[0]
            raise MaterialError(
                f"found the wavelength {float(outside)!r} nm; allowed for {name}: "
                f"{nodes[0]:g} to {nodes[-1]:g} nm, the range of its table",
                where="material",
            )
        found.append(np.interp(wavelengths, nodes, values))
    return found[0], found[1]


def _check(name: str) -> None:
    names = conductor_names()
    if name not in names:
        raise MaterialError(
            f"unknown conductor {name!r}; {close(name, names)}allowed: {', '.join(names)}", where="material"
        )


@functools.cache
def _rgb_table() -> dict[str, tuple[RGB, RGB]]:
    table = {}
    with _TABLE.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(line for line in stream if not line.startswith("#")):
            eta = (float(row["eta_r"]), float(row["eta_g"]), float(row["eta_b"]))
            k = (float(row["k_r"]), float(row["k_g"]), float(row["k_b"]))
            table[row["name"]] = (eta, k)
    return table


@functools.cache
def _spectrum(name: str, part: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths and values of Mitsuba's table of ``eta`` or ``k``."""
    import numpy as np

    # The finder itself, since an imported Mitsuba has replaced its module object by one without a location.
    spec = PathFinder.find_spec("mitsuba")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    for folder in folders:
        path = Path(folder) / "data" / "ior" / f"{name}.{part}.spd"
        if path.is_file():
            table = np.loadtxt(path, dtype=np.float64, comments="#", ndmin=2)
            return table[:, 0], table[:, 1]
    raise MaterialError(
        f"the spectral table of {name} comes with the package mitsuba, which is not installed here",
        where="material",
    )
