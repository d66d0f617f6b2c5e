"""How wide the light is that gets through a rough interface, and where its middle is: a table of `make_lobe_tables`.

First-order derivatives of refraction stretch a lobe in the plane of incidence and across it alike, beyond the horizon
if need be. What really gets through is bounded by it, and narrower in the plane than across. So it is counted: light
that is a lobe of a mirror goes through the interface, and among the lobes of mirrors with a roughness in the plane of
incidence and one across it, around any direction in that plane, that one is taken under which what got through is
most likely (the least divergence of Kullback and Leibler). Its tails are longer and its core is narrower than those of
what is fitted, so it is made a little wider, by as much as makes the widths of glass sheets right (`wider`).
"""

from __future__ import annotations

import numpy as np

#: samples for each place
SAMPLES = 1597
#: roughnesses below this are taken as this, and ratios of indices nearer to 1 likewise
SMALL, NEAR = 0.01, 1.05
#: rounds of the search, and its first step
ROUNDS, STEP = 16, 0.25
#: what a shift may be at most, in first-order roughnesses; and the logarithm of a ratio at least and at most
SHIFT, LOW, HIGH = 1.9, -3.0, 0.6

#: the largest number that the file holds
LARGEST = 1.999


def light(eta: float, alpha: np.ndarray, width: np.ndarray, cos: np.ndarray) -> tuple:
    """Directions (N SAMPLES,) of what gets through, mirrored to z > 0, and its weights, N after N."""
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect

    steps = np.arange(SAMPLES)[:, None] + 0.5
    base = 1.1673039782614187  # the positive root of x^5 = x + 1: an even sequence in four dimensions
    u = np.mod(0.5 + steps * base ** -np.arange(1.0, 5.0), 1)
    u = [Float64(np.tile(u[:, k], len(cos))) for k in range(4)]
    alpha, width, cos = (np.repeat(x, SAMPLES) for x in (alpha, width, cos))
    w = Array3f64(-np.sqrt((1 - cos) * (1 + cos)), 0 * cos, cos)
    mirror = Microfacets(Float64(width), Float64(width), "ggx", "correlated")
    o = reflect(w, mirror.sample(w, u[0], u[1]))
    up = Array3f64(o.x, o.y, dr.maximum(dr.abs(o.z), 1e-6))
    kept = dr.select(o.z > 0, mirror.masked(w, up, mirror.sigma(w)), 0)
    facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
    through = BoundDielectric(Float64(eta), facets, False, Frame(0.0)).sample(
        up, (0.5, u[2], u[3]), True, "transmit"
    )
    kept = dr.select(through.o.z < -1e-6, kept * through.weight, 0)
    return Array3f64(through.o.x, through.o.y, dr.maximum(-through.o.z, 1e-6)), kept


