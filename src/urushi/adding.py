"""The adding equations: what two layers do together, given what each does alone.

Light goes back and forth between the two layers; the sum over all bounces is a geometric series (Stokes 1862):

    R_top = R1_top + T1_up R2_top (1 - R1_bottom R2_top)^-1 T1_down
    T_down =         T2_down      (1 - R1_bottom R2_top)^-1 T1_down

and, for light from below, the same with the pair turned over. Whether R and T are numbers (Stokes), colours, matrices
in a directional basis (Grant & Hunt 1969) or operators with a delta part changes nothing in them but what "times" and
the series mean: that is an `Algebra`, and the second argument's only business. What all have in common is `+`.
Derived in docs/theory/adding.md: theory (adding.3 to adding.5).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .errors import UrushiError


class Slab(NamedTuple):
    """Reflection and transmission of a layer: light from above (`r_top`, `t_down`), from below (`r_bottom`, `t_up`)."""

    r_top: Any
    t_down: Any
    r_bottom: Any
    t_up: Any

    @property
    def symmetric(self) -> bool:
        """True for a layer that is known to be its own mirror image: it has one object for both sides."""
        return self.r_top is self.r_bottom and self.t_down is self.t_up

    def turned_over(self) -> Slab:
        """The layer upside down."""
        return Slab(self.r_bottom, self.t_up, self.r_top, self.t_down)


class Algebra(NamedTuple):
    """What the adding equations need beside `+`.

    Attributes:
        times: a, b -> a b.
        bounce: a, b, x -> (1 - a b)^-1 x = x + a b x + a b a b x + ...
    """

    times: Callable[[Any, Any], Any]
    bounce: Callable[[Any, Any, Any], Any]


#: quantities that commute: numbers, colours, arrays of either, of numpy or Dr.Jit
NUMBERS = Algebra(operator.mul, lambda a, b, x: x * (1 / (1 - a * b)))


def _solve(a: Any, b: Any, x: Any) -> Any:
    bounce = a @ b
    return np.linalg.solve(np.eye(bounce.shape[-1]) - bounce, x)


#: (..., out, in) matrices; all further axes are stacked layers, solved at once
MATRICES = Algebra(operator.matmul, _solve)


def add(upper: Slab, lower: Slab, algebra: Algebra = NUMBERS) -> Slab:
    """Put `upper` on `lower`. Nothing may reflect everything between them for ever, so that the series converges."""
    return Slab(
        *from_above(upper, lower, algebra),
        *from_above(lower.turned_over(), upper.turned_over(), algebra),
    )


def double(slab: Slab, times: int, algebra: Algebra = NUMBERS) -> Slab:
    """2^times layers of the same kind, one on another, in `times` additions (van de Hulst 1963)."""
    for _ in range(times):
        slab = _join(slab, slab, algebra)
    return slab


def pile(slab: Slab, count: int, algebra: Algebra = NUMBERS) -> Slab:
    """`count` layers of the same kind, one on another, by the binary digits of the number.

    Raises:
        UrushiError: no layers at all.
    """
    if count < 1:
        raise UrushiError(f"pile: found {count} layers; allowed: at least 1")
    whole: Slab | None = None
    while True:
        if count & 1:
            whole = slab if whole is None else _join(whole, slab, algebra)
        count >>= 1
        if not count:
            assert whole is not None
            return whole
        slab = _join(slab, slab, algebra)


def from_above(upper: Slab, lower: Slab, algebra: Algebra) -> tuple[Any, Any]:
    """Reflection and transmission of both together, for light from above."""
    times = algebra.times
    down = algebra.bounce(upper.r_bottom, lower.r_top, upper.t_down)  # all that travels down between them
    return upper.r_top + times(upper.t_up, times(lower.r_top, down)), times(lower.t_down, down)


def within(slabs: Sequence[Slab], source: Any, algebra: Algebra = NUMBERS) -> tuple[list[Any], list[Any]]:
    """The light between the layers of a pile, top down, lit from above by `source`.

    Returns:
        down, up: what travels down and up above each layer, all bounces included; and, last, what leaves below, where
        `up` has no entry. What a layer keeps is what goes in less what comes out, down[k] + up[k + 1] - up[k] -
        down[k + 1], so what all keep and what leaves adds up to the source, term by term.
    """
    times = algebra.times
    rests = [slabs[-1].r_top]  # reflection of all from a layer on
    for slab in reversed(slabs[:-1]):
        back = algebra.bounce(slab.r_bottom, rests[-1], slab.t_down)
        rests.append(slab.r_top + times(slab.t_up, times(rests[-1], back)))
    rests.reverse()
    down = [source]
    for k, slab in enumerate(slabs):
        passed = times(slab.t_down, down[k])
        down.append(passed if k + 1 == len(slabs) else algebra.bounce(slab.r_bottom, rests[k + 1], passed))
    return down, [times(rest, light) for rest, light in zip(rests, down, strict=False)]


def _join(upper: Slab, lower: Slab, algebra: Algebra) -> Slab:
    """Add layers that are piles of the same kind: if that is symmetric, so are they, and half the work is saved."""
    if not (upper.symmetric and lower.symmetric):
        return add(upper, lower, algebra)
    r, t = from_above(upper, lower, algebra)
    return Slab(r, t, r, t)
