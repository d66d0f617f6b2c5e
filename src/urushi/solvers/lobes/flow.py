"""Energies of two kinds of light at once: a beam, which has a direction, and diffuse light, which has none left.

What a layer does to both is a triangular matrix: a beam stays one or becomes diffuse, and nothing becomes a beam
again. Products and the series of bounces of such matrices (theory (lobes.9, lobes.10)) are what the adding equations
(`urushi.adding`) need.
"""

from __future__ import annotations

from typing import NamedTuple

from ...adding import Algebra
from ...optics.vectors import Array


class Flow(NamedTuple):
    """What becomes of light: beam to beam, beam to diffuse, diffuse to diffuse; colours or numbers."""

    beam: Array
    scattered: Array
    diffuse: Array

    def __add__(self, other: Flow) -> Flow:  # type: ignore[override]
        return Flow(*(_plus(a, b) for a, b in zip(self, other, strict=True)))


#: nothing
NONE = Flow(0.0, 0.0, 0.0)
#: all of it, unchanged
ALL = Flow(1.0, 0.0, 1.0)


def _is(value: Array, number: float) -> bool:
    return isinstance(value, float) and value == number


def _plus(a: Array, b: Array) -> Array:
    return b if _is(a, 0) else a if _is(b, 0) else a + b


def _times(a: Array, b: Array) -> Array:
    """The product, which costs nothing where a factor is known to be 0 or 1."""
    if _is(a, 0) or _is(b, 0):
        return 0.0
    return b if _is(a, 1) else a if _is(b, 1) else a * b


def times(a: Flow, b: Flow) -> Flow:
    """First b, then a."""
    return Flow(
        _times(a.beam, b.beam),
        _plus(_times(a.scattered, b.beam), _times(a.diffuse, b.scattered)),
        _times(a.diffuse, b.diffuse),
    )


def bounce(a: Flow, b: Flow, x: Flow) -> Flow:
    """(1 - a b)^-1 x."""
    loop = times(a, b)
    beam, diffuse = (_series(value) for value in (loop.beam, loop.diffuse))
    series = Flow(beam, _times(_times(beam, loop.scattered), diffuse), diffuse)
    return times(series, x)


def _series(loop: Array) -> Array:
    return 1.0 if _is(loop, 0) else 1 / (1 - loop)


FLOWS = Algebra(times, bounce)
