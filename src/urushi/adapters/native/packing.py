"""A `Solution` as a header and a few arrays, and back.

With W the etendue of the nodes, X_m[o, i] = A_m[o, i] / W_o is symmetric (reciprocity): of reflection the triangle
o <= i is kept, of transmission what comes from above; of a stack that is its own mirror image, half of that. X is
proportional to the BSDF, so that one step per pair of nodes

    step[o, i] = error / (2.3 sqrt M + M / 6) min(peak_o, peak_i)

keeps the BSDF, a sum of M orders, to `error` of its peak for that angle of incidence: 2.3 sqrt M is four standard
deviations of the sum of as many rounding errors, M / 6 the end of a series that rounds to 0. Peaks are those of each
channel, and of the blocks and the closed forms apart: what `eval` adds exactly hides nothing of what it looks up. The
integers are smooth in both nodes, so their differences are stored, which are small. The sums of order 0 are energies:
what rounding takes from them is stored as well (`energies`).

Light scattered once behind smooth interfaces is not stored where the description gives it (`Known`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.solution import Block, Part, Solution

from . import energies
from .symmetry import alike, headed, is_mirror, joined, same_delta, turned

#: the four parts by (from above, to above)
SIDES = {
    "above to above": (True, True),
    "above to below": (True, False),
    "below to above": (False, True),
    "below to below": (False, False),
}
#: light that passes; the part that is its mirror image, and not stored; and the other one where the stack is its own
THROUGH, MIRRORED, UNDER = "above to below", "below to above", "below to below"
#: bytes of an integer
PLANES = 8
#: bits of a peak that are kept
ROUGH = np.uint32(0xFFFFF000)
#: less than this is not told from nothing, as peaks are kept in single precision
FAINT = 1e-35
#: numbers that operators may have, however few bytes tell them
FREE = 1 << 24
#: errors that the integers have room for
LEAST, MOST = 1e-7, 0.1


@dataclass(frozen=True)
class Piece:
    """Where a block of a part is stored.

    Attributes:
        part: one of `SIDES`.
        kind: "blocks" or "rest".
        orders, first: of the block.
        shape: (n_out, n_in) nodes from `first` on.
        symmetric: whether X is.
    """

    part: str
    kind: str
    orders: range
    first: int
    shape: tuple[int, int]
    symmetric: bool

    @property
    def low(self) -> int:
        """1 if order 0 is among them."""
        return int(self.orders.start == 0)

    @property
    def pairs(self) -> int:
        """Pairs of nodes that are stored: all, or those of a triangle."""
        n_out, n_in = self.shape
        return n_in * (n_in + 1) // 2 if self.symmetric else n_out * n_in

    @property
    def sums(self) -> int:
        """Sums of order 0 that are stored: of all columns, and of all rows where those are others."""
        return self.low * (self.shape[1] if self.symmetric else sum(self.shape))

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the stored pairs."""
        if self.symmetric:
            return np.triu_indices(self.shape[0])
        rows, columns = np.indices(self.shape)
        return rows.ravel(), columns.ravel()


#: what a description says of `Part.rest`: (grid and terms, side, orders and first nodes) -> blocks, or None
Known = Callable[[Solution, tuple[bool, bool], list[tuple[range, int]]], "list[Block] | None"]


