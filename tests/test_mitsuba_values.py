"""What the plugin answers: the means of the Python solver, decided by (wi, wo, uv, time, seed) and by nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import direction
from mitsuba_plugin import IMPORTANCE, RADIANCE, Asked, above, everywhere, layered

# A rough coat over a scattering medium and metal; rough glass that transmits; a scattering slab between smooth walls;
# anisotropic metal under lacquer; coloured absorption over a diffuse base.
PRESETS = ["enamel-on-gold", "frosted-glass", "milky-glass", "brushed-metal-lacquer", "urushi-red"]

SIGMAS = 5.5
"""Each comparison goes further by chance once in 26 million times, and there are about 400 in this file."""

PAIRS, COPIES = 12, 1 << 13


def pairs(stack: ur.Stack, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Directions on the sides where the stack scatters, away from grazing ones."""
    one = direction(rng.uniform(0.15, 1, PAIRS), rng.uniform(0, 2 * np.pi, PAIRS))
    other = direction(rng.uniform(0.15, 1, PAIRS), rng.uniform(0, 2 * np.pi, PAIRS))
    if not stack.layers[-1].opaque:
        one[PAIRS // 2 :, 2] *= -1
        other[::2, 2] *= -1
    return one, other


@pytest.mark.parametrize("mode", [RADIANCE, IMPORTANCE])
@pytest.mark.parametrize("name", PRESETS)
def test_its_mean_is_that_of_the_solver(mi, rng, name, mode):
    """Over many texture coordinates, hence many noises, against `ur.solve` and within both standard errors."""
    stack = ur.load(f"preset:{name}")
    wi, wo = pairs(stack, rng)
    solved = ur.solve(stack, method="walk", samples=1 << 13, mode=mode.lower(), backend="llvm")
    truth, error = solved.eval(wi, wo, with_error=True)
    many = np.repeat(wi, COPIES, axis=0), np.repeat(wo, COPIES, axis=0)
    asked = Asked.of(
        mi, layered(mi, filename=f"preset:{name}"), many[0], mode, uv=rng.random((len(many[0]), 2))
    )
    values = asked.value(many[1]).reshape(PAIRS, COPIES, 3)
    mean, spread = values.mean(axis=1), values.std(axis=1) / np.sqrt(COPIES)
    off = np.abs(mean - truth) / np.sqrt(error**2 + spread**2 + (2e-6 * truth + 1e-9) ** 2)
    assert off.max() < SIGMAS, (off.max(), mean[off > SIGMAS], truth[off > SIGMAS])
    # The comparison has to be sharp enough to see a per cent where most of the light is.
    assert np.sum(np.hypot(error, spread)) < 0.02 * np.sum(truth)


@pytest.mark.parametrize("name", PRESETS)
def test_its_density_is_that_of_the_solver(mi, rng, name):
    """`pdf` is a formula of the same directions: equal but for rounding."""
    stack = ur.load(f"preset:{name}")
    wi, wo = everywhere(rng, 500), everywhere(rng, 500)
    expected = ur.solve(stack, method="walk", backend="llvm").pdf(wi, wo)
    found = Asked.of(mi, layered(mi, filename=f"preset:{name}"), wi).density(wo)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-7)
    assert np.count_nonzero(found) > 100


def test_more_samples_average_the_same_noise_less(mi, rng):
    """16 samples: the same mean, a sixteenth of the variance (two of everything, so within a factor of 1.5)."""
    n = 1 << 14
    wi, wo = (np.repeat(direction(c, p)[None], n, axis=0) for c, p in ((0.8, 0.0), (0.6, 1.0)))
    uv = rng.random((n, 2))
    one, many = (
        Asked.of(mi, layered(mi, filename="preset:urushi-red", samples=s), wi, uv=uv).value(wo)[:, 0]
        for s in (1, 16)
    )
    assert abs(one.mean() - many.mean()) < SIGMAS * np.hypot(one.std(), many.std()) / np.sqrt(n)
    assert 16 / 1.5 < one.var() / many.var() < 16 * 1.5


