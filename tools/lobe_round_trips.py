"""How light that entered through a rough interface comes back to it from below: tables of `make_lobe_tables`.

A beam enters through an interface, a lossless mirror of some roughness below sends it back, and so on for ever. What
of it gets out, the first time and in the mean over all later ones, depends on the shape of what entered near the
critical angle, which no lobe has. So it is followed here as energies at many cosines, with kernels from samples of
`BoundDielectric`.
"""

from __future__ import annotations

import numpy as np

from make_lobe_tables import FINE, along, lobe, sent, spread_over

#: samples for each cosine
SAMPLES = 4181
#: what is taken to be left from one later visit to the next, for two means over all later visits
KEPT = (0.5, 0.9)
#: the same, for the mean cosine of what comes back down
KEPT_DOWN = 0.8


def spread(cos: np.ndarray, alpha: float, eta: float, transmit: bool) -> np.ndarray:
    """(N, FINE): where light from each cosine goes; rows sum to reflectance or transmittance.

    Args:
        cos: (N,) of incidence on the side where the index ratio is eta.
        alpha: roughness; 0 for a smooth interface.
        eta: index beyond over index before.
        transmit: what is transmitted, at nodes for light that comes back up through the interface; else what is
            reflected, at nodes for light on this side.
    """
    out, weight = sent(cos, alpha, eta, transmit, SAMPLES)
    place = along(np.maximum(out, 1e-6), 1 / eta if transmit else eta)
    return spread_over(place, weight / weight.shape[1], FINE)


def round_trips(eta: float, alphas: np.ndarray, widths: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """(A, W, N, 7): what happens to what entered through the interface, each time it comes back from below.

    Args:
        eta: index below over index above.
        alphas, widths: roughnesses of the interface, and of the mirror below.
        cos: (N,) of the light that enters.

    Returns:
        reflectance and transmittance at the first return, both in the mean over all later ones if `KEPT` of the light
        is left from one to the next, and the mean cosine of the light on its way back down.
    """
    from urushi.solvers.lobes import axes

    inside = axes.cosines(1 / eta, FINE)
    mirrors = []
    for width in widths:
        o, weight = lobe(inside, float(width))
        mirrors.append(spread_over(along(o, 1 / eta), weight, FINE))
    table = np.zeros((len(alphas), len(widths), len(cos), 7))
    for a, alpha in enumerate(alphas):
        entered = spread(cos, float(alpha), eta, True)
        energy = entered.sum(axis=1)
        for i in reversed(
            range(len(cos) - 1)
        ):  # nothing to follow where all is reflected: as the next one has it
            entered[i] = entered[i] if energy[i] > 1e-9 else entered[i + 1]
        entered /= entered.sum(axis=1, keepdims=True)
        back = spread(inside, float(alpha), 1 / eta, False)
        r, t = back.sum(axis=1), spread(inside, float(alpha), 1 / eta, True).sum(axis=1)
        for b, mirror in enumerate(mirrors):
            up = entered @ mirror
            down = up @ back
            r1, t1 = up @ r, up @ t
            down = (
                np.where(r1[:, None] > 1e-7, down, up)
                / np.maximum(np.where(r1 > 1e-7, r1, 1), 1e-12)[:, None]
            )
            means = []
            for kept in (*KEPT, KEPT_DOWN):
                trip = kept * (back @ mirror)
                visits = np.linalg.solve(np.eye(FINE) - trip.T, (down @ mirror).T).T
                number = visits.sum(axis=1)
                means += [(1 - 1 / number) / kept, visits @ t / number]
            all_down = down + KEPT_DOWN * (visits @ back)
            c2 = all_down @ inside / all_down.sum(axis=1)
            table[a, b] = np.stack([r1, t1, *means[:4], c2], axis=1)
    return table


def tables() -> np.ndarray:
    """(2, INDICES, ROUGHNESSES, WIDTHS, ENTRIES, 8): `round_trips`, and `lobe_widths` from the thinner side."""
    import lobe_widths
    from urushi.solvers.lobes import axes

    alphas, widths = axes.squares(axes.ROUGHNESSES), axes.squares(axes.WIDTHS)
    found = []
    for side in (0, 1):
        for ratio in axes.ratios():
            eta = float(ratio if side == 0 else 1 / ratio)
            found.append(round_trips(eta, alphas, widths, axes.cosines(eta, axes.ENTRIES)))
            print("round trips", eta, flush=True)
    table = np.stack(found).reshape(2, axes.INDICES, *found[0].shape)
    too_wide = np.ones((*table.shape[:-1], 1))
    too_wide[0, ..., 0] = lobe_widths.table(axes.cosines(2.0, axes.ENTRIES))
    return np.concatenate([table, too_wide], axis=-1)
