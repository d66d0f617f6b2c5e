"""Flux operators with their delta part kept apart, and the algebra of them.

An operator takes the flux carried by the nodes of one region to that carried by the nodes of another. Light that
meets only smooth interfaces, or nothing, stays on its node: that part is a diagonal, the same for every azimuthal
order. The rest is a matrix per order. Products and series keep the two apart exactly: a diagonal never turns dense,
a part that is absent costs nothing, and orders that only one factor has meet the other's diagonal alone.

    (d + D)(e + E) = d e  +  (d E + D e + D E)
    (1 - d - D)^-1 (e + E) = s e  +  (1 - s D)^-1 s (E + D s e),      s = 1 / (1 - d)

See theory (adding.6, adding.7). Regions own prefixes of one list of nodes, so the diagonal of a rectangular operator
belongs to the nodes both have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...adding import Algebra
from ...errors import UrushiError
from .threads import one_thread


@dataclass(frozen=True)
class Operator:
    """A flux operator.

    Attributes:
        shape: (n_out, n_in), numbers of nodes.
        delta: (C, min(shape)) diagonal part, or None for none.
        dense: (C, M, n_out, n_in) the rest, one matrix per azimuthal order, or None for none; orders it lacks are 0.
            C may be 1 for all colours. All operators that meet begin with the same order.
    """

    shape: tuple[int, int]
    delta: np.ndarray | None = None
    dense: np.ndarray | None = None

    def __add__(self, other: Operator) -> Operator:
        return Operator(self.shape, _sum(self.delta, other.delta), _sum_orders(self.dense, other.dense))

    @one_thread()
    def __matmul__(self, other: Operator) -> Operator:
        shape = self.shape[0], other.shape[1]
        delta = None
        if self.delta is not None and other.delta is not None:
            delta = _fit(_fit(self.delta, self.shape[1]) * _fit(other.delta, self.shape[1]), min(shape))
        dense = _sum_orders(
            _rows(self.delta, other.dense, shape[0]), _columns(self.dense, other.delta, shape[1])
        )
        if self.dense is not None and other.dense is not None:
            orders = min(self.dense.shape[1], other.dense.shape[1])
            dense = _sum_orders(self.dense[:, :orders] @ other.dense[:, :orders], dense)
        return Operator(shape, delta, dense)

    @property
    def orders(self) -> int:
        """How many azimuthal orders the dense part has."""
        return 0 if self.dense is None else self.dense.shape[1]

    def matrix(self, order: int) -> np.ndarray:
        """(C, n_out, n_in) the whole of one order as a plain matrix, the diagonal included."""
        zero = np.zeros((1, *self.shape))
        found = zero if order >= self.orders or self.dense is None else self.dense[:, order]
        if self.delta is None:
            return found + zero
        k = np.arange(min(self.shape))
        diagonal = np.zeros((len(self.delta), *self.shape))
        diagonal[:, k, k] = self.delta
        return found + diagonal

    def albedo(self) -> np.ndarray:
        """(C, n_in) the share of the flux of each node that arrives anywhere."""
        return self.matrix(0).sum(axis=1)


def zero(n_out: int, n_in: int | None = None) -> Operator:
    """The operator that lets nothing through."""
    return Operator((n_out, n_out if n_in is None else n_in))


def identity(n: int) -> Operator:
    """The operator that changes nothing."""
    return Operator((n, n), np.ones((1, n)))


@one_thread()
def bounce(a: Operator, b: Operator, x: Operator) -> Operator:
    """(1 - a b)^-1 x: the light `x` and all that comes of it bouncing between two layers.

    Raises:
        UrushiError: light is let in that nothing ever lets out or absorbs.
    """
    both = a @ b
    if both.delta is None:
        delta, dense = x.delta, x.dense
        scale = None
    else:
        # Light at angles of total reflection on both sides, with nothing in between, stays for ever: none is there.
        trapped = both.delta >= 1
        scale = np.where(trapped, 0, 1 / np.where(trapped, 1, 1 - both.delta))
        _check_empty(trapped, x)
        delta = None if x.delta is None else _fit(scale, len(x.delta[0])) * x.delta
        dense = _rows(scale, x.dense, x.shape[0])
    if both.dense is None:
        return Operator(x.shape, delta, dense)
    orders = both.dense.shape[1]
    matrix = both.dense if scale is None else scale[:, None, :, None] * both.dense
    source = _sum_orders(dense, _columns(matrix, delta, x.shape[1]))
    if source is None:
        return Operator(x.shape, delta, None)
    solved = np.linalg.solve(np.eye(both.shape[0]) - matrix[:, : source.shape[1]], source[:, :orders])
    if source.shape[1] > orders:  # orders that nothing scatters on the way
        rest = source[:, orders:]
        solved = np.concatenate([solved, np.broadcast_to(rest, (len(solved), *rest.shape[1:]))], axis=1)
    return Operator(x.shape, delta, solved)


#: what the adding equations need to work on operators
OPERATORS = Algebra(lambda a, b: a @ b, bounce)


def _check_empty(trapped: np.ndarray, x: Operator) -> None:
    if not trapped.any():
        return
    lit = np.zeros((1, x.shape[0]), bool)  # colour by colour: where one is trapped, others may be scattered
    if x.delta is not None:
        lit = lit | (_fit(x.delta, x.shape[0]) != 0)
    if x.dense is not None:
        lit = lit | (x.dense != 0).any(axis=(1, 3))
    if (trapped & lit).any():
        node = int(np.flatnonzero((trapped & lit).any(axis=0))[0])
        raise UrushiError(
            f"light of node {node} is let in between two layers that both reflect all of it, and none absorbs it; "
            "allowed: reflectances whose product is below 1"
        )


def _sum(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    if a is None or b is None:
        return b if a is None else a
    return a + b


def _sum_orders(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    """The sum of (C, M, ...) arrays that may have different numbers of orders."""
    if a is None or b is None:
        return b if a is None else a
    if a.shape[1] == b.shape[1]:
        return a + b
    if a.shape[1] < b.shape[1]:
        a, b = b, a
    found = np.array(np.broadcast_to(a, (max(len(a), len(b)), *a.shape[1:])))
    found[:, : b.shape[1]] += b
    return found


def _fit(delta: np.ndarray, count: int) -> np.ndarray:
    """A diagonal (C, k) for `count` nodes: cut, or continued by 0."""
    if delta.shape[1] >= count:
        return delta[:, :count]
    return np.concatenate([delta, np.zeros((len(delta), count - delta.shape[1]))], axis=1)


def _rows(delta: np.ndarray | None, dense: np.ndarray | None, count: int) -> np.ndarray | None:
    """The product of a diagonal, of `count` rows, with a dense part."""
    if delta is None or dense is None:
        return None
    n = dense.shape[2]
    found = _fit(delta, n)[:, None, :, None] * dense
    if count <= n:
        return found[:, :, :count]
    return np.concatenate([found, np.zeros((*found.shape[:2], count - n, found.shape[3]))], axis=2)


def _columns(dense: np.ndarray | None, delta: np.ndarray | None, count: int) -> np.ndarray | None:
    """The product of a dense part with a diagonal of `count` columns."""
    if delta is None or dense is None:
        return None
    n = dense.shape[3]
    found = dense * _fit(delta, n)[:, None, None, :]
    if count <= n:
        return found[..., :count]
    return np.concatenate([found, np.zeros((*found.shape[:3], count - n))], axis=3)
