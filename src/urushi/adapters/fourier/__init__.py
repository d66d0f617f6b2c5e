"""Fourier ``.bsdf`` files, as layerlab (Jakob et al. 2014) writes and pbrt-v3 reads them.

An isotropic BSDF on a grid of cosines, splines between them, with a cosine series in azimuth at each pair. The format
is defined in `docs/fourier-file.md`.

    table     FourierTable: what a file holds, checked
    file      read_fourier, write_fourier: the same bytes in both directions
    build     fourier_table: a table from series at nodes; the running integrals
    export    fourier_of: a table of a stack solved by adding
    values    eval, reflectance: what a table says, in numpy
"""

from __future__ import annotations

from .build import fourier_table
from .file import read_fourier, write_fourier
from .table import FourierTable
from .values import blended, evaluate, reflectance

__all__ = [
    "FourierTable",
    "blended",
    "evaluate",
    "fourier_table",
    "read_fourier",
    "reflectance",
    "write_fourier",
]
