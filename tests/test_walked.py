"""Rough interfaces with a walk among their facets: energy, reciprocity, agreement of sampling and values, limits."""

from __future__ import annotations

import importlib
import itertools
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import DOUBLE, SINGLE, Lanes, back, direction, hemisphere, needs_llvm
from microwalk import ask, draw, facets, glass, metal, numbers, streams
from quadrature import sphere
from surface import spread
from urushi.errors import MaterialError
from urushi.interfaces import BoundDielectric, BoundDiffuse, RoughDiffuse, WalkedDielectric
from urushi.interfaces.base import Frame
from urushi.interfaces.standin import panes
from urushi.optics.microfacet import Microfacets

pytestmark = needs_llvm

each_distribution = pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
#: the same where what is compiled takes long: Beckmann's normals are found by loops
one_distribution = pytest.mark.parametrize(
    "distribution", ["ggx", pytest.param("beckmann", marks=pytest.mark.slow)]
)
each_side = pytest.mark.parametrize("above", [True, False], ids=["above", "below"])
GOLD = (0.2, 3.0)


def test_energy_of_a_dielectric() -> None:
    """Reflectance and transmittance that an independent program printed, by sampling."""
    n, rng = 1 << 20, np.random.default_rng(5)
    table = {
        (True, 0.2): (0.0851, 0.9149),
        (True, 0.9): (0.0316, 0.9684),
        (False, 0.2): (0.931, 0.069),
        (False, 0.9): (0.341, 0.659),
    }
    for (above, cos), (reflected, transmitted) in table.items():
        w = SINGLE.vectors(spread(direction(cos)[None], n))
        event = glass(SINGLE, 1.5, 0.5).sample(w, numbers(SINGLE, rng, n), above, "both", streams(w, 1))
        through, weight = np.array(event.through), back(event.weight)
        assert np.all(weight == 1) and np.all((back(event.o)[:, 2] < 0) == through)
        error = 4 * np.sqrt(reflected * transmitted / n) + (5e-5 if above else 5e-4)
        assert abs(np.mean(~through) - reflected) < error


@one_distribution
@pytest.mark.parametrize("kind", ["metal", "above", "below"])
def test_furnace(kind: str, distribution: str, rng: np.random.Generator) -> None:
    """All light comes back, or goes through: the flux density sums to 1, for every roughness and index."""
    n = 1 << 14
    etas = (1.0,) if kind == "metal" else (1.05, 1.33, 1.5, 2.0, 3.0)
    rough = [(a, a) for a in (0.01, 0.05, 0.1, 0.3, 0.5, 0.7, 1.0)] + [(0.1, 1.0), (0.5, 0.05)]
    cases = list(itertools.product(rough, etas, (0.02, 0.15, 0.5, 0.95)))
    (alpha, eta, cos), above = zip(*cases, strict=True), kind != "below"
    x, y = np.repeat(np.array(alpha).T, n, axis=1)
    w = np.repeat(direction(np.array(cos), 0.4), n, axis=0)
    surface = (
        metal(SINGLE, x, y, distribution)
        if kind == "metal"
        else glass(SINGLE, np.repeat(eta, n), x, y, distribution)
    )
    o = draw(SINGLE, surface, w, rng, len(w), above, 1)
    value, pdf = ask(SINGLE, surface, w, o, above, "both", 2)
    assert np.all(value[pdf == 0] == 0)
    ratio = (value / np.where(pdf > 0, pdf, 1)).reshape(len(cases), n)
    mean, error = ratio.mean(axis=1), ratio.std(axis=1) / np.sqrt(n)
    # Nearly matched facets bend light by little, and several of them by little more: lobes so narrow that a mean of
    # this many values is nothing like normal. Those count below only, and by the samples of the next test.
    z = (mean - 1) / np.hypot(error, 2e-4) * (np.array(eta) != 1.05)
    assert np.abs(z).max() < 5, (cases[np.argmax(np.abs(z))], mean[np.argmax(np.abs(z))])
    assert np.average(mean, weights=error**-2) == pytest.approx(1, abs=2e-3)


