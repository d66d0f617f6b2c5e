"""Phase functions against quadrature and against Mitsuba's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from chi2 import SIGNIFICANCE, p_value, strata
from lanes import DOUBLE, SINGLE, Lanes, back, both_precisions, direction, needs_llvm, unit
from quadrature import gauss, midpoints
from urushi.optics.phase import PHASE_FUNCTIONS, HenyeyGreenstein, Isotropic, Rayleigh
from urushi.optics.vectors import channels

pytestmark = needs_llvm

ASYMMETRIES = [-0.999, -0.99, -0.7, -1e-4, 0.0, 1e-4, 0.3, 0.9, 0.99, 0.999]
CASES = [("isotropic", None), ("rayleigh", None), *(("henyey_greenstein", g) for g in ASYMMETRIES)]


def phase(lanes: Lanes, kind: str, g: float | None) -> Any:
    return PHASE_FUNCTIONS[kind](*([] if g is None else [lanes(g)]))


def by_angle(lanes: Lanes, bound: Any, cos: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The function of the scattering angle, for light that travels along `axis`."""
    side = unit(np.cross(axis, [0.36, 0.48, 0.8]))
    after = cos[:, None] * axis + np.sqrt((1 - cos) * (1 + cos))[:, None] * side
    return back(bound.eval(lanes.vectors(0 * after + axis), lanes.vectors(after)))


def peaked(g: float | None, x: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A quadrature of [0, 1] as one of the cosine that is fine where the function is large."""
    if g is None or g == 0:
        return 2 * x - 1, 2 * weight
    # 1 - cos = 2 ((1 + s)^x - 1) / s grades the distance to the peak from s upwards.
    scale = (2 / (1 - abs(g))) ** 2
    away = 2 * np.expm1(x * np.log1p(scale)) / scale
    return np.copysign(1, g) * (1 - away), weight * 2 * np.log1p(scale) * np.exp(x * np.log1p(scale)) / scale


@pytest.mark.parametrize(("kind", "g"), CASES)
def test_normalised_with_the_right_mean_cosine(kind: str, g: float | None) -> None:
    cos, weight = peaked(g, *gauss(400, 0, 1))
    values = by_angle(DOUBLE, phase(DOUBLE, kind, g), cos, np.array([0.0, 0.0, -1.0]))
    assert 2 * np.pi * values @ weight == pytest.approx(1, abs=1e-8)
    assert 2 * np.pi * (values * cos) @ weight == pytest.approx(g or 0, abs=1e-8)


@both_precisions
@pytest.mark.parametrize(("kind", "g"), CASES)
def test_against_the_closed_form(kind: str, g: float | None, lanes: Lanes) -> None:
    """The function depends on the angle alone, and is the textbook's."""
    cos = np.concatenate([np.linspace(-1, 1, 201), 1 - 10.0 ** np.arange(-7, -1)])
    if kind == "isotropic":
        expected = np.full_like(cos, 1 / (4 * np.pi))
    elif kind == "rayleigh":
        expected = 3 / (16 * np.pi) * (1 + cos**2)
    else:
        g = float(lanes.rounded(g))
        expected = (1 - g * g) / (4 * np.pi) / (1 + g * g - 2 * g * cos) ** 1.5
    for axis in (np.array([0.0, 0.0, -1.0]), unit([1.0, -2.0, 0.5])):
        found = by_angle(lanes, phase(lanes, kind, g), cos, axis)
        # Directions are known to one rounding, which at a sharp peak, of width 1 - |g|, is what limits the value.
        blunt = 4 * lanes.exact / (1 - abs(g or 0))
        assert np.allclose(found, expected, rtol=blunt)


@pytest.mark.parametrize(("kind", "g"), CASES)
def test_samples_follow_the_function(kind: str, g: float | None, rng: np.random.Generator) -> None:
    """Chi² over the cumulative distribution of the cosine, which the quadrature gives, and over the azimuth."""
    u = strata(rng, 512)
    before = SINGLE.vectors(unit(rng.normal(size=(len(u), 3))))
    bound = phase(SINGLE, kind, g)
    after = bound.sample(before, SINGLE(u[:, 0]), SINGLE(u[:, 1]))
    w, o = back(before), back(after)
    assert np.allclose(np.linalg.norm(o, axis=1), 1, atol=1e-6)
    found = np.sum(w * o, axis=1)
    # Half the squared distance to the peak tells angles apart where the cosine is 1 to single precision.
    peak = -w if (g or 0) < 0 else w
    away = np.sum((o - peak) ** 2, axis=1) / 2
    limits = np.geomspace(1e-3 * (1 - abs(g or 0)) ** 2, 2, 40)
    limits[0], limits[-1] = 0, 2.001
    cos, weight = peaked(g, midpoints(20000), np.full(20000, 1 / 20000))
    mass = 2 * np.pi * weight * by_angle(DOUBLE, phase(DOUBLE, kind, g), cos, np.array([0.0, 0.0, 1.0]))
    nodes = 1 - np.copysign(1.0, g or 0) * cos
    order = np.argsort(nodes)
    ranks = np.concatenate([[0], np.cumsum(mass[order]) - mass[order] / 2, [1]])
    expected = np.diff(np.interp(limits, np.concatenate([[0], nodes[order], [2]]), ranks)) * len(u)
    counts = np.histogram(away, limits)[0]
    expected *= len(u) / expected.sum()
    assert p_value(counts, expected) > SIGNIFICANCE
    assert found.mean() == pytest.approx(g or 0, abs=2e-3)
    # The azimuth about the axis, measured from a direction that moves smoothly with the axis.
    side = unit(np.cross(w, [0.0, 0.6, 0.8]))
    azimuth = np.arctan2(np.sum(o * np.cross(w, side), axis=1), np.sum(o * side, axis=1))
    if abs(g or 0) < 0.999:
        flat = np.histogram(azimuth, 64, (-np.pi, np.pi))[0]
        assert p_value(flat, np.full(64, len(u) / 64)) > SIGNIFICANCE


def test_samples_stay_on_the_sphere_at_the_edges() -> None:
    edges = np.array([0.0, 2.0**-24, 0.25, 0.5, 0.75, 1 - 2.0**-24])
    axes = np.array(
        [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0, -0.8], [1e-4, 0, -1], [1, 0, 1e-9], [1, 0, -1e-9]]
    )
    u1, u2, g, axis = (x.ravel() for x in np.meshgrid(edges, edges, ASYMMETRIES, np.arange(len(axes))))
    before = SINGLE.vectors(unit(axes[axis]))
    for bound in (Isotropic(), Rayleigh(), HenyeyGreenstein(SINGLE(g))):
        after = bound.sample(before, SINGLE(u1), SINGLE(u2))
        assert np.allclose(np.linalg.norm(back(after), axis=1), 1, atol=1e-6)
        value = back(bound.eval(before, after))
        assert np.all(np.isfinite(value)) and np.all(value > 0)


