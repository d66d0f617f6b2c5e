"""What layers make of diffuse light, moment by moment (`urushi.solvers.lobes.moments`): tables of `make_lobe_tables`.

A polynomial of the cosine is the light that comes; what of it is reflected and transmitted is counted by samples of
`BoundDielectric` and of the facets of `Microfacets`, or by solutions of the transfer equation, and told by its moments.
"""

from __future__ import annotations

import numpy as np

from make_lobe_tables import FINE, along, beams, hats, lobe, sent, spread_over

#: samples for each cosine, and cosines on either side of the critical angle
SAMPLES, NODES = 1597, 20
#: depth that stands for 0
THIN = 1e-4


def cosines(eta: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's nodes and weights over (0, 1), with a break at the critical angle, crowded around it."""
    x, weight = np.polynomial.legendre.leggauss(NODES)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    critical = np.sqrt(max(1 - eta**2, 0)) if eta < 1 else 0.5
    above = critical + (1 - critical) * x**2, (1 - critical) * 2 * x * weight
    below = critical * (1 - x**2), critical * 2 * x * weight
    return np.concatenate([below[0], above[0]]), np.concatenate([below[1], above[1]])


def told(cos: np.ndarray, weight: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """(COUNT^2,): moments (N, COUNT) of what leaves, by cosine of incidence, summed over each of the polynomials."""
    from urushi.solvers.lobes.moments import polynomials

    return np.asarray(np.einsum("np,jn,n->pj", moments, np.stack(polynomials(cos)), weight).ravel())


def counted(out: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N, COUNT) moments of samples (N, S) with weights."""
    from urushi.solvers.lobes.moments import polynomials

    return np.stack([(p * weight).mean(axis=1) for p in polynomials(out)], axis=1)


def dielectric(eta: float, alpha: float) -> np.ndarray:
    """(2 COUNT^2,): moments of what a dielectric reflects, then of what it transmits, of each polynomial.

    Args:
        eta: index beyond over index before.
        alpha: roughness of GGX; 0 for a smooth interface.
    """
    cos, weight = cosines(eta)
    both = [counted(*sent(cos, alpha, eta, transmit, SAMPLES)) for transmit in (False, True)]
    return np.concatenate([told(cos, weight, moments) for moments in both])


def metal(alpha: float) -> np.ndarray:
    """(COUNT^2 NODES of `make_lobe_tables.metal`,): weights of the reflectance at its cosines, moment by moment."""
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect

    cos, weight = cosines(2.0)
    if alpha == 0:
        found = hats(cos)[:, :, None] * counted(cos[:, None], np.ones((len(cos), 1)))
    else:
        w, u = beams(cos, SAMPLES)
        facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
        m = facets.sample(w, *u)
        o = reflect(w, m)
        out = np.abs(np.array(o.z))
        kept = np.array(facets.masked(w, Array3f64(o.x, o.y, out), facets.sigma(w)))
        kept = np.where(np.array(o.z) > 0, kept, 0)
        shape = len(cos), -1
        each = hats(np.clip(np.array(m.x * w.x + m.y * w.y + m.z * w.z), 0, 1)) * kept
        found = np.stack([counted(out.reshape(shape), e.reshape(shape)) for e in each])
    return np.concatenate([told(cos, weight, moments) for moments in found])


def tables() -> dict[str, np.ndarray]:
    """ "dielectric": (2, INDICES, ROUGHNESSES, 2 COUNT^2), the side first; "metal": (ROUGHNESSES, ...);
    "backs": (2, BACK_INDICES, BACK_ROUGHNESSES, BACK_WIDTHS, BACK_ENTRIES, COUNT - 1)."""
    from urushi.solvers.lobes import axes

    alphas = axes.squares(axes.ROUGHNESSES)
    found = []
    for side in (0, 1):
        for ratio in axes.ratios():
            eta = float(ratio if side == 0 else 1 / ratio)
            found.append([dielectric(eta, float(alpha)) for alpha in alphas])
        print("mixing", side, flush=True)
    shape = 2, axes.INDICES, axes.ROUGHNESSES, -1
    made = {"dielectric": np.reshape(found, shape), "metal": np.stack([metal(float(a)) for a in alphas])}
    return made | {"backs": backs()}


def backs() -> np.ndarray:
    """Moments, over the first, of what entered through an interface and is sent back down by it the first time."""
    from urushi.solvers.lobes import axes

    alphas, widths = axes.squares(axes.BACK_ROUGHNESSES), axes.squares(axes.BACK_WIDTHS)
    found = []
    for side in (0, 1):
        for ratio in axes.ratios(axes.BACK_INDICES):
            eta = float(ratio if side == 0 else 1 / ratio)
            found.append(back(eta, alphas, widths, axes.cosines(eta, axes.BACK_ENTRIES)))
        print("backs", side, flush=True)
    return np.reshape(found, (2, axes.BACK_INDICES, *found[0].shape))


def back(eta: float, alphas: np.ndarray, widths: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """(A, W, N, COUNT - 1): `backs` for an index below over index above, roughnesses of the interface and of the mirror
    below, and cosines of the light that enters."""
    from lobe_round_trips import spread
    from urushi.solvers.lobes import axes
    from urushi.solvers.lobes.moments import COUNT, polynomials

    inside = axes.cosines(1 / eta, FINE)
    legendre = np.stack(polynomials(inside)[1:])
    found = np.zeros((len(alphas), len(widths), len(cos), COUNT - 1))
    for a, alpha in enumerate(alphas):
        entered = spread(cos, float(alpha), eta, True)
        for i in reversed(range(len(cos) - 1)):  # as the next one has it, where all is reflected
            entered[i] = entered[i] if entered[i].sum() > 1e-9 else entered[i + 1]
        down = spread(inside, float(alpha), 1 / eta, False)
        for b, width in enumerate(widths):
            o, weight = lobe(inside, float(width))
            light = entered @ spread_over(along(o, 1 / eta), weight, FINE) @ down
            energy = light.sum(axis=1, keepdims=True)
            sharp = legendre[:, -1] + 0 * energy  # nothing is reflected: any direction does
            found[a, b] = np.where(energy > 1e-9, light @ legendre.T / np.maximum(energy, 1e-9), sharp)
    return found


def slabs(some_g: range | None = None, some_albedos: range | None = None) -> dict[str, np.ndarray]:
    """What Henyey-Greenstein slabs scatter up, and scatter or let down, from solutions of the transfer equation.

    Args:
        some_g, some_albedos: which of `medium.nodes`; None for all.

    Returns:
        "slab": (*`medium.nodes`, 2 COUNT), moments of either for a beam, over what meets a particle;
        "shapes": without the cosine, 2 COUNT^2 channels, as `dielectric` has them, with what is not scattered.
    """
    from urushi.solvers.adding.basis import Grid
    from urushi.solvers.adding.media import Scattering, slab
    from urushi.solvers.adding.phase import HenyeyGreenstein, resolved
    from urushi.solvers.lobes import medium
    from urushi.solvers.lobes.moments import COUNT, polynomials

    grid = Grid.build([1.0], 40)
    mu = np.sqrt(1 - grid.s**2)
    weights = grid.etendue / mu
    order, legendre = np.argsort(mu), np.stack(polynomials(mu))
    gs, albedos, depths, cos = medium.nodes()
    gs = gs if some_g is None else gs[some_g]
    albedos = albedos if some_albedos is None else albedos[some_albedos]
    shape = len(gs), len(albedos), len(depths)
    found, shapes = np.zeros((*shape, len(cos), 2 * COUNT)), np.zeros((*shape, 2 * COUNT**2))
    for i, g in enumerate(gs):
        phase, count = HenyeyGreenstein(g), resolved(mu, weights)
        # A sharp peak is taken as light that goes straight on (delta-M), and counted as scattered below.
        share = float(max(g, 0) ** count)
        moments = (phase.moments(count) - share) / (1 - share)
        scattering = Scattering.build(mu, weights, moments, range(1))
        for j, a in enumerate(albedos):
            for k, tau in enumerate(np.maximum(depths, THIN)):
                scaled = np.array([tau * (1 - a * share)])
                solved = slab(scattering, scaled, np.array([a * (1 - share) / (1 - a * share)]))
                r, t = (op.matrix(0)[0] for op in (solved.r_top, solved.t_down))
                met = -np.expm1(-tau / mu)
                both = np.concatenate([legendre @ r, legendre @ (t - np.diag(1 - met))]) / met
                found[i, j, k] = np.stack([np.interp(cos, mu[order], row[order]) for row in both], axis=1)
                both = np.concatenate([legendre @ r, legendre @ t])
                shapes[i, j, k] = (both @ (legendre * weights).T).ravel()
        print("slab", g, flush=True)
    return {"slab": found, "shapes": shapes}
