"""Directions, and integrals over them that stay exact for the sharpest lobes.

A hemisphere is seen from the direction its lobe is expected in. Stereographic projection makes it the unit disk, a
Möbius transformation of the disk onto itself moves that direction to the centre, and the logarithm of the radius
spreads out what is sharp there: the horizon stays the edge of a rectangle, and a lobe of any width covers some of it.
All of this is conformal, so solid angles follow from one derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from urushi.stack import Stack

from . import chance

#: logarithm of the smallest radius; a lobe of roughness 1e-3 has less than a millionth of its energy inside
INNERMOST = -14.0
#: power that crowds cells and points towards the horizon, for what is broad
SKEW = 2.5
#: points along one side of a cell
ORDER = 4


def direction(cos: np.ndarray | float, phi: np.ndarray | float) -> np.ndarray:
    """Unit vectors from cosine and azimuth, (N, 3)."""
    cos, phi = np.broadcast_arrays(np.atleast_1d(np.asarray(cos, float)), np.asarray(phi, float))
    sin = np.sqrt(np.maximum(0, 1 - cos**2))
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1)


def views(stack: Stack, cosines: tuple[float, ...]) -> np.ndarray:
    """Incident directions to look from, of these cosines: from above, and from below where light gets there."""
    above = direction(np.array(cosines), 0.4 + 2.4 * np.arange(len(cosines)))
    return above if stack.layers[-1].opaque else np.concatenate([above, above * (1, 1, -1)])


def indices(stack: Stack) -> tuple[float, float]:
    """Absolute index above and below the stack (below an opaque base: above)."""
    # A BSDF that comes from elsewhere says of itself as a whole what it is ("bsdf").
    found = [layer.ior for layer in stack.layers if layer.kind in ("dielectric", "bsdf")]  # type: ignore[attr-defined]
    below = found[-1] if found and not stack.layers[-1].opaque else stack.exterior
    return stack.exterior, float(below) if isinstance(below, (int, float)) else float("nan")


def radiance(stack: Stack, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The factor of radiance, (index on the side of wi / index on the side of wo)^2, (N,)."""
    above, below = indices(stack)
    ratio = np.where(wi[:, 2] > 0, above / below, below / above) ** 2
    return np.where(wi[:, 2] * wo[:, 2] < 0, ratio, 1.0)


def mirrored(wi: np.ndarray) -> np.ndarray:
    """The mirror direction."""
    return wi * (-1, -1, 1)


def straight(stack: Stack, wi: np.ndarray) -> np.ndarray:
    """Snell's direction on the other side; the normal where there is none. wi is one direction (3,)."""
    above, below = indices(stack)
    ratio = above / below if wi[2] > 0 else below / above
    sin2 = ratio**2 * (wi[0] ** 2 + wi[1] ** 2)
    z = -np.sign(wi[2])
    return (
        np.array([-ratio * wi[0], -ratio * wi[1], z * np.sqrt(1 - sin2)]) if sin2 < 1 else np.array([0, 0, z])
    )


