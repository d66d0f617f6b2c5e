"""Tables of the light that single scattering loses: their axes, their files, and how Dr.Jit looks into them.

An axis is a coordinate in [0, 1] with nodes at equal distances, chosen such that what is tabulated is smooth along it:

    cosine     most of the range for cosines below the roughness, where masking sets in, the rest for all of them
    roughness  its square root
    index      the root of the logarithm, so that nodes crowd around equal indices; from 1/5 to 5
    ratio      logarithm of the larger over the smaller roughness, from 1 to 16; narrower brushing counts as 16
    azimuth    linear in the angle from the direction of the larger roughness, a quarter turn

Between nodes everything is linear. The files hold the square roots of energies as integers, which resolves small ones.
`tools/make_energy_tables.py` writes them, with `interfaces.energy`.
"""

from __future__ import annotations

import functools
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..optics.vectors import Array, at_least, at_most

DATA = Path(__file__).parent / "data"
#: nodes of the tables of isotropic surfaces
COSINES, ROUGHNESSES, INDICES = 64, 32, 97
#: nodes of those of anisotropic ones
COARSE_COSINES, COARSE_ROUGHNESSES, COARSE_INDICES, RATIOS, AZIMUTHS = 20, 12, 25, 7, 13
#: and those of how what is lost is shared; indices from 1 on
SHARE_INDICES, SHARE_ROUGHNESSES = 17, 12
#: what the square root of 1 is in a file, by the type of its integers
LEVELS = {"uint16": 4095, "uint8": 255}
#: largest index ratio, and largest ratio of roughnesses
MOST_INDEX, MOST_RATIO = 5.0, 16.0
#: share of the cosines' axis for those below the roughness
NEAR = 0.6
#: the roughness that stands for 0
SMOOTHEST = 1e-4


# --- axes: coordinates of values, in Dr.Jit, and values of nodes, in numpy ------------------------------------------


def of_cosine(cos: Array, alpha: Array) -> Array:
    """`alpha` is the roughness, of an anisotropic surface the geometric mean of both."""
    masked = cos * (1 + alpha) * dr.rcp(cos + alpha)
    return dr.fma(1 - NEAR, cos, NEAR * dr.sqrt(at_least(masked, 1e-12)))


def of_roughness(alpha: Array) -> Array:
    return dr.sqrt(alpha)


def of_index(eta: Array) -> Array:
    away = dr.log(eta) * (1 / math.log(MOST_INDEX))
    scaled = dr.sqrt(at_least(dr.abs(away), 1e-12))
    return dr.fma(dr.select(away < 0, -scaled, scaled), 0.5, 0.5)


def of_ratio(alpha_x: Array, alpha_y: Array) -> Array:
    ratio = at_least(alpha_x, alpha_y) / at_most(alpha_x, alpha_y)
    return at_most(dr.log(ratio) * (1 / math.log(MOST_RATIO)), 1)


def cosines(alpha: ArrayLike, n: int) -> NDArray[np.float64]:
    """The nodes' cosines, (..., n) for roughnesses (...): of_cosine(c, alpha) = 0, 1 / (n - 1), ..., 1."""
    alpha = np.asarray(alpha, np.float64)[..., None]
    goal = np.linspace(0, 1, n) + 0 * alpha
    low, high = np.zeros_like(goal), np.ones_like(goal)
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = (1 - NEAR) * middle + NEAR * np.sqrt(middle * (1 + alpha) / (middle + alpha)) < goal
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def roughnesses(n: int) -> NDArray[np.float64]:
    return np.maximum(np.linspace(0, 1, n) ** 2, SMOOTHEST)


def indices(n: int) -> NDArray[np.float64]:
    t = np.linspace(-1, 1, n)
    return np.asarray(MOST_INDEX ** (np.sign(t) * t**2), np.float64)


def ratios(n: int) -> NDArray[np.float64]:
    return np.asarray(MOST_RATIO ** np.linspace(0, 1, n), np.float64)


