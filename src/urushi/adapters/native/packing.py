"""A `Solution` as a header and a few arrays, and back.

With W the etendue of the nodes, X_m[o, i] = A_m[o, i] / W_o is symmetric (reciprocity): of reflection the triangle
o <= i is kept, of transmission what comes from above. X is proportional to the BSDF, so that one step per pair of nodes

    step[o, i] = error / (2.3 sqrt M + M / 6) min(peak_o, peak_i)

keeps the BSDF, a sum of M orders, to `error` of its peak for that angle of incidence: 2.3 sqrt M is four standard
deviations of the sum of as many rounding errors, M / 6 the end of a series that rounds to 0. Peaks are those of each
channel, and of the blocks and the closed forms apart: what `eval` adds exactly hides nothing of what it looks up.
Order 0, whose sums are energies, stays in single precision.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.solution import Block, Part, Solution

#: the four parts by (from above, to above)
SIDES = {
    "above to above": (True, True),
    "above to below": (True, False),
    "below to above": (False, True),
    "below to below": (False, False),
}
#: the part that is the mirror image of "above to below", and not stored
MIRRORED = "below to above"
#: errors that the integers have room for
LEAST, MOST = 1e-7, 0.1


@dataclass(frozen=True)
class Piece:
    """Where a block of a part is stored: `kind` is "blocks" or "rest"; (n_out, n_in) nodes from `first` on."""

    part: str
    kind: str
    orders: range
    first: int
    shape: tuple[int, int]

    @property
    def low(self) -> int:
        """1 if order 0 is among them."""
        return int(self.orders.start == 0)

    @property
    def pairs(self) -> int:
        """Pairs of nodes that are stored: all, or those of a triangle."""
        n_out, n_in = self.shape
        return n_out * n_in if _passes(self.part) else n_in * (n_in + 1) // 2

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the stored pairs."""
        if not _passes(self.part):
            return np.triu_indices(self.shape[0])
        rows, columns = np.indices(self.shape)
        return rows.ravel(), columns.ravel()


def pack(solution: Solution, error: float) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a file keeps of a solution.

    Args:
        solution: with reciprocal operators.
        error: what may be added to the error of the BSDF, relative to its peak for the same angle of incidence.

    Returns:
        a header of plain values, and the arrays ``delta``, ``peaks``, ``mean``, ``values`` (see `shapes`).

    Raises:
        MaterialError: an error out of range, or operators that are not reciprocal to that error.
    """
    if not LEAST <= error <= MOST:
        raise MaterialError(f"found {error!r}; allowed: {LEAST:g} to {MOST:g}", where="error")
    parts = {name: solution.parts[side] for name, side in SIDES.items() if side in solution.parts}
    deltas = {name: part.delta for name, part in parts.items() if part.delta is not None}
    header: dict[str, Any] = {
        "indices": list(solution.grid.indices),
        "panels": [[panel.index, panel.count] for panel in solution.grid.panels],
        "colours": solution.colours,
        "closed_form": solution.closed_form,
        "forward": {str(region): float(share) for region, share in solution.forward.items()},
        "error": error,
        "deltas": {name: int(delta.shape[1]) for name, delta in deltas.items()},
        "parts": {
            name: {"blocks": _headed(part.blocks), "rest": _headed(part.rest)}
            for name, part in parts.items()
            if name != MIRRORED
        },
    }
    blocks = {name: iter(part.whole()) for name, part in parts.items()}
    peaks = {
        (name, kind): _peaks(solution, part, getattr(part, kind))
        for name, part in parts.items()
        for kind in ("blocks", "rest")
        if name != MIRRORED
    }
    means, values = [np.zeros(0, "<f4")], [np.zeros(0, "<u4")]
    for piece in pieces(header):
        block, top = next(blocks[piece.part]), peaks[piece.part, piece.kind]
        x = block.values / solution.grid.etendue[piece.first :][: piece.shape[0], None]
        mirrored = x if not _passes(piece.part) else next(blocks[MIRRORED]).values
        if _passes(piece.part):
            mirrored = mirrored / solution.grid.etendue[piece.first :][: piece.shape[1], None]
        step = _step(top, header, piece)
        if (np.abs(x - mirrored.swapaxes(2, 3)).sum(axis=1) > _terms(header) * step + 1e-300).any():
            raise MaterialError(
                f"found operators {piece.part} that are not their own mirror image to {error:g}; allowed: "
                "reciprocal ones"
            )
        rows, columns = piece.places()
        kept, scale = x[:, :, rows, columns], step[:, None, rows, columns]
        means.append(kept[:, : piece.low].astype("<f4").ravel())
        found = np.rint(kept[:, piece.low :] / np.where(scale > 0, scale, 1)).astype(np.int64)
        values.append(((found << 1) ^ (found >> 63)).astype("<u4").ravel())  # small ones stay small
    planes = np.concatenate(values).view(np.uint8).reshape(-1, 4).T
    header["planes"] = next((k for k in range(4, 0, -1) if planes[k - 1].any()), 0)
    return header, {
        "delta": np.concatenate([np.zeros(0, "<f8"), *(delta.ravel() for delta in deltas.values())]),
        "peaks": np.concatenate(
            [np.zeros(0, "<f4"), *(top.ravel() for pair in peaks.values() for top in pair)]
        ),
        "mean": np.concatenate(means),
        "values": np.ascontiguousarray(planes[: header["planes"]]),
    }


def unpack(header: dict[str, Any], arrays: dict[str, np.ndarray], diagnostics: dict[str, Any]) -> Solution:
    """The solution of a header (as `pack` makes it) and of arrays that have its `shapes`."""
    grid = Grid.build([n for n, _ in header["panels"]], [count for _, count in header["panels"]])
    grid = replace(grid, indices=tuple(header["indices"]))
    colours = header["colours"]
    planes = np.zeros((4, arrays["values"].shape[1]), np.uint8)
    planes[: header["planes"]] = arrays["values"]
    zigzag = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.int64)
    delta, peak = _Taker(arrays["delta"]), _Taker(arrays["peaks"])
    mean, value = _Taker(arrays["mean"]), _Taker((zigzag >> 1) ^ -(zigzag & 1))
    names = [*header["parts"], *([MIRRORED] if "above to below" in header["parts"] else [])]
    parts = {name: Part(*SIDES[name], None, []) for name in names}
    for name, count in header["deltas"].items():
        parts[name] = replace(parts[name], delta=delta(colours, count).astype(np.float64))
    peaks = {
        (name, kind): tuple(peak(colours, n) for n in _nodes(header, name)[::-1])
        for name in header["parts"]
        for kind in ("blocks", "rest")
    }
    for piece in pieces(header):
        rows, columns = piece.places()
        x = np.zeros((colours, len(piece.orders), *piece.shape))
        if piece.low:
            x[:, 0, rows, columns] = mean(colours, piece.pairs)
        step = _step(peaks[piece.part, piece.kind], header, piece)[:, None, rows, columns]
        x[:, piece.low :, rows, columns] = value(colours, len(piece.orders) - piece.low, piece.pairs) * step
        if not _passes(piece.part):
            x[:, :, columns, rows] = x[:, :, rows, columns]
        _put(parts[piece.part], piece, x, grid)
        if _passes(piece.part):
            _put(parts[MIRRORED], piece, x.swapaxes(2, 3), grid)
    forward = {int(region): float(share) for region, share in header["forward"].items()}
    by_side = {part_side: parts[name] for name, part_side in SIDES.items() if name in parts}
    return Solution(grid, by_side, header["closed_form"], colours, diagnostics, forward)


def shapes(header: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """The shapes of the arrays that belong to a header; Python's integers, which do not overflow."""
    colours = header["colours"]
    mean = sum(piece.pairs * piece.low for piece in pieces(header))
    values = sum(piece.pairs * (len(piece.orders) - piece.low) for piece in pieces(header))
    return {
        "delta": (colours * sum(header["deltas"].values()),),
        "peaks": (2 * colours * sum(sum(_nodes(header, name)) for name in header["parts"]),),
        "mean": (colours * mean,),
        "values": (header["planes"], colours * values),
    }


