"""What goes back and forth in a sheet of rough glass: a table of `make_lobe_tables`.

What entered through one rough interface meets another like it, with the same index beyond. How much of it that reflects
totally hangs on the shape of the light near the critical angle, as in `lobe_round_trips`, and is followed likewise.
"""

from __future__ import annotations

import numpy as np

from lobe_round_trips import spread
from make_lobe_tables import FINE


def sheet(eta: float, alphas: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """(A, A, N, 8): for the roughness of the interface that light enters through, that of the other, and the cosine.

    Args:
        eta: index within over index around.
        alphas: roughnesses.
        cos: (N,) of the light that enters.

    Returns:
        reflectance and transmittance of the other interface, the first time and in the mean over all later ones; the
        same of the first interface, for what comes back to it.
    """
    from urushi.solvers.lobes import axes

    inside = axes.cosines(1 / eta, FINE)
    entered = [spread(cos, float(alpha), eta, True) for alpha in alphas]
    entered = [light / light.sum(axis=1, keepdims=True) for light in entered]
    back = [spread(inside, float(alpha), 1 / eta, False) for alpha in alphas]
    out = [spread(inside, float(alpha), 1 / eta, True).sum(axis=1) for alpha in alphas]
    table = np.zeros((len(alphas), len(alphas), len(cos), 8))
    for a, light in enumerate(entered):
        for b in range(len(alphas)):
            up = light @ back[b]
            r, t = up.sum(axis=1), light @ out[b]
            up /= np.maximum(r, 1e-9)[:, None]
            down = up @ back[a]
            back_r, back_t = down.sum(axis=1), up @ out[a]
            down /= np.maximum(back_r, 1e-9)[:, None]
            trip = 0.9999 * (back[b] @ back[a])
            visits = np.linalg.solve(np.eye(FINE) - trip.T, down.T).T  # all that comes down later
            again = visits @ back[b]
            number, other = visits.sum(axis=1), again.sum(axis=1)
            later = [other / number, visits @ out[b] / number, (number - 1) / other, again @ out[a] / other]
            table[a, b] = np.stack([r, t, *later[:2], back_r, back_t, *later[2:]], axis=1)
    return table


def tables() -> np.ndarray:
    """(SHEETS, WIDTHS, WIDTHS, SHEET_COSINES, 8), along the axes of index ratios, roughnesses and cosines."""
    from urushi.solvers.lobes import axes

    alphas = axes.squares(axes.WIDTHS)
    found = []
    for ratio in axes.ratios(axes.SHEETS):
        found.append(sheet(float(ratio), alphas, axes.cosines(2.0, axes.SHEET_COSINES)))
        print("sheet", ratio, flush=True)
    return np.stack(found)
