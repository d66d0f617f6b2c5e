"""Homogeneous slabs by the modes of their light (discrete ordinates: Chandrasekhar 1950; Stam 2001).

With X = F F^T and Y = G G^T (see `media`), the singular values of F^T G = U k V^T are the rates at which the modes
fade, and Z = (F U) (tanh h k / k) (F U)^T, V = (G V) (tanh h k / k) (G V)^T. That takes no square of k, so a mode that
hardly fades keeps its digits, and one that never fades (albedo 1) is no special case.
"""

from __future__ import annotations

import numpy as np

from ...adding import Slab
from ...errors import UrushiError
from .media import Scattering
from .operator import Operator


def solve(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> Slab:
    """A homogeneous slab; see `media.slab`, which checks the arguments."""
    albedos, which = np.unique(albedo, return_inverse=True)
    k, f, g = modes(scattering, albedos)
    h = np.broadcast_to(depth[:, None, None] / 2, (max(len(depth), len(albedo)), 1, 1))
    which = np.broadcast_to(which, len(h))
    x = h * k[which]
    fading = h * np.where(x > 1e-8, np.tanh(x) / np.where(x > 1e-8, x, 1), 1)
    unit = np.eye(len(scattering.mu))

    def half(factor: np.ndarray) -> np.ndarray:
        scaled = factor[which] * fading[:, :, None, :]
        return np.linalg.solve(unit + scaled @ np.swapaxes(factor[which], 2, 3), unit)

    alike, opposite = half(f), half(g)
    passed = np.exp(-2 * h[:, 0] / scattering.mu)
    return operators(
        scattering, alike - opposite, alike + opposite - unit * (1 + passed[:, None, None, :]), passed
    )


def modes(scattering: Scattering, albedo: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The modes for some albedos.

    Args:
        scattering: the phase function on the nodes.
        albedo: (A,) different albedos.

    Returns:
        k: (A, M, n) rates of fading, >= 0; F U and G V: (A, M, n, n).

    Raises:
        UrushiError: too few nodes for the phase function: more light is scattered than there is.
    """
    slant = 1 / np.sqrt(scattering.mu)[:, None]
    roots = []
    for matrix, known in ((scattering.even, True), (scattering.odd, False)):
        value, vector = np.linalg.eigh(matrix)
        if known and scattering.first == 0 and abs(value[0, -1] - 1) < 1e-10:
            value[0, -1] = 1  # the columns were normalised: this one is known
        left = 1 - albedo[:, None, None] * value
        if left.min() < 0:
            raise UrushiError(
                f"phase function: {len(scattering.mu)} nodes make it scatter {value.max()} of the light; use more nodes"
            )
        roots.append(slant * vector * np.sqrt(left)[:, :, None, :])
    f, g = roots
    u, k, vt = np.linalg.svd(np.swapaxes(f, 2, 3) @ g)
    return k, f @ u, g @ np.swapaxes(vt, 2, 3)


def operators(scattering: Scattering, r: np.ndarray, t: np.ndarray, passed: np.ndarray) -> Slab:
    """A slab that is its own mirror image, from its symmetric matrices.

    Args:
        r, t: (C, M, n, n) in amplitudes, flux / sqrt(w mu), without what passes unscattered.
        passed: (C, n) the share that passes unscattered.
    """
    n = len(scattering.mu)
    root = np.sqrt(scattering.weights * scattering.mu)
    scale = root[:, None] / root
    found = [(x + np.swapaxes(x, 2, 3)) * (0.5 * scale) for x in (r, t)]
    reflected, transmitted = Operator((n, n), None, found[0]), Operator((n, n), passed, found[1])
    return Slab(reflected, transmitted, reflected, transmitted)
