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
    unit = np.eye(len(scattering.mu))

    def half(factor: np.ndarray) -> np.ndarray:
        found: np.ndarray = np.linalg.inv(unit + (factor * fading[:, :, None]) @ np.swapaxes(factor, 2, 3))
        return found

    alike, opposite = half(f), half(g)
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
    slant = 1 / np.sqrt(scattering.mu)[:, None]
    lasting = (albedo > CONSERVED) & (scattering.first == 0)
    f = slant * _root(scattering.even, albedo, lasting)
    g = slant * _root(scattering.odd, albedo, lasting & False)
    u, k, vt = np.linalg.svd(np.swapaxes(f, 2, 3) @ g)
    return k, f @ u, g @ np.swapaxes(vt, 2, 3)


def _root(scattered: np.ndarray, albedo: np.ndarray, lasting: np.ndarray) -> np.ndarray:
    """(A, M, n, n) F with F F^T = 1 - a E: Cholesky's factor.

    Args:
        scattered: (M, n, n) E.
        albedo: (A,) a.
        lasting: (A,) where the first matrix loses next to nothing: its largest eigenvalue is 1, so that at albedo 1
            there is no such factor, and eigenvectors make one.
    """
    unit = np.eye(scattered.shape[1])
    left = unit - albedo[:, None, None, None] * scattered
    left[lasting, 0] = unit
    found = np.empty(left.shape)
    try:  # from the horizon on, where light fades fastest: that keeps ten times as many digits
        found[..., ::-1, :] = np.linalg.cholesky(left[..., ::-1, ::-1])
    except np.linalg.LinAlgError:
        raise _too_few(scattered) from None
    if lasting.any():
        value, vector = np.linalg.eigh(scattered[0])
        if abs(value[-1] - 1) < 1e-10:
            value[-1] = 1  # the columns were normalised: this one is known
        if value[-1] > 1:
            raise _too_few(scattered)
        found[lasting, 0] = vector * np.sqrt(1 - albedo[lasting, None, None] * value)
    return found


def _too_few(scattered: np.ndarray) -> UrushiError:
    most = np.linalg.eigvalsh(scattered).max()
    return UrushiError(
        f"phase function: {scattered.shape[1]} nodes make it scatter {most} of the light; use more nodes"
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
