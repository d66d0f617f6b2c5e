"""A stack solved by adding as a Fourier ``.bsdf`` table.

Between its nodes a table has cubic splines, and no closed forms: what the solution knows from a few dozen nodes takes
many more there. Nodes are added until the table, read as every reader reads it, says what the solution says.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.fft import dct

from urushi.errors import UrushiError
from urushi.solvers.adding import build
from urushi.solvers.adding.core import Closed
from urushi.solvers.adding.refine import AZIMUTHS, COSINES, OFFSETS
from urushi.solvers.adding.result import AddingBSDF
from urushi.solvers.adding.solution import Part, Solution
from urushi.solvers.arrays import padded

from .build import fourier_table
from .table import FourierTable
from .values import evaluate

#: the names that `fourier_table` has for the parts
NAMES = {
    (True, True): "r_top",
    (True, False): "t_down",
    (False, True): "t_up",
    (False, False): "r_bottom",
}
#: numbers of nodes to try on each side, and most orders of a closed form
FEWEST, GROWTH, MOST, MOST_ORDERS = 48, 1.5, 800, 4096
#: cosine from which on the accuracy holds
GRAZING = 0.06
#: numbers that the series may take before they are cut
_ROOM = 1 << 26


def fourier_of(
    bsdf: AddingBSDF, *, accuracy: float | None = None, nodes: int | None = None, delta: str = "refuse"
) -> tuple[FourierTable, float]:
    """A table of a solved stack.

    Args:
        bsdf: what `solve(stack, "adding")` gave; of 1 or 3 channels.
        accuracy: error allowed of what a reader of the table finds, relative to the peak of the BSDF for the same
            angle of incidence, up to 86 degrees; by default that of the solution.
        nodes: a fixed number of nodes on each side instead, whatever the error.
        delta: the format has no room for what smooth interfaces and unscattered light leave in one direction:
            "refuse" such stacks, or "omit" that light.

    Returns:
        the table, and its error in the sense of `accuracy`.

    Raises:
        UrushiError: an option out of range, delta parts that were to be refused, or an accuracy that takes too many
            nodes.
    """
    if delta not in ("refuse", "omit"):
        raise UrushiError(f"delta: found {delta!r}; allowed: refuse, omit")
    accuracy = float(bsdf.solution.diagnostics.get("accuracy", 1e-3)) if accuracy is None else accuracy
    if not 1e-6 <= accuracy <= 0.5:
        raise UrushiError(f"accuracy: found {accuracy!r}; allowed: 1e-6 to 0.5")
    if nodes is not None and not 4 <= nodes <= MOST:
        raise UrushiError(f"nodes: found {nodes!r}; allowed: 4 to {MOST}")
    if bsdf.solution.colours not in (1, 3):
        raise UrushiError(f"channels: found {bsdf.solution.colours}; allowed: 1 or 3 in a Fourier .bsdf file")
    parts = bsdf.solution.parts.values()
    if delta == "refuse" and any(part.delta is not None and (part.delta > 0).any() for part in parts):
        raise UrushiError(
            "a Fourier .bsdf file has no place for light that leaves in one direction only, and this stack has some; "
            "allowed: rough interfaces outside, delta='omit', or a .urushi.npz file"
        )
    count = FEWEST if nodes is None else nodes
    while True:
        table = _on(bsdf, cosines(count), accuracy)
        error = difference(bsdf, table)
        if nodes is not None or error <= accuracy:
            return table, error
        count = int(np.ceil(GROWTH * count))
        if count > MOST:
            raise UrushiError(
                f"accuracy: found {accuracy:g}, but {len(table.nodes) // 2 - 1} nodes still leave an error of "
                f"{error:.2g}; allowed: a larger one, or nodes=..."
            )


def cosines(count: int) -> np.ndarray:
    """(count,) ascending cosines in (0, 1], close together at the horizon, and more so at normal incidence.

    There splines in the cosine see odd orders as roots of 1 - mu.
    """
    u = 1 - np.arange(1, count + 1) / count
    return np.asarray(np.cos(0.5 * np.pi * u**1.4) ** 2)


def difference(bsdf: AddingBSDF, table: FourierTable) -> float:
    """The largest error of a table, relative to the peak for the same angle of incidence, on directions of `refine`."""
    worst = 0.0
    indices = bsdf.solution.grid.indices
    for from_above, to_above in bsdf.solution.parts:
        n_i, n_o = (indices[0 if above else -1] for above in (from_above, to_above))
        for mu in COSINES:
            sin_o = min(np.sqrt(1 - mu**2) * n_i / n_o, 1.0)
            theta = np.minimum(np.abs(np.arcsin(sin_o) + OFFSETS), np.radians(86))
            theta, phi = (x.ravel() for x in np.meshgrid(theta, AZIMUTHS))
            wi = np.array([-np.sqrt(1 - mu**2), 0, mu if from_above else -mu])
            up = np.cos(theta) * (1 if to_above else -1)
            wo = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), up], axis=1)
            wi = np.broadcast_to(wi, wo.shape)
            truth = bsdf.eval(wi, wo)
            found = evaluate(table, wi, wo, mode=bsdf.mode)
            cosine = np.cos(theta)[:, None]
            peak = (truth / cosine).max()
            if peak > 0:
                worst = max(worst, float(np.abs((found - truth) / cosine).max() / peak))
    return worst


def _on(bsdf: AddingBSDF, mu: np.ndarray, accuracy: float) -> FourierTable:
    solution = bsdf.solution
    bound, _ = build.bind_numbers(bsdf.stack)
    closed = Closed(bound, solution) if solution.closed_form is not None else None
    blocks: dict[str, Any] = {}
    for side, part in solution.parts.items():
        series = _looked_up(solution, part, mu)
        if closed is not None:
            more = _closed(closed, part, mu, solution.colours, 0.1 * accuracy)
            longer, shorter = (more, series) if more.shape[1] > series.shape[1] else (series, more)
            longer[:, : shorter.shape[1]] += shorter
            series = longer
        blocks[NAMES[side]] = series
    eta = solution.grid.indices[-1] / solution.grid.indices[0] if len(solution.parts) > 1 else 1.0
    return fourier_table(mu, **blocks, tolerance=0.3 * accuracy, eta=eta, metadata=bsdf.stack.name.encode())


def _looked_up(solution: Solution, part: Part, mu: np.ndarray) -> np.ndarray:
    """(C, K, n, n) the series of what the solution interpolates, between its nodes."""
    grid, n = solution.grid, len(solution.grid.indices)
    region_i, region_o = ((0 if above else -1) % n for above in (part.from_above, part.to_above))
    spread = {
        region: _spread(grid.stencil(region, mu), len(grid.mu[region])) for region in {region_i, region_o}
    }
    mu_i, mu_o, weight = grid.mu[region_i], grid.mu[region_o], grid.weights[region_o]
    scale = (mu_o[:, None] + mu_i) / (mu_o * weight)[:, None] / (2 * np.pi)
    orders = max([1, *(block.orders.stop for block in part.blocks)])
    _check_room(solution.colours * orders * len(mu) ** 2)
    found = np.zeros((solution.colours, orders, len(mu), len(mu)))
    for block in part.blocks:
        q = block.values * scale[block.first :, block.first :]
        for k, order in enumerate(block.orders):
            out, into = (spread[r][order % 2][:, block.first :] for r in (region_o, region_i))
            found[:, order] += (out @ q[:, k] @ into.T) * (2 if order else 1)
    return found * (mu[:, None] / (mu[:, None] + mu))


def _spread(stencil: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, count) matrices of a stencil, for even and odd orders."""
    both = np.zeros((2, len(stencil.node), count))
    rows = np.arange(len(stencil.node))[:, None]
    for matrix, weight in zip(both, (stencil.even, stencil.odd), strict=True):
        np.add.at(matrix, (rows, stencil.node), weight)
    return both[0], both[1]


