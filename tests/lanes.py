"""The precisions and backends that formulas are tested in, and the way from numpy to them and back."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from conftest import LLVM

needs_llvm = pytest.mark.skipif(LLVM is None, reason="no LLVM can be had here")


@dataclass(frozen=True)
class Lanes:
    """Vectors of numbers in one precision.

    Attributes:
        number_name, vector_name: the types' names in `drjit.llvm.ad`.
        dtype: of the numbers, in numpy.
        exact: relative error to expect of a handful of operations.
    """

    number_name: str
    vector_name: str
    dtype: Any
    exact: float

    @property
    def number(self) -> Any:
        return getattr(importlib.import_module("drjit.llvm.ad"), self.number_name)

    @property
    def vector(self) -> Any:
        return getattr(importlib.import_module("drjit.llvm.ad"), self.vector_name)

    def __call__(self, values: Any) -> Any:
        """Numbers, one per lane."""
        return self.number(np.ascontiguousarray(values, self.dtype).ravel())

    def vectors(self, values: Any) -> Any:
        """Directions, (N, 3) to one per lane."""
        return self.vector(*(self(values[..., i]) for i in range(3)))

    def rounded(self, values: Any) -> Any:
        """`values` as this precision holds them, in double precision."""
        return np.asarray(np.asarray(values, self.dtype), np.float64)


SINGLE = Lanes("Float", "Array3f", np.float32, 1e-6)
DOUBLE = Lanes("Float64", "Array3f64", np.float64, 1e-12)

both_precisions = pytest.mark.parametrize(
    "lanes", [pytest.param(SINGLE, id="single"), pytest.param(DOUBLE, id="double")]
)


def back(value: Any) -> np.ndarray:
    """Dr.Jit to numpy in double precision, vectors as (N, 3)."""
    array = np.asarray(np.array(value), np.float64)
    return array.T if array.ndim == 2 else array


def one_by_one(function: Callable[..., float], *values: Any) -> np.ndarray:
    """A formula of plain floats, lane after lane."""
    return np.array([function(*map(float, lane)) for lane in np.broadcast(*values)])


def unit(values: Any) -> np.ndarray:
    """Vectors scaled to length 1."""
    values = np.asarray(values, np.float64)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def direction(cos: Any, phi: Any = 0.0) -> np.ndarray:
    """Directions of given cosine and azimuth, (..., 3)."""
    cos, phi = np.broadcast_arrays(np.asarray(cos, np.float64), np.asarray(phi, np.float64))
    sin = np.sqrt(np.maximum(0.0, 1 - cos**2))
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


def hemisphere(rng: np.random.Generator, n: int, lowest: float = 0.0) -> np.ndarray:
    """Random directions with cosines uniform in [lowest, 1]."""
    return direction(rng.uniform(lowest, 1, n), rng.uniform(0, 2 * np.pi, n))
