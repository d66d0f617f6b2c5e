"""Light scattered to and fro within a backward peak that the nodes do not resolve.

A peak straight back (moments (-1)^l b_l, b_l > 0) sends light to and fro along one line: two streams, for which each
degree l of the angle about that line is a number x = a b_l. A slab of depth t = tau / mu sends back and passes
(Schuster 1905)

    R(x) = x (1 - E) / (k (1 + E) + 1 - E),    T(x) = 2 k e^(-k t) / (k (1 + E) + 1 - E),

with k^2 = 1 - x^2 and E = e^(-2 k t).

Odd powers of x are light that goes back, even ones light that goes on. The nodes have v_l for b_l: their series and a
share f that goes exactly back. Light scattered once has its closed form; of all other, with h = R(a b) - a b (1 -
e^(-2 t)) / 2 back and h = T(a b) - e^(-t) straight on,

    sum (2 l + 1) / (4 pi) (h(b_l) - h(v_l) + h(f)) P_l

over the mean cosine is added to what is sent along the line, and h(f) taken off the nodes (theory (basis.20)). h is a
polynomial in b^2, through values at a few points. Light scattered two, three or four times, which between the nodes is
nearly as sharp, is added and taken off besides, as by `peak`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array
from .delta_m import Truncated
from .media import Scattering
from .peak import Rows, moments
from .phase import Phase
from .stencil import Lookup

#: points of either polynomial
POINTS = 5


class Retro(Rows):
    """A backward peak: series of the polynomials of h for light that goes back, of those for light that goes on; and of
    light scattered three, two and four times on the nodes.

    Args:
        phase: the phase function.
        terms: how many terms of it the nodes have.

    Attributes:
        points: (POINTS,) the values of b that h is asked for.
    """

    def __init__(self, phase: Phase, terms: int) -> None:
        cut = Truncated.of(phase, terms)
        f = cut.backward
        chi = moments(phase, terms)
        b = chi * (-1.0) ** np.arange(len(chi))
        v = np.full(len(b), f)
        v[:terms] += cut.moments * (-1.0) ** np.arange(terms)
        # Chebyshev's points in b^2, up to where b and v part.
        most = float(b[np.abs(b - v) > 1e-12].max(initial=f))
        square = 0.5 * most**2 * (1 - np.cos(np.pi * (np.arange(POINTS) + 0.5) / POINTS))
        self.points = np.sqrt(square)
        through = np.linalg.inv(square[:, None] ** np.arange(POINTS)).T  # of each point, the powers of b^2
        rows = []
        for power in (3, 2):  # h begins with this power of b
            each = [b**n - v**n + f**n for n in range(power, power + 2 * POINTS, 2)]
            rows.append((through / self.points[:, None] ** power) @ np.array(each))
        sharp = np.zeros((3, len(b)))
        for row, n in zip(sharp, (3, 2, 4), strict=True):
            row[:terms] = cut.times(n) * (-1.0) ** (n * np.arange(terms))
        super().__init__(np.concatenate([*rows, sharp]), max(terms, 0.5 * len(chi)))

    def back(self, away: Array, toward: Array, t: Array, albedo: Array, table: Lookup) -> Array:
        """What is sent back, over the mean cosine, scattered three times or more.

        Args:
            away, toward: squared lengths of the difference and of the sum of both directions, pointing away.
            t: mean depth along both.
            albedo: of the medium; as t, a number or a colour.
            table: see `sums`.
        """
        *rows, thrice = self.sums(away, toward, table, (*range(POINTS), 2 * POINTS))
        found = sum(row * back(albedo * float(b), t, dr) for row, b in zip(rows, self.points, strict=True))
        return found + thrice * (albedo * albedo * albedo * few(t, dr)[1])

    def on(self, away: Array, toward: Array, t: Array, albedo: Array, table: Lookup) -> Array:
        """What goes on, scattered twice or more: see `back`, but for the ways light travels."""
        *rows, two, four = self.sums(
            away, toward, table, (*range(POINTS, 2 * POINTS), 2 * POINTS + 1, 2 * POINTS + 2)
        )
        found = sum(row * on(albedo * float(b), t, dr) for row, b in zip(rows, self.points, strict=True))
        twice, _, again = few(t, dr)
        return found + albedo * albedo * (two * twice + four * (albedo * albedo * again))


def back(x: Any, t: Any, module: Any) -> Any:
    """R(x) without light scattered once. `module`: numpy or Dr.Jit, whatever x and t are of."""
    k = module.sqrt(1 - x * x)
    faded = module.exp(-2 * k * t)
    return x * ((1 - faded) / (k * (1 + faded) + 1 - faded) - 0.5 * (1 - module.exp(-2 * t)))


def on(x: Any, t: Any, module: Any) -> Any:
    """T(x) without light that is not scattered; see `back`."""
    k = module.sqrt(1 - x * x)
    faded = module.exp(-k * t)
    square = faded * faded
    return 2 * k * faded / (k * (1 + square) + 1 - square) - module.exp(-t)


def few(t: Any, module: Any) -> tuple[Any, Any, Any]:
    """The coefficients of x^2, x^3 and x^4 in T and R; see `back`."""
    faded = module.exp(-2 * t)
    square = faded * faded
    two = 0.5 * t - 0.25 * (1 - faded)
    four = 0.5 * two * two + 0.125 * t - 0.03125 * (1 - square) - 0.125 * (1 - faded * (1 + 2 * t))
    on = module.exp(-t)
    return on * two, 0.125 * (1 - square) - 0.5 * t * faded, on * four


def operators(
    backward: float, again: Iterable[Scattering], depth: np.ndarray, albedo: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What of this is taken off the nodes, sent back and on: (C, M, n, n) each.

    Args:
        backward: f.
        again: light scattered two, three and four times on the nodes, `Scattering.powers`.
        depth, albedo: (C,) of the medium.
    """
    two, three, four = again
    mu, root = two.mu, np.sqrt(two.weights)
    a, t = albedo[:, None], depth[:, None] / mu
    sign = np.where((two.first + np.arange(len(two.even))) % 2, -1.0, 1.0)[:, None, None]
    unit = np.eye(len(mu))
    slant = 0.5 * depth[:, None, None] * (1 / mu + 1 / mu[:, None])
    share = mu[:, None] / (mu + mu[:, None]) * (root[:, None] / root)
    on_two, back_three, on_four = (
        (a[..., None] ** n * share * found)[:, None]
        for n, found in zip((2, 3, 4), few(slant, np), strict=True)
    )
    sent = unit * back(a * backward, t, np)[:, None, None] * sign + back_three * (three.even - three.odd)
    passed = on_two * (two.even + two.odd) + on_four * (four.even + four.odd)
    return sent, passed + unit * on(a * backward, t, np)[:, None, None]


def backward(phase: Phase, terms: int) -> Retro | None:
    """None where what the nodes do not resolve is no sharp backward peak alone."""
    return _kept(phase, terms)  # type: ignore[arg-type]


@lru_cache(maxsize=16)
def _kept(phase: Phase, terms: int) -> Retro | None:
    cut = Truncated.of(phase, terms)
    return Retro(phase, terms) if cut.again and cut.backward else None