def _closed(closed: Closed, part: Part, mu: np.ndarray, colours: int, tolerance: float) -> np.ndarray:
    """(C, K, n, n) the series of what the solution adds in closed form, from as many azimuths as that takes."""
    from drjit.llvm.ad import Array3f64, Float64

    sin = np.sqrt((1 - mu) * (1 + mu))
    far = mu > GRAZING  # towards the horizon lobes become ever narrower in azimuth
    count = 32
    while True:
        _check_room(colours * count * len(mu) ** 2)
        phi = np.pi * (np.arange(count) + 0.5) / count
        o, i, p = (x.ravel() for x in np.meshgrid(np.arange(len(mu)), np.arange(len(mu)), phi, indexing="ij"))
        zero = Float64(padded(0 * p))
        wi = Array3f64(Float64(padded(-sin[i])), zero, Float64(padded(mu[i] if part.from_above else -mu[i])))
        up = mu[o] if part.to_above else -mu[o]
        across = Float64(padded(sin[o] * np.cos(p))), Float64(padded(sin[o] * np.sin(p)))
        wo = Array3f64(*across, Float64(padded(up)))
        value = np.atleast_2d(np.array(closed.eval(wi, wo) + zero))
        value = value.reshape(-1, len(mu), len(mu), count)
        series = dct(value, type=2, axis=-1) / count
        series[..., 0] *= 0.5
        f = np.abs(series[:, far][:, :, far] / mu[far, None, None])
        peak, tail = (some.sum(axis=3).max(axis=(0, 1)) for some in (f, f[..., count // 2 :]))
        if (tail <= tolerance * np.maximum(peak, 1e-30)).all() or count == MOST_ORDERS:
            break
        count *= 2
    return np.array(np.broadcast_to(np.moveaxis(series, 3, 1), (colours, count, len(mu), len(mu))))


def _check_room(numbers: int) -> None:
    if numbers > _ROOM:
        raise UrushiError(
            f"a table of {numbers} numbers; allowed: {_ROOM}: ask for a larger accuracy or fewer nodes, or write a "
            ".urushi.npz file"
        )