# --- files ----------------------------------------------------------------------------------------------------------


def energies(kind: str, model: str) -> NDArray[np.float64]:
    """The lost energy at all nodes.

    Args:
        kind: "metal" [roughness, cosine], "glass" [index, roughness, cosine], "brushed_metal" [roughness, ratio,
            azimuth, cosine] or "brushed_glass" [index, roughness, ratio, azimuth, cosine]; "metal" is a perfect mirror.
        model: "ggx_correlated", ...: the distribution and the masking.
    """
    with np.load(DATA / f"{kind}.npz") as file:
        steps = file[model]
    roots = np.cumsum(steps, axis=-1, dtype=steps.dtype) / LEVELS[steps.dtype.name]
    return np.asarray(roots, np.float64) ** 2


def refined(kind: str, model: str) -> NDArray[np.float64]:
    """`energies` with nodes in between by cubic interpolation: it costs memory, and no time later."""
    table = energies(kind, model)
    if kind == "brushed_metal":
        for axis, even in ((-1, False), (-2, True), (-3, False), (-4, False)):
            table = _doubled(table, axis, even)
    elif kind == "brushed_glass":
        table = _doubled(table, -2, True)
    else:
        # Linear pieces have steps in their derivative by roughness: smaller ones now.
        table = _doubled(table, -2)
    if kind.endswith("glass"):
        # Equal indices are no smooth limit: each side by itself.
        half = len(table) // 2
        low, middle, high = table[:half], table[half : half + 1], table[half + 1 :]
        near = 0.5 * (low[-1:] + middle), 0.5 * (middle + high[:1])
        table = np.concatenate([_doubled(low, 0), near[0], middle, near[1], _doubled(high, 0)])
    return np.clip(table, 0, 1)


def _doubled(table: NDArray[np.float64], axis: int, even: bool = False) -> NDArray[np.float64]:
    """With a node between each two; beyond the ends lies a mirror image (`even`) or a parabola."""
    table = np.moveaxis(table, axis, 0)
    before, after = table[1:2], table[-2:-1]
    if not even:
        before = 3 * (table[:1] - table[1:2]) + table[2:3]
        after = 3 * (table[-1:] - table[-2:-1]) + table[-3:-2]
    wide = np.concatenate([before, table, after])
    out = np.empty((2 * len(table) - 1, *table.shape[1:]))
    out[::2] = table
    out[1::2] = (9 * (wide[1:-2] + wide[2:-1]) - wide[:-3] - wide[3:]) / 16
    return np.moveaxis(out, 0, axis)


def shares(model: str) -> NDArray[np.float64]:
    """[index from 1, roughness]: see `make_energy_tables.shares`."""
    with np.load(DATA / "shares.npz") as file:
        return np.asarray(file[model], np.float64)


#: how many times finer than their tables the roughnesses of means are, and the cosines they are taken over
FINER = 2


