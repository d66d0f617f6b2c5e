"""What a `FourierTable` says, in numpy and double precision: Urushi's conventions (z up, wi and wo point away).

The splines, the clamping of luminance and colours and the factor of radiance are those of pbrt-v3's `FourierBSDF`; what
it calls wo is wi here, whose cosine is that of the incident node.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from urushi.errors import MaterialError, UrushiError
from urushi.optics.spline import chords, running_integral, weights
from urushi.solvers.bsdf import directions, same_count

from .build import GREEN
from .table import FourierTable


def evaluate(table: FourierTable, wi: Any, wo: Any, *, mode: str = "radiance") -> np.ndarray:
    """f |cos theta_o| of one BSDF.

    Args:
        table: with one basis (`blended` makes it of several).
        wi, wo: (N, 3) unit vectors.
        mode: "radiance" (the factor (index on the side of wi / index on the side of wo)^2 where light passes) or
            "importance".

    Returns:
        (N, 1), or (N, 3) linear RGB.
    """
    _check(table)
    if mode not in ("radiance", "importance"):
        raise UrushiError(f"mode: found {mode!r}; allowed: radiance, importance")
    wi, wo = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi, wo")
    incident, w_i = _spline(table, wi[:, 2])
    outgoing, w_o = _spline(table, -wo[:, 2])
    phi = np.arctan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], -(wi[:, :2] * wo[:, :2]).sum(axis=1))
    # A vertical direction has no azimuth: the value is the mean over all.
    upright = (wi[:, :2] ** 2).sum(axis=1) * (wo[:, :2] ** 2).sum(axis=1) < 1e-30
    sums = np.zeros((len(wi), table.channels))
    for a, b in product(range(4), range(4)):
        counts = table.counts[incident[:, a], outgoing[:, b]].astype(np.int64)
        offsets = table.offsets[incident[:, a], outgoing[:, b]].astype(np.int64)
        weight = w_i[:, a] * w_o[:, b]
        orders = np.where(weight == 0, 0, np.where(upright, np.minimum(counts, 1), counts))
        for k in range(int(orders.max(initial=0))):
            on = np.nonzero(orders > k)[0]
            wave = weight[on] * np.cos(k * phi[on])
            for channel in range(table.channels):
                sums[on, channel] += wave * table.coefficients[offsets[on] + channel * counts[on] + k]
    if mode == "radiance":
        sums *= radiance(table.eta, wi[:, 2], wo[:, 2])[:, None]
    return colours(sums)


def colours(sums: np.ndarray) -> np.ndarray:
    """(..., 1) luminance, or (..., 3) linear RGB, of the channels in a file; nothing is negative."""
    y = np.maximum(sums[..., 0], 0)
    if sums.shape[-1] == 1:
        return y[..., None]
    r, b = sums[..., 1], sums[..., 2]
    return np.maximum(np.stack([r, GREEN[0] * y + GREEN[1] * r + GREEN[2] * b, b], axis=-1), 0)


def radiance(eta: float, cos_i: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
    """The factor of radiance for cosines of wi and wo."""
    return np.where(cos_i * cos_o < 0, np.where(cos_i > 0, eta**-2.0, eta**2.0), 1.0)


def reflectance(table: FourierTable, wi: Any) -> tuple[np.ndarray, np.ndarray]:
    """Share of the light from wi that is reflected and transmitted, by the integral of the splines.

    Args:
        table: with one basis.
        wi: (N, 3) unit vectors.

    Returns:
        two arrays (N, 1), or (N, 3) linear RGB.
    """
    _check(table)
    wi = directions(wi, "wi")
    up, down = totals(table)
    index, weight = _spline(table, wi[:, 2])
    sums = [np.einsum("na,nac->nc", weight, side[index]) for side in (up, down)]
    above = (wi[:, 2] > 0)[:, None]
    return colours(np.where(above, *sums)), colours(np.where(above, *sums[::-1]))


def totals(table: FourierTable) -> tuple[np.ndarray, np.ndarray]:
    """The energy that leaves above and below for light from each node, in the channels of the file: (N, channels)."""
    mean = np.zeros((table.channels, *table.counts.shape))
    full = table.counts > 0
    for channel in range(table.channels):
        where = table.offsets[full].astype(np.int64) + channel * table.counts[full].astype(np.int64)
        mean[channel][full] = table.coefficients[where]
    integral = 2 * np.pi * running_integral(table.nodes, mean)
    middle = int(np.searchsorted(table.nodes, 0.0))
    return integral[..., middle].T, (integral[..., -1] - integral[..., middle]).T


def blended(table: FourierTable, values: Any) -> FourierTable:
    """The BSDF at a point of the grid of parameters, linear between its corners.

    Args:
        table: with any number of parameters.
        values: one number for each, within its positions.

    Returns:
        A table of one basis and no parameters.
    """
    values = [float(v) for v in values]
    if len(values) != len(table.positions):
        raise MaterialError(f"found {len(values)}; allowed: {len(table.positions)}", where="parameters")
    shares = np.ones(1)
    for i, (value, ticks) in enumerate(zip(values, table.positions, strict=True)):
        if not ticks[0] <= value <= ticks[-1]:
            raise MaterialError(
                f"found {value}; allowed: {ticks[0]:g} to {ticks[-1]:g}", where=f"parameters[{i}]"
            )
        hats = [np.interp(value, ticks, np.eye(len(ticks))[k]) for k in range(len(ticks))]
        shares = np.outer(shares, hats).ravel()
    counts = table.counts.astype(np.int64)
    ends = np.cumsum(counts * table.channels).reshape(counts.shape)
    starts = ends - counts * table.channels
    coefficients = np.zeros(int(ends[-1, -1]))
    # Every coefficient of a channel by its series and order.
    flat = counts.ravel()
    order = np.arange(flat.sum()) - np.repeat(np.cumsum(flat) - flat, flat)
    source, target, count = (
        np.repeat(a.ravel().astype(np.int64), flat) for a in (table.offsets, starts, counts)
    )
    for channel in range(table.channels):
        to = target + channel * count + order
        for basis in np.nonzero(shares)[0]:
            at = source + (channel * table.bases + basis) * count + order
            coefficients[to] += shares[basis] * table.coefficients[at]
    return FourierTable(
        nodes=table.nodes,
        cdf=(table.cdf @ shares)[..., None],
        offsets=starts,
        counts=counts,
        coefficients=coefficients,
        channels=table.channels,
        max_order=table.max_order,
        flags=table.flags,
        eta=table.eta,
        alpha=table.alpha,
        metadata=table.metadata,
    )


def _check(table: FourierTable) -> None:
    if table.extrapolated:
        raise MaterialError("found 3; allowed: 1, as extrapolated series cannot be evaluated", where="flags")
    if table.bases != 1:
        raise MaterialError(
            f"found {table.bases}; allowed: 1; blended(table, values) gives one BSDF of several",
            where="bases",
        )


def _spline(table: FourierTable, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the nodes around cosines and their weights, (N, 4) each; all 0 beyond the first and last node."""
    nodes = table.nodes.astype(np.float64)
    x = np.clip(x, -1, 1)  # what rounding left of a unit vector
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    width, left, right = chords(nodes)
    t = (x - nodes[i]) / width[i]
    weight = np.stack(weights(t, left[i], right[i]), axis=1)
    weight[(x < nodes[0]) | (x > nodes[-1])] = 0
    return np.clip(i[:, None] + np.arange(-1, 3), 0, len(nodes) - 1), weight
