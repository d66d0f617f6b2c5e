"""Homogeneous slabs by doubling (van de Hulst 1963), from a start whose error is known.

For a thin slab the tanh of `media` is a fraction of powers, tanh x / x = (15 + x^2) / (15 + 6 x^2) + 2 x^6 / 1575: with
x at most 1/20 along the shallowest node, the start is good to 1e-12 of itself, and 2 h may be a tenth of the smallest
cosine where the usual start (one collision) would need a millionth.
"""

from __future__ import annotations

import numpy as np

from ...adding import Slab, double
from .media import Scattering
from .operator import OPERATORS
from .ordinates import operators

#: the largest depth of half a thin slab, along the shallowest node
THIN = 0.04


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
        """1 / (1 + Z), with Z = h X (15 + h^2 Y X) / (15 + 6 h^2 Y X)."""
        square = h**2 * (other @ one)
        above, below = h * one @ (15 * unit + square), 15 * unit + 6 * square
        return below @ np.linalg.solve(below + above, np.broadcast_to(unit, above.shape))

    alike, opposite = half(x, y), half(y, x)
    passed = np.exp(-depth[:, None] / scattering.mu)
    return operators(
        scattering, alike - opposite, alike + opposite - unit * (1 + passed[:, None, None, :]), passed
    )