@each_distribution
def test_all_light_gets_out(distribution: str, rng: np.random.Generator) -> None:
    """Every walk ends, on the right side, and one part of the light with the other is all of it."""
    n = 1 << 16
    w = SINGLE.vectors(direction(rng.uniform(1e-3, 1, n), rng.uniform(0, 6, n)))
    x, y = (SINGLE(10 ** rng.uniform(-3, 0, n)) for _ in range(2))
    u = numbers(SINGLE, rng, n)
    event = metal(SINGLE, back(x), back(y), distribution).sample(w, u, True, "both", streams(w, 1))
    assert np.allclose(back(event.weight), 1, atol=1e-4) and np.all(back(event.o)[:, 2] > 0)
    for above in (True, False):
        coat = glass(SINGLE, rng.uniform(1.05, 3, n), back(x), back(y), distribution)
        parts = []
        for seed, part in enumerate(("reflect", "transmit")):
            event = coat.sample(w, u, above, part, streams(w, seed))
            weight, z = back(event.weight), back(event.o)[:, 2]
            assert np.all((z > 0 if part == "reflect" else z < 0)[weight > 0])
            parts.append(weight)
        both = np.sum(parts, axis=0)
        assert abs(both.mean() - 1) < 4.5 * np.hypot(parts[0].std(), parts[1].std()) / np.sqrt(n)