def places(eta: float, thin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosines before and beyond of a boundary, for its cosines in the thinner medium."""
    n = max(eta, 1 / eta)
    dense = np.sqrt(1 - (1 - thin**2) / n**2)
    return (thin, dense) if eta > 1 else (dense, thin)


def first_order(
    eta: float, alpha: np.ndarray, width: np.ndarray, cos: np.ndarray, beyond: np.ndarray
) -> np.ndarray:
    """The roughness that derivatives give, 1 at most."""
    from urushi.solvers.lobes.width import OURS

    ratio, p = cos / (eta * beyond), OURS.power
    sum_ = (width * ratio) ** p + (0.5 * alpha * np.abs(1 - ratio)) ** p
    return np.asarray(np.minimum(sum_ ** (1 / p), 1))


def exits(eta: float, alphas: np.ndarray, widths: np.ndarray, thin: np.ndarray) -> np.ndarray:
    """(A, W, N, 3): roughness in the plane of incidence and across it over that of first order, and by what angle the
    middle is farther from the normal than Snell's law says, over the same.

    Args:
        eta: index beyond over index before.
        alphas, widths: roughness of the interface, and of the light that meets it.
        thin: (N,) cosines of the light's middle in the thinner medium, ascending; the last is 1.
    """
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64, UInt32

    from urushi.interfaces.base import Frame
    from urushi.solvers.lobes.lobe import Lobe

    alphas, widths = np.maximum(alphas, SMALL), np.maximum(widths, SMALL)
    before, after = places(eta, thin)
    alpha, width, cos = (
        np.broadcast_to(x, (len(alphas), len(widths), len(thin))).ravel()
        for x in (alphas[:, None, None], widths[None, :, None], before[None, None])
    )
    beyond = np.broadcast_to(after, (len(alphas), len(widths), len(thin))).ravel()
    o, weight = light(eta, alpha, width, cos)
    first = first_order(eta, alpha, width, cos, beyond)
    angle = np.arccos(beyond)
    cell = dr.arange(UInt32, len(cos) * SAMPLES) // SAMPLES
    whole = np.maximum(np.array(dr.block_sum(weight, SAMPLES)), 1e-12)

    def likely(p: np.ndarray) -> np.ndarray:
        turned = np.clip(angle + p[2] * first, -1.55, 1.55)
        lanes = [
            dr.gather(Float64, Float64(x), cell)
            for x in (first * np.exp(p[0]), first * np.exp(p[1]), np.sin(turned), np.cos(turned))
        ]
        axis = Array3f64(lanes[2], 0 * lanes[2], lanes[3])
        lobe = Lobe(1.0, axis, *(dr.minimum(x, 1) for x in lanes[:2]), Frame(0.0), False, 0, "")
        found = weight * dr.log(dr.maximum(lobe.value(o), 1e-12))
        return np.array(dr.block_sum(found, SAMPLES)) / whole

    p, step = np.zeros((3, len(cos))), np.full((3, len(cos)), STEP)
    best = likely(p)
    for _ in range(ROUNDS):
        for k in range(3):
            moved = np.zeros(len(cos), bool)
            for way in (1, -1):
                trial = p.copy()
                trial[k] += way * step[k]
                trial[k] = np.clip(trial[k], -SHIFT if k == 2 else LOW, SHIFT if k == 2 else HIGH)
                value = likely(trial)
                better = value > best
                p, best, moved = np.where(better, trial, p), np.where(better, value, best), moved | better
            step[k] *= np.where(moved, 1.2, 0.5)
    found = np.stack([np.exp(p[0]), np.exp(p[1]), p[2]], axis=-1).reshape(len(alphas), len(widths), -1, 3)
    found[:, :, -1, :2] = found[:, :, -1, :2].mean(axis=-1, keepdims=True)  # no plane of incidence there
    found[:, :, -1, 2] = 0
    return np.minimum(found * wider(thin), LARGEST)


def wider(thin: np.ndarray) -> np.ndarray:
    """(N, 3): what the most likely lobe is multiplied by, fitted to sheets of alpha 0.05 to 0.3 at 0 to 60 degrees."""
    c2 = thin**2
    return np.stack([0.96 + 0.06 * c2, 1.045 - 0.025 * c2, np.ones_like(c2)], axis=-1)


def tables() -> np.ndarray:
    """(2, EXIT_INDICES, EXIT_ROUGHNESSES, EXIT_WIDTHS, EXIT_COSINES, 3), the side first."""
    from urushi.solvers.lobes import axes

    alphas, widths = axes.squares(axes.EXIT_ROUGHNESSES), axes.squares(axes.EXIT_WIDTHS)
    thin = axes.exit_cosines()
    found = []
    for side in (0, 1):
        for ratio in np.maximum(axes.ratios(axes.EXIT_INDICES), NEAR):
            found.append(exits(float(ratio if side == 0 else 1 / ratio), alphas, widths, thin))
            print("exits", side, ratio, flush=True)
    return np.stack(found).reshape(2, axes.EXIT_INDICES, *found[0].shape)
