"""The axes of the tables: where their nodes lie, so that linear interpolation between few of them is good.

Every axis runs over u in [0, 1]. Cosines and roughnesses are squares of u: what changes does so near 0. Seen from the
denser side, cosines are counted from the critical angle, where Snell's law has a root:

    u > 1/2   cos^2 = cos_c^2 + eta^2 (2 u - 1)^2      2 u - 1 is the cosine beyond the boundary
    u < 1/2   cos^2 = cos_c^2 (1 - (1 - 2 u)^2)        total reflection
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_least, at_most, root

#: nodes along index, roughness, width of the incident light, cosine
INDICES, ROUGHNESSES, WIDTHS, COSINES = 15, 13, 9, 33
#: nodes along the cosine at which light enters that comes back
ENTRIES = 25
#: nodes along index and cosine for sheets
SHEETS, SHEET_COSINES = 11, 17
#: nodes along index, roughness, width and cosine for what gets through an interface
EXIT_INDICES, EXIT_ROUGHNESSES, EXIT_WIDTHS, EXIT_COSINES = 8, 9, 7, 15
#: nodes along index, roughness, width and cosine for the moments of what comes back down
BACK_INDICES, BACK_ROUGHNESSES, BACK_WIDTHS, BACK_ENTRIES = 8, 7, 5, 13
#: nodes along the mean cosine of a lobe
MEANS = 33
#: nodes along the azimuth, in its squared sine
AZIMUTHS = 7
#: the largest ratio of two indices, and the nearest to 1 that is told from it
LARGEST, SMALLEST = 5.0, 1.004
#: (n - 1) / (n + 1) of the largest ratio
REACH = (LARGEST - 1) / (LARGEST + 1)


def ratios(count: int = INDICES) -> np.ndarray:
    """Index ratios n > 1 of the nodes."""
    q = np.maximum(np.linspace(0, REACH, count), (SMALLEST - 1) / (SMALLEST + 1))
    return np.asarray((1 + q) / (1 - q))


def squares(count: int) -> np.ndarray:
    """Nodes of an axis of squares."""
    return np.linspace(0, 1, count) ** 2


def cosines(eta: float, count: int = COSINES) -> np.ndarray:
    """Cosines of the nodes for light that sees the index ratio eta (below 1 from the denser side)."""
    u = np.linspace(0, 1, count)
    if eta >= 1:
        return np.maximum(u**2, 1e-4)
    critical = 1 - eta**2
    beyond = np.square(2 * u - 1)
    return np.sqrt(np.maximum(np.where(u > 0.5, critical + eta**2 * beyond, critical * (1 - beyond)), 1e-8))


def exit_cosines() -> np.ndarray:
    """Cosines of the nodes in the thinner of two media."""
    return np.asarray(np.maximum(np.linspace(0, 1, EXIT_COSINES) ** 2, 2e-3))


def along_cosine(cos: Array, eta: Array) -> Array:
    """u of a cosine."""
    excess = dr.square(cos) - (1 - dr.square(eta))
    critical = at_least(1 - dr.square(eta), 1e-12)
    beyond = at_most(root(excess) / eta, 1.0)
    within = at_most(root(-excess / critical), 1.0)
    inside = 0.5 + 0.5 * dr.select(excess > 0, beyond, -within)
    return dr.select(eta >= 1, root(cos), inside)


def along_square(value: Array) -> Array:
    """u of a roughness or a width; its slope stays finite at 0."""
    return at_most(dr.sqrt(at_least(value, 1e-12)), 1.0)


def along_ratio(eta: Array) -> Array:
    """u of an index ratio, from either side."""
    return at_most(dr.abs(eta - 1) / ((eta + 1) * REACH), 1.0)