def pieces(header: dict[str, Any]) -> Iterator[Piece]:
    """All blocks that are stored, in their order."""
    for name, part in header["parts"].items():
        n_in, n_out = _nodes(header, name)
        for kind in ("blocks", "rest"):
            for start, stop, first in part[kind]:
                shape = (max(n_out - first, 0), max(n_in - first, 0))
                yield Piece(name, kind, range(start, stop), first, shape)


def _passes(name: str) -> bool:
    return SIDES[name][0] != SIDES[name][1]


def _nodes(header: dict[str, Any], name: str) -> tuple[int, int]:
    """How many nodes light of a part comes from and goes to."""
    found = []
    for above in SIDES[name]:
        index = header["indices"][0 if above else -1]
        found.append(sum(count for n, count in header["panels"] if n <= index * (1 + 1e-9)))
    return found[0], found[1]


def _terms(header: dict[str, Any]) -> float:
    """How many steps the sum of all orders may be off."""
    orders = max([1, *(piece.orders.stop for piece in pieces(header))])
    return float(2.3 * np.sqrt(orders) + orders / 6)


def _step(peaks: tuple[np.ndarray, ...], header: dict[str, Any], piece: Piece) -> np.ndarray:
    out, into = (np.asarray(peak, np.float64)[:, piece.first :] for peak in peaks)
    return np.minimum(out[:, :, None], into[:, None]) * (header["error"] / _terms(header))


def _peaks(solution: Solution, part: Part, blocks: list[Block]) -> tuple[np.ndarray, np.ndarray]:
    """The largest sum of X over the orders, at either end of the azimuths: (C, n_out) and (C, n_in)."""
    grid = solution.grid
    n_in, n_out = (len(grid.mu[0 if above else -1]) for above in (part.from_above, part.to_above))
    total = np.zeros((2, solution.colours, n_out, n_in))
    for block in blocks:
        orders = np.array(block.orders)
        both = np.where(orders > 0, 2, 1) * np.array([np.ones(len(orders)), (-1.0) ** orders])
        total[:, :, block.first :, block.first :] += np.einsum(
            "sm,cmoi->scoi", both, block.values, optimize=True
        )
    highest = np.abs(total / grid.etendue[:n_out, None]).max(axis=0)
    return highest.max(axis=2, initial=0).astype("<f4"), highest.max(axis=1, initial=0).astype("<f4")


def _put(part: Part, piece: Piece, x: np.ndarray, grid: Grid) -> None:
    values = x * grid.etendue[piece.first :][: x.shape[2], None]
    getattr(part, piece.kind).append(Block(piece.orders, piece.first, values))


def _headed(blocks: list[Block]) -> list[list[int]]:
    return [[block.orders.start, block.orders.stop, block.first] for block in blocks]


class _Taker:
    """An array from which one piece after another is taken."""

    def __init__(self, array: np.ndarray) -> None:
        self.array, self.at = array, 0

    def __call__(self, *shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        self.at += size
        return self.array[self.at - size : self.at].reshape(shape)
