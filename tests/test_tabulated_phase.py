"""A tabulated phase function: its description, its values and samples, its series, and both methods with it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from chi2 import SIGNIFICANCE, p_value, strata
from lanes import SINGLE, Lanes, back, both_precisions, needs_llvm, unit
from urushi.optics.phase import Tabulated
from urushi.solvers.adding import phase as series

TABLES = [
    (1.0, 1.0),
    (3.0, 1.0, 0.0),
    (0.0, 2.0, 0.0, 1.0),
    tuple(10 ** (3 * math.cos(a)) for a in np.linspace(0, np.pi, 181)),
    tuple(10 ** (-2 * math.cos(a)) for a in np.linspace(0, np.pi, 722)),
]
ids = pytest.mark.parametrize("values", TABLES, ids=lambda values: f"{len(values)} values")


def density(values: tuple[float, ...], cos: np.ndarray) -> np.ndarray:
    """The definition: linear in the cosine between equal steps of the angle, with an integral of 1."""
    nodes = np.cos(np.linspace(0, np.pi, len(values)))[::-1]
    table = np.array(values)[::-1]
    found = np.interp(cos, nodes, table) / (2 * np.pi * np.trapezoid(table, nodes))
    return np.asarray(found)


def directions(cos: np.ndarray, axis: np.ndarray) -> np.ndarray:
    side = unit(np.cross(axis, [0.36, 0.48, 0.8]))
    found: np.ndarray = cos[:, None] * axis + np.sqrt((1 - cos) * (1 + cos))[:, None] * side
    return found


@needs_llvm
@both_precisions
@ids
def test_values(values: tuple[float, ...], lanes: Lanes) -> None:
    cos = np.concatenate(
        [np.linspace(-1, 1, 301), 1 - 10.0 ** np.arange(-6, -1), 10.0 ** np.arange(-6, -1) - 1]
    )
    for axis in (np.array([0.0, 0.0, -1.0]), unit([1.0, -2.0, 0.5])):
        after = directions(cos, axis)
        found = back(Tabulated(values).eval(lanes.vectors(0 * after + axis), lanes.vectors(after)))
        truth = density(values, cos)
        assert np.allclose(
            found, truth, rtol=300 * lanes.exact, atol=1e3 * lanes.exact * truth.max() / len(values)
        )


@ids
def test_plain_floats(values: tuple[float, ...]) -> None:
    from drjit.scalar import Array3f64

    bound = Tabulated(values)
    for cos in (1.0, 0.9, 0.1, -0.4, -1.0):
        after = Array3f64(math.sqrt(1 - cos * cos), 0.0, cos)
        found = bound.eval(Array3f64(0.0, 0.0, 1.0), after)
        assert isinstance(found, float) and found == pytest.approx(
            density(values, np.array([cos]))[0], abs=1e-9
        )
    for u in (0.0, 0.3, 1 - 1e-12):
        out = bound.sample(Array3f64(0.0, 0.6, 0.8), u, 0.4)
        assert dr.norm(out) == pytest.approx(1, abs=1e-12)


@needs_llvm
@ids
def test_samples_follow_the_function(values: tuple[float, ...], rng: np.random.Generator) -> None:
    u = strata(rng, 512)
    before = SINGLE.vectors(unit(rng.normal(size=(len(u), 3))))
    after = Tabulated(values).sample(before, SINGLE(u[:, 0]), SINGLE(u[:, 1]))
    w, o = back(before), back(after)
    assert np.allclose(np.linalg.norm(o, axis=1), 1, atol=1e-6)
    limits = np.cos(np.linspace(np.pi, 0, 49))
    limits[[0, -1]] = -1.001, 1.001
    fine = np.linspace(-1, 1, 400001)
    mass = np.concatenate([[0], np.cumsum(0.5 * (density(values, fine)[1:] + density(values, fine)[:-1]))])
    expected = np.diff(np.interp(limits, fine, mass / mass[-1])) * len(u)
    counts = np.histogram(np.sum(w * o, axis=1), limits)[0]
    assert p_value(counts[expected > 0], expected[expected > 0]) > SIGNIFICANCE
    # At the ends, too: the distance to the nearest pole.
    away = np.minimum(np.sum((o - w) ** 2, axis=1), np.sum((o + w) ** 2, axis=1)) / 2
    near = np.linspace(0, 0.02, 9)
    both = np.interp(1 - near, fine, mass) - np.interp(near - 1, fine, mass)
    expected = -np.diff(both) / mass[-1] * len(u)
    counts = np.histogram(away, near)[0]
    assert (
        p_value(np.append(counts, len(u) - counts.sum()), np.append(expected, len(u) - expected.sum()))
        > SIGNIFICANCE
    )


@ids
def test_the_series(values: tuple[float, ...]) -> None:
    """Moments by a fine quadrature, and the same values as the walk has."""
    found = series.Tabulated(values)
    x, w = np.polynomial.legendre.leggauss(16)
    nodes = np.linspace(0, np.pi, len(values))
    for _ in range(3):
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
    nodes = np.cos(nodes)[::-1]
    cos = (nodes[:-1, None] + np.diff(nodes)[:, None] * (1 + x) / 2).ravel()
    weight = (np.diff(nodes)[:, None] * w / 2).ravel()
    assert np.allclose(found.eval(cos), density(values, cos), rtol=1e-9, atol=1e-12)
    moments = found.moments(60)
    for l in (0, 1, 2, 17, 59):  # noqa: E741
        legendre = np.polynomial.legendre.Legendre.basis(l)(cos)
        assert moments[l] == pytest.approx(2 * np.pi * (weight * density(values, cos)) @ legendre, abs=1e-9)
    assert moments[0] == pytest.approx(1, abs=1e-12)
    assert np.allclose(found.moments(900)[:60], moments, atol=1e-12)


def test_flat_or_not() -> None:
    assert Tabulated((1.0, 1.0)).flat and Tabulated((3.0, 1.0, 0.0)).flat and not Tabulated(TABLES[3]).flat


@needs_llvm
def test_a_table_of_a_known_function_is_that_function() -> None:
    """Henyey and Greenstein by 1000 values, in the walk: the same reflectance, within the noise."""
    angles = np.linspace(0, np.pi, 1000)
    values = series.HenyeyGreenstein(0.5).eval(np.cos(angles))
    wi = np.array([[0.6, 0.0, 0.8]])
    found = []
    for phase in (ur.Tabulated(values), ur.HenyeyGreenstein(0.5)):
        slab = ur.Stack(layers=[ur.Medium(depth=1.0, albedo=0.9, phase=phase)])
        bsdf = ur.solve(slab, "walk", samples=1 << 16)
        found.append(
            [bsdf.reflectance(wi, with_error=True), bsdf.eval(wi, -wi * (1, 1, -1), with_error=True)]
        )
    for (one, error), (other, other_error) in zip(*found, strict=True):
        assert np.all(np.abs(one - other) < 4 * np.hypot(error, other_error))


# ------------------------------------------------------------------------------------- description


@pytest.mark.parametrize(
    ("values", "where", "words"),
    [
        ([1.0], "values", "which has 1 values; allowed: a list of 2 to 4096 numbers"),
        ([1.0, -1.0], "values[1]", "found -1.0; allowed: a list"),
        ([0.0, 0.0], "values", "none of which is above 1e-12"),
        ([1.0, "much"], "values[1]", "found 'much'"),
        ([1.0, float("nan")], "values[1]", "not finite"),
        (3.0, "values", "found 3.0; allowed: a list"),
        ([1.0] * 5000, "values", "which has 5000 values"),
    ],
    ids=str,
)
def test_refusals(values: Any, where: str, words: str) -> None:
    with pytest.raises(ur.MaterialError) as error:
        ur.Tabulated(values)
    assert error.value.where == where and words in error.value.problem


def test_in_a_file(tmp_path: Path) -> None:
    stack = ur.Stack(layers=[ur.Medium(depth=1, albedo=1, phase=ur.Tabulated([2, 1.5, 0]))])
    assert stack.layers[0].phase == ur.Tabulated(np.array([2, 1.5, 0])) != ur.Tabulated([2, 1, 0])
    for name in ("a.yaml", "a.json"):
        ur.save(stack, tmp_path / name)
        assert ur.load(tmp_path / name) == stack
    assert "phase=Tabulated(values=(2.0, 1.5, 0.0))" in repr(stack)
    assert list(stack.parameters()) == ["layer_0.depth", "layer_0.albedo"]
