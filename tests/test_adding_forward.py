"""Peaks that the nodes do not resolve: light scattered more than once on its way through a slab."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drjit.llvm.ad import Float64

import urushi as ur
from urushi.solvers.adding.core import Closed
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.peak import Peak, forward
from urushi.solvers.adding.phase import HenyeyGreenstein
from urushi.solvers.adding.retro import backward
from urushi.solvers.adding.stencil import Lookup


def direction(theta: np.ndarray, phi: np.ndarray | float, down: bool = False) -> np.ndarray:
    sin, cos = np.sin(theta), np.cos(theta)
    return np.stack(np.broadcast_arrays(sin * np.cos(phi), sin * np.sin(phi), -cos if down else cos), axis=-1)


@pytest.mark.parametrize(("y", "z"), [(0.05, 0.04), (0.8, 0.8), (3.0, 1.0)])
def test_peak_is_its_series(y: float, z: float) -> None:
    """With what the nodes say of it, light scattered at small angles is exp(y chi_l), all orders at once.

    Nodes scatter by v_l = f + rest_l instead of chi_l; of that, light scattered once and, along another way, the high
    degrees of light scattered two to eight times are taken off.
    """
    g, terms = 0.9, 20
    phase = HenyeyGreenstein(g)
    cut = Truncated.of(phase, terms)
    peak = Peak(phase, terms)
    assert cut.sharp and cut.again
    angle = np.array([0.0, 0.01, 0.05, 0.2, 0.7, 1.9, 3.0])
    chi, rest, taken = g ** np.arange(400), np.zeros(400), np.zeros(400)
    rest[:terms] = cut.moments * (1 - cut.forward)
    for n in range(2, 9):
        high = rest[:terms] ** n * (1 - np.exp(-((np.arange(terms) / 3) ** 2)))
        taken[:terms] += z ** (n - 1) / math.factorial(n) * high
    on_nodes = np.exp(y * rest) - 1 - y * rest
    truth = (np.exp(y * (chi - cut.forward)) - np.exp(-y * cut.forward) - on_nodes) / y + taken
    away, toward = (Float64(4 * x(0.5 * angle) ** 2) for x in (np.sin, np.cos))
    once = Float64(phase.eval(np.cos(angle)))
    found = np.array(peak.scattered(once, away, toward, Float64(y), Float64(z), Lookup(peak.values, Float64)))
    truth = np.polynomial.legendre.legval(np.cos(angle), (2 * np.arange(400) + 1) / (4 * np.pi) * truth)
    assert np.abs(found - truth).max() < 3e-5 * np.abs(truth).max()


def test_a_resolved_phase_function_has_no_peak() -> None:
    assert forward(HenyeyGreenstein(0.5), 60) is None and forward(HenyeyGreenstein(-0.99), 60) is None
    assert forward(HenyeyGreenstein(0.99), 60) is not None
    assert backward(HenyeyGreenstein(-0.5), 60) is None and backward(HenyeyGreenstein(0.99), 60) is None
    assert backward(HenyeyGreenstein(-0.99), 60) is not None


def slab(g: float, depth: float = 0.5, albedo: float = 0.9) -> ur.Stack:
    return ur.Stack(layers=[ur.Medium(depth=depth, albedo=albedo, phase=ur.HenyeyGreenstein(g=g))])


def test_strongly_forward_slabs_take_few_nodes() -> None:
    """And what a third of the nodes says differs by no more than both expect, straight on included."""
    bsdf = ur.solve(slab(0.97), "adding")
    assert bsdf.diagnostics["nodes"] <= 150 and bsdf.diagnostics["estimated_error"] <= 1e-3
    coarse = ur.solve(slab(0.97), "adding", nodes=60)
    theta = np.radians([0.0, 30.0, 60.0])
    away = np.radians([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
    wi = np.repeat(direction(theta, np.pi), len(away), axis=0)
    wo = direction((theta[:, None] + away).ravel(), 0.0, down=True)
    one, two = (b.eval(wi, wo)[:, 0].reshape(3, -1) for b in (bsdf, coarse))
    assert np.abs(one - two).max() < 2e-3 * one.max()
    back = bsdf.eval(wo, wi)[:, 0].reshape(3, -1) / np.abs(wi[:, 2]).reshape(3, -1)
    assert np.allclose(back, one / np.abs(wo[:, 2]).reshape(3, -1), rtol=1e-5)


def test_bright_slabs_take_as_few() -> None:
    """Where most light has been scattered again and again within the peak: on 82 nodes as on 123, straight on too."""
    bright = slab(0.99, 1.0, 1.0)
    few, more = (ur.solve(bright, "adding", nodes=n) for n in (82, 123))
    theta = np.radians([0.0, 34.0, 47.0, 59.0, 68.0])
    away = np.radians([0.0, 0.7, 2.0, 5.0])
    wi = np.repeat(direction(theta, np.pi), len(away), axis=0)
    wo = direction((theta[:, None] + away).ravel(), 0.0, down=True)
    one, two = (b.eval(wi, wo)[:, 0].reshape(5, -1) for b in (few, more))
    assert (np.abs(one - two).max(axis=1) < 2e-4 * two.max(axis=1)).all()


def test_without_the_peak_the_same_nodes_are_wrong() -> None:
    """The share of the correction itself: some per cent where it is looked for, nothing in reflection."""
    bsdf = ur.solve(slab(0.97), "adding", nodes=60)
    closed = Closed(bsdf.prepared.stack, bsdf.solution)
    assert closed.once is not None and closed.once.peaks.keys() == {1}
    mu, phi = np.array([1.0, 0.5, 0.2]), np.zeros(3)
    through, back = (closed.density(mu, mu, phi, True, up) for up in (False, True))
    closed.once.peaks = {}
    assert (np.abs(closed.density(mu, mu, phi, True, False) / through - 1) > 0.01).all()
    assert np.array_equal(closed.density(mu, mu, phi, True, True), back)


def test_sums_know_the_peak() -> None:
    """A slab between two planes of its own index, put together, is the slab."""
    whole = ur.solve(slab(0.95), "adding", nodes=40, indices=(1.0,))
    nothing = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.0)]), "adding", nodes=40, indices=(1.0,))
    both = ur.add(nothing, whole)
    assert both.solution.peaks.keys() == whole.solution.peaks.keys() == {1}


@pytest.mark.parametrize("kind", ["scalar", "llvm"])
def test_backends_agree(kind: str) -> None:
    bsdf = ur.solve(slab(0.95), "adding", nodes=30, backend=kind)
    wi, wo = direction(np.array([0.3]), np.pi), direction(np.array([0.32]), 0.0, down=True)
    truth = ur.solve(slab(0.95), "adding", nodes=30).eval(wi, wo)
    assert np.allclose(bsdf.eval(wi, wo), truth, rtol=1e-9)
