"""How wide the light is that gets out of a coat: a channel of the tables of `lobe_round_trips`.

Light enters through a rough interface, a rough mirror sends it back, and it gets out, soon or late. First-order
derivatives of refraction say how wide it is then, which near the horizon is too much: nothing gets out beyond. So it is
counted here.
A width is the median tangent of the angle between the half-way vector and the normal, as everywhere in `urushi`'s
tests of lobes, and what is stored is by how much the roughness that has this median differs from the first order's.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import interp1d

#: samples for each place
SAMPLES = 3000
#: times that light comes back, and what the mirror keeps of it from one to the next
TRIPS, KEPT = 4, 0.85
#: roughnesses below this are taken as this
SMALL = 2e-3
#: roughnesses whose lobes are compared with
COMPARED = np.geomspace(1e-3, 1, 41)


def median(value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N,) weighted medians of (N, S)."""
    order = np.argsort(value, axis=1)
    value, weight = (np.take_along_axis(x, order, axis=1) for x in (value, weight))
    below = np.cumsum(weight, axis=1)
    at = (below < 0.5 * below[:, -1:]).sum(axis=1)
    return value[np.arange(len(value)), np.minimum(at, value.shape[1] - 1)]


class Places:
    """Directions, `SAMPLES` times each.

    Args:
        cos: (N,) of incidence.
    """

    def __init__(self, cos: np.ndarray) -> None:
        from drjit.llvm.ad import Array3f64, Float64

        self.rng = np.random.default_rng(1)
        self.number, self.shape = Float64, (len(cos), SAMPLES)
        c = np.repeat(cos, SAMPLES)
        self.w = Array3f64(np.sqrt((1 - c) * (1 + c)), 0 * c, c)

    def random(self) -> list:
        return [self.number(self.rng.random(self.shape[0] * SAMPLES)) for _ in range(2)]

    def reflect(self, w: object, alpha: float) -> tuple:
        """Direction and weight after a rough mirror."""
        import drjit as dr

        from urushi.optics.microfacet import Microfacets
        from urushi.optics.vectors import reflect

        facets = Microfacets(self.number(alpha), self.number(alpha), "ggx", "correlated")
        o = reflect(w, facets.sample(w, *self.random()))
        up = type(w)(o.x, o.y, dr.maximum(dr.abs(o.z), 1e-6))
        return up, dr.select(o.z > 0, facets.masked(w, up, facets.sigma(w)), 0)

    def median(self, ends: list[tuple]) -> np.ndarray:
        """Median tangents of the half-way vectors of all directions, with their weights."""
        import drjit as dr

        slopes, weights = [], []
        for o, weight in ends:
            h = self.w + o
            slope = dr.sqrt(dr.square(h.x) + dr.square(h.y)) / dr.abs(h.z)
            slopes.append(np.array(slope).reshape(self.shape))
            weights.append(np.array(weight).reshape(self.shape))
        return median(np.concatenate(slopes, axis=1), np.concatenate(weights, axis=1))


def too_wide(eta: float, alphas: np.ndarray, widths: np.ndarray, cos: np.ndarray) -> np.ndarray:
    """(A, W, N): true over first-order roughness; `eta` above 1, others as for `lobe_round_trips.round_trips`."""
    import drjit as dr

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.microfacet import Microfacets
    from urushi.solvers.lobes.width import OURS

    places = Places(cos)
    seen = np.stack([places.median([places.reflect(places.w, float(alpha))]) for alpha in COMPARED])
    below = np.sqrt(1 - (1 - cos**2) / eta**2)
    power = OURS.power
    found = np.ones((len(alphas), len(widths), len(cos)))
    for a, alpha in enumerate(np.maximum(alphas, SMALL)):
        number = places.number
        facets = Microfacets(number(alpha), number(alpha), "ggx", "correlated")
        inward = BoundDielectric(number(eta), facets, False, Frame(0.0))
        outward = BoundDielectric(number(1 / eta), facets, False, Frame(0.0))
        one = inward.sample(places.w, (0.5, *places.random()), True, "transmit")
        back = upward(-one.o)
        down = 0.5 * alpha * np.abs(1 - cos / (eta * below))
        up = 0.5 * alpha * np.abs(1 - below * eta / cos)
        factor = eta * below / cos
        for b, width in enumerate(np.maximum(widths, SMALL)):
            light, kept, ends = back, dr.select(one.o.z < 0, one.weight, 0), []
            for _ in range(TRIPS):
                o, by = places.reflect(light, float(width))
                kept = kept * by
                under = type(o)(-o.x, -o.y, o.z)
                two = outward.sample(under, (0.5, *places.random()), True, "transmit")
                ends.append((upward(two.o), dr.select(two.o.z < 0, kept * two.weight, 0)))
                again = outward.sample(under, (0.5, *places.random()), True, "reflect")
                kept = KEPT * dr.select(again.o.z > 0, kept * again.weight, 0)
                light = upward(-again.o)
            out = places.median(ends)
            first = ((down**power + width**power) * factor**power + up**power) ** (1 / power)
            true = [np.interp(out[n], seen[:, n], COMPARED) for n in range(len(cos))]
            found[a, b] = np.clip(true / np.minimum(first, 1), 0.2, 1.9)
    return found


def upward(o: object) -> object:
    """Mirrored to the upper side."""
    import drjit as dr

    return type(o)(o.x, o.y, dr.maximum(dr.abs(o.z), 1e-6))


def table(cos: np.ndarray) -> np.ndarray:
    """(INDICES, ROUGHNESSES, WIDTHS, N), counted at some of the nodes and interpolated between them."""
    from urushi.solvers.lobes import axes

    indices, alphas = np.array([0, 2, 4, 6, 9, axes.INDICES - 1]), np.arange(0, axes.ROUGHNESSES, 2)
    found = []
    for k in indices:
        eta = float(axes.ratios()[k])
        found.append(too_wide(eta, axes.squares(axes.ROUGHNESSES)[alphas], axes.squares(axes.WIDTHS), cos))
        print("widths", eta, flush=True)
    counted = interp1d(alphas, np.stack(found), axis=1)(np.arange(axes.ROUGHNESSES))
    return np.asarray(interp1d(indices, counted, axis=0)(np.arange(axes.INDICES)))
