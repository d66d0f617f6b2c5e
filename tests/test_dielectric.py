"""The dielectric interface against Mitsuba's, and the laws of sampling, energy and reciprocity."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from against_mitsuba import Plugin
from lanes import DOUBLE, SINGLE, Lanes, back, direction, hemisphere, needs_llvm
from surface import albedo, check_samples, check_weights, evaluate, numbers, sample
from test_fresnel import complex_fresnel
from test_microfacet import smith_lambda, walter_g1
from urushi.interfaces import BoundDielectric
from urushi.interfaces.base import Frame
from urushi.optics.microfacet import Microfacets

pytestmark = needs_llvm

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
each_model = pytest.mark.parametrize(("distribution", "masking"), MODELS)
PARTS = ("both", "reflect", "transmit")


def rough(
    lanes: Lanes,
    eta: Any,
    alpha_x: Any,
    alpha_y: Any = None,
    distribution: str = "ggx",
    masking: str = "correlated",
    rotation: Any = 0.0,
    delta: Any = False,
) -> BoundDielectric:
    facets = Microfacets(
        lanes(alpha_x), lanes(alpha_x if alpha_y is None else alpha_y), distribution, masking
    )
    return BoundDielectric(lanes(eta), facets, delta, Frame(rotation))


def smooth(lanes: Lanes, eta: Any) -> BoundDielectric:
    return BoundDielectric(lanes(eta), None, True, Frame(0.0))


SIGNS = np.array([1, 1, -1])


def half_vector(w: np.ndarray, o: np.ndarray, eta: float) -> np.ndarray:
    m = np.where(o[:, 2:] > 0, w + o, w + eta * o)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    return np.where(m[:, 2:] < 0, -m, m)


@pytest.mark.parametrize("side", ["above", "below"])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_against_mitsuba(mi: Any, distribution: str, side: str, rng: np.random.Generator) -> None:
    """Values and densities for random pairs; Mitsuba computes in single precision, this in both."""
    above = side == "above"
    for alpha_x, alpha_y in [(0.1, 0.1), (0.5, 0.5), (0.05, 0.5), (1.0, 1.0)]:
        for index in (1.5, 1 / 1.5, 2.4):
            plugin = Plugin.load(
                mi,
                type="roughdielectric",
                distribution=distribution,
                alpha_u=alpha_x,
                alpha_v=alpha_y,
                int_ior=index if index > 1 else 1.0,
                ext_ior=1.0 if index > 1 else 1 / index,
            )
            w, o = (SINGLE.rounded(hemisphere(rng, 8000, 0.02)) for _ in range(2))
            o[::2, 2] *= -1
            # The interface is asked in a frame with w above; Mitsuba in that of the surface.
            theirs = (w, o) if above else (w * SIGNS, o * SIGNS)
            expected, pdf = plugin.eval_pdf(*theirs)
            expected = expected[:, 0]
            ratio = index if above else 1 / index
            if distribution == "beckmann":
                # Mitsuba's density takes Walter's fit for the masking of w, where this has Smith's.
                pdf = pdf / (
                    (1 + smith_lambda("beckmann", alpha_x, alpha_y, w)) * walter_g1(alpha_x, alpha_y, w)
                )
            exact = evaluate(
                DOUBLE, rough(DOUBLE, index, alpha_x, alpha_y, distribution, "separable"), w, o, above
            )
            found = evaluate(
                SINGLE, rough(SINGLE, index, alpha_x, alpha_y, distribution, "separable"), w, o, above
            )
            # Near the critical angle Mitsuba's 1 - F has few digits.
            m = half_vector(w, o, ratio)
            sin_sq = (1 - np.sum(w * m, axis=1) ** 2) / ratio**2
            clear = np.abs(1 - sin_sq) > 0.05
            for mine, single, reference in zip(exact, found, (expected, pdf), strict=True):
                lit = clear & (reference > 1e-6 * reference.max())
                assert np.mean(mine[clear] > 0) > 0.4
                error = np.abs(mine / np.where(reference > 0, reference, 1) - 1)[lit]
                assert np.quantile(error, 0.99) < 1e-5 and error.max() < 3e-4
                assert np.all(reference[mine == 0] <= 1e-4 * reference.max())
                lit = mine > 1e-6 * mine.max()
                error = np.abs(single[lit] / mine[lit] - 1)
                assert np.quantile(error, 0.99) < 1e-5 and error.max() < 5e-4


def test_radiance_is_flux_over_the_squared_index(mi: Any, rng: np.random.Generator) -> None:
    """What a solver scales once: Mitsuba's radiance mode divides what is transmitted by eta^2."""
    w, o = (SINGLE.rounded(hemisphere(rng, 2000, 0.1)) for _ in range(2))
    o[::2, 2] *= -1
    plugin = Plugin.load(
        mi, "Radiance", type="roughdielectric", distribution="ggx", alpha=0.4, int_ior=1.5, ext_ior=1.0
    )
    expected = plugin.eval_pdf(w, o)[0][:, 0]
    found, _ = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.4, masking="separable"), w, o)
    assert np.allclose(np.where(o[:, 2] < 0, found / 1.5**2, found), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("index", [1.5, 1 / 1.5, 1.1])
def test_smooth_against_mitsuba(mi: Any, index: float, rng: np.random.Generator) -> None:
    plugin = Plugin.load(
        mi, type="dielectric", int_ior=index if index > 1 else 1.0, ext_ior=1.0 if index > 1 else 1 / index
    )
    w, u = SINGLE.rounded(hemisphere(rng, 4000)), SINGLE.rounded(rng.random((4000, 3)))
    for above in (True, False):
        wo, weight, _ = plugin.sample(w if above else w * SIGNS, u)
        found = sample(SINGLE, smooth(SINGLE, index), w, u, above)
        # The choice itself may differ by a rounding of Fresnel's reflectance.
        cos, ratio = w[:, 2], index if above else 1 / index
        sure = np.abs(u[:, 0] - complex_fresnel(cos, ratio)) > 1e-4
        assert np.allclose(found.o[sure], (wo if above else wo * SIGNS)[sure], atol=2e-4)
        assert np.allclose(found.weight[sure], weight[sure, 0], atol=1e-5)
        assert np.median(np.abs(found.o - (wo if above else wo * SIGNS)).max(axis=1)) < 1e-6


@pytest.mark.parametrize("above", [True, False], ids=["above", "below"])
def test_smooth_parts(above: bool, rng: np.random.Generator) -> None:
    """Reflection and refraction on request carry F and 1 - F; `smooth_energy` says the same."""
    w, u = hemisphere(rng, 1000), np.full((1000, 3), 0.5)
    ratio = 1.5 if above else 1 / 1.5
    fresnel = complex_fresnel(w[:, 2], ratio)
    interface = smooth(DOUBLE, 1.5)
    reflected = sample(DOUBLE, interface, w, u, above, "reflect")
    assert np.allclose(reflected.weight, fresnel) and np.allclose(reflected.o, w * [-1, -1, 1])
    assert not reflected.through.any()
    refracted = sample(DOUBLE, interface, w, u, above, "transmit")
    some = fresnel < 1 - 1e-9
    assert np.allclose(refracted.weight, 1 - fresnel) and refracted.through.all()
    assert np.allclose(refracted.o[some, :2] * ratio, -w[some, :2]) and np.all(refracted.o[some, 2] < 0)
    energy = [back(x) for x in interface.smooth_energy(DOUBLE(w[:, 2]), above)]
    assert np.allclose(energy, [fresnel, 1 - fresnel])
    for value in (interface.reflect, interface.transmit):
        assert all(np.all(back(x) == 0) for x in value(DOUBLE.vectors(w), DOUBLE.vectors(w), above))


@each_model
@pytest.mark.parametrize("above", [True, False], ids=["above", "below"])
def test_weight_is_value_over_density(
    distribution: str, masking: str, above: bool, rng: np.random.Generator
) -> None:
    n = 1 << 14
    w, u = hemisphere(rng, n, 0.01), rng.random((n, 3))
    alpha = 10 ** rng.uniform(-3, 0, (2, n))
    eta = rng.choice([1 / 3, 1 / 1.5, 1.05, 1.5, 3.0], n)
    for part in PARTS:
        interface = rough(DOUBLE, eta, *alpha, distribution, masking, DOUBLE(rng.uniform(0, 360, n)))
        check_weights(DOUBLE, interface, w, u, above, part, 1e-6)
    # In single precision a lobe of this width is known to about three digits.
    wide = rough(SINGLE, eta, 0.3, 0.3, distribution, masking)
    found = sample(SINGLE, wide, w, u, above)
    value, pdf = evaluate(SINGLE, wide, w, found.o, above)
    sure = (found.weight > 0) & (np.abs(found.o[:, 2]) > 0.01)
    error = np.abs(value / np.maximum(pdf * found.weight, 1e-12) - 1)[sure]
    assert np.quantile(error, 0.99) < 1e-4
    error = np.abs(pdf / found.pdf - 1)[sure]
    assert np.quantile(error, 0.99) < 1e-2 and np.median(error) < 1e-5


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize(
    ("above", "cos"), [(True, 1.0), (True, 0.5), (True, 0.05), (False, 0.8), (False, 0.2)]
)
def test_samples_follow_the_density(
    distribution: str, above: bool, cos: float, rng: np.random.Generator
) -> None:
    """With either masking, which does not enter the density. Grazing rays are refracted into a sharp edge that
    quadrature does not resolve: there only the reflection."""
    w = direction(cos, 0.4)
    parts = PARTS if cos >= 0.5 else ("reflect",)
    for alpha, masking in (((0.3, 0.3), "correlated"), ((0.5, 0.2), "separable")):
        for part in parts:
            args = (1.5, *alpha, distribution, masking, 30.0)
            check_samples(rough(SINGLE, *args), rough(DOUBLE, *args), w, rng, above, part)  # type: ignore[arg-type]


@each_model
def test_energy(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """Never more comes back than went in; the integral of the value is the mean weight of the samples."""
    u = numbers(rng, 200)
    for eta, alpha, cos in itertools.product((1 / 1.5, 2.4), (0.25, 1.0), (0.3, 0.95)):
        interface, w = rough(DOUBLE, eta, alpha, alpha, distribution, masking), direction(cos, 1.0)
        total = albedo(interface, w)
        assert total <= 1 + 1e-4
        parts = [sample(DOUBLE, interface, w, u, part=part).weight.mean() for part in PARTS[1:]]
        # The steepest facets of GGX end abruptly, which costs the quadrature a digit.
        assert sum(parts) == pytest.approx(total, abs=1e-3 if distribution == "beckmann" else 3e-3)
    # Over the whole range of roughness and angle, by samples.
    few = u[::20]
    alpha, cos = (
        x.ravel() for x in np.meshgrid([1e-4, 1e-3, 0.01, 0.1, 1.0], [0.0, 1e-4, 1e-3, 0.02, 0.1, 0.5, 1.0])
    )
    rows = np.arange(len(cos)).repeat(len(few))
    interface = rough(SINGLE, 1.5, alpha[rows], alpha[rows], distribution, masking)
    for above in (True, False):
        weight = sample(SINGLE, interface, direction(cos[rows]), np.tile(few, (len(cos), 1)), above).weight
        assert weight.reshape(len(cos), -1).mean(axis=1).max() <= 1 + 1e-5


@each_model
def test_reciprocity(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """Helmholtz: K(a -> b) |cos a| n_a^2 = K(b -> a) |cos b| n_b^2, K being the flux density."""
    n = 4000
    a, b = hemisphere(rng, n, 0.01), hemisphere(rng, n, 0.01)
    eta, alpha = rng.uniform(0.4, 2.5, n), rng.uniform(0.05, 1, (2, n))
    interface = rough(DOUBLE, eta, *alpha, distribution, masking, DOUBLE(rng.uniform(0, 360, n)))
    there, back_again = evaluate(DOUBLE, interface, a, b)[0], evaluate(DOUBLE, interface, b, a)[0]
    assert np.all(there > 0) or distribution == "beckmann"
    assert np.allclose(there * a[:, 2], back_again * b[:, 2], rtol=1e-8, atol=1e-12)
    below = b * SIGNS
    there = evaluate(DOUBLE, interface, a, below)[0]
    # Seen from below, in the mirrored frame, b lies above and a below.
    back_again = evaluate(DOUBLE, interface, b, a * SIGNS, above=False)[0]
    assert np.mean(there > 0) > 0.1
    assert np.allclose(there * a[:, 2], back_again * b[:, 2] * eta**2, rtol=1e-6, atol=1e-12)


@each_model
def test_smooth_and_matched_lanes_among_rough_ones(
    distribution: str, masking: str, rng: np.random.Generator
) -> None:
    """Per-lane masks: a smooth lane is the smooth interface, an index-matched one is not there, a rough one rough."""
    n = 6000
    w, o, u = hemisphere(rng, n), hemisphere(rng, n), SINGLE.rounded(rng.random((n, 3)))
    w[:10] = direction(np.zeros(10))
    o[::2, 2] *= -1
    alpha, eta = np.full(n, 0.3), np.full(n, 1.5)
    alpha[::3], eta[1::3] = 0.0, 1.0
    smooth_lanes, matched, rest = (np.arange(n) % 3 == i for i in range(3))
    delta = (SINGLE(alpha) <= 0) | (SINGLE(eta) == 1)
    mixed = rough(SINGLE, eta, alpha, alpha, distribution, masking, delta=delta)
    only = rough(SINGLE, 1.5, 0.3, 0.3, distribution, masking)
    flat = smooth(SINGLE, 1.5)
    for above in (True, False):
        for part in PARTS:
            value, pdf = evaluate(SINGLE, mixed, w, o, above, part)
            assert np.all(value[~rest] == 0) and np.all(pdf[~rest] == 0)
            expected = evaluate(SINGLE, only, w, o, above, part)
            assert np.allclose(value[rest], expected[0][rest], rtol=1e-5)
            assert np.allclose(pdf[rest], expected[1][rest], rtol=1e-5)
            found = sample(SINGLE, mixed, w, u, above, part)
            assert np.all(np.isfinite(found.o[w[:, 2] > 0])) and np.all(np.isfinite(found.weight))
            there = sample(SINGLE, flat, w, u, above, part)
            seen = smooth_lanes & (w[:, 2] > 0) & (there.weight > 0)
            assert np.allclose(found.o[seen], there.o[seen], atol=1e-6)
            assert np.allclose(found.weight[seen], there.weight[seen], atol=1e-5)
            there = sample(SINGLE, only, w, u, above, part)
            assert np.allclose(found.weight[rest], there.weight[rest], atol=1e-5)
            if part == "reflect":
                assert np.all(found.weight[matched] == 0)
            else:
                assert np.allclose(found.o[matched], -w[matched], atol=1e-6)
                assert np.all(found.weight[matched] == 1)
        energy = [back(x) for x in mixed.smooth_energy(SINGLE(w[:, 2]), above)]
        fresnel = complex_fresnel(w[:, 2], 1.5 if above else 1 / 1.5)
        assert np.allclose(energy[0], np.where(smooth_lanes, fresnel, 0), atol=1e-5)
        assert np.allclose(energy[1], np.where(smooth_lanes, 1 - fresnel, matched), atol=1e-5)


@each_model
def test_nothing_breaks(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """A million random lanes in single precision: no NaN, no infinity, nothing negative."""
    n = 1 << 18
    w, o, u = hemisphere(rng, n), hemisphere(rng, n), rng.random((n, 3)) * (1 - 2.0**-23)
    w[: n // 4] = direction(10 ** rng.uniform(-9, 0, n // 4), rng.uniform(0, 7, n // 4))
    o[n // 8 : n // 2] = direction(
        10 ** rng.uniform(-9, 0, n // 2 - n // 8), rng.uniform(0, 7, n // 2 - n // 8)
    )
    w[:100], o[50:150], w[150:200] = [1, 0, 0], [0, 1, 0], [0, 0, 1]
    o[200:400] = w[200:400] * [-1, -1, 1]
    o[400:600] = w[400:600]
    alpha = np.where(rng.random((2, n)) < 0.1, 1.0, 10 ** rng.uniform(-4, 0, (2, n)))
    eta = np.exp(rng.uniform(-np.log(3), np.log(3), n))
    eta[: n // 8] = 1 + np.exp(rng.uniform(np.log(1e-4), 0, n // 8)) * rng.choice([-0.5, 1], n // 8)
    interface = rough(SINGLE, eta, *alpha, distribution, masking)
    for above in (True, False):
        for signs in (1, SIGNS):
            for found in evaluate(SINGLE, interface, w, o * signs, above):
                assert np.all(np.isfinite(found)) and found.min() >= 0
        for part in PARTS:
            event = sample(SINGLE, interface, w, u, above, part)  # type: ignore[arg-type]
            for found in (event.weight, event.pdf):
                assert np.all(np.isfinite(found)) and found.min() >= 0
            assert np.allclose(np.linalg.norm(event.o, axis=1)[event.weight > 0], 1, atol=1e-4)
            most = 1.004 if (distribution, masking) == ("beckmann", "separable") else 1 + 1e-5
            assert event.weight.max() <= most


def test_rotation_turns_the_lobe(rng: np.random.Generator) -> None:
    """Turning roughness, w and o together changes nothing; a quarter turn exchanges the two roughnesses."""
    w, o = hemisphere(rng, 500), hemisphere(rng, 500)
    o[::2, 2] *= -1
    degrees = rng.uniform(0, 360, 500)
    straight = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.1, 0.6), w, o)[0]
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))

    def turned(v: np.ndarray) -> np.ndarray:
        return np.stack([cos * v[:, 0] - sin * v[:, 1], sin * v[:, 0] + cos * v[:, 1], v[:, 2]], axis=1)

    both = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.1, 0.6, rotation=DOUBLE(degrees)), turned(w), turned(o))[0]
    assert np.allclose(straight, both, rtol=1e-8)
    alone = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.1, 0.6, rotation=DOUBLE(degrees)), w, o)[0]
    lit = straight > 0
    assert np.mean(lit) > 0.3 and np.mean(np.isclose(straight, alone, rtol=1e-2)[lit]) < 0.1
    quarter = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.1, 0.6, rotation=90.0), w, o)[0]
    exchanged = evaluate(DOUBLE, rough(DOUBLE, 1.5, 0.6, 0.1), w, o)[0]
    assert np.allclose(quarter, exchanged, rtol=1e-8)
    # Samples scatter along the rough axis, which points along x.
    u = numbers(rng, 64)
    for rotation, axis in ((0.0, 0), (90.0, 1)):
        found = sample(
            DOUBLE, rough(DOUBLE, 1.5, 0.6, 0.1, rotation=rotation), direction(1.0), u, part="reflect"
        )
        spread = found.o[:, :2].std(axis=0)
        assert spread[axis] > 3 * spread[1 - axis]


def test_lobe_is_a_sane_guess() -> None:
    cos = DOUBLE([0.1, 0.7, 1.0])
    for above in (True, False):
        r, t, alpha = (back(x) for x in rough(DOUBLE, 1.5, 0.2, 0.4).lobe(cos, above))
        assert np.allclose(r + t, 1) and np.all(alpha == 0.4)
    assert np.all(back(smooth(DOUBLE, 1.5).lobe(cos, True)[2]) == 0)
    interface = rough(DOUBLE, 1.5, 0.2)
    assert back(interface.ratio(True))[0] == pytest.approx(1.5)
    assert back(interface.ratio(False))[0] == pytest.approx(1 / 1.5)
