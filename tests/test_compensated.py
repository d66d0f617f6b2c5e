"""Compensated interfaces: nothing is lost, whatever the roughness; and the laws of sampling and reciprocity."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
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
from test_interface_energy import COSINES, REFLECTED
from urushi.interfaces import (
    CompensatedConductor,
    CompensatedDielectric,
    WalkedConductor,
    WalkedDielectric,
    tables,
)
from urushi.interfaces.compensated import MEAN_COSINES, MEAN_WEIGHTS
from urushi.interfaces.energy import directional, hemispherical

pytestmark = needs_llvm

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
each_model = pytest.mark.parametrize(("distribution", "masking"), MODELS)
PARTS = ("both", "reflect", "transmit")
GRAZING = (0.003, 0.03, 0.1, 0.25, 0.5, 0.75, 1.0)


def mirror(lanes: Lanes, alpha: Any, other: Any = None, *args: Any, **more: Any) -> CompensatedConductor:
    more.setdefault("index", MIRROR)
    return CompensatedConductor(metal(lanes, alpha, other, *args, **more), other is None)


def glass(
    lanes: Lanes, eta: Any, alpha: Any, other: Any = None, *args: Any, **more: Any
) -> CompensatedDielectric:
    return CompensatedDielectric(rough(lanes, eta, alpha, other, *args, **more), other is None)


def total(interface: Any, w: Any, above: bool = True, accuracy: float = 3e-4) -> np.ndarray:
    found = directional(interface, w, above, accuracy=accuracy)
    return found.reflectance + found.transmittance


# --- energy -----------------------------------------------------------------------------------------------------------


@each_model
@pytest.mark.parametrize("alpha", [0.01, 0.06, pytest.param(0.23, marks=pytest.mark.slow), 0.6])
def test_a_white_metal_is_white(alpha: float, distribution: str, masking: str) -> None:
    interface = mirror(DOUBLE, alpha, None, distribution, masking)
    assert np.abs(total(interface, GRAZING) - 1).max() < 2e-3
    # The planted fault: without its lobe.
    if alpha > 0.2:
        assert np.abs(total(interface.single, GRAZING) - 1).max() > 0.01


def _glasses() -> list[Any]:
    """Every index and model, one of them quickly."""
    quick = (1.5, "ggx", "correlated")
    cases = [(eta, *model) for eta in (1.05, 1.5, 3.0) for model in MODELS]
    return [pytest.param(*case, marks=() if case == quick else pytest.mark.slow) for case in cases]


@pytest.mark.parametrize(("eta", "distribution", "masking"), _glasses())
def test_clear_glass_is_clear(eta: float, distribution: str, masking: str) -> None:
    """From both sides; Walter's fit gives Beckmann's separable masking 2e-3 too much by itself."""
    for alpha, above in itertools.product((0.01, 0.3, 1.0), (True, False)):
        interface = glass(DOUBLE, eta, alpha, None, distribution, masking)
        assert np.abs(total(interface, GRAZING, above, 6e-4) - 1).max() < 2e-3, (alpha, above)


@pytest.mark.slow
@each_model
def test_clear_glass_at_random(distribution: str, masking: str, rng: np.random.Generator) -> None:
    for _ in range(40):
        eta, alpha = np.exp(rng.uniform(np.log(1.05), np.log(3))), 10 ** rng.uniform(-2, 0)
        cos, above = rng.uniform(0.003, 1, 12) ** 1.5, bool(rng.integers(2))
        interface = glass(DOUBLE, eta, alpha, None, distribution, masking)
        assert np.abs(total(interface, cos, above, 6e-4) - 1).max() < 2.5e-3, (eta, alpha, above)


BRUSHED = [(1.0, 0.1), (0.5, 0.05), (0.1, 0.01), (0.2, 0.6), (0.3, 0.3)]


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alphas", BRUSHED)
def test_brushed_metal_is_white(alphas: tuple[float, float], distribution: str) -> None:
    w = direction(
        *(grid.ravel() for grid in np.meshgrid((0.02, 0.1, 0.4, 0.8, 1.0), np.radians([0, 25, 50, 75, 90])))
    )
    found = total(mirror(DOUBLE, *alphas, distribution), w, accuracy=2e-3)
    assert np.abs(found - 1).max() < 1e-2


@pytest.mark.parametrize("alphas", [(1.0, 1e-4), (1e-4, 0.1)])
def test_beyond_the_tables_light_is_lost_but_not_gained(alphas: tuple[float, float]) -> None:
    """Brushing narrower than 16 to 1 counts as that: too little is given back along the grooves, near grazing."""
    w = direction(*(grid.ravel() for grid in np.meshgrid((0.02, 0.1, 0.4, 1.0), np.radians([0, 45, 90]))))
    for interface in (mirror(DOUBLE, *alphas), glass(DOUBLE, 1.5, *alphas)):
        found = total(interface, w, accuracy=4e-3)
        assert found.max() < 1.01 and found.min() > 0.7


@pytest.mark.parametrize(
    "eta", [1.5, *(pytest.param(eta, marks=pytest.mark.slow) for eta in (1.05, 1.2, 3.0))]
)
@pytest.mark.parametrize(
    "alphas", [(0.5, 0.05), pytest.param((1.0, 0.1), marks=pytest.mark.slow), (0.2, 0.6)]
)
def test_brushed_glass_is_clear(alphas: tuple[float, float], eta: float) -> None:
    """Total reflection by nearly equal indices is too sharp for the coarse tables: there 2e-2, else 1e-2."""
    w = direction(
        *(grid.ravel() for grid in np.meshgrid((0.02, 0.1, 0.4, 0.8, 1.0), np.radians([0, 25, 50, 75, 90])))
    )
    for above in (True, False):
        found = total(glass(DOUBLE, eta, *alphas), w, above, accuracy=2e-3)
        assert np.abs(found - 1).max() < (2e-2 if eta < 1.2 else 1e-2)


def test_glass_on_average() -> None:
    """Over the hemisphere nothing is lost but what the tables round, and n1^2 T12 = n2^2 T21."""
    for alpha in (0.1, 0.8):
        interface = glass(DOUBLE, 1.5, alpha)
        one, other = (hemispherical(interface, above, accuracy=5e-4) for above in (True, False))
        for found in (one, other):
            assert found.reflectance + found.transmittance == pytest.approx(1, abs=1e-3)
        assert other.transmittance * 1.5**2 == pytest.approx(one.transmittance, abs=1.5e-3)


# --- the tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("masking", "alpha"), REFLECTED)
def test_tables_against_printed_numbers(masking: str, alpha: float) -> None:
    interface = mirror(SINGLE, alpha, masking=masking)
    w = SINGLE.vectors(direction(np.array(COSINES)))
    expected = np.array(REFLECTED[masking, alpha])
    assert np.allclose(1 - back(interface.missing(w, True)), expected[:6], atol=1e-3)
    assert 1 - back(interface.missing.mean(True)) == pytest.approx(expected[6], abs=1e-3)


def test_nodes_lie_where_their_coordinates_say() -> None:
    for alpha in (1e-4, 0.03, 1.0):
        found = back(tables.of_cosine(DOUBLE(tables.cosines(alpha, 9)), alpha))
        assert np.allclose(found, np.linspace(0, 1, 9), atol=1e-6)
    assert np.allclose(back(tables.of_index(DOUBLE(tables.indices(9)))), np.linspace(0, 1, 9), atol=1e-6)
    assert np.allclose(
        back(tables.of_roughness(DOUBLE(tables.roughnesses(9)))), np.linspace(0, 1, 9), atol=1.1e-2
    )
    ratios = DOUBLE(tables.ratios(9))
    assert np.allclose(back(tables.of_ratio(ratios, DOUBLE(1))), np.linspace(0, 1, 9), atol=1e-6)


def test_tables_are_what_their_tool_makes(rng: np.random.Generator) -> None:
    """A few nodes of each, anew."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
    try:
        import make_energy_tables as tool
    finally:
        sys.path.pop(0)
    for distribution, masking in MODELS:
        model = f"{distribution}_{masking}"
        for kind in ("metal", "glass", "brushed_metal", "brushed_glass"):
            table = tables.energies(kind, model)
            at = [rng.integers(1, n, 6) for n in table.shape]
            if kind.endswith("glass"):
                near = at[0] == len(table) // 2
                at[0][near] += 1
            brushed = kind.startswith("brushed")
            names = ["index"] * kind.endswith("glass") + ["rough"] + ["ratio", "turn"] * brushed + ["cos"]
            place = dict(zip(names, at, strict=True))
            n = dict(zip(names, table.shape, strict=True))
            alpha = tables.roughnesses(n["rough"])[place["rough"]]
            ratio = tables.ratios(n["ratio"])[place["ratio"]] if brushed else np.ones(6)
            mean = alpha / np.sqrt(ratio)
            cos = [tables.cosines(a, n["cos"])[j] for a, j in zip(mean, place["cos"], strict=True)]
            phi = place["turn"] * (np.pi / 2 / (n["turn"] - 1)) if brushed else 0.0
            eta = tables.indices(n["index"])[place["index"]] if "index" in n else 0.0
            lost = tool.missing(
                (distribution, masking),
                21,
                cos=np.array(cos),
                phi=phi,
                alpha_x=alpha,
                alpha_y=alpha / ratio,
                eta=eta,
            )
            assert np.allclose(table[tuple(at)], np.maximum(lost, 0), atol=4e-3 if brushed else 6e-4)


