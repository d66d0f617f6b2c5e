"""How light that entered through a rough interface comes back to it from below: tables of `make_lobe_tables`.

A beam enters through an interface, a lossless mirror of some roughness below sends it back, and so on for ever. What
of it gets out, the first time and in the mean over all later ones, depends on the shape of what entered near the
critical angle, which no lobe has. So it is followed here as energies at many cosines, with kernels from samples of
`BoundDielectric`.
"""

from __future__ import annotations

import numpy as np

from make_lobe_tables import FINE, along, lattice, lobe, spread_over

#: samples for each cosine
SAMPLES = 4181
#: what is taken to be left from one later visit to the next, for two means over all later visits
KEPT = (0.5, 0.9)
#: the same, for the mean cosine of what comes back down
KEPT_DOWN = 0.8


def sent(cos: np.ndarray, alpha: float, eta: float, transmit: bool) -> np.ndarray:
    """(N, FINE): where light from each cosine goes; rows sum to reflectance or transmittance.

    Args:
        cos: (N,) of incidence on the side where the index ratio is eta.
        alpha: roughness; 0 for a smooth interface.
        eta: index beyond over index before.
        transmit: what is transmitted, at nodes for light that comes back up through the interface; else what is
            reflected, at nodes for light on this side.
    """
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.fresnel import fresnel_dielectric
    from urushi.optics.microfacet import Microfacets

    there = 1 / eta if transmit else eta
    if alpha == 0:
        r, below = (np.array(x) for x in fresnel_dielectric(Float64(cos), Float64(eta), Float64(1 / eta)))
        out, energy = (below, 1 - r) if transmit else (cos, r)
        return spread_over(along(out, there)[:, None], energy[:, None], FINE)
    u1, u2 = lattice(SAMPLES)
    c = np.repeat(cos, len(u1))
    w = Array3f64(np.sqrt((1 - c) * (1 + c)), 0 * c, c)
    facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
    interface = BoundDielectric(Float64(eta), facets, False, Frame(0.0))
    u = (0.5, Float64(np.tile(u1, len(cos))), Float64(np.tile(u2, len(cos))))
    found = interface.sample(w, u, True, "transmit" if transmit else "reflect")
    out, weight = np.array(found.o.z), np.array(found.weight)
    right = out < 0 if transmit else out > 0
    shape = len(cos), len(u1)
    out = np.maximum(np.abs(out), 1e-6).reshape(shape)
    weight = np.where(right & np.isfinite(weight), weight, 0).reshape(shape) / len(u1)
    return spread_over(along(out, there), weight, FINE)


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
        entered = sent(cos, float(alpha), eta, True)
        energy = entered.sum(axis=1)
        for i in reversed(
            range(len(cos) - 1)
        ):  # nothing to follow where all is reflected: as the next one has it
            entered[i] = entered[i] if energy[i] > 1e-9 else entered[i + 1]
        entered /= entered.sum(axis=1, keepdims=True)
        back = sent(inside, float(alpha), 1 / eta, False)
        r, t = back.sum(axis=1), sent(inside, float(alpha), 1 / eta, True).sum(axis=1)
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
