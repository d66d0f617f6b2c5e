"""Backward peaks that the nodes do not resolve; and sharp peaks either way against random walks from outside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drjit.llvm.ad import Float64

import urushi as ur
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.media import Scattering, slab
from urushi.solvers.adding.phase import HenyeyGreenstein, between
from urushi.solvers.adding.projection import Projection
from urushi.solvers.adding.retro import Retro, back, few, on
from urushi.solvers.adding.stencil import Lookup

DATA = json.loads((Path(__file__).parent / "data" / "peaks.json").read_text("utf-8"))


def stack(g: float, depth: float = 0.5, albedo: float = 0.9) -> ur.Stack:
    return ur.Stack(layers=[ur.Medium(depth=depth, albedo=albedo, phase=ur.HenyeyGreenstein(g=g))])


@pytest.mark.parametrize("t", [0.1, 1.0, 30.0])
def test_two_streams(t: float) -> None:
    """Against steps through the slab: dR/dt = x (1 + R^2) - 2 R, dT/dt = (x R - 1) T; and the first powers of x."""
    x, steps = 0.7, 20000
    r, passed, h = 0.0, 1.0, t / steps
    for _ in range(steps):
        middle = r + 0.5 * h * (x * (1 + r * r) - 2 * r)
        passed *= np.exp(h * (x * middle - 1))
        r += h * (x * (1 + middle * middle) - 2 * middle)
    assert back(x, t, np) == pytest.approx(r - x * 0.5 * -np.expm1(-2 * t), rel=1e-5, abs=1e-7)
    assert on(x, t, np) == pytest.approx(passed - np.exp(-t), rel=1e-4, abs=1e-12)
    two, three, four = few(t, np)
    x = 0.03
    assert back(x, t, np) == pytest.approx(three * x**3, rel=2e-3)
    assert on(x, t, np) == pytest.approx(two * x**2 + four * x**4, rel=1e-4 * (1 + t), abs=1e-15)
    assert four * x**4 > 1e-6 * two * x**2


@pytest.mark.parametrize("t", [0.3, 2.0])
def test_closed_form_and_nodes_are_two_streams(t: float) -> None:
    """Degree by degree: what is added, and what the nodes have less what is taken off, is all light to and fro."""
    g, terms, a = -0.9, 24, 0.95
    phase = HenyeyGreenstein(g)
    cut, retro = Truncated.of(phase, terms), Retro(phase, terms)
    f, b = cut.backward, np.abs(g) ** np.arange(400)
    v, sharp = np.full(400, f), np.zeros((5, 400))
    v[:terms] += cut.moments * (-1.0) ** np.arange(terms)
    for n in (2, 3, 4):
        sharp[n, :terms] = cut.times(n) * (-1.0) ** (n * np.arange(terms))
    two, three, four = few(t, np)
    angle = np.array([0.0, 0.02, 0.1, 0.4])
    away, toward = (Float64(4 * x(0.5 * angle) ** 2) for x in (np.sin, np.cos))
    table = Lookup(retro.values, Float64)
    degree = (2 * np.arange(400) + 1) / (4 * np.pi)
    for found, h, taken in (
        (retro.back(away, toward, Float64(t), Float64(a), table), back, a**3 * three * sharp[3]),
        (
            retro.on(away, toward, Float64(t), Float64(a), table),
            on,
            a**2 * two * sharp[2] + a**4 * four * sharp[4],
        ),
    ):
        nodes = h(a * v, t, np) - h(a * f, t, np) - taken
        truth = np.polynomial.legendre.legval(np.cos(angle), degree * (h(a * b, t, np) - nodes))
        whole = np.polynomial.legendre.legval(1.0, degree * h(a * b, t, np))
        assert np.abs(np.array(found) - truth).max() < 2e-4 * whole


def test_projection_is_the_series_where_the_nodes_resolve_it() -> None:
    """In two panels, all orders; and of more terms than nodes carry none comes back as light sent straight back."""
    grid, moments, orders = Grid.build([1.0, 1.5], 40), 0.5 ** np.arange(12), range(5)
    projection = Projection(grid, 1, len(moments))
    n = grid.count(1)
    for one, other in zip(
        projection.between(moments, orders, n - 3), between(grid.mu[1][3:], moments, orders), strict=True
    ):
        assert np.abs(one - other).max() < 1e-7
    air = Grid.build([1.0], 24)
    many = 0.999 ** np.arange(80)
    sharp = Projection(air, 0, 80)
    found = Scattering.build(air.mu[0], air.weights[0], many, range(3), projection=sharp)
    assert found.correction < 1e-9
    assert max(np.abs(np.linalg.eigvalsh(x)).max() for x in (found.even, found.odd)) < 1 + 1e-9
    plain = Scattering.build(air.mu[0], air.weights[0], many, range(3))
    assert np.abs(np.linalg.eigvalsh(plain.even)).max() > 1.1
    slab(found, np.ones(1), np.full(1, 0.9))


@pytest.mark.slow
@pytest.mark.parametrize("case", DATA["cases"], ids=lambda c: f"g{c['g']}depth{c['depth']}mu{c['mu']}")
def test_against_random_walks(case: dict[str, Any]) -> None:
    """Energies, and the flux around straight back and straight on, on few nodes."""
    g, mu, depth = case["g"], case["mu"], case["depth"]
    bsdf = ur.solve(stack(g, depth, case["albedo"]), "adding", nodes=90)
    sin = np.sqrt(1 - mu * mu)
    wi = np.array([[-sin, 0.0, mu]])

    def near(found: float, truth: list[float], share: float) -> None:
        assert abs(found - truth[0]) <= 4 * truth[1] + share * truth[0]

    near(bsdf.reflectance(wi)[0, 0], case["reflectance"], 1e-3)
    near(bsdf.transmittance(wi)[0, 0] - np.exp(-depth / mu), case["diffuse_transmittance"], 1e-3)
    x, w = np.polynomial.legendre.leggauss(20)
    azimuth = 2 * np.pi * (np.arange(16) + 0.5) / 16
    into = np.array([sin, 0.0, -mu])
    axes = np.array([mu, 0.0, sin]), np.array([0.0, 1.0, 0.0])
    for name, axis in (("cones_back", -into), ("cones_on", into)):
        for degrees, truth in zip(DATA["cones"], case[name], strict=True):
            half = 0.5 * np.radians(degrees)
            theta = half * (x + 1)
            around = np.cos(azimuth)[:, None] * axes[0] + np.sin(azimuth)[:, None] * axes[1]
            wo = np.cos(theta)[:, None, None] * axis + np.sin(theta)[:, None, None] * around
            value = bsdf.eval(np.repeat(wi, wo.shape[0] * wo.shape[1], axis=0), wo.reshape(-1, 3))[:, 0]
            flux = 2 * np.pi * half * (w * np.sin(theta)) @ value.reshape(len(theta), -1).mean(axis=1)
            near(float(flux), truth, 3e-3)


@pytest.mark.slow
def test_straight_back_by_what_is_scattered_again() -> None:
    """Where least light goes: f straight back of a strongly forward slab, less light scattered once."""
    case = DATA["cases"][0]
    g, (truth, error) = case["g"], case["backscatter_twice_or_more"]
    bsdf = ur.solve(stack(g), "adding")
    once = 0.9 * (1 - g * g) / (4 * np.pi * (1 + g) ** 3) * 0.5 * -np.expm1(-1.0)
    up = np.array([[0.0, 0.0, 1.0]])
    assert abs(bsdf.eval(up, up)[0, 0] - once - truth) < 4 * error


def test_strongly_backward_slabs_take_few_nodes() -> None:
    bsdf = ur.solve(stack(-0.97), "adding")
    assert bsdf.diagnostics["nodes"] <= 150 and bsdf.diagnostics["estimated_error"] <= 1e-3
