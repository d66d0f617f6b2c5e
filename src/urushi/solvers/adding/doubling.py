"""Homogeneous slabs by doubling (van de Hulst 1963), from a start whose error is known.

For a thin slab the tanh of `media` is a fraction of powers (three terms of its continued fraction),

    tanh x / x = (105 + 10 x^2) / (105 + 45 x^2 + x^4) + x^8 / 99225 + ...

With x at most 0.15 along the shallowest node the start is good to 3e-12 of itself, and may be 0.3 times as deep as the
smallest cosine, where the usual start (one collision) would need a millionth. What is left is rounding, which every
doubling doubles: about 1e-9 of the largest element in the end.
"""

from __future__ import annotations

import numpy as np

from ...adding import Slab, double
from .media import Scattering
from .operator import OPERATORS
from .ordinates import operators

#: the largest depth of half a thin slab, along the shallowest node
THIN = 0.15


def solve(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> Slab:
    """A homogeneous slab; see `media.slab`, which checks the arguments."""
    times = max(int(np.ceil(np.log2(max(depth.max() / (2 * scattering.mu.min() * THIN), 1)))), 0)
    return double(thin(scattering, depth / 2.0**times, albedo), times, OPERATORS)


def thin(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> Slab:
    """A slab thinner than its smallest cosine."""
    unit = np.eye(len(scattering.mu))
    slant = 1 / np.sqrt(scattering.mu)
    share = albedo[:, None, None, None]
    x, y = (slant[:, None] * (unit - share * m) * slant for m in (scattering.even, scattering.odd))
    h = depth[:, None, None, None] / 2

    def half(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """1 / (1 + Z), with Z = X K^-1 tanh h K, K^2 = Y X (or V, of Y and X)."""
        square = h**2 * (other @ one)
        above, below = h * one @ (105 * unit + 10 * square), 105 * unit + 45 * square + square @ square
        return below @ np.linalg.solve(below + above, np.broadcast_to(unit, above.shape))

    alike, opposite = half(x, y), half(y, x)
    passed = np.exp(-depth[:, None] / scattering.mu)
    return operators(
        scattering, alike - opposite, alike + opposite - unit * (1 + passed[:, None, None, :]), passed
    )
