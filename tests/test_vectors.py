"""The small helpers for directions, in every precision and on plain floats."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import drjit.scalar
import numpy as np
import pytest

from chi2 import SIGNIFICANCE, p_value, strata
from lanes import DOUBLE, SINGLE, Lanes, back, both_precisions, hemisphere, needs_llvm, unit
from urushi.optics import vectors

pytestmark = needs_llvm


@both_precisions
def test_reflection_and_refraction(lanes: Lanes, rng: np.random.Generator) -> None:
    """In one plane, at equal angles; and as Snell says."""
    m = hemisphere(rng, 2000)
    w = unit(rng.normal(size=(2000, 3)))
    w = np.where(np.sum(w * m, axis=1)[:, None] < 0, -w, w)
    cos = np.sum(w * m, axis=1)
    o = back(vectors.reflect(lanes.vectors(w), lanes.vectors(m)))
    assert np.allclose(w + o, 2 * cos[:, None] * m, atol=10 * lanes.exact)
    eta = rng.uniform(0.3, 3, 2000)
    sin_t_sq = (1 - cos**2) / eta**2
    some = sin_t_sq < 0.99
    cos_t = np.sqrt(np.maximum(0, 1 - sin_t_sq))
    found = back(
        vectors.refract(lanes.vectors(w), lanes.vectors(m), lanes(cos), lanes(cos_t), lanes(1 / eta))
    )[some]
    assert np.allclose(np.linalg.norm(found, axis=1), 1, atol=10 * lanes.exact)
    assert np.allclose(np.sum(found * m[some], axis=1), -cos_t[some], atol=10 * lanes.exact)
    # eta sin_t = sin_i as vectors: the components along the facet are opposite, and in that ratio.
    along, onwards = (x - np.sum(x * m[some], axis=1)[:, None] * m[some] for x in (w[some], found))
    assert np.allclose(onwards * eta[some, None], -along, atol=30 * lanes.exact)


@both_precisions
def test_azimuth(lanes: Lanes) -> None:
    u = np.concatenate([np.linspace(0, 1, 10001)[:-1], [2.0**-24, 1 - 2.0**-24]])
    sin, cos = (back(x) for x in vectors.azimuth(lanes(u)))
    angle = 2 * np.pi * (lanes.rounded(u) - 0.5)
    room = 4e-7 if lanes is SINGLE else 1e-15
    assert np.abs(sin - np.sin(angle)).max() < room and np.abs(cos - np.cos(angle)).max() < room


@both_precisions
def test_around_an_axis(lanes: Lanes, rng: np.random.Generator) -> None:
    """The angle from the axis, and azimuths a quarter turn apart at right angles, also where the frame is touchy."""
    axes = unit(rng.normal(size=(1000, 3)))
    axes[:8] = unit(
        [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0), (1, 0, -1e-9), (1e-4, 0, -1), (0, 1e-7, -1), (1, 0, 0)]
    )
    axes[7, 2] = -0.0
    cos = np.resize([-1.0, -0.5, 0.0, 0.3, 0.999, 1.0], 1000)
    one, other = (
        back(vectors.around(lanes.vectors(axes), lanes(cos), lanes(u)))
        for u in (np.full(1000, 0.4), np.full(1000, 0.65))
    )
    room = 4 * lanes.exact
    for found in (one, other):
        assert np.allclose(np.linalg.norm(found, axis=1), 1, atol=room)
        assert np.allclose(np.sum(found * axes, axis=1), cos, atol=room)
    assert np.allclose(np.sum(one * other, axis=1), cos**2, atol=room)
    turn = np.sum(np.cross(one, other) * axes, axis=1)
    assert np.allclose(turn, 1 - cos**2, atol=room)  # counter-clockwise about the axis, everywhere


def test_cosine_hemisphere(rng: np.random.Generator) -> None:
    """cos^2 and the azimuth are uniform."""
    u = strata(rng, 256)
    o = back(vectors.cosine_hemisphere(SINGLE(u[:, 0]), SINGLE(u[:, 1]), SINGLE.vectors(np.zeros((1, 3)))))
    assert np.allclose(np.linalg.norm(o, axis=1), 1, atol=1e-6) and np.all(o[:, 2] >= 0)
    cells = np.histogram2d(o[:, 2] ** 2, np.arctan2(o[:, 1], o[:, 0]), 16, ((0, 1), (-np.pi, np.pi)))[0]
    assert p_value(cells, np.full(cells.shape, len(u) / cells.size)) > SIGNIFICANCE


def test_mirror_and_rotation() -> None:
    w = np.array([[0.6, 0.0, 0.8]])
    assert np.allclose(back(vectors.mirror(DOUBLE.vectors(w))), [[0.6, 0, -0.8]])
    turned = vectors.rotate(DOUBLE.vectors(w), math.cos(math.pi / 2), math.sin(math.pi / 2))
    assert np.allclose(back(turned), [[0, 0.6, 0.8]])  # counter-clockwise seen from above


def test_plain_floats_and_vectors_agree(rng: np.random.Generator) -> None:
    """One source: the scalar types take the same path, up to rounding."""
    for axis, cos, u in zip(
        unit(rng.normal(size=(20, 3))), rng.uniform(-1, 1, 20), rng.random(20), strict=True
    ):
        many = vectors.around(DOUBLE.vectors(axis[None]), DOUBLE(cos), DOUBLE(u))
        one = vectors.around(dr.scalar.Array3f64(*axis), float(cos), float(u))
        assert np.allclose(np.array(one), back(many)[0], atol=1e-6)


def test_types() -> None:
    import drjit.llvm.ad as llvm

    w = SINGLE.vectors(np.zeros((1, 3)))
    assert vectors.float_type(w) is llvm.Float and vectors.module_of(w) is llvm
    one = dr.scalar.Array3f(0, 0, 1)
    assert vectors.float_type(one) is float and vectors.module_of(one) is dr.scalar
    colour: Any = SINGLE.vectors(np.array([[0.1, 0.2, 0.4]]))
    assert vectors.channels(colour) == 3 and vectors.channels(SINGLE(1.0)) == 0 and vectors.channels(0.5) == 0
    assert back(vectors.total(colour))[0] == pytest.approx(0.7) and vectors.total(0.5) == 0.5
    assert back(vectors.peak(colour))[0] == pytest.approx(0.4) and vectors.peak(0.5) == 0.5
    assert vectors.total(SINGLE([1, 2])).shape == (2,)
    assert list(vectors.negate(llvm.Bool([True, False]))) == [False, True]
    assert vectors.negate(True) is False and vectors.negate(False) is True