@pytest.mark.parametrize(("kind", "g"), [c for c in CASES if c[1] is None or abs(c[1]) <= 0.99])
def test_against_mitsuba(mi: Any, kind: str, g: float | None, rng: np.random.Generator) -> None:
    theirs = {"isotropic": "isotropic", "rayleigh": "rayleigh", "henyey_greenstein": "hg"}[kind]
    plugin = mi.load_dict({"type": theirs} | ({} if g is None else {"g": g}))
    before, after = (unit(rng.normal(size=(2000, 3))) for _ in range(2))
    mei = mi.MediumInteraction3f()
    mei.wi = -mi.Vector3f(SINGLE.vectors(before))
    _, expected = plugin.eval_pdf(mi.PhaseFunctionContext(), mei, mi.Vector3f(SINGLE.vectors(after)))
    found = back(phase(SINGLE, kind, g).eval(SINGLE.vectors(before), SINGLE.vectors(after)))
    # 1 + g^2 - 2 g cos, as Mitsuba has it, cancels near the peak.
    away = 1 - np.copysign(1.0, g or 1.0) * np.sum(before * after, axis=1)
    assert np.allclose(found, back(expected), rtol=1e-5 * np.maximum(1, 0.3 / away))


def test_a_colour_of_nothing() -> None:
    """A phase function gives one number per lane, not one per colour."""
    w = SINGLE.vectors(direction([0.3, -0.5]))
    for bound in (Isotropic(), Rayleigh(), HenyeyGreenstein(0.5)):
        assert channels(bound.eval(w, w)) == 0
