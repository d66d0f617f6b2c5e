"""The conductor against Mitsuba's, and the laws of sampling, energy and reciprocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from against_mitsuba import Plugin
from lanes import DOUBLE, SINGLE, Lanes, back, direction, hemisphere, needs_llvm
from surface import albedo, check_samples, check_weights, evaluate, numbers, sample
from test_fresnel import complex_fresnel
from test_microfacet import ALBEDO, ALBEDO_COSINES, smith_lambda, walter_g1
from urushi.interfaces import BoundConductor
from urushi.interfaces.base import Frame
from urushi.optics.ior import conductor_rgb
from urushi.optics.microfacet import Microfacets

pytestmark = needs_llvm

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
each_model = pytest.mark.parametrize(("distribution", "masking"), MODELS)
GOLD = conductor_rgb("Au")
MIRROR = ((0.0,) * 3, (1.0,) * 3)


def colour(lanes: Lanes, rgb: Any) -> Any:
    return lanes.vector(*(lanes(x) for x in rgb))


def metal(
    lanes: Lanes,
    alpha_x: Any,
    alpha_y: Any = None,
    distribution: str = "ggx",
    masking: str = "correlated",
    index: Any = GOLD,
    exterior: Any = 1.0,
    rotation: Any = 0.0,
    delta: Any = False,
) -> BoundConductor:
    eta, k = (colour(lanes, x) for x in index)
    smooth = alpha_x is None
    facets = None
    if not smooth:
        alphas = lanes(alpha_x), lanes(alpha_x if alpha_y is None else alpha_y)
        facets = Microfacets(*alphas, distribution, masking)
    return BoundConductor(eta, k, exterior, facets, True if smooth else delta, Frame(rotation))


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_against_mitsuba(mi: Any, distribution: str, rng: np.random.Generator) -> None:
    """Values and densities in all channels, for random pairs."""
    w, o = (SINGLE.rounded(hemisphere(rng, 8000, 0.02)) for _ in range(2))
    for alpha_x, alpha_y in [(0.1, 0.1), (0.5, 0.5), (0.05, 0.5), (1.0, 1.0)]:
        plugin = Plugin.load(
            mi,
            type="roughconductor",
            material="Au",
            distribution=distribution,
            alpha_u=alpha_x,
            alpha_v=alpha_y,
        )
        expected, pdf = plugin.eval_pdf(w, o)
        if distribution == "beckmann":
            # Mitsuba's density takes Walter's fit for the masking of w, where this has Smith's.
            pdf = pdf / ((1 + smith_lambda("beckmann", alpha_x, alpha_y, w)) * walter_g1(alpha_x, alpha_y, w))
        for lanes in (SINGLE, DOUBLE):
            found = evaluate(lanes, metal(lanes, alpha_x, alpha_y, distribution, "separable"), w, o)
            for mine, reference in zip(found, (expected, pdf), strict=True):
                lit = reference > 1e-6 * reference.max()
                error = np.abs(mine[lit] / reference[lit] - 1)
                assert np.quantile(error, 0.99) < 1e-5 and error.max() < 1e-4
                assert mine[~lit].max(initial=0) <= 1e-5 * reference.max()


def test_smooth_against_mitsuba(mi: Any, rng: np.random.Generator) -> None:
    w, u = SINGLE.rounded(hemisphere(rng, 2000)), rng.random((2000, 3))
    for name in ("Au", "Ag", "none"):
        wo, weight, _ = Plugin.load(mi, type="conductor", material=name).sample(w, u)
        interface = metal(SINGLE, None, index=conductor_rgb(name) if name != "none" else MIRROR)
        found = sample(SINGLE, interface, w, u)
        assert np.allclose(found.o, wo, atol=1e-6) and not found.through.any()
        assert np.allclose(found.weight, weight, atol=2e-6)
        assert np.allclose(back(interface.smooth_energy(SINGLE(w[:, 2]), True)[0]), weight, atol=2e-6)


def test_under_a_medium(rng: np.random.Generator) -> None:
    """The index counts relative to what lies above, per lane too."""
    w, exterior = hemisphere(rng, 500), rng.uniform(1, 2, 500)
    found = sample(DOUBLE, metal(DOUBLE, None, exterior=DOUBLE(exterior)), w, np.zeros((500, 3))).weight
    for c in range(3):
        eta, k = GOLD[0][c] / exterior, GOLD[1][c] / exterior
        assert np.allclose(found[:, c], complex_fresnel(w[:, 2], eta, k), atol=1e-12)


@each_model
def test_weight_is_value_over_density(distribution: str, masking: str, rng: np.random.Generator) -> None:
    n = 1 << 14
    w, u = hemisphere(rng, n, 0.01), rng.random((n, 3))
    alpha = 10 ** rng.uniform(-3, 0, (2, n))
    args = (*alpha, distribution, masking)
    interface = metal(DOUBLE, *args, rotation=DOUBLE(rng.uniform(0, 360, n)))
    for part in ("both", "reflect"):
        check_weights(DOUBLE, interface, w, u, True, part, 1e-6)  # type: ignore[arg-type]
    assert np.all(back(interface.transmit(DOUBLE.vectors(w), DOUBLE.vectors(-w), True)[0]) == 0)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("cos", [1.0, 0.5, 0.05])
def test_samples_follow_the_density(distribution: str, cos: float, rng: np.random.Generator) -> None:
    for alpha in ((0.3, 0.3), (0.6, 0.15)):
        args = (*alpha, distribution)
        single, double = metal(SINGLE, *args, rotation=30.0), metal(DOUBLE, *args, rotation=30.0)
        check_samples(single, double, direction(cos, 0.4), rng, True, "reflect")


@each_model
def test_energy(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """A perfect mirror's facets give the albedo of the table, by integral and by samples, and never more than 1."""
    u = numbers(rng, 200)
    for alpha in (0.3, 0.5, 1.0):
        mirror = metal(DOUBLE, alpha, None, distribution, masking, MIRROR)
        for cos in (0.3, 0.9):
            w = direction(cos, 1.0)
            total = albedo(mirror, w)
            assert np.all(total <= 1 + 1e-5)
            assert np.allclose(sample(DOUBLE, mirror, w, u).weight.mean(axis=0), total, atol=1e-3)
            if distribution == "ggx" and (masking, alpha) in ALBEDO:
                assert np.allclose(total, ALBEDO[masking, alpha][ALBEDO_COSINES.index(cos)], atol=1e-3)
    few = u[::20]
    alpha, cos = (
        x.ravel() for x in np.meshgrid([1e-4, 1e-3, 0.01, 0.1, 1.0], [0, 1e-4, 1e-3, 0.02, 0.1, 0.5, 1])
    )
    rows = np.arange(len(cos)).repeat(len(few))
    interface = metal(SINGLE, alpha[rows], None, distribution, masking, MIRROR)
    weight = sample(SINGLE, interface, direction(cos[rows]), np.tile(few, (len(cos), 1))).weight
    assert weight.reshape(len(cos), -1).mean(axis=1).max() <= 1 + 1e-5


