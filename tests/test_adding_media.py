"""Slabs for adding: closed forms, other programs, conservation, reciprocity, and three ways to the same answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from outside import cases
from urushi.adding import Slab, add, pile
from urushi.errors import UrushiError
from urushi.solvers.adding import single
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.media import Method, Scattering, slab
from urushi.solvers.adding.operator import OPERATORS
from urushi.solvers.adding.phase import (
    HenyeyGreenstein,
    Isotropic,
    Phase,
    Rayleigh,
)

AIR = Grid.build([1.0], 24)
PHASE_FUNCTIONS = {
    "isotropic": Isotropic(),
    "rayleigh": Rayleigh(),
    "forward": HenyeyGreenstein(0.5),
    "sharp": HenyeyGreenstein(0.99),
    "backward": HenyeyGreenstein(-0.99),
}
EXTREMES = [(1e-6, 0.5), (1e-6, 1.0), (1.0, 0.0), (1.0, 0.9), (1.0, 1.0), (1e3, 0.99), (1e3, 1.0), (1e6, 1.0)]


def medium(
    phase: Phase,
    depth: Any,
    albedo: Any,
    grid: Grid = AIR,
    region: int = 0,
    method: Method = "ordinates",
    orders: int | None = None,
) -> tuple[Slab, Scattering, Truncated]:
    """A slab of a region of a grid, with as many terms as there can be."""
    mu, weights = grid.mu[region], grid.weights[region]
    truncated = Truncated.fit(phase, mu, weights)
    scaled = truncated.scale(np.atleast_1d(depth), np.atleast_1d(albedo))
    m = range(len(truncated.moments) if orders is None else orders)
    scattering = Scattering.build(mu, weights, truncated.moments, m, truncated.backward)
    return slab(scattering, *scaled, method), scattering, truncated


def at(grid: Grid, region: int, cosines: Any, values: np.ndarray) -> np.ndarray:
    """Values (..., n) of an even order, between the nodes."""
    stencil = grid.stencil(region, np.atleast_1d(cosines))
    found: np.ndarray = (values[..., stencil.node] * stencil.even).sum(axis=-1)
    return found


def test_what_is_not_allowed() -> None:
    scattering = Scattering.build(AIR.mu[0], AIR.weights[0], np.ones(1), range(1))
    for depth, albedo, message in (
        (-1, 1, "depth"),
        (np.inf, 1, "depth"),
        (1, 1.1, "albedo"),
        (1, -0.1, "albedo"),
    ):
        with pytest.raises(UrushiError, match=f"medium: found {message}"):
            slab(scattering, np.array([depth]), np.array([albedo]))
    few = Grid.build([1.0], 8)
    sharp = Scattering.build(few.mu[0], few.weights[0], 0.95 ** np.arange(30), range(1))
    assert sharp.correction > 0.1
    with pytest.raises(UrushiError, match=r"8 nodes make it scatter .* use more nodes"):
        slab(sharp, np.ones(1), np.ones(1))


# ------------------------------------------------------------------------------------------- laws


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
@pytest.mark.parametrize(("depth", "albedo"), EXTREMES)
def test_energy_and_reciprocity(name: str, depth: float, albedo: float) -> None:
    for grid, region in ((AIR, 0), (Grid.build([1.0, 1.5], 16), 1)):
        found, _, _ = medium(PHASE_FUNCTIONS[name], depth, albedo, grid, region, orders=3)
        r, t = found.r_top, found.t_down
        assert found.symmetric
        total = r.albedo() + t.albedo()
        if albedo == 1:
            assert np.allclose(total, 1, rtol=0, atol=2e-12)
        else:
            assert np.all(total < 1 + 1e-12) and np.all(total >= 0)
        flux = grid.weights[region] * grid.mu[region]
        for part in (r, t):
            if part.dense is None:
                assert albedo == 0
                continue
            symmetric = part.dense / flux[:, None]
            assert np.allclose(symmetric, np.swapaxes(symmetric, 2, 3), rtol=1e-12, atol=1e-14)


def test_absorption_only_is_a_diagonal() -> None:
    for depth in (0.0, 0.3, 1e3):
        found, _, _ = medium(Isotropic(), depth, 0.0)
        assert found.r_top.delta is None and found.r_top.dense is None and found.t_down.dense is None
        assert np.allclose(found.t_up.delta, np.exp(-depth / AIR.mu[0]), rtol=1e-14, atol=1e-14)
    found, _, _ = medium(Isotropic(), 0.0, 1.0)
    assert np.all(found.t_up.delta == 1) and found.t_up.dense is None


def test_colours_are_solved_at_once() -> None:
    depth, albedo = np.array([0.5, 2.0, 0.5]), np.array([0.3, 1.0, 0.9])
    found, _, _ = medium(HenyeyGreenstein(0.6), depth, albedo, orders=4)
    for c in range(3):
        alone, _, _ = medium(HenyeyGreenstein(0.6), depth[c], albedo[c], orders=4)
        for one, other in zip(found, alone, strict=True):
            assert np.allclose(one.dense[c], other.dense[0], rtol=1e-9, atol=1e-13)
    one_albedo, _, _ = medium(HenyeyGreenstein(0.6), depth, 0.9, orders=2)
    assert one_albedo.r_top.dense.shape[:2] == (3, 2)


# ---------------------------------------------------------------------------- truth from outside


def test_anchors() -> None:
    """A(mu) and T(mu) of slabs without boundaries, by another doubling program (64 nodes; good to 5e-5)."""
    for depth, albedo, g, reflected, transmitted in (
        (1, 1.0, 0.0, {1: 0.34133, 0.5: 0.49837, 0.2: 0.64597}, {1: 0.65867}),
        (1, 0.9, 0.0, {1: 0.26740, 0.5: 0.39365, 0.2: 0.51940}, {1: 0.59158, 0.5: 0.41482}),
        (1, 0.9, 0.8, {1: 0.04236, 0.5: 0.14321, 0.2: 0.32997}, {1: 0.84535, 0.5: 0.64921}),
        (2, 0.5, 0.0, {1: 0.11283, 0.5: 0.15924}, {1: 0.18932, 0.5: 0.06140}),
        (10, 1.0, 0.0, {1: 0.85302, 0.5: 0.89825}, {1: 0.14700}),
        (1e6, 0.9, 0.0, {1: 0.41495}, {1: 0.0}),
    ):
        found, _, _ = medium(HenyeyGreenstein(g), depth, albedo, orders=1)
        for part, truth in ((found.r_top, reflected), (found.t_down, transmitted)):
            assert np.allclose(at(AIR, 0, list(truth), part.albedo()[0]), list(truth.values()), atol=5e-5)
    half_space, _, _ = medium(Isotropic(), 1e6, 0.9)
    assert 2 * AIR.etendue @ half_space.r_top.albedo()[0] == pytest.approx(0.47802, abs=6e-6)


def test_half_space_by_its_h_function() -> None:
    """Chandrasekhar: of an isotropic half-space, R(mu) = 1 - H(mu) sqrt(1 - albedo), H by its own integral equation."""
    x, w = np.polynomial.legendre.leggauss(200)
    mu, w = (0.5 * (1 + x)) ** 2, 0.5 * w * (1 + x)
    for albedo in (0.3, 0.9, 0.999):
        h = np.ones_like(mu)
        for _ in range(20000):
            new = 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * (mu / (mu + mu[:, None])) @ (w * h))
            done = np.max(np.abs(new - h)) < 1e-14
            h = new
            if done:
                break
        found, _, _ = medium(Isotropic(), 1e5, albedo)
        at_nodes = 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * (mu / (mu + AIR.mu[0][:, None])) @ (w * h))
        assert np.allclose(found.r_top.albedo(), 1 - at_nodes * np.sqrt(1 - albedo), atol=2e-7)


def angular(grid: Grid, case: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, float, float]:
    """f of reflection and transmission at the angles of a case, and R and T."""
    phase, mu0 = HenyeyGreenstein(case["g"]), case["mu0"]
    whole, scattering, truncated = medium(phase, case["tau"], case["omega"], grid)
    scaled = truncated.scale([case["tau"]], [case["omega"]])
    mus, phis = np.array(case["mus"]), np.array(case["phis"])
    cos_o, phi = (x.ravel() for x in np.meshgrid(mus, phis, indexing="ij"))
    once = single.single(
        phase, truncated, [case["tau"]], [case["omega"]], np.full_like(cos_o, mu0), cos_o, phi
    )
    mu, weights = grid.mu[0], grid.weights[0]
    into, out = grid.stencil(0, np.array([mu0])), grid.stencil(0, mus)
    found = []
    on_nodes = single.operators(scattering, *scaled)
    for part, exact, taken_off in zip((whole.r_top, whole.t_down), once, on_nodes, strict=True):
        rest = (part.dense - taken_off)[0] / weights[:, None] * (mu + mu[:, None]) / mu[:, None]
        value = exact[0].reshape(len(mus), len(phis)) / mus[:, None]
        for m, matrix in enumerate(rest):
            a, b = (out.odd, into.odd) if m % 2 else (out.even, into.even)
            between_nodes = np.einsum("okj,ok,j->o", matrix[out.node][:, :, into.node[0]], a, b[0])
            azimuth = (2 - (m == 0)) / (2 * np.pi) * np.cos(m * phis)
            value = value + (between_nodes / (mu0 + mus))[:, None] * azimuth
        found.append(value)
    unscattered = np.exp(-scaled[0] / mu)
    t = at(grid, 0, mu0, whole.t_down.albedo()[0] - unscattered)[0] + np.exp(-scaled[0][0] / mu0)
    return found[0], found[1], at(grid, 0, mu0, whole.r_top.albedo()[0])[0], t


@pytest.mark.parametrize(
    "case", cases("slab_disort"), ids=lambda case: f"{case['tau']} {case['g']} {case['mu0']}"
)
def test_discrete_ordinates(case: dict[str, Any]) -> None:
    """DISORT, 64 streams: R and T (which it knows to 1e-6) and every angle (to 1e-5)."""
    reflected, transmitted, r, t = angular(AIR, case)
    assert r == pytest.approx(case["R"], abs=4e-6) and t == pytest.approx(case["T"], abs=4e-6)
    assert np.allclose(reflected, case["brdf"], atol=3e-5) and np.allclose(
        transmitted, case["btdf"], atol=3e-5
    )


# ----------------------------------------------------------------------- one answer, several ways


@pytest.mark.parametrize(
    "phase", [Isotropic(), HenyeyGreenstein(0.8), Rayleigh()], ids=lambda p: type(p).__name__
)
@pytest.mark.parametrize(("depth", "albedo"), [(1e-6, 0.5), (0.3, 1.0), (1.0, 0.9), (20.0, 0.99)])
def test_doubling_agrees_with_the_modes(phase: Phase, depth: float, albedo: float) -> None:
    grid = Grid.build([1.0], 16)
    found, _, _ = medium(phase, depth, albedo, grid)
    doubled, _, _ = medium(phase, depth, albedo, grid, method="doubling")
    for one, other in zip(found[:2], doubled[:2], strict=True):
        assert np.max(np.abs(one.dense - other.dense)) < 1e-9 * np.max(np.abs(other.dense))


def test_piles_of_slabs_are_one_slab() -> None:
    phase = HenyeyGreenstein(0.5)
    whole, scattering, truncated = medium(phase, 1.4, 0.95)
    piece = slab(scattering, *truncated.scale([0.2], [0.95]))
    for found in (
        pile(piece, 7, OPERATORS),
        add(slab(scattering, *truncated.scale([1.2], [0.95])), piece, OPERATORS),
    ):
        for one, other in zip(found, whole, strict=True):
            assert np.allclose(one.dense, other.dense, atol=1e-10)
            assert one.delta is other.delta is None or np.allclose(
                one.delta, other.delta, rtol=1e-12, atol=1e-14
            )


@pytest.mark.parametrize(
    ("g", "depth", "albedo"),
    [(0.9, 1.0, 1.0), (0.99, 5.0, 1.0), (0.99, 100.0, 0.99), (-0.99, 1.0, 1.0), (-0.9, 5.0, 0.9)],
)
def test_peaks_too_sharp_for_the_nodes(g: float, depth: float, albedo: float) -> None:
    """With delta-M, 24 nodes are good to 5e-4 (to 4e-3 at a cosine of 0.05) of what 120 nodes find."""
    cosines = np.array([0.05, 0.2, 0.5, 0.8, 1.0])
    found = []
    for n in (24, 120):
        grid = Grid.build([1.0], n)
        whole, _, _ = medium(HenyeyGreenstein(g), depth, albedo, grid, orders=1)
        found.append(at(grid, 0, cosines, whole.r_top.albedo()[0]))
    error = np.abs(found[0] - found[1])
    assert error[0] < 4e-3 and np.max(error[1:]) < 5e-4
