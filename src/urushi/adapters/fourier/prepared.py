"""A `FourierTable` made ready to be evaluated and sampled in Dr.Jit, once for all who have the same file."""

from __future__ import annotations

import hashlib
import weakref
from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.optics.series import Series, prepare
from urushi.optics.tabulated import Tabulated

from .file import packed
from .table import FourierTable

_TABULATED: weakref.WeakValueDictionary[Any, Tabulated] = weakref.WeakValueDictionary()
#: numbers that a Dr.Jit index reaches
_REACH = 2**32


def prepared(table: FourierTable, luminance: bool = False) -> Series:
    """The series of one BSDF, its channels side by side: (Y,) or (Y, R, B).

    Args:
        table: with one basis, not extrapolated.
        luminance: leave out the colours.
    """
    if table.extrapolated or table.bases != 1:
        raise MaterialError(
            f"found {table.flags} and {table.bases} bases; allowed: 1 and 1 basis", where="flags"
        )
    channels = 1 if luminance else table.channels
    counts = table.counts.astype(np.int64)
    if 4 * int(counts.sum()) > _REACH:
        raise MaterialError(
            f"found {int(counts.sum())} coefficients of a channel; allowed: {_REACH // 4}", where="counts"
        )
    flat = counts.ravel()
    starts = (np.cumsum(flat) - flat).reshape(counts.shape)
    order = np.arange(flat.sum()) - np.repeat(starts.ravel(), flat)
    source, length = np.repeat(table.offsets.ravel().astype(np.int64), flat), np.repeat(flat, flat)
    rows = [table.coefficients[source + channel * length + order] for channel in range(channels)]
    return prepare(table.nodes, starts, counts, np.stack(rows, axis=1))


def tabulated(table: FourierTable, number: type, luminance: bool = False) -> Tabulated:
    """The same in Dr.Jit arrays of a float type; equal tables share them as long as someone has them."""
    key = hashlib.blake2b(packed(table)).digest(), luminance, number
    tables = _TABULATED.get(key)
    if tables is None:
        tables = _TABULATED[key] = Tabulated(prepared(table, luminance), number)
    return tables