def test_the_same_question_has_the_same_answer(mi, rng):
    """Asked again, of another object, in another order and in another batch: the same bits."""
    wi, wo, uv = everywhere(rng, 300), everywhere(rng, 300), rng.random((300, 2))
    u = rng.random((300, 3))
    bsdf, twin = (layered(mi, filename="preset:milky-glass") for _ in range(2))
    first = Asked.of(mi, bsdf, wi, uv=uv).value(wo)
    np.testing.assert_array_equal(first, Asked.of(mi, bsdf, wi, uv=uv).value(wo))
    np.testing.assert_array_equal(first, Asked.of(mi, twin, wi, uv=uv).value(wo))
    order = rng.permutation(300)[:77]
    np.testing.assert_array_equal(first[order], Asked.of(mi, twin, wi[order], uv=uv[order]).value(wo[order]))
    weights = [Asked.of(mi, b, wi, uv=uv).sample(u)[1] for b in (bsdf, twin)]
    np.testing.assert_array_equal(*weights)
    assert np.count_nonzero(first) > 100 and np.count_nonzero(weights[0]) > 100


@pytest.mark.parametrize(
    "change", [{"uv": (0.25, 0.75)}, {"uv": (0.5, 0.5)}, {"time": 0.5}, {"seed": 1}, {"seed": 2**32 - 1}]
)
def test_another_place_time_or_seed_is_another_noise(mi, rng, change):
    """Every lane with randomness in it changes, whichever part of the key does; the mean stays."""
    n = 4000
    wi, wo = above(rng, n), above(rng, n)
    change = dict(change)
    other = layered(mi, filename="preset:urushi-red", seed=change.pop("seed", 0))
    before = Asked.of(mi, layered(mi, filename="preset:urushi-red"), wi, uv=(0.25, 0.5)).value(wo)
    after = Asked.of(mi, other, wi, **{"uv": (0.25, 0.5), **change}).value(wo)
    assert np.mean(np.any(before != after, axis=1)) > 0.95
    difference = before - after
    assert np.all(np.abs(difference.mean(axis=0)) < SIGMAS * difference.std(axis=0) / np.sqrt(n))


@pytest.mark.parametrize("name", [*PRESETS, "thin-slab", "wet-stone"])
def test_a_sample_is_worth_what_eval_and_pdf_say(mi, rng, name):
    """weight = eval / pdf with the same noise, sample.pdf = pdf(sample.wo), but for delta parts, which both ignore."""
    n = 4000
    wi, u = everywhere(rng, n), rng.random((n, 3))
    asked = Asked.of(mi, layered(mi, filename=f"preset:{name}"), wi, uv=rng.random((n, 2)))
    sample, weight = asked.sample(u)
    wo, pdf, kind = (
        np.array(sample.wo).T,
        np.array(sample.pdf, dtype=np.float64),
        np.array(sample.sampled_type),
    )
    delta = (kind & int(mi.BSDFFlags.Delta)) != 0
    valid = pdf > 0
    assert np.all(weight[~valid] == 0) and np.isfinite(weight).all() and np.isfinite(pdf).all()
    np.testing.assert_allclose(np.linalg.norm(wo[valid], axis=1), 1, atol=1e-5)
    value, density = asked.value(wo), asked.density(wo)
    rough = valid & ~delta
    np.testing.assert_allclose(density[rough], pdf[rough], rtol=1e-3)
    np.testing.assert_allclose(value[rough] / density[rough][:, None], weight[rough], rtol=1e-3, atol=1e-6)
    up = wi[:, 2] > 0
    if name == "thin-slab":
        assert valid.mean() > 0.99 and np.all(delta[valid]) and not value.any() and not density.any()
    elif ur.load(f"preset:{name}").layers[-1].opaque:
        assert not valid[~up].any() and valid[up].mean() > 0.9
    else:
        assert valid.mean() > 0.9


def test_nothing_scatters_from_or_to_the_far_side_of_an_opaque_stack(mi, rng):
    wi, wo = everywhere(rng, 1000), everywhere(rng, 1000)
    asked = Asked.of(mi, layered(mi, filename="preset:urushi-red"), wi)
    hidden = (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    assert not asked.value(wo)[hidden].any() and not asked.density(wo)[hidden].any()
    assert asked.value(wo)[~hidden].all() and asked.density(wo)[~hidden].all()
