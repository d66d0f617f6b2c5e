"""Compensated interfaces: the laws of sampling and reciprocity, derivatives, and what the walk says."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from lanes import DOUBLE, SINGLE, Lanes, back, direction, hemisphere, needs_llvm
from quadrature import sphere
from surface import check_samples, check_weights, evaluate, sample
from test_conductor import GOLD, MIRROR, metal
from test_dielectric import rough
from urushi.interfaces import (
    CompensatedConductor,
    CompensatedDielectric,
    WalkedConductor,
    WalkedDielectric,
)
from urushi.interfaces.energy import directional, hemispherical

pytestmark = needs_llvm

PARTS = ("both", "reflect", "transmit")


def mirror(lanes: Lanes, alpha: Any, other: Any = None, *args: Any, **more: Any) -> CompensatedConductor:
    more.setdefault("index", MIRROR)
    return CompensatedConductor(metal(lanes, alpha, other, *args, **more), other is None)


def glass(
    lanes: Lanes, eta: Any, alpha: Any, other: Any = None, *args: Any, **more: Any
) -> CompensatedDielectric:
    return CompensatedDielectric(rough(lanes, eta, alpha, other, *args, **more), other is None)


@pytest.mark.parametrize("above", [True, False])
def test_reciprocity(above: bool, rng: np.random.Generator) -> None:
    """f(w, o) cos_w n1^-2 = f(o, w) cos_o n2^-2, exactly, in whichever way the light goes."""
    n = 4000
    w, o = hemisphere(rng, n, 0.02), hemisphere(rng, n, 0.02)
    eta, alpha = rng.uniform(1.05, 3, n), rng.uniform(0.05, 1, (2, n))
    for lanes, tolerance in ((DOUBLE, 1e-8), (SINGLE, 2e-4)):
        for interface in (
            glass(lanes, eta, alpha[0]),
            glass(lanes, eta, *alpha),
            mirror(lanes, alpha[0], index=GOLD),
        ):
            there = evaluate(lanes, interface, w, o, above)[0]
            back_ = evaluate(lanes, interface, o, w, above)[0]
            there, back_ = (x.reshape(n, -1) for x in (there, back_))
            assert np.allclose(there * w[:, 2:], back_ * o[:, 2:], rtol=tolerance, atol=1e-6)
            if interface.opaque:
                continue
            down = o * [1, 1, -1]
            there = evaluate(lanes, interface, w, down, above)[0]
            # From the other side both are seen mirrored.
            back_ = evaluate(lanes, interface, o, w * [1, 1, -1], not above)[0]
            square = eta**2 if above else eta**-2
            assert np.allclose(there * w[:, 2], back_ * o[:, 2] * square, rtol=tolerance, atol=1e-6)


@pytest.mark.parametrize("part", PARTS)
def test_weight_is_value_over_density(part: Any, rng: np.random.Generator) -> None:
    n = 1 << 13
    w, u = hemisphere(rng, n, 0.01), rng.random((n, 3))
    alpha, eta = 10 ** rng.uniform(-2.5, 0, (2, n)), rng.uniform(1.05, 3, n)
    for above in (True, False):
        check_weights(DOUBLE, glass(DOUBLE, eta, alpha[0]), w, u, above, part, 1e-5)
        check_weights(DOUBLE, glass(DOUBLE, eta, *alpha), w, u, above, part, 1e-5)
    if part != "transmit":
        check_weights(DOUBLE, mirror(DOUBLE, alpha[0], index=GOLD), w, u, True, part, 1e-5)


CASES = [("metal", 0.7, True, "both"), ("glass", 0.5, True, "both"), ("glass", 0.8, False, "both")]
CASES += [("glass", 0.5, True, "reflect"), ("glass", 0.8, False, "transmit")]


@pytest.mark.parametrize(("kind", "alpha", "above", "part"), CASES)
def test_samples_follow_their_density(
    kind: str, alpha: float, above: bool, part: Any, rng: np.random.Generator
) -> None:
    make: Any = (
        (lambda lanes: mirror(lanes, alpha)) if kind == "metal" else (lambda lanes: glass(lanes, 1.5, alpha))
    )
    check_samples(make(SINGLE), make(DOUBLE), direction(0.6, 0.4), rng, above, part)


def test_what_samples_carry_is_the_energy(rng: np.random.Generator) -> None:
    """Samples weigh one, nearly each by itself; those of reflection and of transmission on the average."""
    w, u = direction(np.full(1 << 16, 0.4)), rng.random((1 << 16, 3))
    for alpha, above in itertools.product((0.02, 0.3, 1.0), (True, False)):
        found = sample(SINGLE, glass(SINGLE, 1.5, alpha), w, u, above).weight
        assert found.mean() == pytest.approx(1, abs=2e-3)
        assert found.std() < 0.1
        parts = [sample(SINGLE, glass(SINGLE, 1.5, alpha), w, u, above, part).weight for part in PARTS[1:]]
        assert np.mean(parts) * 2 == pytest.approx(1, abs=2e-3 + 4 * np.std(parts) / 256)


def test_smooth_lanes_are_smooth(rng: np.random.Generator) -> None:
    """Where a lane is smooth or index-matched nothing is added, and the sample is that of the single interface."""
    n = 400
    w, u = hemisphere(rng, n, 0.05), rng.random((n, 3))
    flat = rng.random(n) < 0.5
    delta = SINGLE(flat.astype(float)) > 0.5
    for interface in (glass(SINGLE, 1.5, 0.5, delta=delta), mirror(SINGLE, 0.5, delta=delta)):
        one, other = sample(SINGLE, interface, w, u), sample(SINGLE, interface.single, w, u)
        assert np.array_equal(one.o[flat], other.o[flat]) and np.array_equal(
            one.weight[flat], other.weight[flat]
        )
        assert np.all(evaluate(SINGLE, interface, w, w)[0][flat] == 0)
        assert np.abs(one.weight - other.weight)[~flat].max() > 0.01


def test_extremes_are_finite() -> None:
    cos = np.array([1e-7, 1e-4, 0.01, 0.5, 1.0])
    alpha, eta = np.array([1e-4, 1e-3, 0.03, 1.0]), np.array([0.2, 0.999, 1.001, 5.0])
    c, d, a, b, e = (grid.ravel() for grid in np.meshgrid(cos, cos, alpha, alpha, eta))
    w, o = direction(c, 0.3), direction(d, 2.0)
    u = np.random.default_rng(1).random((len(c), 3))
    for interface in (glass(SINGLE, e, a), glass(SINGLE, e, a, b), mirror(SINGLE, a), mirror(SINGLE, a, b)):
        for above, side in itertools.product((True, False), (1, -1)):
            for found in evaluate(SINGLE, interface, w, o * [1, 1, side], above):
                assert np.isfinite(found).all() and found.min() >= 0
            event = sample(SINGLE, interface, w, u, above)
            assert np.isfinite(event.weight).all() and event.weight.min() >= 0 and np.isfinite(event.o).all()


def test_scalars_give_the_same() -> None:
    from drjit.scalar import Array3f64

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.microfacet import Microfacets

    facets = Microfacets(0.4, 0.4, "ggx", "correlated")
    single = BoundDielectric(1.5, facets, False, Frame(0.0))
    interface = CompensatedDielectric(single, True)
    w, o = direction(0.5, 0.2), direction(0.3, 1.0)
    wide = glass(DOUBLE, 1.5, 0.4)
    for above, side in itertools.product((True, False), (1, -1)):
        one, other = Array3f64(*w), Array3f64(*(o * [1, 1, side]))
        found = (interface.reflect if side == 1 else interface.transmit)(one, other, above)
        expected = evaluate(DOUBLE, wide, w[None], o[None] * [1, 1, side], above)
        assert np.allclose(found, np.ravel(expected), rtol=1e-6)
    event = interface.sample(Array3f64(*w), (0.5, 0.99, 0.3), True)
    assert event.weight > 0


# --- derivatives, the walk, stacks ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["alpha", "eta", "k"])
def test_derivatives(name: str, rng: np.random.Generator) -> None:
    """Reverse mode against central differences, for values with the tables in them."""
    n = 64
    w, o = hemisphere(rng, n, 0.1), hemisphere(rng, n, 0.1)
    value = {"alpha": 0.437, "eta": 1.53, "k": 2.9}[name]

    def ask(x: Any) -> Any:
        one, other = DOUBLE.vectors(w), DOUBLE.vectors(o)
        if name == "k":
            interface: Any = mirror(DOUBLE, 0.6)
            interface.single.k, interface.single.eta = x, DOUBLE(0.3)
            return CompensatedConductor(interface.single, True).reflect(one, other, True)[0]
        single = rough(DOUBLE, 1.5, 0.5)
        alpha, eta = (x, DOUBLE(1.5)) if name == "alpha" else (DOUBLE(0.5), x)
        from urushi.interfaces.dielectric import BoundDielectric
        from urushi.optics.microfacet import Microfacets

        single = BoundDielectric(eta, Microfacets(alpha, alpha, "ggx", "correlated"), False, single.frame)
        interface = CompensatedDielectric(single, True)
        return interface.reflect(one, other, True)[0] + interface.transmit(one, -other, False)[0]

    x = DOUBLE(value)
    dr.enable_grad(x)
    dr.backward(dr.sum(ask(x)))
    step = 1e-6
    high, low = (back(ask(DOUBLE(value + s))).sum() for s in (step, -step))
    assert dr.grad(x)[0] == pytest.approx((high - low) / (2 * step), rel=1e-5)


@pytest.mark.parametrize(("eta", "alpha"), [(1.5, 0.3), (2.2, 1.0)])
def test_the_walk_shares_alike(eta: float, alpha: float) -> None:
    """Transmittance of light from the hemisphere, against the random walk."""
    for above in (True, False):
        interface = glass(DOUBLE, eta, alpha)
        found = hemispherical(interface, above, accuracy=5e-4).transmittance
        walked = hemispherical(WalkedDielectric(rough(SINGLE, eta, alpha)), above, accuracy=2e-3)
        assert found == pytest.approx(walked.transmittance, abs=2e-3)
        # The planted fault: all of what is lost reflected.
        single = hemispherical(interface.single, above, accuracy=5e-4).transmittance
        assert walked.transmittance - single > 4e-3


def test_colours_are_near_those_of_the_walk() -> None:
    """Hill's series knows one mean reflectance: gold is at worst 0.015 too dark at alpha 0.3, and 0.017 at 0.6."""
    for alpha in (0.3, 0.6):
        found = directional(mirror(DOUBLE, alpha, index=GOLD), [0.3, 0.9]).reflectance
        walked = directional(WalkedConductor(metal(SINGLE, alpha)), [0.3, 0.9], accuracy=1.5e-3).reflectance
        assert np.abs(found - walked).max() < 0.022
        single = directional(metal(DOUBLE, alpha), [0.3, 0.9]).reflectance
        assert np.abs(single - walked).max() > 0.1


