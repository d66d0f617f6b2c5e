"""Light scattered exactly once in a homogeneous slab, in closed form.

    k_R = a p(cos) mu_o / (mu_i + mu_o) (1 - exp(-tau (1/mu_i + 1/mu_o)))
    k_T = a p(cos) tau / mu_i exp(-tau / mu_max) (1 - exp(-x)) / x,      x = tau (1/mu_min - 1/mu_max)

(flux density per solid angle and unit flux, Chandrasekhar 1950; theory (basis.13)). It holds all that is sharp in the
phase function and whatever is not smooth as both directions graze; the rest is smooth enough to interpolate. Of a
truncated phase function `operators` gives the same on the nodes, to be taken off before that.
"""

from __future__ import annotations

import numpy as np

from .delta_m import Truncated
from .media import Scattering
from .phase import Phase


def reflected(depth: np.ndarray, mu_i: np.ndarray, mu_o: np.ndarray) -> np.ndarray:
    """Probability of leaving through the side that light came in by, per albedo and phase function: (C, ...).

    Args:
        depth: (C,) optical depth.
        mu_i, mu_o: cosines of the directions, > 0, of any shapes that fit.
    """
    tau = _column(depth, mu_i, mu_o)
    return mu_o / (mu_i + mu_o) * -np.expm1(-tau * (1 / mu_i + 1 / mu_o))


def transmitted(depth: np.ndarray, mu_i: np.ndarray, mu_o: np.ndarray) -> np.ndarray:
    """The same through the other side; as exact for equal cosines as for any."""
    tau = _column(depth, mu_i, mu_o)
    low, high = np.minimum(mu_i, mu_o), np.maximum(mu_i, mu_o)
    x = tau * ((high - low) / (low * high))
    share = np.where(x > 1e-12, -np.expm1(-x) / np.where(x > 1e-12, x, 1), 1)
    return tau / mu_i * np.exp(-tau / high) * share


def single(
    phase: Phase,
    truncated: Truncated,
    depth: np.ndarray,
    albedo: np.ndarray,
    mu_i: np.ndarray,
    mu_o: np.ndarray,
    phi: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Flux density of light scattered once, reflected and transmitted, by the true phase function.

    Args:
        phase: the phase function.
        truncated: its series on the nodes; light is attenuated as it is there (Nakajima & Tanaka 1988, "TMS").
        depth, albedo: (C,) of the medium itself.
        mu_i, mu_o: (N,) cosines of incidence and of exit, > 0.
        phi: (N,) azimuth between the ways light travels: 0 is straight on.

    Returns:
        k_R, k_T: (C, N) each.
    """
    depth, albedo = np.atleast_1d(depth).astype(float), np.atleast_1d(albedo).astype(float)
    left = 1 - albedo * truncated.forward
    share = (albedo / np.where(left > 0, left, 1))[:, None]
    sines = np.sqrt((1 - mu_i) * (1 + mu_i) * (1 - mu_o) * (1 + mu_o)) * np.cos(phi)
    up, down = np.clip(sines - mu_i * mu_o, -1, 1), np.clip(sines + mu_i * mu_o, -1, 1)
    return (
        share * phase.eval(up) * reflected(depth * left, mu_i, mu_o),
        share * phase.eval(down) * transmitted(depth * left, mu_i, mu_o),
    )


def operators(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light scattered once on the nodes: dense parts (C, M, n, n) of reflection and transmission.

    Args:
        scattering: the truncated phase function on the nodes.
        depth, albedo: (C,) as they go with it (`Truncated.scale`).
    """
    mu, root = scattering.mu, np.sqrt(scattering.weights)
    scale = 0.5 * np.atleast_1d(albedo)[:, None, None] * (root[:, None] / root)
    r = scale * reflected(depth, mu, mu[:, None])
    t = scale * transmitted(depth, mu, mu[:, None])
    return r[:, None] * (scattering.even - scattering.odd), t[:, None] * (scattering.even + scattering.odd)


def _column(depth: np.ndarray, mu_i: np.ndarray, mu_o: np.ndarray) -> np.ndarray:
    return np.asarray(depth, float).reshape(-1, *(1,) * max(np.ndim(mu_i), np.ndim(mu_o)))
