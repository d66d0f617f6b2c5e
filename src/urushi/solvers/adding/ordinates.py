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

#: albedo above which a mode may fade so slowly that its rate needs all digits
CONSERVED = 0.999


def solve(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> Slab:
    """A homogeneous slab; see `media.slab`, which checks the arguments."""
    k, f, g = modes(scattering, albedo)
    h = depth[:, None, None] / 2
    x = h * k
    fading = h * np.divide(np.tanh(x), x, out=np.ones_like(x), where=x > 1e-8)
    unit, factor = np.eye(len(scattering.mu)), np.stack((f, g))
    alike, opposite = np.linalg.inv(unit + (factor * fading[:, :, None]) @ factor.swapaxes(3, 4))
    passed = np.exp(-depth[:, None] / scattering.mu)
    return operators(
        scattering, alike - opposite, alike + opposite - unit * (1 + passed[:, None, None]), passed
    )


def modes(scattering: Scattering, albedo: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The modes for some albedos.

    Args:
        scattering: the phase function on the nodes.
        albedo: (A,) albedos.

    Returns:
        k: (A, M, n) rates of fading, >= 0; F U and G V: (A, M, n, n).

    Raises:
        UrushiError: too few nodes for the phase function: more light is scattered than there is.
    """
    f, g = _roots(scattering, albedo) / np.sqrt(scattering.mu)[:, None]
    u, k, vt = np.linalg.svd(f.swapaxes(2, 3) @ g)
    return k, f @ u, g @ vt.swapaxes(2, 3)


def _roots(scattering: Scattering, albedo: np.ndarray) -> np.ndarray:
    """(2, A, M, n, n) F with F F^T = 1 - a E, and the same of O: Cholesky's factors."""
    unit = np.eye(len(scattering.mu))
    left = unit - albedo[:, None, None, None] * np.stack((scattering.even, scattering.odd))[:, None]
    # Where next to nothing is lost, the largest eigenvalue of E is 1: it has no such factor, and eigenvectors make one.
    lasting = (albedo > CONSERVED) & (scattering.first == 0)
    left[0, lasting, 0] = unit
    found = np.empty(left.shape)
    try:  # from the horizon on, where light fades fastest: that keeps ten times as many digits
        found[..., ::-1, :] = np.linalg.cholesky(left[..., ::-1, ::-1])
    except np.linalg.LinAlgError:
        raise _too_few(scattering) from None
    if lasting.any():
        value, vector = np.linalg.eigh(scattering.even[0])
        if abs(value[-1] - 1) < 1e-10:
            value[-1] = 1  # the columns were normalised: this one is known
        if value[-1] > 1:
            raise _too_few(scattering)
        found[0, lasting, 0] = vector * np.sqrt(1 - albedo[lasting, None, None] * value)
    return found


def _too_few(scattering: Scattering) -> UrushiError:
    most = max(np.linalg.eigvalsh(matrix).max() for matrix in (scattering.even, scattering.odd))
    return UrushiError(
        f"phase function: {len(scattering.mu)} nodes make it scatter {most} of the light; use more nodes"
    )


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
