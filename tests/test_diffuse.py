"""Lambert's base."""

from __future__ import annotations

import numpy as np
import pytest

from lanes import DOUBLE, SINGLE, back, direction, hemisphere, needs_llvm
from surface import albedo, check_samples, check_weights, evaluate, sample
from urushi.interfaces import BoundDiffuse

pytestmark = needs_llvm

REFLECTANCE = (0.2, 0.5, 1.0)


def paper(lanes: object) -> BoundDiffuse:
    return BoundDiffuse(lanes.vector(*REFLECTANCE))  # type: ignore[attr-defined]


def test_value_and_energy(rng: np.random.Generator) -> None:
    w, o = hemisphere(rng, 1000), hemisphere(rng, 1000)
    o[::2, 2] *= -1
    value, pdf = evaluate(DOUBLE, paper(DOUBLE), w, o)
    up = np.maximum(o[:, 2], 0) / np.pi
    assert np.allclose(pdf, up) and np.allclose(value, up[:, None] * REFLECTANCE)
    assert np.allclose(albedo(paper(DOUBLE), direction(0.4)), REFLECTANCE, atol=1e-6)
    assert albedo(BoundDiffuse(DOUBLE(0.3)), direction(0.4)) == pytest.approx(0.3, abs=1e-6)


def test_against_mitsuba(mi: object, rng: np.random.Generator) -> None:
    from against_mitsuba import Plugin

    w, o = hemisphere(rng, 1000), hemisphere(rng, 1000)
    plugin = Plugin.load(mi, type="diffuse", reflectance={"type": "rgb", "value": list(REFLECTANCE)})
    for found, expected in zip(evaluate(SINGLE, paper(SINGLE), w, o), plugin.eval_pdf(w, o), strict=True):
        assert np.allclose(found, expected, rtol=1e-5)


def test_sampling(rng: np.random.Generator) -> None:
    for cos in (1.0, 0.1):
        check_samples(paper(SINGLE), paper(DOUBLE), direction(cos, 0.4), rng, True, "both")
    w, u = hemisphere(rng, 1000), rng.random((1000, 3))
    check_weights(DOUBLE, paper(DOUBLE), w, u, True, "both", 1e-10)
    found = sample(SINGLE, paper(SINGLE), w, u)
    assert np.allclose(found.weight, REFLECTANCE) and not found.through.any()
    assert paper(SINGLE).opaque and paper(SINGLE).flat and paper(SINGLE).delta is False


def test_no_smooth_energy_and_the_widest_lobe() -> None:
    cos = SINGLE([0.0, 0.5, 1.0])
    assert all(np.all(back(x) == 0) for x in paper(SINGLE).smooth_energy(cos, True))
    reflectance, transmittance, alpha = paper(SINGLE).lobe(cos, True)
    assert np.allclose(back(reflectance), REFLECTANCE)
    assert np.all(back(transmittance) == 0) and np.all(back(alpha) == 1)
