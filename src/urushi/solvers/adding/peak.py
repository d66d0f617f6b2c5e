"""Light scattered again and again within a peak that the nodes do not resolve, on its way through a slab.

Delta-M makes one direction of a peak. What is straight on is then right in all that the nodes resolve; what they do not
is small angles, at which scattering n times has the moments chi_l^n of the peak alone (Goudsmit & Saunderson 1940):
f for l < L, chi_l beyond. With y = a tau / mu, and 1 / mu the mean of those of both directions, light scattered n times
is to light scattered once as y^(n-1) p_n / n! to p_1, so in its closed form (`once`) p becomes

    p + (exp(-y f) - 1) p_1 + exp(-y f) sum over n > 1 of y^(n-1) p_n / n!,    p_n = sum (2 l + 1) / (4 pi) chi_l^n P_l

and p_1 = p less the series on the nodes. To second order in y it is Nakajima & Tanaka's "IMS" (1988, eq. 24), which
takes no more; theory (basis.13). Directions close to the horizon on both sides, and light sent back, have none of it.
"""

from __future__ import annotations

from functools import lru_cache
from math import e, factorial

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_least, at_most
from .delta_m import Truncated
from .phase import Phase
from .stencil import Lookup

#: a peak of less than this share of the light is none
LEAST = 1e-6
#: what may be left out of p_n, relative to the phase function straight on; orders of scattering at most
SMALL, MOST_TIMES = 1e-5, 10
#: degrees to look at first, and at most; steps of the table for one wave of the highest that counts
FIRST, LAST, STEPS = 256, 8192, 25


class Peak:
    """p_1, ..., p_N in a table over the scattering angle, interpolated by cubics.

    Args:
        phase: the phase function.
        terms: how many terms of it the nodes have.

    Attributes:
        forward: f.
        values: (K + 4, N) the series on the nodes, f and (1 - f) p' in all; p_2, p_3, ..., each over n!: at angles
            pi (k - 1) / K.
    """

    def __init__(self, phase: Phase, terms: int) -> None:
        self.forward = Truncated.of(phase, terms).forward
        chi = _moments(phase, terms)
        peak = np.minimum(np.where(np.arange(len(chi)) < terms, self.forward, chi), self.forward)
        top = float(phase.eval(np.ones(1))[0])
        degree = (2 * np.arange(len(chi)) + 1) / (4 * np.pi)
        rows = [degree * (chi - peak)]
        for n in range(2, MOST_TIMES + 1):
            row = degree * peak**n / factorial(n)
            # y^(n-1) exp(-y f) is largest for y f = n - 1
            if row.sum() * ((n - 1) / (e * self.forward)) ** (n - 1) < SMALL * top and n > 2:
                break
            rows.append(row)
        waves = max(terms, 0.5 * len(chi))
        self.steps = int(np.ceil(STEPS * waves / 2))
        angle = np.pi * np.abs(np.arange(-1, self.steps + 3)) / self.steps
        self.values = _series(np.array(rows), np.cos(angle)).T

    @classmethod
    def make(cls, phase: Phase, terms: int | None) -> Peak | None:
        """None where the nodes resolve all of the phase function, or where what they do not is no forward peak."""
        if terms is None or Truncated.of(phase, terms).forward < LEAST:
            return None
        return _kept(phase, terms)  # type: ignore[arg-type]

    def scattered(self, once: Array, away: Array, toward: Array, y: Array, table: Lookup) -> Array:
        """What p becomes.

        Args:
            once: p, the phase function itself.
            away, toward: squared lengths of the difference and of the sum of both ways light travels.
            y: albedo times optical depth along the way: a number or a colour.
            table: `values` in the module and precision of these.
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
        sums = [
            sum(weight * table[(low + k) * count + n] for k, weight in enumerate(weights))
            for n in range(count)
        ]
        again: Array = 0 * y
        for p in reversed(sums[1:]):
            again = (again + p) * y
        left = dr.exp(-self.forward * y)
        return at_least(left * (once + again) + (1 - left) * sums[0], 0)


@lru_cache(maxsize=16)
def _kept(phase: Phase, terms: int) -> Peak:
    return Peak(phase, terms)


def _moments(phase: Phase, terms: int) -> np.ndarray:
    """As many as scattering twice within the peak needs."""
    count, top = max(FIRST, 2 * terms), 4 * np.pi * float(phase.eval(np.ones(1))[0])
    while True:
        chi = phase.moments(count)
        l = np.arange(count)  # noqa: E741
        left = np.cumsum(((2 * l + 1) * np.maximum(chi, 0) ** 2)[::-1])[::-1]
        enough = left <= SMALL * top
        if enough[-1] and not enough.all():
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
