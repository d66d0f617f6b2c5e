"""Sums of order 0, which are energies: rounding takes from them, and this gives it back.

Rounded values X of a block are off by half a step each at most, their sums over the etendue W of the nodes by less than
half of those of the steps. What is missing is stored, as a 16-bit share of that, and

    X[o, i] + (b_o + a_i) step[o, i]

has the true sums again, with b and a of a fraction of one. Where X is symmetric, b is a. The sums are linear in both:
with what is missing on the right, they are the solution of a system whose matrix is symmetric and has no negative
eigenvalue.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: what all steps of a sum together count
WHOLE = 65535
#: what nodes may have of the most that any has, and count as dark
DARK = 1e-12


def missing(
    off: np.ndarray, step: np.ndarray, w_out: np.ndarray, w_in: np.ndarray, symmetric: bool
) -> list[np.ndarray]:
    """What rounding took from the sums, as 16-bit shares of those of the steps.

    Args:
        off: (C, n_out, n_in) true values less rounded ones, up to half a step.
        step: (C, n_out, n_in).
        w_out, w_in: etendue of the nodes.
        symmetric: whether both are.

    Returns:
        of the columns (C, n_in) and, unless symmetric, of the rows (C, n_out).
    """
    pairs = [(w_out @ off, w_out @ step), (off @ w_in, step @ w_in)]
    shares = [one / np.where(all_ > 0, all_, 1) for one, all_ in pairs[: 1 if symmetric else 2]]
    return [np.clip(np.rint(WHOLE * share), -32767, 32767).astype("<i2") for share in shares]


def given_back(
    x: np.ndarray, step: np.ndarray, taken: Sequence[np.ndarray], w_out: np.ndarray, w_in: np.ndarray
) -> np.ndarray:
    """Rounded values with the sums that they should have.

    Args:
        x, step: (C, n_out, n_in) rounded values, and their steps.
        taken: what is `missing`: one array where X is symmetric.
        w_out, w_in: etendue of the nodes.

    Returns:
        (C, n_out, n_in).
    """
    symmetric = len(taken) == 1
    shared = w_out[:, None] * step * w_in  # etendue at both ends
    columns, rows = shared.sum(axis=1), shared.sum(axis=2)
    n_out, n_in = step.shape[1:]
    right = taken[0] * (columns / WHOLE)  # of flux from all of a node's etendue
    if symmetric:
        matrix = shared + columns[:, :, None] * np.eye(n_in)
    else:
        right = np.concatenate([right, taken[1] * (rows / WHOLE)], axis=1)
        matrix = np.zeros((len(step), n_in + n_out, n_in + n_out))
        matrix[:, :n_in, n_in:], matrix[:, n_in:, :n_in] = shared.swapaxes(1, 2), shared
        both = np.concatenate([columns, rows], axis=1)
        matrix += both[:, :, None] * np.eye(n_in + n_out)
        # More of a and as much less of b is nothing: of all solutions the one without. And what columns and rows add up
        # to differs by the rounding of their shares, which is spread like etendue.
        sign, spread = np.append(np.ones(n_in), -np.ones(n_out)), np.append(w_in, -w_out)
        matrix += (both.sum(axis=1) / np.abs(spread).sum())[:, None, None] * (spread[:, None] * sign)
    # Nodes without any light, or hardly any, as those that graze behind a medium, have an equation without a term.
    sums = columns if symmetric else both
    each = sums / (w_in if symmetric else np.concatenate([w_in, w_out]))
    dark = np.where(each > DARK * each.max(axis=1, keepdims=True), 0.0, 1.0)
    share = np.linalg.solve(matrix + dark[:, :, None] * np.eye(dark.shape[1]), right[..., None])[..., 0]
    a, b = share[:, :n_in], share if symmetric else share[:, n_in:]
    found: np.ndarray = x + (b[:, :, None] + a[:, None, :]) * step
    return found
