"""Smooth interfaces for adding, and stacks of them with media between: closed forms and other programs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanes import DOUBLE, needs_llvm
from outside import cases
from urushi.adding import Slab, add
from urushi.interfaces.base import Frame
from urushi.interfaces.conductor import BoundConductor
from urushi.interfaces.dielectric import BoundDielectric
from urushi.interfaces.null import Null
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.media import Scattering, slab
from urushi.solvers.adding.operator import OPERATORS, Operator
from urushi.solvers.adding.phase import HenyeyGreenstein, Isotropic, Phase
from urushi.solvers.adding.smooth import smooth

pytestmark = needs_llvm


def dielectric(eta: float) -> BoundDielectric:
    return BoundDielectric(eta, None, True, Frame(0.0))


def surfaces(grid: Grid) -> list[Slab]:
    """The smooth interfaces between all regions of a grid."""
    return [
        smooth(dielectric(below / above), grid, region)
        for region, (above, below) in enumerate(zip(grid.indices, grid.indices[1:], strict=False))
    ]


def medium(
    grid: Grid, region: int, depth: Any, albedo: Any, phase: Phase | None = None, orders: int = 1
) -> Slab:
    mu, weights = grid.mu[region], grid.weights[region]
    truncated = Truncated.fit(phase or Isotropic(), mu, weights)
    scattering = Scattering.build(mu, weights, truncated.moments, range(orders), truncated.backward)
    return slab(scattering, *truncated.scale(np.atleast_1d(depth), np.atleast_1d(albedo)))


def stacked(*layers: Slab) -> Slab:
    whole = layers[0]
    for layer in layers[1:]:
        whole = add(whole, layer, OPERATORS)
    return whole


def fresnel(cos: np.ndarray, eta: complex) -> np.ndarray:
    """Unpolarised reflectance by Fresnel's equations (Hecht), eta relative and perhaps complex."""
    cos_t = np.sqrt(1 - (1 - cos.astype(complex) ** 2) / eta**2)
    s = (cos - eta * cos_t) / (cos + eta * cos_t)
    p = (eta * cos - cos_t) / (eta * cos + cos_t)
    found: np.ndarray = 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)
    return found


@pytest.mark.parametrize("indices", [(1.0, 1.5), (1.5, 1.0), (1.33, 1.33001)], ids=str)
def test_dielectric(indices: tuple[float, float]) -> None:
    grid = Grid.build(indices, 16)
    (found,) = surfaces(grid)
    rare = int(indices[1] < indices[0])
    n = grid.count(rare)
    truth = fresnel(grid.mu[rare], indices[1 - rare] / indices[rare])
    for part in (found.r_top, found.r_bottom):
        assert part.dense is None and part.shape == (part.delta.shape[1],) * 2
        assert np.allclose(part.delta[0, :n], truth, rtol=1e-8, atol=1e-13)
        assert np.all(part.delta[0, n:] == 1)
    assert np.array_equal(found.t_down.delta, found.t_up.delta)  # reciprocity, exactly
    assert np.allclose(found.t_down.delta[0], 1 - truth, rtol=1e-9, atol=1e-14)
    assert found.t_down.shape == found.t_up.shape[::-1] == (grid.count(1), grid.count(0))
    for r, t in ((found.r_top, found.t_down), (found.r_bottom, found.t_up)):
        assert np.allclose(r.albedo() + t.albedo(), 1, rtol=0, atol=1e-15)


@pytest.mark.parametrize("indices", [(1.0, 1.5), (1.5, 1.0)], ids=str)
def test_next_to_total_reflection(indices: tuple[float, float]) -> None:
    """Where a millionth passes, its digits are those of the rarer side's cosine."""
    grid = Grid.build(indices, 64)
    (found,) = surfaces(grid)
    rare = min(grid.mu, key=len)
    assert rare[-1] < 1e-6
    for part in (found.t_down, found.t_up):
        assert np.allclose(part.delta[0], 1 - fresnel(rare, 1.5), rtol=1e-8, atol=0)


def test_conductor_and_nothing() -> None:
    grid = Grid.build([1.5], 12)
    colour = DOUBLE.vector(0.2, 1.5, 0.9), DOUBLE.vector(3.9, 0.2, 0.0)
    found = smooth(BoundConductor(*colour, 1.5, None, True, Frame(0.0)), grid, 0)
    for c, eta in enumerate((0.2 - 3.9j, 1.5 - 0.2j, 0.9 + 0j)):
        assert np.allclose(found.r_top.delta[c], fresnel(grid.mu[0], eta / 1.5), rtol=1e-9, atol=1e-14)
    assert found.t_down.delta is found.r_bottom.delta is found.t_up.delta is None
    nothing = smooth(Null(), Grid.build([1.0, 1.0], 8), 0)
    assert np.all(nothing.t_down.delta == 1) and np.all(nothing.r_top.delta == 0)


