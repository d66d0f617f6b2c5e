"""A `FourierTable` from series at nodes, and the sizes and integrals that a file wants with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.optics.spline import running_integral

from .table import FLOAT, LARGEST, WHOLE, FourierTable

#: luminance of linear R, G, B as layerlab writes it, and G from Y, R, B as pbrt-v3 reads it
LUMINANCE = (0.212671, 0.715160, 0.072169)
GREEN = (1.39829, -0.297375, -0.100913)
#: the four blocks and the signs of the (incident, outgoing) nodes that each fills
BLOCKS = {
    "r_top": (1, -1),
    "t_down": (1, 1),
    "r_bottom": (-1, 1),
    "t_up": (-1, -1),
}


def fourier_table(
    mu: Any,
    *,
    r_top: Any = None,
    t_down: Any = None,
    r_bottom: Any = None,
    t_up: Any = None,
    tolerance: float = 1e-3,
    positions: Any = (),
    eta: float = 1.0,
    alpha: tuple[float, float] = (0.0, 0.0),
    metadata: bytes = b"",
) -> FourierTable:
    """A table from Fourier series at pairs of nodes.

    Args:
        mu: (n,) ascending |cosines| in (0, 1], the same on both sides.
        r_top, t_down, r_bottom, t_up: (C, K, n, n) or (B, C, K, n, n)
            [basis, channel, order, outgoing, incident]: a_k of f |mu_o| = sum a_k cos(k phi), without eta^2; phi = 0 in
            the mirror direction. C is 1, or 3 for linear RGB. What is None scatters nothing.
        tolerance: a series ends where the absolute sum of what follows is at most this times |a_0|, in every channel
            and basis.
        positions: the values along each parameter; B is the product of how many they are, the last runs fastest.
        eta, alpha, metadata: see `FourierTable`.

    Returns:
        The table, with the two nodes at 0 that layerlab puts between the sides.

    Raises:
        MaterialError: arrays that do not fit together, or values that are not finite.
    """
    mu = np.asarray(mu, np.float64)
    rounded = mu.astype(FLOAT)
    if mu.ndim != 1 or not len(mu) or not ((rounded > 0) & (mu <= 1)).all() or (np.diff(rounded) <= 0).any():
        raise MaterialError("found others; allowed: ascending cosines in (0, 1]", where="mu")
    if not tolerance >= 0:
        raise MaterialError(f"found {tolerance}; allowed: a number from 0", where="tolerance")
    given = {
        "r_top": r_top,
        "t_down": t_down,
        "r_bottom": r_bottom,
        "t_up": t_up,
    }
    blocks = {name: _block(value, len(mu), name) for name, value in given.items() if value is not None}
    if not blocks or len({block.shape[:2] for block in blocks.values()}) != 1:
        found = {name: block.shape for name, block in blocks.items()}
        raise MaterialError(
            f"found the blocks {found}; allowed: at least one, of the same bases and channels"
        )
    bases, channels = next(iter(blocks.values())).shape[:2]
    n = len(mu)
    nodes = np.concatenate([-mu[::-1], [0.0, 0.0], mu])
    places = {1: np.arange(n) + n + 2, -1: np.arange(n)[::-1]}
    counts = np.zeros((len(nodes), len(nodes)), np.int64)
    mean = np.zeros((len(nodes), len(nodes), bases))
    cells = {}
    for name, block in blocks.items():
        incident, outgoing = (places[sign] for sign in BLOCKS[name])
        cells[name] = np.ix_(incident, outgoing)
        counts[cells[name]] = _lengths(block, tolerance).T
        blocks[name] = block = _luminous(block)
        mean[cells[name]] = block[:, 0, 0].transpose(2, 1, 0).astype(FLOAT)
    ends = np.cumsum(counts * (bases * channels)).reshape(counts.shape)
    if ends[-1, -1] > LARGEST:
        raise MaterialError(
            f"found {ends[-1, -1]} coefficients; allowed: at most {LARGEST}; a larger tolerance keeps fewer"
        )
    offsets = ends - counts * (bases * channels)
    coefficients = np.zeros(int(ends[-1, -1]), FLOAT)
    for name, block in blocks.items():
        _scatter(block, counts[cells[name]].T, offsets[cells[name]].T, coefficients)
    cdf = np.moveaxis(running_integral(nodes, np.where(counts[..., None] > 0, mean, 0).swapaxes(1, 2)), 1, 2)
    return FourierTable(
        nodes=nodes.astype(FLOAT),
        cdf=cdf.astype(FLOAT),
        offsets=offsets.astype(WHOLE),
        counts=counts.astype(WHOLE),
        coefficients=coefficients,
        channels=channels,
        bases=bases,
        max_order=int(counts.max()),
        positions=tuple(positions),
        eta=eta,
        alpha=alpha,
        metadata=metadata,
    )


def _block(value: Any, n: int, name: str) -> np.ndarray:
    block = np.asarray(value, np.float64)
    if block.ndim == 4:
        block = block[None]
    if block.ndim != 5 or block.shape[1] not in (1, 3) or block.shape[3:] != (n, n) or 0 in block.shape:
        raise MaterialError(
            f"found the shape {np.shape(value)}; allowed: ([B,] 1 or 3, K, {n}, {n})", where=name
        )
    if not np.isfinite(block).all():
        raise MaterialError("found values that are not finite; allowed: finite numbers", where=name)
    return block


def _lengths(block: np.ndarray, tolerance: float) -> np.ndarray:
    """(outgoing, incident) how many orders to keep."""
    size = np.abs(block)
    rest = np.cumsum(size[:, :, ::-1], axis=2)[:, :, ::-1]  # of this order and all that follow
    needed = rest > tolerance * size[:, :, :1]
    needed[:, :, 0] = rest[:, :, 0] > 0
    kept: np.ndarray = needed.sum(axis=2).max(axis=(0, 1))  # the sum falls with the order
    return kept


def _luminous(block: np.ndarray) -> np.ndarray:
    """Channels R, G, B as Y, R, B."""
    if block.shape[1] == 1:
        return block
    luminance = np.einsum("c,bc...->b...", np.array(LUMINANCE), block)
    return np.stack([luminance, block[:, 0], block[:, 2]], axis=1)


def _scatter(block: np.ndarray, counts: np.ndarray, offsets: np.ndarray, out: np.ndarray) -> None:
    """Put the series of a block where the table says; counts and offsets as (outgoing, incident)."""
    bases, channels = block.shape[:2]
    for k in range(int(counts.max())):
        o, i = np.nonzero(counts > k)
        start, count = offsets[o, i] + k, counts[o, i]
        for channel in range(channels):
            for basis in range(bases):
                out[start + (channel * bases + basis) * count] = block[basis, channel, k, o, i]
