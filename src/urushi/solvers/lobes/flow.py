"""Energies of two kinds of light at once: a beam, which has a direction, and diffuse light, which has none left.

What a layer does to both is a triangular matrix: a beam stays one or becomes diffuse, and nothing becomes a beam
again. Products and the series of bounces of such matrices (theory (lobes.9, lobes.10)) are what the adding equations
(`urushi.adding`) need.

Diffuse light is a number where it is even, and four moments elsewhere (`moments`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...adding import Algebra
from ...optics.vectors import Array
from .moments import Mixing, Moments, energy, inverse, sum_of


class Flow(NamedTuple):
    """What becomes of light: beam to beam, beam to diffuse, diffuse to diffuse.

    The first is a colour or a number; so are the others, or they are `Moments` and a `Mixing`.
    """

    beam: Array
    scattered: Any
    diffuse: Any

    def __add__(self, other: Flow) -> Flow:  # type: ignore[override]
        return Flow(*(sum_of(a, b) for a, b in zip(self, other, strict=True)))

    @property
    def spread(self) -> Array:
        """Energy of the diffuse light that a beam becomes."""
        return energy(self.scattered)


#: nothing
NONE = Flow(0.0, 0.0, 0.0)
#: all of it, unchanged
ALL = Flow(1.0, 0.0, 1.0)
#: the light that everything begins with
BEAM = Flow(1.0, 0.0, 0.0)


def _is(value: Any, number: float) -> bool:
    return isinstance(value, float) and value == number


def _times(a: Any, b: Any) -> Any:
    """The product, which costs nothing where a factor is known to be 0 or 1."""
    if _is(a, 0) or _is(b, 0):
        return 0.0
    if _is(b, 1):
        return a
    if _is(a, 1):
        return b
    return b * a if isinstance(b, (Moments, Mixing)) and not isinstance(a, Mixing) else a * b


def times(a: Flow, b: Flow) -> Flow:
    """First b, then a."""
    return Flow(
        _times(a.beam, b.beam),
        sum_of(_times(a.scattered, b.beam), _times(a.diffuse, b.scattered)),
        _times(a.diffuse, b.diffuse),
    )


def bounce(a: Flow, b: Flow, x: Flow) -> Flow:
    """(1 - a b)^-1 x."""
    loop = times(a, b)
    beam, diffuse = (_series(value) for value in (loop.beam, loop.diffuse))
    series = Flow(beam, _times(diffuse, _times(loop.scattered, beam)), diffuse)
    return times(series, x)


def _series(loop: Any) -> Any:
    if isinstance(loop, Mixing):
        return inverse(loop)
    return 1.0 if _is(loop, 0) else 1 / (1 - loop)


FLOWS = Algebra(times, bounce)
