"""Layers whose properties vary with depth, by the adding equations in the limit of thin layers (Max et al. 1997).

To put one more thin layer under a slab is to add its P and B (see `media`) once: the reflectance for light from below
and the transmittance obey

    R' = B - (1/mu - P) R - R (1/mu - P) + R B R,      T' = -(1/mu - P) T + R B T      (' along the optical depth)

the first of which is Riccati's equation (theory (adding.10)). The same from the bottom up gives the reflectance for
light from above; what passes upwards is the transpose of what passes downwards. The rates 1/mu of grazing light are
large, but diagonal: they are integrated exactly, the rest by four stages (exponential time differencing: Cox &
Matthews 2002). Steps are chosen by comparing one step with two of half the length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...adding import Slab
from ...errors import UrushiError
from .media import Scattering
from .operator import Operator
from .threads import one_thread

#: a profile: from the height t (0 at the top of the layer, 1 at its bottom) to one number per colour, (C,)
Profile = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class Gradient:
    """A layer whose properties vary with depth.

    Attributes:
        depth: optical depth of all of it along the normal, > 0, the same for all colours.
        constituents: what scatters: the phase function of each on the nodes, and its albedo at the height t, the share
            of all extinction there that it scatters. The albedos add up to 1 at most. t is measured in optical depth.
    """

    depth: float
    constituents: Sequence[tuple[Scattering, Profile]]


@one_thread()
def solve(layer: Gradient, tolerance: float = 1e-8) -> Slab:
    """Reflection and transmission of a layer whose properties vary with depth.

    Args:
        layer: the layer.
        tolerance: allowed error of a step, per element of the symmetric matrices (of which none exceeds 1); all steps
            together make some thirty times as much.

    Raises:
        UrushiError: a depth or an albedo out of range; a tolerance that rounding does not allow.
    """
    if not (np.isfinite(layer.depth) and layer.depth > 0):
        raise UrushiError(f"medium: found depth {layer.depth}; allowed: finite, > 0")
    if not layer.constituents:
        raise UrushiError("medium: found no constituents; allowed: one or more")
    mu = layer.constituents[0][0].mu
    _, r_top = _integrate(layer, lambda t: 1 - t, tolerance, transmit=False)
    t_down, r_bottom = _integrate(layer, lambda t: t, tolerance, transmit=True)
    n = len(mu)
    passed = np.exp(-layer.depth / mu)[None]
    t_down = t_down - np.eye(n) * passed
    root = np.sqrt(layer.constituents[0][0].weights * mu)
    scale = root[:, None] / root
    return Slab(
        Operator((n, n), None, r_top * scale),
        Operator((n, n), passed, t_down * scale),
        Operator((n, n), None, r_bottom * scale),
        Operator((n, n), passed, np.swapaxes(t_down, 2, 3) * scale),
    )


def homogeneous(scattering: Scattering, depth: np.ndarray, albedo: np.ndarray) -> Slab:
    """A homogeneous slab, one colour after another; see `media.slab`, which checks the arguments.

    Its error is some 3e-8 of the largest element of the symmetric matrices.
    """
    n = len(scattering.mu)
    depth, albedo = np.broadcast_arrays(depth, albedo)
    passed = np.exp(-depth[:, None] / scattering.mu)
    r = np.zeros((len(depth), len(scattering.even), n, n))
    t = r.copy()
    for c, (deep, share) in enumerate(zip(depth, albedo, strict=True)):
        if deep > 0:
            found = solve(Gradient(float(deep), [(scattering, _constant(share))]), 1e-10)
            r[c], t[c] = found.r_top.dense[0], found.t_down.dense[0]
    reflected, through = Operator((n, n), None, r), Operator((n, n), passed, t)
    return Slab(reflected, through, reflected, through)


def _constant(albedo: float) -> Profile:
    value = np.atleast_1d(albedo)
    return lambda t: value


def _integrate(
    layer: Gradient, height: Callable[[float], float], tolerance: float, transmit: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(T, R) of the layer built up from one side, by steps of controlled error."""
    mu = layer.constituents[0][0].mu
    slant = 1 / np.sqrt(mu)

    def scatter(tau: float) -> tuple[np.ndarray, np.ndarray]:
        """P and B at an optical depth from where the integration began."""
        t = min(max(height(tau / layer.depth), 0.0), 1.0)  # the ends of steps add up to it but for rounding
        even = odd = total = np.zeros(1)
        for scattering, profile in layer.constituents:
            albedo = np.atleast_1d(np.asarray(profile(t), float))
            if not (albedo >= 0).all():
                raise UrushiError(f"medium: found albedo {albedo} at height {t}; allowed: 0 to 1")
            total = total + albedo
            share = 0.5 * albedo[:, None, None, None]
            even, odd = even + share * scattering.even, odd + share * scattering.odd
        if not (total <= 1 + 1e-12).all():
            raise UrushiError(f"medium: found albedos that add up to {total} at height {t}; allowed: 0 to 1")
        return slant[:, None] * (even + odd) * slant, slant[:, None] * (even - odd) * slant

    def rest(tau: float, state: np.ndarray) -> np.ndarray:
        """All of the right-hand side but the diagonal rates."""
        p, b = scatter(tau)
        t, r = state
        pr, rb = p @ r, r @ b
        return np.stack([(p + rb) @ t if transmit else 0 * t, b + pr + np.swapaxes(pr, 2, 3) + rb @ r])

    first = scatter(0.0)[0]
    unit = np.broadcast_to(np.eye(len(mu)), first.shape)
    state = np.stack([unit, 0 * unit])
    rates = np.stack([np.broadcast_to(1 / mu[:, None], unit.shape[2:]), 1 / mu[:, None] + 1 / mu])[
        :, None, None
    ]
    tau, step = 0.0, min(float(mu.min()), layer.depth)
    while tau < layer.depth:
        step = min(step, layer.depth - tau)
        whole = _step(rest, rates, tau, step, state)
        middle = _step(rest, rates, tau, step / 2, state)
        halves = _step(rest, rates, tau + step / 2, step / 2, middle)
        error = float(np.max(np.abs(halves - whole))) / 15
        if error <= tolerance:
            tau = layer.depth if step >= layer.depth - tau else tau + step
            state = halves + (halves - whole) / 15
        elif step < 1e-12 * layer.depth:
            raise UrushiError(
                f"medium: found no step at depth {tau} that keeps to {tolerance}; use a larger tolerance"
            )
        step *= min(max(0.9 * (tolerance / max(error, 1e-300)) ** 0.2, 0.2), 4.0)
    return state[0], state[1]