def test_the_mean_of_a_metal() -> None:
    """Four nodes, against many; for the metals that have names."""
    from test_fresnel import complex_fresnel
    from urushi.optics.ior import conductor_names, conductor_rgb

    nodes, weights = np.polynomial.legendre.leggauss(200)
    cos = 0.5 * (nodes + 1)
    for name in conductor_names():
        for eta, k in zip(*conductor_rgb(name), strict=True):
            if name == "none" or eta * eta + k * k < 1:
                continue
            exact = np.sum(weights * cos * complex_fresnel(cos, eta, k))
            found = np.dot(MEAN_WEIGHTS, complex_fresnel(np.array(MEAN_COSINES), eta, k))
            assert found == pytest.approx(exact, abs=1e-3), name


# --- the laws ---------------------------------------------------------------------------------------------------------


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
    """The mean weight of samples is one, and its standard error small: the lobes fit."""
    w, u = direction(np.full(1 << 16, 0.4)), rng.random((1 << 16, 3))
    for alpha, above in itertools.product((0.02, 0.3, 1.0), (True, False)):
        found = sample(SINGLE, glass(SINGLE, 1.5, alpha), w, u, above).weight
        assert found.mean() == pytest.approx(1, abs=2e-3 + 4 * found.std() / 256)
        assert found.std() < 1


def test_smooth_lanes_are_smooth(rng: np.random.Generator) -> None:
    """Where a lane is smooth or index-matched nothing is added, and the sample is that of the single interface."""
    n = 400
    w, u = hemisphere(rng, n, 0.05), rng.random((n, 3))
    flat = rng.random(n) < 0.5
    alpha = np.where(flat, 1e-4, 0.3)
    delta = SINGLE(flat.astype(float)) > 0.5
    for interface in (glass(SINGLE, 1.5, alpha, delta=delta), mirror(SINGLE, alpha, delta=delta)):
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
