"""One flight through a slab, against the closed forms of exponential attenuation."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from chi2 import strata
from lanes import DOUBLE, SINGLE, Lanes, back, both_precisions, direction, needs_llvm
from quadrature import gauss
from surface import spread
from urushi.media import BoundMedium, inverse_cosine
from urushi.optics.phase import Isotropic

pytestmark = needs_llvm

#: optical depths and albedos: grey, coloured, with a clear channel, absorbing, scattering only, thin and thick
SLABS = {
    "grey": (0.7, 0.6),
    "clear": (0.0, 0.9),
    "thin": (1e-6, 0.9),
    "one": (1.0, 1.0),
    "absorbing": (1.0, 0.0),
    "thick": (1000.0, 0.8),
    "coloured": ((0.3, 1.0, 3.0), (0.9, 0.5, 0.2)),
    "one channel clear": ((0.0, 1.0, 2.0), (0.9, 0.9, 0.9)),
    "one channel black": ((0.5, 1.0, 2.0), (0.9, 0.0, 1.0)),
    "last channel black": ((0.5, 1.0, 2.0), (0.9, 1.0, 0.0)),
    "from thin to thick": ((1e-6, 1.0, 1000.0), (0.9, 0.9, 0.9)),
    "grey depth, coloured albedo": (0.8, (0.9, 0.5, 0.0)),
    "coloured depth, grey albedo": ((0.3, 1.0, 3.0), 0.8),
    "all clear": ((0.0, 0.0, 0.0), (0.9, 0.9, 0.9)),
    "all black": ((0.5, 1.0, 2.0), (0.0, 0.0, 0.0)),
}
#: where the flight starts and the cosine of its direction (downwards if negative)
FLIGHTS = [(0.0, -1.0), (0.0, -0.3), (1.0, 0.7), (0.4, -0.6), (0.4, 0.6), (0.0, -0.01), (0.999, -1.0)]
THROUGHPUT = (0.9, 0.3, 0.6)


def value(lanes: Lanes, x: Any) -> Any:
    return lanes.vector(*(lanes(c) for c in x)) if isinstance(x, tuple) else lanes(x)


def fly(lanes: Lanes, slab: str, t: float, cos: float, u: np.ndarray) -> dict[str, np.ndarray]:
    """One flight per row of u; weights as colours."""
    depth, albedo = (value(lanes, x) for x in SLABS[slab])
    medium = BoundMedium(depth, albedo, Isotropic())
    n = len(u)
    w = lanes.vectors(spread(direction(np.abs(cos)) * [1, 1, np.sign(cos)], n))
    throughput = value(lanes, THROUGHPUT if _coloured(slab) else 1.0)
    flight = medium.fly(lanes(np.full(n, t)), w, throughput, *(lanes(u[:, i]) for i in range(3)))
    dr.eval(flight.collided, flight.t, flight.weight, flight.scattered)

    def colours(x: Any) -> np.ndarray:
        x = back(x)
        x = x[:, None] if x.ndim == 1 else x
        return np.broadcast_to(x, (n, x.shape[1]))

    return {
        "collided": np.broadcast_to(np.array(flight.collided, bool), n),
        "t": np.broadcast_to(back(flight.t), n),
        "weight": colours(flight.weight),
        "scattered": colours(flight.scattered),
    }


def _coloured(slab: str) -> bool:
    return any(isinstance(x, tuple) for x in SLABS[slab])


def truth(slab: str, t: float, cos: float, power: int) -> tuple[np.ndarray, np.ndarray]:
    """(transmitted to the boundary ahead, integral of the collisions times place ** power), per channel."""
    depth, albedo = (np.broadcast_to(np.atleast_1d(x), 3 if _coloured(slab) else 1) for x in SLABS[slab])
    ahead = 1 - t if cos < 0 else t
    per_length = depth / max(abs(cos), 1e-9)
    passed = np.exp(-per_length * ahead)
    # Substituting the transmittance itself for the distance keeps thick slabs smooth.
    x, weight = gauss(200, 0, 1)
    hits = []
    for c in range(len(depth)):
        lost = -np.expm1(-per_length[c] * ahead)
        s = -np.log1p(-x * lost) / per_length[c] if per_length[c] > 0 else x * ahead
        place = t + s if cos < 0 else t - s
        hits.append(albedo[c] * lost * (place**power) @ weight)
    return passed, np.array(hits)


@pytest.fixture(scope="module")
def u() -> np.ndarray:
    """Numbers for the choice, the place and the channel; the first two stratified against each other."""
    from conftest import SEED

    rng = np.random.default_rng(SEED)
    both = strata(rng, 512)
    return np.column_stack([both[:, 0], both[:, 1], rng.random(len(both)) * (1 - 2.0**-23)])


@pytest.mark.parametrize("slab", SLABS)
def test_means(slab: str, u: np.ndarray) -> None:
    """E[weight; passed] is the transmittance, and both the weight of the collisions and what all collisions carry
    together (`scattered`) average to the integral of albedo x extinction x attenuation, with any function of place."""
    for t, cos in FLIGHTS:
        found = fly(SINGLE, slab, t, cos, u)
        hit = found["collided"][:, None]
        for power in (0, 1, 2):
            passed, hits = truth(slab, t, cos, power)
            place = found["t"][:, None] ** power
            # An error bar, since channels far apart make uneven weights, plus the grain of single precision.
            for samples, expected in (
                (found["weight"] * ~hit, passed),
                (found["weight"] * hit * place, hits),
                (found["scattered"] * place, hits),
            ):
                error = samples.std(axis=0) / np.sqrt(len(samples))
                # What happens less than once among all samples may be missing altogether.
                room = (
                    5 * error
                    + 2e-5 * expected
                    + 5 * np.sqrt(np.minimum(expected, 1e-4) / len(samples))
                    + 1e-7
                )
                assert np.all(np.abs(samples.mean(axis=0) - expected) <= room), (t, cos, power)
                assert np.all(error <= 0.01)


@pytest.mark.parametrize("slab", SLABS)
def test_bounds(slab: str, u: np.ndarray) -> None:
    """Nothing is NaN, infinite or negative, places lie in the slab and ahead, and the walk never gains: what a grey
    slab lets live is the weight of every flight; in colour, the carried light divides by its mean at most."""
    edges = np.array([0.0, 2.0**-23, 0.5, 1 - 2.0**-23])
    corners = np.stack(np.meshgrid(edges, edges, edges), axis=-1).reshape(-1, 3)
    for t, cos in [*FLIGHTS, (0.5, 1e-4), (0.5, -1e-7), (0.0, -1e-12), (1.0, 1e-12), (0.0, 0.5), (1.0, -0.5)]:
        for numbers in (corners, u[::64]):
            found = fly(SINGLE, slab, t, cos, numbers)
            for name, values in found.items():
                assert np.all(np.isfinite(values)), (name, t, cos)
            for name in ("weight", "scattered"):
                assert found[name].min() >= 0
            ahead = found["t"] - t if cos < 0 else t - found["t"]
            assert ahead.min() >= -1e-7 and found["t"].min() >= 0 and found["t"].max() <= 1
            passed, hits = truth(slab, t, cos, 0)
            lived = passed + hits
            if not _coloured(slab):
                assert np.allclose(found["weight"], lived, rtol=1e-5, atol=1e-7)
            # The light in all channels after the flight, on average over the choice, is what survives of it.
            before = np.array(THROUGHPUT if _coloured(slab) else (1.0,))
            after = found["weight"] @ before if _coloured(slab) else found["weight"][:, 0]
            assert after.max() <= before @ lived * (1 + 1e-4) + 1e-7


def test_absorbers_only_attenuate(u: np.ndarray) -> None:
    for slab in ("absorbing", "all black"):
        found = fly(SINGLE, slab, 0.0, -0.5, u)
        assert not found["collided"].any() and np.all(found["scattered"] == 0)
        assert np.allclose(found["weight"], truth(slab, 0.0, -0.5, 0)[0], rtol=1e-5)


@both_precisions
def test_place_of_collision(lanes: Lanes) -> None:
    """A truncated exponential, inverted; the series for thin flights joins the logarithm without a step."""
    depth, u2 = (
        x.ravel() for x in np.meshgrid([1e-6, 1e-3, 8e-3, 0.00999, 0.01001, 0.1, 3.0], np.arange(64) / 64)
    )
    n = len(depth)
    medium = BoundMedium(lanes(depth), lanes(np.full(n, 0.9)), Isotropic())
    w = lanes.vectors(spread(np.array([0.0, 0.0, -1.0]), n))
    found = back(medium.fly(lanes(np.zeros(n)), w, lanes(1.0), lanes(np.zeros(n)), lanes(u2), lanes(0.0)).t)
    # The series leaves out the cube of the depth.
    assert np.allclose(found, -np.log1p(u2 * np.expm1(-depth)) / depth, atol=2e-5)


@both_precisions
def test_transmittance(lanes: Lanes) -> None:
    """Beer and Lambert; grazing directions see an endless slab, and not NaN."""
    depth, distance, cos = (
        x.ravel() for x in np.meshgrid([0, 1e-6, 1, 1000.0], [0, 0.3, 1], [1, 0.3, 1e-3, 0.0])
    )
    w = lanes.vectors(direction(cos) * [1, 1, -1])
    medium = BoundMedium(lanes(depth), lanes(0.5), Isotropic())
    found = back(medium.transmittance(lanes(distance), inverse_cosine(w.z)))
    expected = np.exp(-depth * distance / np.maximum(cos, 1e-9))
    # The exponent is known to one rounding.
    assert np.allclose(found, expected, rtol=50 * lanes.exact, atol=1e-30)


def test_what_is_left_at_once(u: np.ndarray) -> None:
    """Passing and colliding exhaust the light: a lossless slab gives weight 1 on every flight."""
    for t, cos in FLIGHTS:
        assert np.allclose(fly(SINGLE, "one", t, cos, u[::16])["weight"], 1, atol=1e-6)


def test_double_precision(u: np.ndarray) -> None:
    """The same formulas: flights with the same numbers end in the same place."""
    for slab in ("grey", "coloured", "from thin to thick"):
        one, other = (fly(lanes, slab, 0.4, -0.6, u[::64]) for lanes in (SINGLE, DOUBLE))
        same = one["collided"] == other["collided"]
        assert np.mean(same) > 0.999
        assert np.median(np.abs(one["t"] - other["t"])) < 1e-6
        assert np.allclose(one["weight"][same], other["weight"][same], rtol=1e-3, atol=1e-5)