@each_model
def test_reciprocity_and_rotation(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """K(a -> b) |cos a| = K(b -> a) |cos b|; turning everything together changes nothing."""
    n = 4000
    a, b, degrees = hemisphere(rng, n, 0.01), hemisphere(rng, n, 0.01), rng.uniform(0, 360, n)
    alpha = rng.uniform(0.05, 1, (2, n))
    interface = metal(DOUBLE, *alpha, distribution, masking, rotation=DOUBLE(degrees))
    there, back_again = evaluate(DOUBLE, interface, a, b)[0], evaluate(DOUBLE, interface, b, a)[0]
    assert np.allclose(there * a[:, 2:], back_again * b[:, 2:], rtol=1e-8, atol=1e-12)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))

    def turned_back(v: np.ndarray) -> np.ndarray:
        return np.stack([cos * v[:, 0] + sin * v[:, 1], cos * v[:, 1] - sin * v[:, 0], v[:, 2]], axis=1)

    straight = evaluate(DOUBLE, metal(DOUBLE, *alpha, distribution, masking), turned_back(a), turned_back(b))[
        0
    ]
    assert np.allclose(there, straight, rtol=1e-8, atol=1e-12)
    alone = evaluate(DOUBLE, metal(DOUBLE, *alpha, distribution, masking), a, b)[0]
    assert not np.allclose(there, alone, rtol=0.1)


