"""How much of the light an interface reflects and transmits, by quadrature in double precision.

What comes from one direction (`directional`) is the mean weight of the interface's own samples. Over the two numbers
that choose a facet that mean is taken on a Fibonacci lattice (Sloan & Joe 1994, Lattice Methods for Multiple
Integration, section 5): the sampling has already removed the peak of the distribution, and kinks at the horizon and at
total reflection, which spoil Gauss's rule, do little harm to a lattice. What an interface adds to one scattering
between its facets (`Interface.single`) is smooth, and integrated over directions. The mean over the hemisphere
(`hemispherical`, weighted by the cosine as an even sky weighs it) is a product rule of directions.

Every answer is computed on lattices of growing size until two in a row agree to the accuracy asked for. A stochastic
interface is sampled instead, until the standard error is below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from urushi.errors import UrushiError

from ..optics.random import generator, uniform
from ..optics.vectors import Array, Vector, channels, root
from .base import Interface

#: ranks of the Fibonacci numbers that are the sizes of the lattices: 10 946 points to 1 346 269
RANKS = (20, 22, 24, 26, 28, 30)
#: samples of a stochastic interface per launch, and launches at most
SAMPLES, LAUNCHES = 1 << 20, 512
SEED = 20_160_724

Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


class Energy(NamedTuple):
    """Fractions of the incident flux.

    Attributes:
        reflectance, transmittance: (N,), or (N, 3) for a coloured interface; without N from `hemispherical`.
        error: the largest difference to the next coarser lattice, or the largest standard error.
    """

    reflectance: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    error: float


def directional(interface: Interface, w: ArrayLike, above: bool = True, *, accuracy: float = 1e-4) -> Energy:
    """Directional-hemispherical reflectance and transmittance, delta parts included.

    Args:
        interface: bound with one value per parameter, best in double precision.
        w: cosines of incidence (N,) in (0, 1], with azimuth 0; or unit vectors (N, 3) with z > 0, in the frame of
            the side they come from.
        above: the side they come from.
        accuracy: absolute error to stay below, as estimated.

    Raises:
        UrushiError: a direction from the wrong side, or an accuracy out of reach.
    """
    directions = _directions(w)
    if interface.delta is True:
        r, t = _facets(interface, directions, above, RANKS[0], 1)
        return Energy(r, t, 0.0)
    if interface.stochastic:
        return _sampled(interface, directions, above, accuracy)
    before: Pair | None = None
    error = np.inf
    for rank in RANKS:
        now = _facets(interface.single or interface, directions, above, rank)
        if interface.single is not None:
            more = _beyond(interface, directions, above, rank)
            now = now[0] + more[0], now[1] + more[1]
        if before is not None:
            error = max(float(np.abs(a - b).max()) for a, b in zip(now, before, strict=True))
            if error <= accuracy:
                return Energy(now[0], now[1], error)
        before = now
    raise UrushiError(f"accuracy: found {accuracy:g}; reached {error:g}; allowed: that or more")


def hemispherical(interface: Interface, above: bool = True, *, accuracy: float = 1e-4) -> Energy:
    """Reflectance and transmittance of light that comes evenly from the whole hemisphere: means of `directional`.

    Args:
        interface, above, accuracy: as for `directional`.

    Raises:
        UrushiError: an accuracy out of reach.
    """
    smooth = interface.delta is True
    x, y = (1.0, 1.0) if smooth else _roughness(interface)
    eta = _number(interface.ratio(above))
    breaks = []
    if 0 < eta < 1:
        # Total reflection ends within a few times the roughness of the critical angle.
        critical = float(np.sqrt(1 - eta**2))
        ends = (critical,) if smooth else (critical - 3 * max(x, y), critical, critical + 3 * max(x, y))
        breaks = [c for c in ends if 0 < c < 1]
    before: Pair | None = None
    error = np.inf
    for n in (6, 12, 24, 48, 96):
        directions, weights = hemisphere(n, 1 if x == y else n, max(x, y), breaks)
        r, t, own = directional(interface, directions, above, accuracy=0.7 * accuracy)
        now = np.tensordot(weights, r, 1), np.tensordot(weights, t, 1)
        if before is not None:
            # A sampled mean has an error of its own, smaller than that of each direction.
            error = max(float(np.abs(a - b).max()) for a, b in zip(now, before, strict=True))
            if error <= accuracy or (interface.stochastic and error <= 4 * own):
                return Energy(now[0], now[1], max(error, own))
        before = now
    raise UrushiError(f"accuracy: found {accuracy:g}; reached {error:g}; allowed: that or more")


def hemisphere(
    n: int, azimuths: int, alpha: float, breaks: Sequence[float] = ()
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions (N, 3) and weights (N,) of the mean over the hemisphere by cosine.

    Args:
        n: nodes of Gauss's rule in each panel of cosines; the first panel ends at `alpha`, since rough surfaces change
            most there, each further one is four times as long.
        azimuths: of one quarter turn, since every interface here mirrors in its two axes (1: all at azimuth 0).
        alpha: length of the first panel, in (0, 1].
        breaks: cosines where another panel begins.
    """
    x, weight = np.polynomial.legendre.leggauss(n)
    ends = np.unique([0.0, *(alpha * 4.0**k for k in range(20) if alpha * 4.0**k < 0.5), *breaks, 1.0])
    half = 0.5 * np.diff(ends)[:, None]
    cos = (ends[:-1, None] + half * (1 + x)).ravel()
    weight = (half * weight).ravel()
    phi = 0.5 * np.pi * (np.arange(azimuths) + 0.5) / azimuths if azimuths > 1 else np.zeros(1)
    c, p = (grid.ravel() for grid in np.meshgrid(cos, phi, indexing="ij"))
    sin = np.sqrt((1 - c) * (1 + c))
    each = np.repeat(2 * cos * weight / azimuths, azimuths)
    return np.stack([sin * np.cos(p), sin * np.sin(p), c], axis=1), each


