"""Integrals over directions by quadrature, in double precision: truth that draws no random number."""

from __future__ import annotations

import functools

import numpy as np

from lanes import direction

_legendre = functools.cache(np.polynomial.legendre.leggauss)


def gauss(n: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights."""
    x, w = _legendre(n)
    return 0.5 * (high - low) * x + 0.5 * (high + low), 0.5 * (high - low) * w


def midpoints(n: int) -> np.ndarray:
    """The middles of n equal parts of [0, 1]."""
    return (np.arange(n) + 0.5) / n


def sphere(n_cos: int, n_phi: int, low: float = -1.0, high: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Directions with cosines in [low, high] and the solid angles that belong to them."""
    cos, weight = gauss(n_cos, low, high)
    phi = 2 * np.pi * midpoints(n_phi)
    grid = direction(cos[:, None], phi[None, :])
    return grid.reshape(-1, 3), np.repeat(weight * 2 * np.pi / n_phi, n_phi)


def normals(
    distribution: str, alpha_x: float, alpha_y: float, u: np.ndarray, phi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Facet normals by their rank, and the solid angle per unit of (u, phi).

    In the stretched polar coordinates of the slopes, (alpha_x r cos phi, alpha_y r sin phi), the share u of the facets
    (by projected area) that are flatter than r is r^2 / (1 + r^2) for GGX and 1 - exp(-r^2) for Beckmann.
    """
    if distribution == "ggx":
        r_sq, r_dr = u / (1 - u), 0.5 / (1 - u) ** 2
    else:
        r_sq, r_dr = -np.log1p(-u), 0.5 / (1 - u)
    r = np.sqrt(r_sq)
    slopes = np.stack([-alpha_x * r * np.cos(phi), -alpha_y * r * np.sin(phi), np.ones_like(r)], axis=-1)
    length = np.linalg.norm(slopes, axis=-1)
    return slopes / length[..., None], alpha_x * alpha_y * r_dr / length**3


@functools.cache
def all_normals(
    distribution: str, alpha_x: float, alpha_y: float, n: int = 256
) -> tuple[np.ndarray, np.ndarray]:
    """Facet normals over the whole upper hemisphere, and their solid angles."""
    v, weight = gauss(n, 0, 1)
    phi = 2 * np.pi * midpoints(2 * n)
    # u = 1 - v^2 spaces the steep facets such that even an integrand growing like their slope stays bounded.
    u, phi = (grid.ravel() for grid in np.meshgrid(1 - v**2, phi, indexing="ij"))
    m, per_u = normals(distribution, alpha_x, alpha_y, u, phi)
    return m, per_u * np.repeat(2 * v * weight, 2 * n) * (np.pi / n)
