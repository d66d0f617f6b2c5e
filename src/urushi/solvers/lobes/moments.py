"""Diffuse light by its first moments: how much, and how it lies between the normal and the horizon.

What particles scatter is not even: from a thin slab most leaves near the horizon, and what a boundary reflects totally
stays there. Four numbers tell it well enough, the moments of the flux by Legendre's polynomials of 2 c - 1, c the
cosine:

    a_p = integral P_p(2 c - 1) f(c) dc        f(c) = sum_p (2 p + 1) a_p P_p(2 c - 1)        p = 0 to 3

The first is the energy. Even light, f = 2 c, has (1, 1/3, 0, 0). A layer mixes moments: a matrix of four by four, from
tables of what it makes of each of the polynomials (`mixing`, `medium`). See theory (lobes.9).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...optics.vectors import Array

#: how many
COUNT = 4


def polynomials(c: Any) -> tuple[Any, ...]:
    """P_p(2 c - 1), which are the moments of a beam of unit energy."""
    x = 2 * c - 1
    return 1 + 0 * x, x, 1.5 * x * x - 0.5, (2.5 * x * x - 1.5) * x


class Moments:
    """Diffuse light.

    Args:
        parts: its moments, each a colour or a number.
    """

    def __init__(self, *parts: Array) -> None:
        self.parts = parts

    def __add__(self, other: Moments) -> Moments:
        return Moments(*(a + b for a, b in zip(self.parts, other.parts, strict=True)))

    def __mul__(self, factor: Array) -> Moments:
        return Moments(*(a * factor for a in self.parts))


class Mixing:
    """What a layer makes of diffuse light.

    Args:
        rows: (COUNT, COUNT), the moments that leave by those that come.
    """

    def __init__(self, rows: list[list[Array]]) -> None:
        self.rows = rows

    @classmethod
    def told(cls, values: list[Array]) -> Mixing:
        """From the moments of what becomes of each polynomial, as tables have them: all of the first moment first."""
        return cls([[(2 * j + 1) * values[p * COUNT + j] for j in range(COUNT)] for p in range(COUNT)])

    @classmethod
    def evened(cls, reflectance: Array) -> Mixing:
        """That of a surface which sends back even light, whatever comes."""
        return cls([[reflectance * even, *[0.0] * (COUNT - 1)] for even in EVEN])

    def __add__(self, other: Mixing) -> Mixing:
        return Mixing(
            [
                [sum_of(a, b) for a, b in zip(x, y, strict=True)]
                for x, y in zip(self.rows, other.rows, strict=True)
            ]
        )

    def __mul__(self, other: Any) -> Any:
        """With light, with what another layer makes of it first, or with a number."""
        if isinstance(other, Moments):
            return Moments(*(_dot(row, other.parts) for row in self.rows))
        if isinstance(other, Mixing):
            columns = list(zip(*other.rows, strict=True))
            return Mixing([[_dot(row, column) for column in columns] for row in self.rows])
        return Mixing([[_times(value, other) for value in row] for row in self.rows])

    def completed(self, other: Mixing) -> tuple[Mixing, Mixing]:
        """This and another, of the same layer, so that together they keep all energy: what lacks is added, evenly."""
        mine, others = self.rows[0], other.rows[0]
        lost = [(0.0 if j else 1.0) - a - b for j, (a, b) in enumerate(zip(mine, others, strict=True))]
        share = mine[0] / (mine[0] + others[0])
        rests = Mixing([[part * even for part in lost] for even in EVEN])
        return self + rests * share, other + rests * (1 - share)


#: moments of even light
EVEN = (1.0, 1 / 3, 0.0, 0.0)


def energy(light: Any) -> Array:
    """Of light as moments or as a number."""
    return light.parts[0] if isinstance(light, Moments) else light


def inverse(loop: Mixing) -> Mixing:
    """(1 - loop)^-1, by Gauss's elimination: no light grows from bounce to bounce, so no pivot is 0."""
    rows = [
        [(1.0 if p == j else 0.0) - value for j, value in enumerate(row)]
        + [1.0 if p == j else 0.0 for j in range(COUNT)]
        for p, row in enumerate(loop.rows)
    ]
    for n in range(COUNT):
        scale = 1 / rows[n][n]
        rows[n] = [_times(value, scale) for value in rows[n]]
        for p in range(COUNT):
            if p != n:
                factor = -rows[p][n]
                rows[p] = [
                    sum_of(value, _times(mine, factor)) for value, mine in zip(rows[p], rows[n], strict=True)
                ]
    return Mixing([row[COUNT:] for row in rows])


def of_powers(means: list[Array]) -> Mixing:
    """The mixing of a layer that takes the share of light that the cosine says, and changes no direction.

    Args:
        means: the integrals over (0, 1) of that share times c^n dc, n = 0 to 2 COUNT - 2.
    """
    rows: list[list[Array]] = []
    for p in range(COUNT):
        row: list[Array] = []
        for j in range(COUNT):
            product = np.polymul(_POWERS[p], _POWERS[j])[::-1]
            row.append(sum((2 * j + 1) * float(factor) * means[n] for n, factor in enumerate(product)))
        rows.append(row)
    return Mixing(rows)


#: coefficients of the polynomials in c, the highest first
_POWERS = (
    np.array([1.0]),
    np.array([2.0, -1.0]),
    np.array([6.0, -6.0, 1.0]),
    np.array([20.0, -30.0, 12.0, -1.0]),
)


def is_zero(value: Any) -> bool:
    """Whether a value is the float 0, which stands for what is not there and costs nothing."""
    return isinstance(value, float) and value == 0


def sum_of(a: Array, b: Array) -> Array:
    """The sum, without what is not there."""
    return b if is_zero(a) else a if is_zero(b) else a + b


def _times(a: Array, b: Array) -> Array:
    return 0.0 if is_zero(a) or is_zero(b) else a * b


def _dot(a: Any, b: Any) -> Array:
    found: Array = 0.0
    for x, y in zip(a, b, strict=True):
        found = sum_of(found, _times(x, y))
    return found