def test_rough_interfaces_have_no_smooth_part() -> None:
    rough = BoundDielectric(1.5, None, False, Frame(0.0))
    found = smooth(rough, Grid.build([1.0, 1.5], 8), 0)
    assert all(np.all(part.delta == 0) for part in found)


@pytest.mark.parametrize(
    "indices", [(1.0, 1.5, 1.0), (1.0, 1.5, 1.33), (1.5, 1.0, 1.5), (1.33, 2.4, 1.0)], ids=str
)
def test_absorbing_slab(indices: tuple[float, float, float]) -> None:
    """R = r1 + t1^2 a^2 r2 / (1 - r1 r2 a^2), T = t1 t2 a / (1 - r1 r2 a^2), from both sides, colour by colour."""
    grid = Grid.build(indices, 12)
    depth = np.array([0.0, 0.2, 3.0])
    first, second = surfaces(grid)
    found = stacked(first, medium(grid, 1, depth, 0.0), second)
    assert all(part.dense is None for part in found)
    both = min(grid.count(region) for region in range(3))
    mu0, mu1, mu2 = (mu[:both] for mu in grid.mu)
    r1, r2 = fresnel(mu0, indices[1] / indices[0]), fresnel(mu2, indices[1] / indices[2])
    a = np.exp(-depth[:, None] / mu1)
    series = 1 / (1 - r1 * r2 * a**2)
    for part, one, other in ((found.r_top, r1, r2), (found.r_bottom, r2, r1)):
        truth = one + (1 - one) ** 2 * other * a**2 * series
        assert np.allclose(part.delta[:, :both], truth, rtol=1e-11, atol=1e-12)
    for part in (found.t_down, found.t_up):
        assert np.allclose(part.delta[:, :both], (1 - r1) * (1 - r2) * a * series, rtol=1e-8, atol=1e-13)
        assert np.all(part.delta[:, both:] == 0)


def test_pile_of_plates() -> None:
    """Stokes 1862: 2 m surfaces that reflect r each reflect 2 m r / (1 + (2 m - 1) r)."""
    for m in (1, 2, 5):
        grid = Grid.build([1.0, *([1.5, 1.0] * m)], 12)
        found, r = stacked(*surfaces(grid)), fresnel(grid.mu[0], 1.5)
        truth = 2 * m * r / (1 + (2 * m - 1) * r)
        assert np.allclose(found.r_top.delta[0], truth, rtol=1e-12, atol=1e-14)
        assert np.allclose(found.t_down.delta[0], 1 - truth, rtol=1e-9, atol=1e-14)


def test_smooth_coat_over_smooth_metal() -> None:
    grid = Grid.build([1.0, 1.5], 12)
    (coat,) = surfaces(grid)
    metal = smooth(BoundConductor(0.2, 3.0, 1.5, None, True, Frame(0.0)), grid, 1)
    found = stacked(coat, medium(grid, 1, 0.3, 0.0), metal)
    n = grid.count(0)
    inside = grid.mu[1][:n]
    r, below = fresnel(grid.mu[0], 1.5), fresnel(inside, (0.2 - 3j) / 1.5)
    a2 = np.exp(-0.6 / inside)
    assert np.allclose(
        found.r_top.delta[0], r + (1 - r) ** 2 * below * a2 / (1 - r * below * a2), rtol=1e-9, atol=1e-14
    )


def lambertian(grid: Grid, region: int, reflectance: float) -> Slab:
    """A diffuse base: every column spreads over the cosine, 2 mu w."""
    n = grid.count(region)
    column = 2 * grid.mu[region] * grid.weights[region] * reflectance
    zero = Operator((n, n))
    return Slab(Operator((n, n), None, np.tile(column[:, None], (1, 1, 1, n))), zero, zero, zero)


