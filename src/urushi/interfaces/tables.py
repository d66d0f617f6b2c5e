"""Tables of the light that single scattering loses: their axes, their files, and how Dr.Jit looks into them.

An axis is a coordinate in [0, 1] with nodes at equal distances, chosen such that what is tabulated is smooth along it:

    cosine     most of the range for cosines below the roughness, where masking sets in, the rest for all of them
    roughness  its square root
    index      the root of the logarithm, so that nodes crowd around equal indices; from 1/5 to 5
    ratio      logarithm of the larger over the smaller roughness, from 1 to 16; narrower brushing counts as 16
    azimuth    linear in the angle from the direction of the larger roughness, a quarter turn

Brushed glass has few nodes for many dimensions, and what it loses is steep where total reflection sets in: at facets
whose tilt along the light, which is of the order of the roughness in that azimuth, makes up for the critical angle. Its
axes are therefore scaled by that roughness, so that the steep place lies at the same nodes whatever the other numbers:

    cosine     as above, with twice the roughness in the azimuth of the light
    index      `of_bend`: the cosine of the critical angle, scaled like a cosine; the root of the logarithm in part
    roughness  its power 2/3: what the steepest facets of Beckmann do changes most among the roughest
    azimuth    linear in the angle, but for a slight crowding of nodes around the direction of the smaller roughness

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
#: nodes of those of brushed metal
COARSE_COSINES, COARSE_ROUGHNESSES, RATIOS, AZIMUTHS = 22, 17, 8, 13
#: and of brushed glass [roughness, ratio, azimuth, cosine]; cells of its index for light from the denser side, and not
BRUSHED, DENSE, THIN = (14, 8, 19, 28), 24, 12
#: nodes of the means of brushed glass, along the index
MEAN_INDICES = 25
#: and those of how what is lost is shared; indices from 1 on
SHARE_INDICES, SHARE_ROUGHNESSES = 17, 12
#: what the square root of 1 is in a file, by the type of its integers
LEVELS = {"uint16": 4095, "uint8": 255}
#: largest index ratio, and largest ratio of roughnesses
MOST_INDEX, MOST_RATIO = 5.0, 16.0
#: cells of the index of brushed glass with a node in the middle: the first, where indices differ most
HALVED = 2
#: share of the cosines' axis for those below the roughness
NEAR = 0.6
#: share of the part of `of_bend` that is scaled by the roughness, from the denser side or not, and how many times that
BENT, UNBENT, WIDER = 0.8, 0.5, 2.0
#: azimuths of brushed glass: those of directions whose part across is divided by the ratio to this power
LEAN = 0.1
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


def of_bend(eta: Array, alpha: Array) -> Array:
    """The index of brushed glass.

    Args:
        eta: index beyond over the index before.
        alpha: roughness in the azimuth of the light.
    """
    critical = at_most(eta, dr.rcp(eta))
    critical = dr.sqrt(at_least((1 - dr.square(critical)) * (1 / (1 - MOST_INDEX**-2)), 1e-12))
    wide = WIDER * alpha
    scaled = critical * (1 + wide) * dr.rcp(critical + wide)
    dense = dr.fma(1 - BENT, critical, BENT * scaled)
    thin = dr.sqrt(at_least(dr.log(eta) * (1 / math.log(MOST_INDEX)), 1e-12))
    thin = dr.fma(1 - UNBENT, thin, UNBENT * scaled)
    return dr.select(eta < 1, DENSE * (1 - dense), dr.fma(thin, THIN, DENSE)) * (1 / (DENSE + THIN))


def of_brushed_roughness(alpha: Array) -> Array:
    return dr.power(at_least(alpha, 1e-8), 2 / 3)


def of_azimuth(along: Array, across: Array, ratio: Array) -> Array:
    """The azimuth of brushed glass, from the parts of a direction and the ratio of roughnesses."""
    return dr.atan2(across * dr.power(ratio, -LEAN), at_least(along, 1e-12)) * (2 / math.pi)


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


def bends(alpha: ArrayLike) -> NDArray[np.float64]:
    """The nodes' indices (HALVED + DENSE + THIN + 1, ...) for roughnesses (...) in the azimuth of the light."""
    alpha = np.asarray(alpha, np.float64)
    wide = WIDER * alpha
    sides = []
    for n, share in ((DENSE, BENT), (THIN, UNBENT)):
        goal = np.linspace(0, 1, n + 1)
        if n == DENSE:
            goal = np.sort(np.append(goal, 1 - (np.arange(HALVED) + 0.5) / DENSE))
        goal = goal.reshape(-1, *([1] * alpha.ndim)) + 0 * alpha
        low, high = np.zeros_like(goal), np.ones_like(goal)
        for _ in range(60):
            critical = 0.5 * (low + high)
            ratio = 1 / np.sqrt(1 - (1 - MOST_INDEX**-2) * critical**2)
            plain = critical if n == DENSE else np.sqrt(np.log(ratio) / math.log(MOST_INDEX))
            below = (1 - share) * plain + share * critical * (1 + wide) / (critical + wide) < goal
            low, high = np.where(below, critical, low), np.where(below, high, critical)
        ratio[0] = 1
        sides.append(ratio)
    return np.asarray(np.concatenate([1 / sides[0][:0:-1], sides[1]]), np.float64)