def _directions(w: ArrayLike) -> NDArray[np.float64]:
    array = np.atleast_1d(np.asarray(w, np.float64))
    if array.ndim == 1:
        array = np.stack([np.sqrt(np.maximum(1 - array**2, 0)), 0 * array, array], axis=1)
    bad = np.abs(np.linalg.norm(array, axis=1) - 1) > 1e-6
    bad |= array[:, 2] <= 0
    if array.ndim != 2 or array.shape[1] != 3 or bad.any():
        found = array[bad][0].tolist() if bad.any() else f"shape {array.shape}"
        raise UrushiError(f"w: found {found}; allowed: cosines in (0, 1], or unit vectors (N, 3) with z > 0")
    return array


def _roughness(interface: Interface) -> tuple[float, float]:
    """Roughness along x and y as numbers; that of one scattering is meant where there is more."""
    x, y = (max(_number(alpha), 1e-4) for alpha in interface.roughness())
    return x, y


def _number(value: Array) -> float:
    return float(np.max(np.array(dr.detach(value) if dr.is_array_v(value) else value)))


def _lanes(array: NDArray[np.float64]) -> Vector:
    from drjit.auto.ad import Array3f64

    return Array3f64(np.ascontiguousarray(array.T))


def _mean(w: Vector, count: int, term: Any) -> Pair:
    """The mean of term(i) = (reflected, transmitted) over i < count, as numpy arrays."""
    number = type(w.x)
    uint = dr.uint32_array_t(number)
    wide = any(channels(value) for value in term(uint(0)))
    zero = 0 * (w if wide else w.x)

    def body(i: Array, up: Array, down: Array) -> tuple[Array, ...]:
        more_up, more_down = term(i)
        return i + 1, up + more_up, down + more_down

    _, up, down = dr.while_loop((uint(0), zero, zero), lambda i, up, down: i < count, body, label="energy")
    return (np.array(up, np.float64) / count).T, (np.array(down, np.float64) / count).T


