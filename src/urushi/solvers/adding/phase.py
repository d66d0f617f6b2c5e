"""Phase functions as series: what every azimuthal order of them is between all nodes of a region.

A phase function of the scattering angle is its Legendre moments chi_l = integral of p P_l(cos), which the addition
theorem turns into a sum of products, order by order (Chandrasekhar 1950, section 48):

    p_m(mu_o, mu_i) = sum_l (2 l + 1) chi_l Y_l^m(mu_o) Y_l^m(mu_i),     Y_l^m = sqrt((l - m)! / (l + m)!) P_l^m

(theory (basis.6)), in which half the integral of p_0 over all cosines is 1, and p = 1 / (4 pi) sum_m (2 - [m = 0])
p_m cos(m phi). Y_l^m is even or odd in the cosine with l - m, so the sums over even and over odd l - m give both
hemispheres at once.

A new phase function is a class with `moments` and `eval` here, and a line in `PHASES`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from scipy.special import eval_legendre

from ...errors import UrushiError
from ...optics.phase import normalised

#: more terms than this, and the starting values sin(theta)^m of the recurrence leave the range of double precision
MOST_TERMS = 1800
#: so many degrees at a time are tried on the nodes
STRETCH = 32
#: terms to look at first; moments below `NOTHING` there stand for no more terms
FEW_TERMS, NOTHING = 80, 1e-20


class Phase(Protocol):
    """A phase function."""

    def moments(self, count: int) -> np.ndarray:
        """(count,) Legendre moments chi_l; chi_0 = 1, chi_1 the mean cosine."""

    def eval(self, cos: np.ndarray) -> np.ndarray:
        """Density per solid angle at these cosines of the scattering angle (1: straight on)."""


class Isotropic:
    """Equal light in all directions."""

    def moments(self, count: int) -> np.ndarray:
        return (np.arange(count) == 0).astype(float)

    def eval(self, cos: np.ndarray) -> np.ndarray:
        return np.full(np.shape(cos), 1 / (4 * np.pi))


class HenyeyGreenstein:
    """Henyey & Greenstein 1941: chi_l = g^l."""

    def __init__(self, g: float) -> None:
        if not -1 < g < 1:
            raise UrushiError(f"phase function: found g = {g}; allowed: -1 < g < 1")
        self.g = float(g)

    def moments(self, count: int) -> np.ndarray:
        steps = np.full(count, self.g)
        steps[0] = 1
        return np.cumprod(steps)  # ten times as fast as powers, which underflow

    def eval(self, cos: np.ndarray) -> np.ndarray:
        g = abs(self.g)
        away = 1 - np.copysign(1, self.g) * np.asarray(cos)  # from the peak: nothing cancels there
        return (1 - g) * (1 + g) / (4 * np.pi * ((1 - g) ** 2 + 2 * g * away) ** 1.5)


class Rayleigh:
    """3 / (16 pi) (1 + cos^2)."""

    def moments(self, count: int) -> np.ndarray:
        found = np.zeros(count)
        found[: min(count, 3)] = (1, 0, 0.1)[: min(count, 3)]
        return found

    def eval(self, cos: np.ndarray) -> np.ndarray:
        return 3 / (16 * np.pi) * (1 + np.asarray(cos) ** 2)


class Tabulated:
    """Values at equal steps of the scattering angle from 0 to pi, linear in its cosine between them."""

    def __init__(self, values: Sequence[float]) -> None:
        self.away, self.density = normalised(values)

    def moments(self, count: int) -> np.ndarray:
        # Gauss on parts of the steps over which no P_l has more than four half-waves.
        steps = len(self.away) - 1
        ends = 2 * np.sin(np.linspace(0, np.pi / 2, steps * (1 + count // (4 * steps)) + 1)) ** 2
        x, w = np.polynomial.legendre.leggauss(16)
        length = np.diff(ends)[:, None]
        away = (ends[:-1, None] + 0.5 * length * (1 + x)).ravel()
        weight = 2 * np.pi * (0.5 * length * w).ravel() * np.interp(away, self.away, self.density)
        found, before, now = np.zeros(count), np.ones_like(away), 1 - away
        for l in range(count):  # noqa: E741
            found[l] = weight @ before
            before, now = now, ((2 * l + 3) * (1 - away) * now - (l + 1) * before) / (l + 2)
        return found

    def eval(self, cos: np.ndarray) -> np.ndarray:
        return np.interp(1 - np.asarray(cos), self.away, self.density)


#: the phase function of each described kind; called with the numbers of the description
PHASES: dict[str, Any] = {
    "isotropic": Isotropic,
    "henyey_greenstein": HenyeyGreenstein,
    "rayleigh": Rayleigh,
    "tabulated": Tabulated,
}


def series(described: Any) -> Phase:
    """The phase function of a description."""
    numbers = {name: getattr(described, name) for name in type(described).model_fields}
    found: Phase = PHASES[described.kind](**numbers)
    return found


def terms(phase: Phase, tolerance: float, times: int = 1) -> int:
    """How many terms the series needs: what is left out is, at its largest, `tolerance` of the peak.

    Args:
        phase: the phase function.
        tolerance: relative to the peak.
        times: of light scattered so many times, whose moments are powers of those: what is left when light scattered
            once is taken care of in closed form has fewer terms, and fewer azimuthal orders.

    Returns:
        a number of terms, at most `MOST_TERMS`.
    """
    moments = np.abs(phase.moments(FEW_TERMS))
    if moments[-4:].max() > NOTHING:
        moments = np.abs(phase.moments(MOST_TERMS + 1))
    l = np.arange(len(moments))  # noqa: E741
    left = np.cumsum(((2 * l + 1) * (moments if times == 1 else moments**times))[::-1])[::-1]
    enough = left <= tolerance * left[0]
    return int(np.argmax(enough)) if enough[-1] else MOST_TERMS


def resolved(mu: np.ndarray, weights: np.ndarray, tolerance: float = 1e-4) -> int:
    """How many terms of a series the nodes of a region can tell apart.

    Beyond, sums over the nodes make light of terms whose integrals are 0: the quadrature knows every even P_l below the
    number returned to `tolerance`. A little more or less changes little; half as much again, and light comes from
    nothing.

    Args:
        mu, weights: (n,) the nodes of the region.
        tolerance: allowed sum of (2 l + 1) P_l over the nodes.
    """
    most = min(4 * len(mu), MOST_TERMS)
    for start in range(2, most, STRETCH):
        even = np.arange(start, min(start + STRETCH, most), 2)
        wrong = np.abs((2 * even + 1) * (eval_legendre(even[:, None], mu) @ weights)) > tolerance
        if wrong.any():
            return int(even[np.argmax(wrong)])
    return most


def harmonics(mu: np.ndarray, count: int, orders: range) -> np.ndarray:
    """Normalised associated Legendre functions Y_l^m, bounded by 1, without the sign (-1)^m.

    Args:
        mu: (n,) cosines.
        count: l < count.
        orders: which m, ascending by 1.

    Returns:
        (max(count - orders.start, 0), len(orders), n): at [j, i] that of the i-th order and l = m + j; 0 from l = count
        on.

    Raises:
        UrushiError: more terms than double precision carries.
    """
    if count > MOST_TERMS:
        raise UrushiError(f"phase function: found {count} terms; allowed: at most {MOST_TERMS}")
    rows = max(count - orders.start, 0)
    found = np.zeros((rows, len(orders), len(mu)))
    if rows == 0:
        return found
    m, first, one, two = _recurrence(rows, orders)
    found[0, : len(m)] = first[:, None] * np.sqrt((1 - mu) * (1 + mu)) ** m[:, None]
    one = one[..., None] * mu
    for k in range(1, rows):
        now = found[k, : min(rows - k, len(m))]  # the orders that have so many terms
        np.multiply(one[k - 1, : len(now)], found[k - 1, : len(now)], out=now)
        if k > 1:
            now -= two[k - 1, : len(now)] * found[k - 2, : len(now)]
    return found


@lru_cache(maxsize=8)
def _recurrence(rows: int, orders: range) -> tuple[np.ndarray, ...]:
    """Orders m, Y_m^m over sin(theta)^m, and the two factors of the recurrence, stable upwards,

    sqrt(l^2 - m^2) Y_l = (2 l - 1) mu Y_(l-1) - sqrt((l-1)^2 - m^2) Y_(l-2).
    """
    m = np.array(orders)[:rows]
    first = np.cumprod(np.append(1, np.sqrt(1 - 0.5 / np.arange(1, m[-1] + 1))))[m]
    j = np.arange(rows)[:, None]
    root = np.sqrt(j * (j + 2 * m))
    return m, first, (2 * (m + j) - 1)[1:] / root[1:], (root[:-1] / root[1:])[..., None]


def between(mu: np.ndarray, moments: np.ndarray, orders: range) -> tuple[np.ndarray, np.ndarray]:
    """The series summed over even and over odd l - m, between all nodes of a region.

    Args:
        mu: (n,) cosines of the nodes.
        moments: (L,) chi_l.
        orders: which azimuthal orders.

    Returns:
        even, odd: (M, n, n) each, symmetric. Into the same hemisphere goes p_m = even + odd, into the other one
        even - odd.
    """
    return products(harmonics(mu, len(moments), orders), moments, orders)


def products(y: np.ndarray, moments: np.ndarray, orders: range) -> tuple[np.ndarray, np.ndarray]:
    """The same from `harmonics`, (L, M, n)."""
    l = np.arange(len(y))[:, None] + np.array(orders)  # noqa: E741
    weight = (2 * l + 1) * np.append(moments, np.zeros(len(orders)))[l]
    even, odd = (
        y[parity::2].transpose(1, 2, 0) @ (weight[parity::2, :, None] * y[parity::2]).transpose(1, 0, 2)
        for parity in (0, 1)
    )
    return even, odd