@functools.cache
def means(kind: str, model: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means over the hemisphere of what is interpolated in `refined`, for two tables.

    Returns:
        the mean by cosine over the squared roughness, and the mean cosine of light that is lost.

    The roughness (the larger one) is `FINER`: between its nodes the cosines of the nodes change. All axes but azimuth
    and cosine remain.
    """
    table = refined(kind, model)
    brushed = kind.startswith("brushed")
    if brushed:
        turn = np.full(table.shape[-2], 1.0)
        turn[[0, -1]] = 0.5
        table = np.einsum("...pc,p->...c", table, turn / turn.sum())
    else:
        table = table[..., None, :]  # ratio 1
    n = table.shape[-1]
    middle = (np.arange(FINER * (n - 1)) + 0.5) / FINER
    table = _between(table, middle, -1)
    table = _between(table, np.arange(FINER * (table.shape[-3] - 1) + 1) / FINER, -3)
    alpha = roughnesses(table.shape[-3])
    spread = ratios(table.shape[-2]) if brushed else np.ones(1)
    edges = cosines(alpha[:, None] / np.sqrt(spread), len(middle) + 1)
    # The integrals of 2 cos and of 2 cos^2 over each cell.
    first, second = (np.diff(np.power(edges, power), axis=-1) for power in (2, 3))
    mean = np.einsum("...arc,arc->...ar", table, first)
    cosine = np.einsum("...arc,arc->...ar", table, second * 2 / 3) / np.maximum(mean, 1e-30)
    mean = mean / np.square(alpha)[:, None]
    return (mean, cosine) if brushed else (mean[..., 0], cosine[..., 0])


def _between(table: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Linear interpolation along one axis at positions in units of its nodes."""
    low = np.minimum(at.astype(int), table.shape[axis] - 2)
    share = (at - low).reshape(-1, *([1] * (-axis - 1)))
    return (1 - share) * np.take(table, low, axis) + share * np.take(table, low + 1, axis)


# --- looking into them ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A table in Dr.Jit: cells of the last two axes as packets of their four corners.

    Attributes:
        values: the packets one after another; a list of floats in scalar mode.
        shape: numbers of nodes.
        packet: type of a packet; None in scalar mode.
    """

    values: Any
    shape: tuple[int, ...]
    packet: Any

    def __call__(self, *places: Array) -> Array:
        """Multilinear interpolation at coordinates in [0, 1], one for each axis."""
        cells = [_cell(place, n) for place, n in zip(places, self.shape, strict=True)]
        return self._look(cells, 0)

    def _look(self, cells: list[tuple[Array, Array]], start: Array) -> Array:
        (index, share), *rest = cells
        if len(rest) == 1:
            (last, along), n = rest[0], self.shape[-1] - 1
            a, b, c, d = self._corners((start * (self.shape[-2] - 1) + index) * n + last)
            low, high = dr.fma(along, b - a, a), dr.fma(along, d - c, c)
            return dr.fma(share, high - low, low)
        inner = self.shape[-len(cells)]
        start = start * inner + index
        low, high = self._look(rest, start), self._look(rest, start + 1)
        return dr.fma(share, high - low, low)

    def _corners(self, index: Array) -> Any:
        if self.packet is None:
            return self.values[4 * index : 4 * index + 4]
        return dr.gather(self.packet, self.values, index)


def _cell(place: Array, n: int) -> tuple[Array, Array]:
    """The cell of a coordinate among n nodes, and where in it."""
    scaled = at_most(at_least(place, 0), 1) * (n - 1)
    still = dr.detach(scaled) if dr.is_array_v(scaled) else scaled
    integer = dr.uint32_array_t(type(still)) if dr.is_array_v(still) else int
    low = at_most(integer(still), integer(n - 2))
    return low, scaled - (type(still)(low))


@functools.cache
def table(kind: str, model: str, number: Any) -> Table:
    """A table for numbers of one type: of `refined`, of `means` ("mean_" or "cosine_" + kind), or "shares"."""
    if kind == "shares":
        nodes = shares(model)
    elif kind.startswith(("mean_", "cosine_")):
        which, _, surface = kind.partition("_")
        nodes = means(surface, model)[which == "cosine"]
        nodes = nodes[None].repeat(2, 0) if nodes.ndim == 1 else nodes
    else:
        nodes = refined(kind, model)
    corners = [nodes[..., i : i - 1 or None, j : j - 1 or None] for i in (0, 1) for j in (0, 1)]
    packets = np.stack(corners, axis=-1).ravel()
    if number is float:
        return Table(packets.tolist(), nodes.shape, None)
    module = sys.modules[number.__module__]
    single = dr.type_v(number) == dr.VarType.Float32
    still = dr.detached_t(number)
    values = still(packets.astype(np.float32 if single else np.float64))
    dr.eval(values)
    return Table(number(values), nodes.shape, module.Array4f if single else module.Array4f64)
