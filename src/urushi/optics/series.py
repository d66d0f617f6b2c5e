"""A scattering function in splines over two cosines and cosine series in azimuth: what sampling it needs beforehand.

Values (Jakob et al. 2014, section 5; pbrt-v3's `FourierBSDF`): Catmull-Rom splines in both cosines through series at
pairs of nodes. Densities: the same series, but linear in both cosines and *lifted* at each pair of nodes by what makes
them nowhere negative. Splines overshoot, series that end ring, and a spike that layerlab puts where light passes
unscattered falls to minus four times its mean: sampled from the integral of such a function, directions have no density
at all. Lifted and linear ones are a mixture of positive parts: the density is exact, and near the values where the
nodes resolve them.

Nodes are cosines of propagation, z down, as in layerlab: incident wi.z, outgoing -wo.z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from .spline import running_integral

#: a pair of nodes has at least this share of the mean of its neighbours: splines reach as far
_REACH = 1 / 16
#: grid points per order on which the least value of a series is looked for, and how much more is lifted
_FINE, _MARGIN = 4, 1.1
#: numbers that a step of that search may hold
_CHUNK = 1 << 22


@dataclass(frozen=True)
class Series:
    """Prepared tables, for `urushi.optics.tabulated`.

    Attributes:
        nodes: (N,) ascending cosines.
        offsets, counts: (N, N) [incident, outgoing] first row and number of rows of a series in `coefficients`.
        coefficients: (M, C) orders by channels; light is sampled by the first channel.
        lift: (N, N) what is added to the mean of a series to make it positive.
        mean: (N, N) what it is then.
        cdf: (N, N) integral of that, linear between nodes, from the first outgoing node to each.
        flux: (2, N, C) energy that leaves with negative and with positive cosine, by the integral of the splines.
    """

    nodes: np.ndarray
    offsets: np.ndarray
    counts: np.ndarray
    coefficients: np.ndarray
    lift: np.ndarray
    mean: np.ndarray
    cdf: np.ndarray
    flux: np.ndarray

    @property
    def channels(self) -> int:
        return self.coefficients.shape[1]


def prepare(nodes: np.ndarray, offsets: np.ndarray, counts: np.ndarray, coefficients: np.ndarray) -> Series:
    """Find the lifts and integrals of series.

    Args:
        nodes: (N,) ascending cosines in [-1, 1]; two equal ones at 0 part both sides.
        offsets, counts: (N, N) [incident, outgoing], rows of `coefficients`.
        coefficients: (M, C) a_k of f |mu_o| = sum a_k cos(k phi); light is sampled by the first channel.
    """
    nodes = np.asarray(nodes, np.float64)
    offsets, counts = offsets.astype(np.int64), counts.astype(np.int64)
    means = np.zeros((*counts.shape, coefficients.shape[1]))
    full = counts > 0
    means[full] = coefficients[offsets[full]]
    lift = _lifts(offsets, counts, coefficients[:, 0])
    around = _REACH * _neighbours(_neighbours(means[..., 0] + lift).T).T
    lift = np.maximum(lift, around - means[..., 0])
    mean = np.maximum(means[..., 0] + lift, 0)
    steps = np.diff(nodes) * (mean[:, :-1] + mean[:, 1:]) / 2
    cdf = np.concatenate([np.zeros((len(nodes), 1)), np.cumsum(steps, axis=1)], axis=1)
    integral = 2 * np.pi * running_integral(nodes, np.moveaxis(means, 2, 0))
    middle = int(np.searchsorted(nodes, 0.0))
    sides = integral[..., middle], integral[..., -1] - integral[..., middle]
    flux = np.stack([side.T for side in sides])
    return Series(nodes, offsets, counts, coefficients, lift, mean, cdf, flux)


def _lifts(offsets: np.ndarray, counts: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """How far each series falls below 0, with a margin: (N, N)."""
    start, count = offsets.ravel(), counts.ravel()
    lift = np.zeros(count.size)
    order = np.argsort(count, kind="stable")
    order = order[np.searchsorted(count[order], 1) :]
    while len(order):
        # As many of the longest as fit; the others of their step are padded to the same length.
        longest = int(count[order[-1]])
        points = _FINE * fft.next_fast_len(longest, real=True) + 1
        some, order = order[-max(1, _CHUNK // points) :], order[: -max(1, _CHUNK // points)]
        k = np.arange(longest)
        inside = k < count[some][:, None]
        waves = np.zeros((len(some), points), coefficients.dtype)
        waves[:, :longest][inside] = coefficients[(start[some][:, None] + k)[inside]]
        waves[:, 1:] /= 2
        least = fft.dct(waves, type=1, axis=1, overwrite_x=True).min(axis=1)
        lift[some] = np.maximum(0, -_MARGIN * least)
    return lift.reshape(counts.shape)


def _neighbours(values: np.ndarray) -> np.ndarray:
    """The largest of each value and those beside it along the last axis."""
    found = values.copy()
    found[..., 1:] = np.maximum(found[..., 1:], values[..., :-1])
    found[..., :-1] = np.maximum(found[..., :-1], values[..., 1:])
    return found
