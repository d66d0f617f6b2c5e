"""Reciprocity and energy of an interface's matrices, made exact.

Etendue W times a matrix is symmetric for light that may go either way, A[o, i] W_i = A*[i, o] W_o, with A* what
carries light back. Columns computed one by one have that up to what the nodes do not resolve. Of the two values of
each exchange, the one that was computed as a share of less light is the surer: they are averaged with weights W^2 of
the other end. Then every node gets a factor, near 1, that makes the columns of reflection and transmission together
add up to what they should (as Sinkhorn's scaling does, here by Newton's method); reciprocity survives that (theory
(basis.15)).
"""

from __future__ import annotations

import numpy as np

from ...adding import Slab
from ...errors import UrushiError

#: directions of factors that change next to nothing, relative to the strongest
WEAK = 0.03


def reciprocal(there: np.ndarray, back: np.ndarray, w_out: np.ndarray, w_in: np.ndarray) -> np.ndarray:
    """A matrix made reciprocal.

    Args:
        there: (..., n_out, n_in).
        back: (..., n_in, n_out) the same exchanges the other way.
        w_out, w_in: etendue of the nodes.
    """
    returned = np.swapaxes(back, -1, -2) * (w_out[:, None] / w_in)
    sure, unsure = w_out[:, None] ** 2, w_in**2
    return (there * sure + returned * unsure) / (sure + unsure)


def all_reciprocal(slab: Slab, w_above: np.ndarray, w_below: np.ndarray) -> Slab:
    """The four matrices (..., n_out, n_in) of an interface, exactly reciprocal."""
    down = reciprocal(slab.t_down, slab.t_up, w_below, w_above)
    return Slab(
        _mirror(slab.r_top, w_above),
        down,
        _mirror(slab.r_bottom, w_below),
        np.swapaxes(down, -1, -2) * (w_above[:, None] / w_below),
    )


def _mirror(r: np.ndarray, w: np.ndarray) -> np.ndarray:
    return reciprocal(r, r, w, w)


def scales(matrix: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """(C, n) factors d such that the columns of d_o A[o, i] d_i add up to `sums`.

    An interface that reflects next to nothing only exchanges light between both sides. Then all factors above may grow
    as those below shrink, and what the nodes make both sides send and receive has to agree, which it does to their
    accuracy only: such directions are left out, and the sums are met up to that.

    Args:
        matrix: (C, n, n) order 0 of a whole interface: nodes above, then nodes below.
        sums: (C, n).

    Raises:
        UrushiError: the nodes are too few for the sums to come near.
    """
    short = np.abs(sums - matrix.sum(1)).max()
    for cut, left in ((0.0, 1e-9), (WEAK, 0.5 * short)):
        d, missing = _scaled(matrix, sums, cut)
        if np.abs(missing).max() < left and d.min() > 0.5 and d.max() < 2:
            return d
    raise UrushiError(
        f"interface: its matrices on {matrix.shape[1]} nodes miss {short:.2g} of the light; "
        "allowed: nodes close enough together that a factor between 0.5 and 2 puts that right"
    )


def _scaled(matrix: np.ndarray, sums: np.ndarray, cut: float) -> tuple[np.ndarray, np.ndarray]:
    """The factors by Newton's method, and what is missing; directions weaker than `cut` of the strongest left out."""
    n = np.arange(sums.shape[1])
    d = np.ones(sums.shape)
    missing = sums - matrix.sum(1)
    for _ in range(30):
        # A channel that is black needs nothing, and has no inverse.
        left = np.abs(missing).max(axis=1) >= 1e-13
        if not left.any():
            break
        slope = np.swapaxes(matrix[left], 1, 2) * d[left, :, None]
        slope[:, n, n] += np.einsum("co,coi->ci", d, matrix)[left]
        try:
            if cut:
                step = np.linalg.pinv(slope, rcond=cut) @ missing[left][..., None]
            else:
                step = np.linalg.solve(slope, missing[left][..., None])
        except np.linalg.LinAlgError:
            break
        d[left] += step[..., 0]
        missing = sums - np.einsum("co,coi->ci", d, matrix) * d
        if cut and np.abs(step).max() < 1e-3:
            break
    return d, missing