@dataclass(frozen=True)
class Patch:
    """The hemisphere around `axis`: coordinates (s, phi) in [INNERMOST, 0] x [-pi, pi]."""

    axis: tuple[float, float, float]

    @property
    def up(self) -> bool:
        return self.axis[2] > 0

    @property
    def _centre(self) -> complex:
        x, y, z = self.axis
        # A centre on the edge itself would leave nothing of the disk.
        return complex(x, y) / (1 + max(abs(z), 1e-4)) * (1 - 1e-6)

    def directions(self, s: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions (N, 3), and the solid angle of a unit of (s, phi)."""
        p, v = self._centre, np.exp(s + 1j * phi)
        bottom = 1 + np.conj(p) * v
        q = (v + p) / bottom
        # 1 - |q|^2, without the cancellation at the horizon.
        rest = (1 - abs(p) ** 2) * -np.expm1(2 * s) / np.abs(bottom) ** 2
        norm = 1 + np.abs(q) ** 2
        wo = np.stack([2 * q.real / norm, 2 * q.imag / norm, rest / norm * (1 if self.up else -1)], axis=1)
        area = 4 / norm**2 * ((1 - abs(p) ** 2) / np.abs(bottom) ** 2) ** 2 * np.exp(2 * s)
        return wo, area

    def coordinates(self, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(s, phi) of directions in this hemisphere."""
        p, q = self._centre, (wo[:, 0] + 1j * wo[:, 1]) / (1 + np.abs(wo[:, 2]))
        v = (q - p) / (1 - np.conj(p) * q)
        return np.clip(np.log(np.maximum(np.abs(v), 1e-30)), INNERMOST, 0), np.angle(v)

    def bins(self, wo: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Number of the cell of the grid of `integrate` that each direction falls into."""
        s, phi = self.coordinates(wo)
        i = np.clip((1 - (s / INNERMOST) ** (1 / SKEW)) * shape[0], 0, shape[0] - 1).astype(int)
        j = np.clip((phi / (2 * np.pi) + 0.5) * shape[1], 0, shape[1] - 1).astype(int)
        return i * shape[1] + j

    def stratified(self, shape: tuple[int, int], stream: int) -> tuple[np.ndarray, np.ndarray]:
        """Random directions, two in every cell of two grids: one of this patch, one of equal solid angles.

        Returns:
            (2, cells, 3) directions, and the solid angle that each stands for, (2, cells); the two rows are
            independent of one another. What is sharp counts on the first grid, what is broad on the second (balance
            heuristic, Veach 1997).
        """
        rng = np.random.default_rng((chance.SEED, stream))
        n = shape[0] * shape[1]
        i, j = (grid.ravel() for grid in np.meshgrid(*map(np.arange, shape), indexing="ij"))
        v, z = (((i + rng.random((2, n))) / shape[0]).ravel() for _ in range(2))
        phi, turn = ((2 * np.pi * ((j + rng.random((2, n))) / shape[1] - 0.5)).ravel() for _ in range(2))
        sharp, density = self._warped(v, phi)
        broad = direction(z if self.up else -z, turn)
        other = self._warped(*self._unwarped(broad))[1]
        weight = 1 / (n * (np.concatenate([density, other]) + 0.5 / np.pi))
        wo = np.concatenate([sharp.reshape(2, n, 3), broad.reshape(2, n, 3)], axis=1)
        return wo, weight.reshape(2, 2, n).swapaxes(0, 1).reshape(2, 2 * n)

    def _warped(self, v: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions from uniform numbers v and angles phi, and their density."""
        wo, area = self.directions(INNERMOST * v**SKEW, phi)
        return wo, 1 / np.maximum(area * v ** (SKEW - 1) * (-SKEW * INNERMOST * 2 * np.pi), 1e-300)

    def _unwarped(self, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s, phi = self.coordinates(wo)
        return (s / INNERMOST) ** (1 / SKEW), phi


def patches(stack: Stack, wi: np.ndarray) -> list[Patch]:
    """The hemispheres that light from wi (3,) can leave into."""
    found = [Patch(tuple(mirrored(wi)))]
    return found if stack.layers[-1].opaque else [*found, Patch(tuple(straight(stack, wi)))]


def integrate(
    density: Callable[[np.ndarray], np.ndarray], patch: Patch, shape: tuple[int, int], tolerance: float = 1e-5
) -> tuple[np.ndarray, float]:
    """Integrals of a density over the cells of a grid of a hemisphere, by refinement.

    Args:
        density: of directions (N, 3), per solid angle.
        patch: the hemisphere.
        shape: cells along s and phi.
        tolerance: a cell whose quarters disagree with it by more is cut further.

    Returns:
        (cells,) integrals, and the sum of what the last cuts still changed.
    """
    nodes, weights = np.polynomial.legendre.leggauss(ORDER)
    nodes, weights = 0.5 * (nodes + 1), 0.5 * weights
    weight = np.outer(weights, weights).ravel()

    def measure(corner: np.ndarray, size: np.ndarray) -> np.ndarray:
        s = (corner[:, :1, None] + size[:, :1, None] * nodes[None, :, None]) + 0 * nodes
        phi = (corner[:, 1:, None] + size[:, 1:, None] * nodes[None, None, :]) + 0 * nodes[:, None]
        wo, area = patch.directions(s.ravel(), phi.ravel())
        values = (density(wo) * area).reshape(len(corner), -1)
        return values @ weight * size.prod(axis=1)

    edges = INNERMOST * np.linspace(1, 0, shape[0] + 1) ** SKEW, np.linspace(-np.pi, np.pi, shape[1] + 1)
    corner, other = (
        np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
        for ends in ([e[:-1] for e in edges], [e[1:] for e in edges])
    )
    size = other - corner
    home = np.arange(len(corner))
    whole, left = np.zeros(len(corner)), 0.0
    value = measure(corner, size)
    for cut in range(12):
        quarter = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        size = np.repeat(0.5 * size, 4, axis=0)
        corner = np.repeat(corner, 4, axis=0) + np.tile(quarter, (len(corner), 1)) * size
        finer = measure(corner, size)
        change = np.abs(finer.reshape(-1, 4).sum(axis=1) - value)
        done = ~(change > tolerance)
        if cut == 11 or 4 * np.count_nonzero(~done) * ORDER**2 > 1 << 21:
            done[:] = True
        np.add.at(whole, home[done], finer.reshape(-1, 4).sum(axis=1)[done])
        left += float(change[done].sum())
        if done.all():
            break
        keep = np.repeat(~done, 4)
        home, corner, size, value = np.repeat(home, 4)[keep], corner[keep], size[keep], finer[keep]
    return whole, left