@one_distribution
def test_sampling_agrees_with_the_values(distribution: str, rng: np.random.Generator) -> None:
    """What falls into each of a few wide cells of directions, from samples and from the flux density."""
    n, w = 1 << 17, direction(0.6, 0.3)
    edges = (np.array([-1, -0.8, -0.4, 0, 0.4, 0.8, 1.0]), np.linspace(-np.pi, np.pi, 5))

    def cells(o: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi = np.arctan2(o[:, 1], o[:, 0])
        first, second = (
            np.histogram2d(o[:, 2], phi, edges, weights=x)[0].ravel() / n for x in (weight, weight**2)
        )
        return first, np.sqrt(np.maximum(second - first**2, 0) / n)

    for interface, above in (
        (metal(SINGLE, 0.4, 0.8, distribution, GOLD, 25), True),
        (glass(SINGLE, 1.5, 0.6, 0.3, distribution, 25), True),
        (glass(SINGLE, 1.5, 0.4, 0.7, distribution, 25), False),
    ):
        parts = ("both",) if interface.opaque else ("both", "reflect", "transmit")
        one = SINGLE.vectors(spread(w[None], n))
        # Importance directions are in the frame of the facets.
        turned = back(interface.frame.enter(one))
        o = back(interface.frame.leave(SINGLE.vectors(draw(SINGLE, interface, turned, rng, n, above, 4))))
        value, pdf = ask(SINGLE, interface, w[None], o, above, "both", 5)
        values, error = cells(o, value / np.where(pdf > 0, pdf, 1))
        for part in parts:
            event = interface.sample(one, numbers(SINGLE, rng, n), above, part, streams(one, 6))
            found, spread_ = cells(back(event.o), back(event.weight))
            here = found > 0 if part == "both" else found > 1e-9
            z = (found - values)[here] / np.hypot(error, spread_)[here]
            assert here.sum() >= 6 and np.abs(z).max() < 4.5, (part, z)
            # All cells together say more of the energy than each of its share.
            more = found[here].sum() - values[here].sum()
            assert abs(more) < 4.5 * np.sqrt(np.sum(error[here] ** 2 + spread_[here] ** 2)), part


@one_distribution
def test_reciprocity(distribution: str, rng: np.random.Generator) -> None:
    """Of the mean, pair by pair: f |cos| both ways, in squared indices where light goes through."""
    n, pairs = 1 << 15, 12
    w, o = (np.repeat(hemisphere(rng, pairs, 0.15), n, axis=0) for _ in range(2))
    down = o * [1, 1, -1]
    flip = np.array([1, 1, -1])
    for interface in (
        metal(SINGLE, 0.5, 1.0, distribution, GOLD),
        glass(SINGLE, 1.5, 0.8, 0.5, distribution),
    ):
        ways = [
            (
                ask(SINGLE, interface, w, o, True, "both", 1),
                ask(SINGLE, interface, o, w, True, "both", 2),
                1.0,
            )
        ]
        if not interface.opaque:
            there, back_ = (
                ask(SINGLE, interface, w, down, True, "both", 3),
                ask(SINGLE, interface, o, w * flip, False, "both", 4),
            )
            ways.append((there, back_, 1.5**2))
        for (there, _), (again, _), scale in ways:
            one = (there / o[:, 2]).reshape(pairs, n)
            other = (again / w[:, 2] * scale).reshape(pairs, n)
            error = np.hypot(one.std(axis=1), other.std(axis=1)) / np.sqrt(n)
            z = (one.mean(axis=1) - other.mean(axis=1)) / (error + 1e-6)
            assert np.abs(z).max() < 4.5 and np.min(error / (one.mean(axis=1) + 1e-9)) < 0.03


@each_distribution
@each_side
def test_the_density_is_normalised(distribution: str, above: bool) -> None:
    """Over both sides, or the side of one part, by quadrature."""
    halves = [sphere(160, 256, low, low + 1) for low in (-1.0, 0.0)]
    o, solid = (np.concatenate(pair) for pair in zip(*halves, strict=True))
    for cos, alpha, eta in ((0.3, (0.3, 0.6), 1.5), (0.9, (1.0, 0.5), 1.5), (0.6, (0.2, 0.2), 3.0)):
        coat = glass(DOUBLE, eta, *alpha, distribution)
        w = DOUBLE.vectors(spread(direction(cos, 0.5)[None], len(o)))
        for part in ("both", "reflect", "transmit"):
            here = {"both": o[:, 2] != 0, "reflect": o[:, 2] > 0, "transmit": o[:, 2] < 0}[part]
            pdf = back(panes(coat.surface, coat._facet(above), w, DOUBLE.vectors(o), part))[here]
            assert np.sum(pdf * solid[here]) == pytest.approx(1, abs=3e-3)
            assert np.all(pdf > 0)


def test_the_density_is_the_same_function_everywhere(rng: np.random.Generator) -> None:
    n = 2000
    w = hemisphere(rng, n, 0.05)
    one, u = DOUBLE.vectors(w), numbers(DOUBLE, rng, n)
    for interface in (glass(DOUBLE, 1.5, 0.3, 0.5, rotation=20), metal(DOUBLE, 0.3, 0.5, rotation=20)):
        for above, part in ((True, "both"), (True, "reflect"), (False, "transmit")):
            event = interface.sample(one, u, above, part, streams(one, 3))
            alive = back(event.weight) > 0
            if interface.opaque and not above:
                continue
            _, pdf = ask(DOUBLE, interface, w, back(event.o), above, part, 9)
            assert alive.mean() > 0.05 and np.allclose(pdf[alive], back(event.pdf)[alive], rtol=1e-9)


def test_scalars_and_vectors_agree(rng: np.random.Generator) -> None:
    """Plain floats take the same walks as lanes, number by number, but where rounding decides."""
    import drjit.scalar as scalar

    n = 40
    w, u, o = (
        SINGLE.rounded(x) for x in (hemisphere(rng, n, 0.1), rng.random((n, 3)), hemisphere(rng, n, 0.1))
    )
    random = importlib.import_module("urushi.optics.random")
    for distribution in ("ggx", "beckmann"):
        surface = Microfacets(0.7, 0.4, distribution, "correlated")
        many = glass(SINGLE, 1.5, 0.7, 0.4, distribution)
        one = WalkedDielectric(BoundDielectric(1.5, surface, False, Frame(0.0)))
        lanes_w, lanes_o = SINGLE.vectors(w), SINGLE.vectors(o)
        stream = random.generator(lanes_w, [*lanes_w], 1, 2)
        event = many.sample(lanes_w, tuple(SINGLE(u[:, i]) for i in range(3)), True, "reflect", stream)
        value = many.reflect(lanes_w, lanes_o, True, "both", stream)[0]
        expected = np.column_stack([back(event.o), back(event.weight), back(value)])
        agree = []
        for i in range(n):
            v, direction_o = (scalar.Array3f64(*map(float, x[i])) for x in (w, o))
            stream = random.generator(v, [*v], 1, 2)
            event = one.sample(v, tuple(map(float, u[i])), True, "reflect", stream)
            found = [*event.o, event.weight, one.reflect(v, direction_o, True, "both", stream)[0]]
            agree.append(np.allclose(found, expected[i], rtol=1e-3, atol=1e-4))
        assert np.mean(agree) >= 0.9


@one_distribution
@pytest.mark.parametrize(
    "lanes", [pytest.param(SINGLE, id="single"), pytest.param(DOUBLE, id="double", marks=pytest.mark.slow)]
)
def test_extremes_stay_finite(lanes: Lanes, distribution: str, rng: np.random.Generator) -> None:
    """Sharp and rough, grazing and straight, nearly matched indices and high ones: finite and never negative."""
    n = 1 << 13
    cos = np.concatenate(
        [10.0 ** rng.uniform(-9, 0, n // 2), 1 - 10.0 ** rng.uniform(-9, 0, n // 4), np.ones(n // 4)]
    )
    w, o = (direction(rng.permutation(cos), rng.uniform(0, 6.3, n)) for _ in range(2))
    o[: n // 8], o[n // 8 : n // 4] = w[: n // 8] * [-1, -1, 1], w[n // 8 : n // 4]
    x, y = (rng.choice([1e-4, 1e-3, 0.1, 1.0], n) for _ in range(2))
    eta = rng.choice([1.00011, 1.05, 1.5, 5.0], n)
    one = lanes.vectors(w)
    for interface in (metal(lanes, x, y, distribution, GOLD), glass(lanes, eta, x, y, distribution)):
        for above in (True, False):
            for side in (1, -1):
                value, pdf = ask(lanes, interface, w, o * [1, 1, side], above, "both", 3)
                assert np.isfinite(value).all() and value.min() >= 0
                assert np.isfinite(pdf).all() and pdf.min() >= 0
            for part in ("both", "transmit"):
                event = interface.sample(one, numbers(lanes, rng, n), above, part, streams(one, 2))
                out, weight = back(event.o), back(event.weight)
                assert np.isfinite(weight).all() and weight.min() >= 0 and np.isfinite(back(event.pdf)).all()
                assert np.allclose(np.linalg.norm(out, axis=1), 1, atol=1e-3)


def test_smooth_and_matched_lanes_are_those_of_the_plain_interface(rng: np.random.Generator) -> None:
    n = 1000
    w, o = hemisphere(rng, n, 0.1), hemisphere(rng, n, 0.1)
    one, u = DOUBLE.vectors(w), numbers(DOUBLE, rng, n)
    alpha, smooth = np.full(n, 0.5), np.arange(n) % 2 == 0
    alpha[smooth] = 1e-4
    delta = DOUBLE(smooth.astype(float)) > 0.5
    for interface in (metal(DOUBLE, alpha, delta=delta), glass(DOUBLE, 1.5, alpha, delta=delta)):
        event, plain = (
            interface.sample(one, u, True, "both", streams(one, 1)),
            interface.once.sample(one, u, True),
        )
        for name in ("o", "weight"):
            assert np.allclose(back(getattr(event, name))[smooth], back(getattr(plain, name))[smooth])
            assert not np.allclose(back(getattr(event, name))[~smooth], back(getattr(plain, name))[~smooth])
        value, pdf = ask(DOUBLE, interface, w, o, True, "both", 1)
        assert np.all(value[smooth] == 0) and np.all(pdf[smooth] == 0) and np.all(value[~smooth] > 0)
        for found, expected in zip(
            interface.smooth_energy(one.z, True), interface.once.smooth_energy(one.z, True), strict=True
        ):
            assert np.all(back(found) == back(expected))


# A rough diffuse base. -----------------------------------------------------------------------------------------------


def matte(
    lanes: Lanes, reflectance: Any, alpha: Any, walks: bool, delta: Any = False, distribution: str = "ggx"
) -> Any:
    return RoughDiffuse(
        BoundDiffuse(reflectance), facets(lanes, alpha, None, distribution), delta, Frame(0.0), walks
    )


@each_distribution
def test_rough_diffuse(distribution: str, rng: np.random.Generator) -> None:
    """White facets send everything back if light goes on, and lose some if not; values and samples agree."""
    n = 1 << 17
    for walks, cos in itertools.product((True, False), (0.9, 0.2)):
        w = spread(direction(cos)[None], n)
        one, u = SINGLE.vectors(w), numbers(SINGLE, rng, n)
        o = hemisphere(rng, n)
        for reflectance in (1.0, 0.4):
            base = matte(SINGLE, SINGLE(reflectance), 0.7, walks, distribution=distribution)
            weight = back(base.sample(one, u, True, "both", streams(one, 1)).weight)
            value = ask(SINGLE, base, w, o, True, "both", 2)[0] * 2 * np.pi
            error = np.hypot(weight.std(), value.std()) / np.sqrt(n)
            assert abs(weight.mean() - value.mean()) < 4.5 * error
            if walks and reflectance == 1:
                assert np.all(weight == 1)
            else:
                assert weight.mean() < reflectance - 0.01


def test_rough_diffuse_is_reciprocal_and_lambert_where_smooth(rng: np.random.Generator) -> None:
    n, pairs = 1 << 15, 8
    w, o = (np.repeat(hemisphere(rng, pairs, 0.2), n, axis=0) for _ in range(2))
    for walks in (True, False):
        base = matte(SINGLE, SINGLE(0.8), 0.6, walks)
        one = (ask(SINGLE, base, w, o, True, "both", 1)[0] / o[:, 2]).reshape(pairs, n)
        other = (ask(SINGLE, base, o, w, True, "both", 2)[0] / w[:, 2]).reshape(pairs, n)
        error = np.hypot(one.std(axis=1), other.std(axis=1)) / np.sqrt(n)
        assert np.all(np.abs(one.mean(axis=1) - other.mean(axis=1)) < 4.5 * error)
    smooth = np.arange(len(w)) % 2 == 0
    base = matte(SINGLE, SINGLE(0.8), 0.6, True, SINGLE(smooth.astype(float)) > 0.5)
    value = ask(SINGLE, base, w, o, True, "both", 1)[0]
    lambert = 0.8 * o[:, 2] / np.pi
    assert np.allclose(value[smooth], lambert[smooth], rtol=1e-5) and not np.allclose(
        value, lambert, rtol=1e-2
    )


# Through the description and the solver. -----------------------------------------------------------------------------

WALK: dict[str, Any] = {"multiple_scattering": "walk"}


def lattice(n: int) -> np.ndarray:
    """Directions spread evenly over the hemisphere."""
    i = np.arange(n) + 0.5
    return direction(i / n, np.pi * (1 + np.sqrt(5)) * i)


@pytest.mark.parametrize(
    "layers",
    [
        [ur.Conductor(material="Au", alpha=(0.5, 0.2), rotation=30, distribution="beckmann", **WALK)],
        [ur.Dielectric(ior=1.5, alpha=0.3, **WALK), ur.Conductor(material="Au", alpha=0.5, **WALK)],
        [ur.Dielectric(ior=1.5, alpha=0.3, **WALK), ur.Diffuse((0.2, 0.5, 1.0), alpha=0.5, **WALK)],
    ],
    ids=["gold", "coated gold", "coated matte"],
)
def test_the_walk_takes_them(layers: list[Any]) -> None:
    """Reflectance from tracing and from the values, two ways through all of it."""
    n, wi = 2048, direction(0.7, 0.3)[None]
    bsdf = ur.solve(ur.Stack(layers=layers), "walk", samples=256)
    value, error = bsdf.eval(np.repeat(wi, n, axis=0), lattice(n), with_error=True)
    summed, spread_ = value.sum(axis=0) * 2 * np.pi / n, np.sqrt((error**2).sum(axis=0)) * 2 * np.pi / n
    bsdf = ur.solve(ur.Stack(layers=layers), "walk", samples=1 << 15)
    reflectance, own = bsdf.reflectance(wi, with_error=True)
    assert np.all(np.abs(summed - reflectance[0]) < 4 * np.hypot(spread_, own[0]) + 1e-3)
    assert np.all(own < 0.01)


def test_three_rough_coats_over_a_rough_mirror_lose_nothing() -> None:
    coats = [ur.Dielectric(ior=ior, alpha=0.3, **WALK) for ior in (1.3, 1.6, 1.33)]
    stack = ur.Stack(layers=[*coats, ur.Conductor(material="none", alpha=0.3, **WALK)])
    wi = direction(np.array([0.95, 0.5, 0.15]))
    found, error = ur.solve(stack, "walk", samples=1 << 17).reflectance(wi, with_error=True)
    assert np.all(error < 3e-3) and np.all(np.abs(found - 1) < 3e-3 + 2 * error)


def test_a_texture_of_roughness_may_be_smooth_in_places() -> None:
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1, **WALK), ur.Diffuse(0.5, alpha=0.1, **WALK)])
    alphas = np.array([0.0, 0.3, 0.0, 0.8])
    values = {"layer_0.alpha": alphas, "layer_1.alpha": alphas[::-1].copy()}
    bsdf = ur.solve(stack, "walk", samples=4096, parameters=values)
    wi, wo = direction(np.full(4, 0.8)), direction(np.full(4, 0.6), 2.0)
    found, error = bsdf.eval(wi, wo, with_error=True)
    for i, alpha in enumerate(alphas):
        one = stack.replace({"layer_0.alpha": float(alpha), "layer_1.alpha": float(alphas[3 - i])})
        expected, own = ur.solve(one, "walk", samples=4096).eval(wi[:1], wo[:1], with_error=True)
        assert np.all(np.abs(found[i] - expected[0]) < 4.5 * np.hypot(error[i], own[0]) + 1e-5)


def test_what_cannot_be_described() -> None:
    for layer in (ur.Dielectric, ur.Conductor):
        more = {"material": "Au"} if layer is ur.Conductor else {}
        with pytest.raises(MaterialError, match=r"masking: .*'separable'.*'walk'"):
            layer(alpha=0.1, masking="separable", **WALK, **more)
    with pytest.raises(MaterialError, match=r"multiple_scattering: found 'compensated'"):
        ur.Diffuse(0.5, alpha=0.1, multiple_scattering="compensated")