def _lattice(number: Any, rank: int) -> Any:
    """The points of a Fibonacci lattice: a function of their index, and their number."""
    small, size = 1, 1
    for _ in range(rank - 1):
        small, size = size, small + size

    def point(i: Array) -> tuple[Array, Array]:
        first = (number(i) + 0.5) / size
        second = number(i) * small + 0.5
        return first, second / size - dr.floor(second / size)

    return point, size


def _facets(
    interface: Interface, directions: NDArray[np.float64], above: bool, rank: int, size: int | None = None
) -> Pair:
    """The mean weight of samples, reflected and transmitted, over the numbers that choose a facet."""
    w = _lanes(directions)
    point, count = _lattice(type(w.x), rank)

    def term(i: Array) -> tuple[Array, Array]:
        u = (0.5, *point(i))
        up = interface.sample(w, u, above, "reflect")
        up_weight = dr.select(up.o.z > 0, up.weight, 0)
        if interface.opaque:
            return up_weight, 0 * up_weight
        down = interface.sample(w, u, above, "transmit")
        return up_weight, dr.select(down.o.z < 0, down.weight, 0)

    return _mean(w, size or count, term)


def _beyond(interface: Interface, directions: NDArray[np.float64], above: bool, rank: int) -> Pair:
    """What an interface adds to its `single`, by integration over outgoing directions."""
    w, single = _lanes(directions), interface.single
    assert single is not None
    point, count = _lattice(type(w.x), rank)
    alpha = max(*_roughness(interface))

    def term(i: Array) -> tuple[Array, Array]:
        s, turn = point(i)
        # As much of the range for each octave of cosines: what is missing falls off as their inverse square.
        scale = alpha * dr.exp(float(np.log1p(1 / alpha)) * s)
        cos, slope = scale - alpha, scale * float(np.log1p(1 / alpha))
        sin = root((1 - cos) * (1 + cos))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * turn)
        o, measure = type(w)(sin * cos_phi, sin * sin_phi, cos), 2 * dr.pi * slope
        up = (interface.reflect(w, o, above)[0] - single.reflect(w, o, above)[0]) * measure
        if interface.opaque:
            return up, 0 * up
        o = type(w)(o.x, o.y, -cos)
        return up, (interface.transmit(w, o, above)[0] - single.transmit(w, o, above)[0]) * measure

    return _mean(w, count, term)


def _sampled(interface: Interface, directions: NDArray[np.float64], above: bool, accuracy: float) -> Energy:
    """The mean weight of random samples, until its standard error is small."""
    rows = len(directions)
    copies = max(SAMPLES // rows, 1)
    w = _lanes(np.repeat(directions, copies, axis=0))
    number = dr.arange(dr.uint32_array_t(type(w.x)), rows * copies)
    total = square = np.zeros(())
    for launch in range(1, LAUNCHES + 1):
        rng = generator(w, [*w], SEED, number + (launch - 1) * rows * copies)
        u = (uniform(rng, w), uniform(rng, w), uniform(rng, w))
        event = interface.sample(w, u, above, rng=rng)
        up = dr.select(dr.select(event.through, False, event.o.z > 0), event.weight, 0)
        down = dr.select(event.through, event.weight, 0) if not interface.opaque else 0 * up
        found = np.stack([np.array(value, np.float64).T for value in (up, down)])
        found = found.reshape(2, rows, copies, *found.shape[2:])
        total = total + found.sum(axis=2)
        square = square + (found**2).sum(axis=2)
        n = launch * copies
        mean = total / n
        error = float(np.sqrt(np.maximum(square / n - mean**2, 0).max() / max(n - 1, 1)))
        if error <= accuracy and n > 1000:
            return Energy(mean[0], mean[1], error)
    raise UrushiError(f"accuracy: found {accuracy:g}; reached {error:g}; allowed: that or more")