def pack(
    solution: Solution, error: float, known: Known | None = None
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a file keeps of a solution.

    Args:
        solution: with reciprocal operators.
        error: what may be added to the error of the BSDF, relative to its peak for the same angle of incidence.
        known: what need not be stored, as the reader will know it.

    Returns:
        a header of plain values, and the arrays ``delta``, ``peaks``, ``sums``, ``values`` (see `shapes`).

    Raises:
        MaterialError: an error out of range, or operators that are not reciprocal to that error.
    """
    if not LEAST <= error <= MOST:
        raise MaterialError(f"found {error!r}; allowed: {LEAST:g} to {MOST:g}", where="error")
    solution = replace(solution, parts={side: joined(part) for side, part in solution.parts.items()})
    parts = {name: solution.parts[side] for name, side in SIDES.items() if side in solution.parts}
    mirror = is_mirror(solution, error)
    stored = [name for name in parts if name != MIRRORED and not (mirror and name == UNDER)]
    deltas = {name: parts[name].delta for name in stored}
    header: dict[str, Any] = {
        "indices": list(solution.grid.indices),
        "panels": [
            [panel.index, panel.count, *([panel.squeeze] if panel.squeeze != 1 else [])]
            for panel in solution.grid.panels
        ],
        "colours": solution.colours,
        "closed_form": solution.closed_form,
        "forward": {str(region): float(share) for region, share in solution.forward.items()},
        "terms": {str(region): int(count) for region, count in solution.terms.items()},
        "error": error,
        "mirror": mirror,
        "once": [name for name in stored if _is_known(solution, SIDES[name], known)],
        "deltas": {name: int(delta.shape[1]) for name, delta in deltas.items() if delta is not None},
        "parts": {
            name: {"blocks": headed(parts[name].blocks), "rest": headed(parts[name].rest)} for name in stored
        },
    }
    peaks = {
        (name, kind): _peaks(solution, parts[name], getattr(parts[name], kind))
        for name, kind in _kinds(header)
    }
    blocks = {
        (name, kind): iter(zip(getattr(parts[name], kind), getattr(parts[_other(name)], kind), strict=True))
        for name, kind in peaks
    }
    sums, values = [np.zeros(0, "<i2")], [np.zeros(0, "<u8")]
    if THROUGH in stored and not same_delta(parts[THROUGH], parts[MIRRORED]):
        raise MaterialError(
            f"found a delta part {THROUGH} that is not that {MIRRORED}; allowed: its mirror image"
        )
    for piece in pieces(header):
        block, back = next(blocks[piece.part, piece.kind])
        step = _step(peaks[piece.part, piece.kind], header, piece)
        x = block.values / solution.grid.etendue[piece.first :][: piece.shape[0], None]
        mirrored = back.values / solution.grid.etendue[piece.first :][: piece.shape[1], None]
        if (np.abs(x - mirrored.swapaxes(2, 3)).sum(axis=1) > _terms(header) * step + FAINT).any():
            raise MaterialError(
                f"found operators {piece.part} that are not their own mirror image to {error:g}; allowed: "
                "reciprocal ones"
            )
        if piece.symmetric:
            x = 0.5 * (x + x.swapaxes(2, 3))
        whole = np.rint(x / np.where(step > 0, step, 1)[:, None] * (step > 0)[:, None]).astype(np.int64)
        if piece.low:
            off = x[:, 0] - whole[:, 0] * step
            own = energies.missing(off, step, *_etendue(piece, solution.grid), piece.symmetric)
            sums += [part.ravel() for part in own]
        rows, columns = piece.places()
        found = np.diff(np.diff(whole, axis=2, prepend=0), axis=3, prepend=0)[:, :, rows, columns]
        values.append(((found << 1) ^ (found >> 63)).astype("<u8").ravel())  # small ones stay small
    planes = np.concatenate(values).view(np.uint8).reshape(-1, PLANES).T
    least = int(planes.shape[1] > FREE)  # so that a file of nothing but zeros is as large as it claims
    header["planes"] = next((k for k in range(PLANES, 0, -1) if planes[k - 1].any()), least)
    return header, {
        "delta": np.concatenate(
            [
                np.zeros(0, "<f4"),
                *(delta.astype("<f4").ravel() for delta in deltas.values() if delta is not None),
            ]
        ),
        "peaks": np.concatenate(
            [np.zeros(0, "<f4"), *(top.ravel() for pair in peaks.values() for top in pair)]
        ),
        "sums": np.concatenate(sums),
        "values": np.ascontiguousarray(planes[: header["planes"]]),
    }


def unpack(
    header: dict[str, Any],
    arrays: dict[str, np.ndarray],
    diagnostics: dict[str, Any],
    known: Known | None = None,
) -> Solution:
    """The solution of a header (as `pack` makes it) and of arrays that have its `shapes`."""
    panels = header["panels"]
    grid = Grid.build([panel[0] for panel in panels], [panel[1] for panel in panels], *panels[0][2:])
    grid = replace(grid, indices=tuple(header["indices"]))
    colours = header["colours"]
    planes = np.zeros((PLANES, arrays["values"].shape[1]), np.uint8)
    planes[: header["planes"]] = arrays["values"]
    zigzag = np.ascontiguousarray(planes.T).view("<u8").ravel()
    delta, peak, sums = _Taker(arrays["delta"]), _Taker(arrays["peaks"]), _Taker(arrays["sums"])
    value = _Taker((zigzag >> 1).astype(np.int64) ^ -(zigzag & 1).astype(np.int64))
    stored = header["parts"]
    parts = {name: Part(*SIDES[name], None, []) for name in SIDES if name in stored or len(stored) > 1}
    for name, count in header["deltas"].items():
        parts[name] = replace(parts[name], delta=delta(colours, count).astype(np.float64))
    peaks = {
        (name, kind): tuple(peak(colours, n) for n in _nodes(header, name)[::-1])
        for name, kind in _kinds(header)
    }
    for piece in pieces(header):
        rows, columns = piece.places()
        z = np.zeros((colours, len(piece.orders), *piece.shape), np.int64)
        z[:, :, rows, columns] = value(colours, len(piece.orders), piece.pairs)
        if piece.symmetric:
            z[:, :, columns, rows] = z[:, :, rows, columns]
        step = _step(peaks[piece.part, piece.kind], header, piece)[:, None]
        x = np.cumsum(np.cumsum(z, axis=2), axis=3) * step
        if piece.low:
            ends = piece.shape[1:] if piece.symmetric else piece.shape[::-1]
            taken = [sums(colours, n) for n in ends]
            x[:, 0] = energies.given_back(x[:, 0], step[:, 0], taken, *_etendue(piece, grid))
        _put(parts[piece.part], piece, x, grid)
    solution = Solution(grid, {}, header["closed_form"], colours, diagnostics)
    solution.forward.update({int(region): float(share) for region, share in header["forward"].items()})
    solution.terms.update({int(region): int(count) for region, count in header["terms"].items()})
    for name in header["once"]:
        heads = [(range(start, stop), first) for start, stop, first in stored[name]["rest"]]
        found = None if known is None else known(solution, SIDES[name], heads)
        if found is None:
            raise MaterialError(
                "found light scattered once; allowed: descriptions that have it", where=f"once[{name}]"
            )
        parts[name].rest.extend(found)
    if len(stored) > 1:
        parts[MIRRORED] = turned(parts[THROUGH], grid)
    if header["mirror"]:
        above = parts["above to above"]
        parts[UNDER] = replace(above, from_above=False, to_above=False)
    by_side = {side: parts[name] for name, side in SIDES.items() if name in parts}
    return replace(solution, parts=by_side)


def shapes(header: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """The shapes of the arrays that belong to a header; Python's integers, which do not overflow."""
    colours = header["colours"]
    return {
        "delta": (colours * sum(header["deltas"].values()),),
        "peaks": (colours * sum(sum(_nodes(header, name)) for name, _ in _kinds(header)),),
        "sums": (colours * sum(piece.sums for piece in pieces(header)),),
        "values": (
            header["planes"],
            colours * sum(piece.pairs * len(piece.orders) for piece in pieces(header)),
        ),
    }


def most_numbers(header: dict[str, Any]) -> int:
    """How many numbers the operators of a header have, those included that the description tells."""
    found = 0
    for name, part in header["parts"].items():
        n_in, n_out = _nodes(header, name)
        for start, stop, first in (*part["blocks"], *part["rest"]):
            found += (stop - start) * max(n_in - first, 0) * max(n_out - first, 0)
    return int(header["colours"] * found)


def pieces(header: dict[str, Any]) -> Iterator[Piece]:
    """All blocks that are stored, in their order."""
    for name, kind in _kinds(header):
        n_in, n_out = _nodes(header, name)
        for start, stop, first in header["parts"][name][kind]:
            shape = (max(n_out - first, 0), max(n_in - first, 0))
            symmetric = header["mirror"] or not _passes(name)
            yield Piece(name, kind, range(start, stop), first, shape, symmetric)


def _kinds(header: dict[str, Any]) -> list[tuple[str, str]]:
    """What is stored, part by part: "blocks" and, unless the description gives it, "rest"."""
    return [
        (name, kind)
        for name, part in header["parts"].items()
        for kind in ("blocks", "rest")
        if part[kind] and not (kind == "rest" and name in header["once"])
    ]


def _passes(name: str) -> bool:
    return SIDES[name][0] != SIDES[name][1]


def _nodes(header: dict[str, Any], name: str) -> tuple[int, int]:
    """How many nodes light of a part comes from and goes to."""
    found = []
    for above in SIDES[name]:
        index = header["indices"][0 if above else -1]
        found.append(sum(panel[1] for panel in header["panels"] if panel[0] <= index * (1 + 1e-9)))
    return found[0], found[1]


def _terms(header: dict[str, Any]) -> float:
    """How many steps the sum of all orders may be off."""
    orders = max([1, *(piece.orders.stop for piece in pieces(header))])
    return float(2.3 * np.sqrt(orders) + orders / 6)


def _step(peaks: tuple[np.ndarray, ...], header: dict[str, Any], piece: Piece) -> np.ndarray:
    """(C, n_out, n_in)."""
    out, into = (np.asarray(peak, np.float64)[:, piece.first :] for peak in peaks)
    return np.minimum(out[:, :, None], into[:, None]) * (header["error"] / _terms(header))


def _peaks(solution: Solution, part: Part, blocks: list[Block]) -> tuple[np.ndarray, ...]:
    """The largest sum of X over the orders, at either end of the azimuths: (C, n_out) and (C, n_in), rounded down."""
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
    return tuple(
        (highest.max(axis=axis, initial=0).astype("<f4").view("<u4") & ROUGH).view("<f4") for axis in (2, 1)
    )


def _etendue(piece: Piece, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Etendue of the nodes that the light of a piece goes to and comes from."""
    w = grid.etendue[piece.first :]
    return w[: piece.shape[0]], w[: piece.shape[1]]


def _other(name: str) -> str:
    """The part that carries the light of this one back."""
    return MIRRORED if name == THROUGH else name


def _is_known(solution: Solution, side: tuple[bool, bool], known: Known | None) -> bool:
    """Whether a reader of the description finds the rest of a part without being told."""
    rest = solution.parts[side].rest
    if known is None or not rest:
        return False
    found = known(solution, side, [(block.orders, block.first) for block in rest])
    return found is not None and alike(found, rest, solution.grid, 1e-3)


def _put(part: Part, piece: Piece, x: np.ndarray, grid: Grid) -> None:
    values = x * grid.etendue[piece.first :][: x.shape[2], None]
    getattr(part, piece.kind).append(Block(piece.orders, piece.first, values))


class _Taker:
    """An array from which one piece after another is taken."""

    def __init__(self, array: np.ndarray) -> None:
        self.array, self.at = array, 0

    def __call__(self, *shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        self.at += size
        return self.array[self.at - size : self.at].reshape(shape)