@pytest.mark.parametrize("ior", [1.33, 1.5, 3.0])
@pytest.mark.parametrize("albedo", [0.5, 1.0])
def test_smooth_coat_over_diffuse(ior: float, albedo: float) -> None:
    """f = t(wi) t(wo) rho / (pi n^2 (1 - rho R)), R the internal reflectance of diffuse light."""
    grid = Grid.build([1.0, ior], 24)
    (coat,) = surfaces(grid)
    found = stacked(coat, lambertian(grid, 1, albedo))
    x, w = np.polynomial.legendre.leggauss(400)
    outside, w = 0.5 * (1 + x), 0.5 * w  # diffuse light inside by the etendue it has outside
    inside = 1 - 2 / ior**2 * (w * outside) @ (1 - fresnel(outside, ior))
    t = 1 - fresnel(grid.mu[0], ior)
    truth = t[:, None] * t * albedo / (np.pi * ior**2 * (1 - albedo * inside)) * grid.mu[0][:, None]
    value = found.r_top.dense[0, 0] / grid.weights[0][:, None] / (2 * np.pi)
    assert np.allclose(value, truth, rtol=1e-6, atol=1e-14)
    if albedo == 1:
        assert np.allclose(found.r_top.albedo(), 1, atol=1e-12)


# -------------------------------------------------------------------------- media between surfaces


@pytest.mark.parametrize(
    "case", cases("slab_glass"), ids=lambda case: f"{case['depth']} {case['g']} {case['ior']}"
)
def test_slabs_with_smooth_boundaries(case: dict[str, Any]) -> None:
    """Adding-doubling with Fresnel boundaries (good to 1e-4), at normal and at diffuse incidence."""
    grid = Grid.build([1.0, case["ior"], 1.0], 32)
    first, second = surfaces(grid)
    phase = HenyeyGreenstein(case["g"])
    found = stacked(first, medium(grid, 1, case["depth"], case["albedo"], phase), second)
    diffuse = 2 * grid.weights[0] * grid.mu[0]
    for part, name in ((found.r_top, "R"), (found.t_down, "T"), (found.r_bottom, "R"), (found.t_up, "T")):
        albedo = part.albedo()[0]
        assert albedo[0] == pytest.approx(case[f"{name}_normal"], abs=1e-4)
        assert diffuse @ albedo == pytest.approx(case[f"{name}_hemispherical"], abs=1e-4)


@pytest.mark.parametrize(
    "indices", [(1.0, 1.5, 1.0), (1.0, 1.5, 1.33), (1.5, 1.0, 1.2), (2.4, 1.0001, 1.0)], ids=str
)
@pytest.mark.parametrize(("depth", "g"), [(1e-6, 0.0), (1.0, 0.99), (1e3, -0.99), (2.0, 0.5)])
def test_lossless_stacks_lose_nothing(indices: tuple[float, ...], depth: float, g: float) -> None:
    """From above and from below, through any indices; and nothing else than the etendue tells the sides apart."""
    grid = Grid.build(indices, 12)
    first, second = surfaces(grid)
    found = stacked(first, medium(grid, 1, depth, 1.0, HenyeyGreenstein(g), orders=2), second)
    assert np.allclose(found.r_top.albedo() + found.t_down.albedo(), 1, atol=2e-10)
    assert np.allclose(found.r_bottom.albedo() + found.t_up.albedo(), 1, atol=2e-10)
    w0, w2 = (grid.etendue[: grid.count(region)][:, None] for region in (0, 2))
    for one, other in (
        (found.r_top.dense / w0, found.r_top.dense / w0),
        (found.r_bottom.dense / w2, found.r_bottom.dense / w2),
        (found.t_down.dense / w2, found.t_up.dense / w0),
    ):
        assert np.allclose(one, np.swapaxes(other, 2, 3), rtol=1e-7, atol=1e-9 * np.max(np.abs(one)))


def test_a_film_without_contrast_is_not_there() -> None:
    phase = HenyeyGreenstein(0.5)
    grid = Grid.build([1.0, 1.0, 1.0], 16)
    bare = medium(grid, 1, 0.7, 0.8, phase, orders=3)
    found = stacked(smooth(Null(), grid, 0), bare, smooth(Null(), grid, 1))
    for one, other in zip(found, bare, strict=True):
        assert np.allclose(one.dense, other.dense, rtol=1e-13, atol=1e-14)


def test_more_nodes_change_nothing() -> None:
    """A coated scattering layer: the error falls by more than 30 from 12 to 24 nodes, and is below 1e-5 there."""
    found = []
    for n in (12, 24, 48):
        grid = Grid.build([1.0, 1.5, 1.0], n)
        first, second = surfaces(grid)
        whole = stacked(first, medium(grid, 1, 2.0, 0.95, HenyeyGreenstein(0.5)), second)
        found.append(2 * grid.weights[0] * grid.mu[0] @ whole.r_top.albedo()[0])
    assert abs(found[1] - found[2]) < 1e-5
    assert abs(found[0] - found[2]) > 30 * abs(found[1] - found[2])
