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
    rows = len(table.coefficients) if channels == 1 else int(table.counts.sum(dtype=np.int64))
    if 4 * rows > _REACH:
        raise MaterialError(f"found {rows} coefficients of a channel; allowed: {_REACH // 4}", where="counts")
    if channels == 1:  # the first channel of a series stands where the series begins
        return prepare(table.nodes, table.offsets, table.counts, table.coefficients[:, None])
    counts = table.counts.astype(np.int64)
    flat = counts.ravel()
    starts = (np.cumsum(flat) - flat).reshape(counts.shape)
    first = np.repeat(table.offsets.ravel().astype(np.int64) - starts.ravel(), flat) + np.arange(flat.sum())
    length = np.repeat(flat, flat)
    columns = [table.coefficients[first + channel * length] for channel in range(channels)]
    return prepare(table.nodes, starts, counts, np.stack(columns, axis=1))


def tabulated(table: FourierTable, number: type, luminance: bool = False) -> Tabulated:
    """The same in Dr.Jit arrays of a float type; equal tables share them as long as someone has them."""
    key = hashlib.blake2b(packed(table)).digest(), luminance, number
    tables = _TABULATED.get(key)
    if tables is None:
        tables = _TABULATED[key] = Tabulated(prepared(table, luminance), number)
    return tables