@pytest.mark.slow
def test_three_rough_glasses_on_a_mirror_lose_nothing() -> None:
    more: Any = {"multiple_scattering": "compensated"}
    layers = [ur.Dielectric(ior=n, alpha=a, **more) for n, a in ((1.5, 0.3), (1.3, 0.5), (1.7, 0.2))]
    base = ur.Conductor(material="none", alpha=0.3, **more)
    bsdf = ur.solve(ur.Stack(layers=[*layers, base]), "walk", samples=1 << 17)
    found, error = bsdf.reflectance(direction(np.array([0.2, 0.5, 0.8, 1.0])), with_error=True)
    spread = np.sqrt((error[:, 0] ** 2).sum()) / 4
    assert spread < 1.5e-3
    assert abs(found[:, 0].mean() - 1) < 3e-3 + 2 * spread


def test_through_a_stack() -> None:
    """Integrating eval over directions is the reflectance; gold under a rough coat, both complete."""
    more: Any = {"multiple_scattering": "compensated"}
    coat = ur.Dielectric(ior=1.5, alpha=0.3, **more)
    gold = ur.Conductor(material="Au", alpha=(0.4, 0.2), **more)
    stack = ur.Stack(layers=[coat, gold])
    o, weight = sphere(32, 64, 0.0, 1.0)
    wi = direction(0.7, 0.5)
    value, error = ur.solve(stack, samples=64).eval(np.tile(wi, (len(o), 1)), o, with_error=True)
    spread = np.sqrt(((weight[:, None] * error) ** 2).sum(axis=0))
    whole, own = ur.solve(stack, samples=1 << 15).reflectance(wi, with_error=True)
    assert np.all(np.abs(weight @ value - whole) < 4 * np.hypot(spread, own) + 2e-3)
    assert np.all(np.hypot(spread, own) < 0.02)
