"""What layers make of diffuse light, moment by moment (`urushi.solvers.lobes.moments`): tables of `make_lobe_tables`.

A polynomial of the cosine is the light that comes; what of it is reflected and transmitted is counted by samples of
`BoundDielectric` and of the facets of `Microfacets`, or by solutions of the transfer equation, and told by its moments.
"""

from __future__ import annotations

import numpy as np

from make_lobe_tables import hats, lattice

#: samples for each cosine, and cosines on either side of the critical angle
SAMPLES, NODES = 1597, 20


def cosines(eta: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's nodes and weights over (0, 1), with a break at the critical angle, crowded around it."""
    x, weight = np.polynomial.legendre.leggauss(NODES)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    critical = np.sqrt(max(1 - eta**2, 0)) if eta < 1 else 0.5
    above = critical + (1 - critical) * x**2, (1 - critical) * 2 * x * weight
    below = critical * (1 - x**2), critical * 2 * x * weight
    return np.concatenate([below[0], above[0]]), np.concatenate([below[1], above[1]])


def told(cos: np.ndarray, weight: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """(9,): moments (N, 3) of what leaves, by cosine of incidence, summed over each of the polynomials."""
    from urushi.solvers.lobes.moments import polynomials

    return np.asarray(np.einsum("np,jn,n->pj", moments, np.stack(polynomials(cos)), weight).ravel())


def counted(out: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N, 3) moments of samples (N, S) with weights."""
    from urushi.solvers.lobes.moments import polynomials

    return np.stack([(p * weight).mean(axis=1) for p in polynomials(out)], axis=1)


def dielectric(eta: float, alpha: float) -> np.ndarray:
    """(18,): moments of what a dielectric reflects, then of what it transmits, of each polynomial.

    Args:
        eta: index beyond over index before.
        alpha: roughness of GGX; 0 for a smooth interface.
    """
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.fresnel import fresnel_dielectric
    from urushi.optics.microfacet import Microfacets

    cos, weight = cosines(eta)
    if alpha == 0:
        r, below = (
            np.array(x)[:, None] for x in fresnel_dielectric(Float64(cos), Float64(eta), Float64(1 / eta))
        )
        sent = [counted(cos[:, None], r), counted(below, 1 - r)]
        return np.concatenate([told(cos, weight, moments) for moments in sent])
    u1, u2 = lattice(SAMPLES)
    c = np.repeat(cos, len(u1))
    w = Array3f64(np.sqrt((1 - c) * (1 + c)), 0 * c, c)
    facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
    interface = BoundDielectric(Float64(eta), facets, False, Frame(0.0))
    u = (0.5, Float64(np.tile(u1, len(cos))), Float64(np.tile(u2, len(cos))))
    found = []
    for lobe, sign in (("reflect", 1), ("transmit", -1)):
        sample = interface.sample(w, u, True, lobe)
        out, energy = sign * np.array(sample.o.z), np.array(sample.weight)
        energy = np.where((out > 0) & np.isfinite(energy), energy, 0)
        shape = len(cos), len(u1)
        found.append(told(cos, weight, counted(np.abs(out).reshape(shape), energy.reshape(shape))))
    return np.concatenate(found)


def metal(alpha: float) -> np.ndarray:
    """(9 NODES of `make_lobe_tables.metal`,): weights of the reflectance at its cosines, moment by moment."""
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect

    cos, weight = cosines(2.0)
    if alpha == 0:
        sent = hats(cos)[:, :, None] * counted(cos[:, None], np.ones((len(cos), 1)))
    else:
        u1, u2 = lattice(SAMPLES)
        c = np.repeat(cos, len(u1))
        w = Array3f64(np.sqrt((1 - c) * (1 + c)), 0 * c, c)
        facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
        m = facets.sample(w, Float64(np.tile(u1, len(cos))), Float64(np.tile(u2, len(cos))))
        o = reflect(w, m)
        out = np.abs(np.array(o.z))
        kept = np.array(facets.masked(w, Array3f64(o.x, o.y, out), facets.sigma(w)))
        kept = np.where(np.array(o.z) > 0, kept, 0)
        shape = len(cos), len(u1)
        each = hats(np.clip(np.array(m.x * w.x + m.y * w.y + m.z * w.z), 0, 1)) * kept
        sent = np.stack([counted(out.reshape(shape), e.reshape(shape)) for e in each])
    return np.concatenate([told(cos, weight, moments) for moments in sent])


def tables() -> dict[str, np.ndarray]:
    """ "dielectric": (2, INDICES, ROUGHNESSES, 18), the side first; "metal": (ROUGHNESSES, 45)."""
    from urushi.solvers.lobes import axes

    alphas = axes.squares(axes.ROUGHNESSES)
    found = []
    for side in (0, 1):
        for ratio in axes.ratios():
            eta = float(ratio if side == 0 else 1 / ratio)
            found.append([dielectric(eta, float(alpha)) for alpha in alphas])
        print("mixing", side, flush=True)
    shape = 2, axes.INDICES, axes.ROUGHNESSES, -1
    return {"dielectric": np.reshape(found, shape), "metal": np.stack([metal(float(a)) for a in alphas])}


def slabs(some_g: range | None = None, some_albedos: range | None = None) -> dict[str, np.ndarray]:
    """What Henyey-Greenstein slabs scatter up, and what they scatter down, from solutions of the transfer equation.

    Args:
        some_g, some_albedos: which of `medium.nodes`; None for all.

    Returns:
        "slab": (*`medium.nodes`, 6), moments of either for a beam;
        "shapes": without the cosine, 18 channels, as `dielectric` has them.
    """
    from urushi.solvers.adding.basis import Grid
    from urushi.solvers.adding.media import Scattering, slab
    from urushi.solvers.adding.phase import HenyeyGreenstein, resolved
    from urushi.solvers.lobes import medium
    from urushi.solvers.lobes.moments import polynomials

    grid = Grid.build([1.0], 40)
    mu = np.sqrt(1 - grid.s**2)
    weights = grid.etendue / mu
    order, legendre = np.argsort(mu), np.stack(polynomials(mu))
    gs, albedos, depths, cos = medium.nodes()
    gs = gs if some_g is None else gs[some_g]
    albedos = albedos if some_albedos is None else albedos[some_albedos]
    shape = len(gs), len(albedos), len(depths)
    found, shapes = np.zeros((*shape, len(cos), 6)), np.zeros((*shape, 18))
    for i, g in enumerate(gs):
        phase, count = HenyeyGreenstein(g), resolved(mu, weights)
        # A sharp peak is taken as light that goes straight on (delta-M), and counted as scattered below.
        share = float(max(g, 0) ** count)
        moments = (phase.moments(count) - share) / (1 - share)
        scattering = Scattering.build(mu, weights, moments, range(1))
        for j, a in enumerate(albedos):
            for k, tau in enumerate(depths):
                scaled = np.array([tau * (1 - a * share)])
                solved = slab(scattering, scaled, np.array([a * (1 - share) / (1 - a * share)]))
                r, t = (op.matrix(0)[0] for op in (solved.r_top, solved.t_down))
                both = np.concatenate([legendre @ r, legendre @ (t - np.diag(np.exp(-tau / mu)))])
                found[i, j, k] = np.stack([np.interp(cos, mu[order], row[order]) for row in both], axis=1)
                shapes[i, j, k] = (both @ (legendre * weights).T).ravel()
        print("slab", g, flush=True)
    return {"slab": found, "shapes": shapes}
