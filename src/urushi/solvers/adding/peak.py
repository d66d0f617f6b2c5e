"""Light scattered again and again within a peak that the nodes do not resolve, on its way through a slab.

Delta-M makes one direction of a peak. What is straight on is then right in all that the nodes resolve; what they do not
is small angles, at which scattering n times has the moments chi_l^n (Goudsmit & Saunderson 1940). With y = a tau / mu,
and 1 / mu the mean of those of both directions, light scattered n times is to light scattered once as y^(n-1) / n!
times its moments. On the nodes those are v^n, v_l what delta-M makes of chi_l: its series, and f everywhere. So in its
closed form (`once`) p becomes

    p + (exp(-y f) - 1) p_1 + exp(-y f) sum over n > 1 of y^(n-1) p_n / n!,
    p_n = sum (2 l + 1) / (4 pi) (chi_l^n - v_l^n + f^n) P_l

(theory (basis.19)): p_n has f^n where the nodes know chi_l, chi_l^n where they know nothing. To second order in y it is
Nakajima & Tanaka's "IMS" (1988, eq. 24), which takes no more. Directions close to the horizon on both sides, and light
sent back, have none of it.

Of a sharp phase function (`Truncated.sharp`) light scattered two to eight times, which between the nodes is nearly as
sharp, is taken off what the nodes say, and added here: z^(n-1) / n! times the part of high degree of (v_l - f)^n
(`Truncated.times`), with z = 2 a tau / (mu_i + mu_o) (theory (basis.21)). That need not be true, only as sharp as
the truth: z is y for equal cosines, and where one of them is small it does not outgrow the light that fades.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from math import e, factorial

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_least, at_most
from . import single
from .delta_m import LEAST, Truncated
from .media import Scattering
from .phase import Phase
from .stencil import Lookup

#: what may be left out of p_n, relative to the phase function straight on; orders of scattering at most
SMALL, MOST_TIMES = 1e-5, 10
#: degrees to look at first, and at most; steps of the table for one wave of the highest that counts
FIRST, LAST, STEPS = 256, 8192, 25
#: as often as light is scattered that is taken off the nodes
TIMES = 8


class Rows:
    """Series of Legendre polynomials in a table over the angle, interpolated by cubics.

    Args:
        moments: (N, L) of each.
        waves: the highest degree that counts.

    Attributes:
        values: (K + 4, N) each over 4 pi, at angles pi (k - 1) / K.
    """

    def __init__(self, moments: np.ndarray, waves: float) -> None:
        self.steps = int(np.ceil(STEPS * waves / 2))
        angle = np.pi * np.abs(np.arange(-1, self.steps + 3)) / self.steps
        degree = (2 * np.arange(moments.shape[1]) + 1) / (4 * np.pi)
        self.values = _series(degree * moments, np.cos(angle)).T

    def sums(self, away: Array, toward: Array, table: Lookup, which: Sequence[int]) -> list[Array]:
        """Some of them.

        Args:
            away, toward: squared lengths of the difference and of the sum of the directions that the angle is between.
            table: `values` in the module and precision of these.
            which: of the N.
        """
        place = dr.atan2(dr.sqrt(away), dr.sqrt(toward)) * (2 * self.steps / np.pi)
        low = int(place) if table.plain else dr.uint32_array_t(type(place))(place)
        low = at_most(low, self.steps)
        t = place - (float(low) if table.plain else type(place)(low))
        weights = (
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        )
        count = self.values.shape[1]
        return [sum(weight * table[(low + k) * count + n] for k, weight in enumerate(weights)) for n in which]


class Peak(Rows):
    """A forward peak: the series on the nodes, that of light scattered twice, p_2 / 2!, p_3 / 3!, ...

    Args:
        phase: the phase function.
        terms: how many terms of it the nodes have.

    Attributes:
        forward: f.
    """

    def __init__(self, phase: Phase, terms: int) -> None:
        cut = Truncated.of(phase, terms)
        self.forward = f = cut.forward
        chi = moments(phase, terms)
        rest = np.zeros(len(chi))
        rest[:terms] = cut.moments * (1 - f)
        height, degree = 4 * np.pi * float(phase.eval(np.ones(1))[0]), 2 * np.arange(len(chi)) + 1
        again = np.zeros((TIMES - 1, len(chi)))
        if cut.again:
            for n, row in enumerate(again, 2):
                row[:terms] = (1 - f) / factorial(n) * cut.times(n)
        rows = [rest, *again]
        for n in range(2, MOST_TIMES + 1):
            row = (chi**n - (rest + f) ** n + f**n) / factorial(n)
            # y^(n-1) exp(-y f) is largest for y f = n - 1
            if np.abs(degree * row).sum() * ((n - 1) / (e * f)) ** (n - 1) < SMALL * height and n > 2:
                break
            rows.append(row)
        super().__init__(np.array(rows), max(terms, 0.5 * len(chi)))

    def scattered(self, once: Array, away: Array, toward: Array, y: Array, z: Array, table: Lookup) -> Array:
        """What p becomes.

        Args:
            once: p, the phase function itself.
            away, toward: squared lengths of the difference and of the sum of both ways light travels.
            y: albedo times optical depth along the way: a number or a colour.
            z: the same along the way of the mean cosine.
            table: see `sums`.
        """
        series, *rows = self.sums(away, toward, table, range(self.values.shape[1]))
        unresolved, taken = (
            _series_in(y, rows[TIMES - 1 :]),
            _series_in(z * (1 - self.forward), rows[: TIMES - 1]),
        )
        left = dr.exp(-self.forward * y)
        # What is taken off the nodes may be negative: it meets what they have more.
        return at_least(left * (once + unresolved) + (1 - left) * series, 0) + taken


def _series_in(x: Array, rows: Sequence[Array]) -> Array:
    """x r_1 + x^2 r_2 + ..."""
    found: Array = 0 * x
    for row in reversed(rows):
        found = (found + row) * x
    return found


def operator(again: Iterable[Scattering], depth: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """What of light scattered again is taken off the nodes as it passes: (C, M, n, n).

    Args:
        again: light scattered 2, ..., `TIMES` times on the nodes, `Scattering.powers`.
        depth, albedo: (C,) as they go with it (`Truncated.scale`).
    """
    a, tau, found = albedo[:, None, None], depth[:, None, None], np.zeros(())
    for n, times in enumerate(again, 2):
        mu, root = times.mu, np.sqrt(times.weights)
        z = a * tau * (2 / (mu + mu[:, None]))
        share = 0.5 * a * z ** (n - 1) * single.transmitted(depth, mu, mu[:, None]) * (root[:, None] / root)
        found = found + (share / factorial(n))[:, None] * (times.even + times.odd)
    return found


def forward(phase: Phase, terms: int) -> Peak | None:
    """None where the nodes resolve all of the phase function, or where what they do not is no forward peak alone."""
    return _kept(phase, terms)  # type: ignore[arg-type]


@lru_cache(maxsize=16)
def _kept(phase: Phase, terms: int) -> Peak | None:
    cut = Truncated.of(phase, terms)
    return None if cut.forward <= LEAST or cut.backward else Peak(phase, terms)


def moments(phase: Phase, terms: int) -> np.ndarray:
    """As many as scattering twice within the peak needs."""
    straight, back = phase.eval(np.array([1.0, -1.0]))
    count, height = max(FIRST, 2 * terms), 4 * np.pi * float(max(straight, back))
    while True:
        chi = phase.moments(count)
        l = np.arange(count)  # noqa: E741
        left = np.cumsum(((2 * l + 1) * chi**2)[::-1])[::-1]
        enough = left <= SMALL * height
        if enough[count // 2] and not enough.all():  # what follows the last is as little
            return chi[: max(int(np.argmax(enough)), terms + 1)]
        if count >= LAST:
            return chi
        count *= 2


def _series(rows: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """(N, K) sums of coefficients (N, L) times P_l."""
    found = np.zeros((len(rows), len(cos)))
    before, now = np.ones_like(cos), cos.copy()
    for l, row in enumerate(rows.T):  # noqa: E741
        found += row[:, None] * before
        before, now = now, ((2 * l + 3) * cos * now - (l + 1) * before) / (l + 2)
    return found