def _step(
    rest: Callable[[float, np.ndarray], np.ndarray],
    rates: np.ndarray,
    tau: float,
    h: float,
    state: np.ndarray,
) -> np.ndarray:
    """One step of u' = -rates u + rest(tau, u) (Cox & Matthews 2002, eqs. 26-29)."""
    half, (e, p1, p2, p3) = _phi(-rates * h / 2), _phi(-rates * h)
    e2, q = half[0], half[1] * (h / 2)
    n0 = rest(tau, state)
    a = e2 * state + q * n0
    n1 = rest(tau + h / 2, a)
    b = e2 * state + q * n1
    n2 = rest(tau + h / 2, b)
    c = e2 * a + q * (2 * n2 - n0)
    n3 = rest(tau + h, c)
    return e * state + h * ((p1 - 3 * p2 + 4 * p3) * n0 + (2 * p2 - 4 * p3) * (n1 + n2) + (4 * p3 - p2) * n3)


def _phi(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """exp z, (exp z - 1) / z, and so on: phi_k = (phi_(k-1) - 1 / (k-1)!) / z, for z <= 0."""
    small = np.abs(z) < 1
    near, far = np.where(small, z, 0), np.where(small, 1, z)
    series = np.zeros_like(z)
    for k in range(20, 2, -1):  # sum of z^(k-3) / k!
        series = series * near + 1 / float(np.prod(np.arange(1.0, k + 1)))
    e = np.exp(z)
    p1 = np.where(small, 1 + near * (0.5 + near * series), np.expm1(far) / far)
    p2 = np.where(small, 0.5 + near * series, (p1 - 1) / far)
    p3 = np.where(small, series, (p2 - 0.5) / far)
    return e, p1, p2, p3
