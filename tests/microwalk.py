"""Interfaces with a walk among their facets, for tests; and the same walk written down as its paper has it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from scipy.special import erf, erfinv

from lanes import Lanes, back
from surface import spread
from urushi.interfaces import BoundConductor, BoundDielectric, WalkedConductor, WalkedDielectric
from urushi.interfaces.base import Frame
from urushi.interfaces.standin import single_share
from urushi.optics.microfacet import Microfacets
from urushi.optics.random import Generator, generator
from urushi.optics.vectors import cosine_hemisphere

MIRROR = (0.0, 1.0)
"""eta and k of facets that reflect everything."""


def facets(lanes: Lanes, alpha_x: Any, alpha_y: Any = None, distribution: str = "ggx") -> Microfacets:
    alpha_y = alpha_x if alpha_y is None else alpha_y
    return Microfacets(lanes(alpha_x), lanes(alpha_y), distribution, "correlated")


def metal(
    lanes: Lanes,
    alpha_x: Any,
    alpha_y: Any = None,
    distribution: str = "ggx",
    index: tuple[Any, Any] = MIRROR,
    rotation: float = 0.0,
    delta: Any = False,
) -> WalkedConductor:
    surface = facets(lanes, alpha_x, alpha_y, distribution)
    return WalkedConductor(BoundConductor(*index, 1.0, surface, delta, Frame(rotation)))


def glass(
    lanes: Lanes,
    eta: Any,
    alpha_x: Any,
    alpha_y: Any = None,
    distribution: str = "ggx",
    rotation: float = 0.0,
    delta: Any = False,
) -> WalkedDielectric:
    surface = facets(lanes, alpha_x, alpha_y, distribution)
    return WalkedDielectric(BoundDielectric(lanes(eta), surface, delta, Frame(rotation)))


def streams(w: Any, seed: int) -> Generator:
    """A generator for each lane."""
    n = dr.width(w)
    uint = dr.uint32_array_t(type(w.x))
    return generator(w, [], uint(seed), dr.arange(uint, n))


def numbers(lanes: Lanes, rng: np.random.Generator, n: int) -> tuple[Any, Any, Any]:
    return tuple(lanes(rng.random(n) * (1 - 2.0**-23)) for _ in range(3))  # type: ignore[return-value]


def ask(
    lanes: Lanes, interface: Any, w: np.ndarray, o: np.ndarray, above: bool, part: str, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Flux density and stand-in density, reflected or transmitted as the sign of o.z says."""
    n = max(len(w), len(o))
    one, other = (lanes.vectors(spread(v, n) if len(v) == 1 else v) for v in (w, o))
    up = other.z > 0
    reflected = interface.reflect(one, other, above, part, streams(one, seed))
    if interface.opaque:
        return back(reflected[0]), back(reflected[1])
    transmitted = interface.transmit(one, other, above, part, streams(one, seed + 1))
    pairs = zip(reflected, transmitted, strict=True)
    value, pdf = (back(dr.select(up, r, t)) for r, t in pairs)
    return value, pdf


def draw(
    lanes: Lanes, interface: Any, w: np.ndarray, rng: np.random.Generator, n: int, above: bool, seed: int
) -> np.ndarray:
    """Directions for importance sampling, drawn as the stand-in density has them."""
    one = lanes.vectors(spread(w[None] if w.ndim == 1 else w, n))
    u = numbers(lanes, rng, n)
    surface, single = interface.surface, lanes(rng.random(n)) < single_share(interface.surface, one)
    m = surface.sample(one, u[1], u[2])
    cosine = back(cosine_hemisphere(u[1], u[2], one))
    facet = interface.facet if interface.opaque else interface._facet(above)
    args = () if interface.opaque else (u[0],)
    o = back(facet.scatter(surface, one, m, surface.area(one), False, streams(one, seed), *args).d)
    if interface.opaque:
        o[:, 2] = np.abs(o[:, 2])
    else:
        cosine[:, 2] *= np.where(rng.random(n) < 0.5, 1, -1)
    return np.where(np.array(single)[:, None], o, cosine)


def energy(
    lanes: Lanes, interface: Any, w: np.ndarray, rng: np.random.Generator, n: int, above: bool, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance by integrating the flux density, (2,), with standard errors."""
    o = draw(lanes, interface, w, rng, n, above, seed)
    value, pdf = ask(lanes, interface, w[None], o, above, "both", seed + 10)
    ratio = np.where(pdf > 0, value / np.where(pdf > 0, pdf, 1), 0)
    split = np.stack([ratio * (o[:, 2] > 0), ratio * (o[:, 2] < 0)])
    return split.mean(axis=1), split.std(axis=1) / np.sqrt(n)


# The walk as in Heitz et al. 2016, on heights of normal distribution, for mirrors of GGX. -----------------------------


def smith(alpha: tuple[float, float], w: np.ndarray) -> np.ndarray:
    """Lambda of any direction, -1 - Lambda(-w) for those below."""
    spread_ = np.hypot(alpha[0] * w[:, 0], alpha[1] * w[:, 1])
    with np.errstate(divide="ignore"):
        a = w[:, 2] / spread_
        return (np.sign(a) * np.sqrt(1 + 1 / a**2) - 1) / 2


def level(h: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * erf(h / np.sqrt(2))


def unlevel(u: np.ndarray) -> np.ndarray:
    return np.sqrt(2) * erfinv(2 * np.clip(u, 1e-15, 1 - 1e-15) - 1)


def visible_normal(alpha: tuple[float, float], w: np.ndarray, u: np.random.Generator) -> np.ndarray:
    """A GGX normal seen from w, by rejection."""
    # On the hemisphere configuration: a normal of the unit hemisphere seen from the stretched direction.
    s = w * [alpha[0], alpha[1], 1]
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    across = np.cross(s, np.where(np.abs(s[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    rest = np.cross(s, across)
    n = np.zeros_like(w)
    todo = np.ones(len(w), bool)
    while todo.any():
        # Points of the disc seen from s; those on the lower half of the sphere are not of the surface.
        k = int(todo.sum())
        r, phi = np.sqrt(u.random(k)), 2 * np.pi * u.random(k)
        x, y = r * np.cos(phi), r * np.sin(phi)
        found = x[:, None] * across[todo] + y[:, None] * rest[todo] + np.sqrt(1 - r**2)[:, None] * s[todo]
        fine = found[:, 2] > 0
        where = np.flatnonzero(todo)[fine]
        n[where] = found[fine]
        todo[where] = False
    m = n * [alpha[0], alpha[1], 1]
    return m / np.linalg.norm(m, axis=1, keepdims=True)


def heitz(
    alpha: tuple[float, float], w: np.ndarray, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """n walks of light from w: directions out, and how many facets each met."""
    d = np.broadcast_to(-w, (n, 3)).copy()
    h = np.full(n, 1 + unlevel(np.array(0.999)))
    met = np.zeros(n, int)
    going = np.arange(n)
    while len(going):
        lam = smith(alpha, d[going])
        c, u = level(h[going]), rng.random(len(going))
        out = (d[going, 2] > 0) & (u > 1 - c ** np.maximum(lam, 0))
        going, lam, c, u = going[~out], lam[~out], c[~out], u[~out]
        h[going] = unlevel(c / (1 - u) ** (1 / lam))
        m = visible_normal(alpha, -d[going], rng)
        d[going] -= 2 * np.sum(d[going] * m, axis=1, keepdims=True) * m
        met[going] += 1
    return d, met