@each_model
def test_nothing_breaks(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """Random lanes in single precision, metals with empty channels among them: no NaN, infinity or negative number."""
    n = 1 << 17
    w, o, u = hemisphere(rng, n), hemisphere(rng, n), rng.random((n, 3)) * (1 - 2.0**-23)
    w[: n // 4] = direction(10 ** rng.uniform(-9, 0, n // 4), rng.uniform(0, 7, n // 4))
    o[n // 8 : n // 2] = direction(
        10 ** rng.uniform(-9, 0, n // 2 - n // 8), rng.uniform(0, 7, n // 2 - n // 8)
    )
    w[:100], o[50:150], w[150:200] = [1, 0, 0], [0, 1, 0], [0, 0, 1]
    o[200:400], o[400:600] = w[200:400] * [-1, -1, 1], w[400:600]
    alpha = np.where(rng.random((2, n)) < 0.1, 1.0, 10 ** rng.uniform(-4, 0, (2, n)))
    eta, k = (np.where(rng.random((3, n)) < 0.2, 0.0, 10 ** rng.uniform(-6, 1.4, (3, n))) for _ in range(2))
    interface = metal(SINGLE, *alpha, distribution, masking, (eta, k))
    for found in evaluate(SINGLE, interface, w, o):
        assert np.all(np.isfinite(found)) and found.min() >= 0
    event = sample(SINGLE, interface, w, u)
    for found in (event.weight, event.pdf):
        assert np.all(np.isfinite(found)) and found.min() >= 0
    assert event.weight.max() <= 1.004


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_smooth_lanes_among_rough_ones(distribution: str, rng: np.random.Generator) -> None:
    n = 3000
    w, o, u = hemisphere(rng, n), hemisphere(rng, n), rng.random((n, 3)) * (1 - 2.0**-23)
    w[:10] = direction(np.zeros(10))
    alpha = np.where(np.arange(n) % 2 == 0, 0.0, 0.3)
    mixed = metal(SINGLE, alpha, None, distribution, delta=SINGLE(alpha) <= 0)
    value, pdf = evaluate(SINGLE, mixed, w, o)
    assert np.all(value[::2] == 0) and np.all(pdf[::2] == 0)
    expected = evaluate(SINGLE, metal(SINGLE, 0.3, None, distribution), w, o)
    assert np.allclose(value[1::2], expected[0][1::2], rtol=1e-5)
    assert np.allclose(pdf[1::2], expected[1][1::2], rtol=1e-5)
    found, there = sample(SINGLE, mixed, w, u), sample(SINGLE, metal(SINGLE, None), w, u)
    assert np.all(np.isfinite(found.weight))
    assert np.allclose(found.o[10::2], there.o[10::2], atol=1e-6)
    assert np.allclose(found.weight[10::2], there.weight[10::2], atol=1e-5)
    energy = back(mixed.smooth_energy(SINGLE(w[:, 2]), True)[0])
    assert np.all(energy[1::2] == 0) and np.allclose(energy[::2], there.weight[::2], atol=1e-5)
    guess = [back(x) for x in mixed.lobe(SINGLE(w[:, 2]), True)]
    assert np.allclose(guess[0], there.weight, atol=1e-5) and np.all(guess[1] == 0)
    assert np.allclose(guess[2], alpha)
