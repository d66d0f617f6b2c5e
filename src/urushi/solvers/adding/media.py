"""Homogeneous slabs as operators on the nodes of their region.

With y = flux / sqrt(w mu), what travels down and up in one azimuthal order obeys (Grant & Hunt 1969)

    d' = -(1/mu - P) d + B u,    u' = -B d + (1/mu - P) u          (' along the optical depth, downwards)

where P and B say what one collision scatters on and back. All matrices are symmetric: reciprocity is built in. Sum and
difference of both directions see only X and Y, of even and of odd l - m:

    (d + u)' = -Y (d - u),    (d - u)' = -X (d + u),
    X = 1/mu - P - B = mu^-1/2 (1 - a E) mu^-1/2,    Y = 1/mu - P + B = mu^-1/2 (1 - a O) mu^-1/2    (a: the albedo)

A slab of depth 2 h, lit alike or oppositely from both sides, then reflects and transmits

    R + T = (1 - Z) / (1 + Z),    Z = X K^-1 tanh h K,    K^2 = Y X
    T - R = (1 - V) / (1 + V),    V = Y K^-1 tanh h K,    K^2 = X Y

(theory (basis.7 to basis.10)) without any growing exponential and without loss where X loses nothing. `ordinates`
finds the tanh by the modes of K, once for all depths; `doubling` by a few powers of thin h; `riccati` goes through the
slab in steps. All do any depth; the modes are faster and, having no thousandfold additions to round, conserve energy to
the last digit: they are what `slab` uses unless told otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ...adding import Slab, double
from ...errors import UrushiError
from .operator import OPERATORS, Operator
from .phase import between
from .projection import Projection
from .threads import one_thread

Method = Literal["ordinates", "doubling", "riccati"]
#: the same as names; the first is used unless told otherwise
METHODS: tuple[Method, ...] = get_args(Method)
#: optical depth, times the root of 1 - albedo, beyond which so little passes that digits are lost
FADED = 4.0


@dataclass(frozen=True)
class Scattering:
    """What one collision does to light on the nodes of a region, without the albedo.

    Attributes:
        mu, weights: (n,) cosines and quadrature weights of the nodes.
        even, odd: (M, n, n) the matrices E and O, symmetric.
        correction: the largest share of the light of a node that the quadrature missed or found too much before
            `even` was normalised; small where there are enough nodes for the phase function.
        first: the first of the azimuthal orders.
    """

    mu: np.ndarray
    weights: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    correction: float
    first: int

    @classmethod
    @one_thread()
    def build(
        cls,
        mu: np.ndarray,
        weights: np.ndarray,
        moments: np.ndarray,
        orders: range,
        backward: float = 0.0,
        projection: Projection | None = None,
    ) -> Scattering:
        """From the Legendre moments of the phase function.

        Args:
            mu, weights: (n,) the nodes of the region.
            moments: (L,) chi_l of the smooth part (chi_0 = 1 - backward).
            orders: which azimuthal orders.
            backward: share of the light that goes back exactly where it came from (delta-M of a backward peak).
            projection: of the region, for a sharp phase function; its last nodes are these.
        """
        if projection is None:
            even, odd = between(mu, moments, orders)
        else:
            even, odd = projection.between(moments, orders, len(mu))
        correction = 0.0
        if 0 in orders:
            # The same to both hemispheres, a_o + a_i each, so that every column sums to chi_0 and all stays symmetric.
            k = orders.index(0)
            missing = moments[0] - weights @ even[k]
            correction = float(np.max(np.abs(missing)))
            a = (missing - weights @ missing / (2 * weights.sum())) / weights.sum()
            even[k] += a[:, None] + a
        root = np.sqrt(weights)
        even *= root[:, None] * root
        odd *= root[:, None] * root
        if backward:
            sign = np.where(np.array(orders) % 2, -1.0, 1.0)[:, None, None]
            unit = np.eye(len(mu)) * (backward * sign)
            even, odd = even + unit, odd - unit
        return cls(mu, weights, even, odd, correction, orders.start)

    def powers(self, times: Sequence[int], low: Scattering, backward: float) -> Iterator[Scattering]:
        """The same of light scattered n times, one of `times` after the other: of high degree alone.

        Args:
            times: each n, ascending.
            low: what keeps low degrees and leaves out high ones.
            backward: share of what goes exactly back, which is left out of it n times.
        """
        sign = np.where((self.first + np.arange(len(self.even))) % 2, -1.0, 1.0)[:, None, None]
        pairs = [
            _powers(*pair, times)
            for pair in ((self.even, low.even, backward * sign), (self.odd, low.odd, -backward * sign))
        ]
        for even, odd in zip(*pairs, strict=True):
            yield Scattering(self.mu, self.weights, even, odd, self.correction, self.first)


def _powers(
    matrix: np.ndarray, low: np.ndarray, back: np.ndarray, times: Sequence[int]
) -> Iterator[np.ndarray]:
    """(A^n - b^n) (1 - low) for each n of `times`; symmetric, as far as they commute."""
    rest = matrix - back * np.eye(matrix.shape[-1])
    first = found = rest - rest @ low
    for n in range(2, times[-1] + 1):
        found = matrix @ found + back ** (n - 1) * first
        if n in times:
            yield 0.5 * (found + found.swapaxes(-1, -2))


@one_thread()
def slab(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray, method: Method = METHODS[0]) -> Slab:
    """A homogeneous slab.

    Args:
        scattering: the phase function on the nodes.
        depth: (C,) optical depth along the normal, >= 0.
        albedo: (C,) single-scattering albedo, in [0, 1]; C may be 1 in either.
        method: which solution; all give the same.

    Returns:
        Reflection and transmission as `Operator`, equal from both sides.

    Raises:
        UrushiError: a depth or an albedo out of range; too few nodes for the phase function.
    """
    from . import doubling, ordinates, riccati

    depth, albedo = np.atleast_1d(np.asarray(depth, float)), np.atleast_1d(np.asarray(albedo, float))
    if not ((depth >= 0) & (depth < np.inf)).all():
        raise UrushiError(f"medium: found depth {depth}; allowed: finite, >= 0")
    if not ((albedo >= 0) & (albedo <= 1)).all():
        raise UrushiError(f"medium: found albedo {albedo}; allowed: 0 to 1")
    if not (albedo.any() and depth.any()):
        n, passed = len(scattering.mu), np.exp(-depth[:, None] / scattering.mu)
        r, t = Operator((n, n)), Operator((n, n), passed)
        return Slab(r, t, r, t)
    solve: Callable[..., Slab] = {
        "ordinates": ordinates.solve,
        "doubling": doubling.solve,
        "riccati": riccati.homogeneous,
    }[method]
    # What little a thick slab lets through is lost in the rounding of both sums: it is put together from thinner ones.
    fading = float((depth * np.sqrt(1 - albedo)).max())
    times = int(np.ceil(np.log2(max(fading / FADED, 1))))
    return double(solve(scattering, depth / 2.0**times, albedo), times, OPERATORS)