def brushed_roughnesses(n: int) -> NDArray[np.float64]:
    return np.maximum(np.linspace(0, 1, n) ** 1.5, SMOOTHEST)


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
        roots = file[model]
    for axis in packed_axes(roots.ndim):
        roots = np.cumsum(roots, axis=axis, dtype=roots.dtype)
    return np.asarray(roots / LEVELS[roots.dtype.name], np.float64) ** 2


def packed_axes(dimensions: int) -> tuple[int, ...]:
    """The axes along which a file holds differences, which compress well: the last three, where there are three."""
    return tuple(range(-min(dimensions, 3), 0))


def refined(kind: str, model: str) -> NDArray[np.float64]:
    """`energies` with nodes in between by cubic interpolation: it costs memory, and no time later."""
    table = energies(kind, model)
    if kind == "brushed_metal":
        for axis, even in ((-1, False), (-2, True), (-3, False), (-4, False)):
            table = _doubled(table, axis, even)
    elif kind == "brushed_glass":
        # Equal indices are no smooth limit: each side by itself.
        halved = 2 * np.arange(HALVED) + 1
        halves, table = table[halved], np.delete(table, halved, axis=0)
        table = np.concatenate([_doubled(table[: DENSE + 1], 0)[:-1], _doubled(table[DENSE:], 0)])
        table[halved] = halves
        table = _doubled(_doubled(table, -2, True), -3)
    else:
        # Linear pieces have steps in their derivative by roughness: smaller ones now.
        table = _doubled(table, -2)
    if kind == "glass":
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
    and cosine remain. Those of brushed glass are from a file, along `of_index`.
    """
    if kind == "brushed_glass":
        return _brushed_means(model)
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


def _brushed_means(model: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`means` of brushed glass [index, roughness, ratio]: see `make_energy_tables.brushed_means`."""
    with np.load(DATA / "brushed_means.npz") as file:
        found = [np.asarray(part, np.float64) for part in file[model]]
    half = MEAN_INDICES // 2
    found = [_doubled(part, -1) for part in found]
    one, other = (
        np.concatenate([_doubled(part[: half + 1], 0)[:-1], _doubled(part[half:], 0)]) for part in found
    )
    return one, other


def _between(table: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Linear interpolation along one axis at positions in units of its nodes."""
    low = np.minimum(at.astype(int), table.shape[axis] - 2)
    share = (at - low).reshape(-1, *([1] * (-axis - 1)))
    return (1 - share) * np.take(table, low, axis) + share * np.take(table, low + 1, axis)


# --- looking into them ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A table in Dr.Jit: cells of the last two axes as packets of their four corners, or those of the last of two.

    Attributes:
        values: the packets one after another; a numpy array in scalar mode.
        shape: numbers of nodes.
        packet: type of a packet; None in scalar mode.
        corners: 4, or 2, which takes more looking up and half of the memory.
    """

    values: Any
    shape: tuple[int, ...]
    packet: Any
    corners: int = 4

    def __call__(self, *places: Array) -> Array:
        """Multilinear interpolation at coordinates in [0, 1], one for each axis."""
        cells = [_cell(place, n) for place, n in zip(places, self.shape, strict=True)]
        return self._look(cells, 0)

    def _look(self, cells: list[tuple[Array, Array]], start: Array) -> Array:
        (index, share), *rest = cells
        n = self.shape[-1] - 1
        if not rest:
            a, b = self._cell(start * n + index)
            return dr.fma(share, b - a, a)
        if self.corners == 4 and len(rest) == 1:
            last, along = rest[0]
            a, b, c, d = self._cell((start * (self.shape[-2] - 1) + index) * n + last)
            low, high = dr.fma(along, b - a, a), dr.fma(along, d - c, c)
            return dr.fma(share, high - low, low)
        inner = self.shape[-len(cells)]
        start = start * inner + index
        low, high = self._look(rest, start), self._look(rest, start + 1)
        return dr.fma(share, high - low, low)

    def _cell(self, index: Array) -> Any:
        if self.packet is None:
            return self.values[self.corners * index : self.corners * (index + 1)].tolist()
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
    few = nodes.ndim > 4  # of such tables memory counts
    ends = (
        [(slice(None), j) for j in (0, 1)]
        if few
        else [(slice(i, i - 1 or None), j) for i in (0, 1) for j in (0, 1)]
    )
    packets = np.stack([nodes[..., i, j : j - 1 or None] for i, j in ends], axis=-1).ravel()
    if number is float:
        return Table(packets, nodes.shape, None, len(ends))
    module = sys.modules[number.__module__]
    single = dr.type_v(number) == dr.VarType.Float32
    still = dr.detached_t(number)
    values = still(packets.astype(np.float32 if single else np.float64))
    dr.eval(values)
    packet = getattr(module, f"Array{len(ends)}f" + ("" if single else "64"))
    return Table(number(values), nodes.shape, packet, len(ends))
