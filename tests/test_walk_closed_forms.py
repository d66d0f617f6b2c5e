"""The walk where the answer is a formula: Fresnel slabs, a coat over a diffuse base, Beer and Lambert, and limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from outside import Tally
from quadrature import gauss
from urushi.solvers import BSDF

pytestmark = needs_llvm

COSINES = np.array([1.0, 0.8, 0.5, 0.2, 0.05])
ABOVE = direction(COSINES, 0.3)
BELOW = ABOVE * (1, 1, -1)


def solve(*layers: Any, samples: int = 1 << 14, **options: Any) -> BSDF:
    exterior = options.pop("exterior", 1.0)
    return ur.solve(ur.Stack(layers=list(layers), exterior=exterior), "walk", samples=samples, **options)


def fresnel(cos: Any, eta: complex) -> np.ndarray:
    """Unpolarised reflectance by Fresnel's equations (Hecht), eta relative and perhaps complex."""
    cos = np.asarray(cos, complex)
    cos_t = np.sqrt(1 - (1 - cos**2) / eta**2)
    s = (cos - eta * cos_t) / (cos + eta * cos_t)
    p = (eta * cos - cos_t) / (eta * cos + cos_t)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


def refracted(cos: Any, eta: float) -> np.ndarray:
    """Cosine beyond the boundary."""
    return np.sqrt(1 - (1 - np.asarray(cos) ** 2) / eta**2)


def delta(bsdf: BSDF, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the delta parts carry to the side of wi and to the other, (N, 3), as `sample` says it."""
    found = []
    for w in wi:
        u = np.full((2048, 3), 0.5)
        u[:, 0] = (np.arange(2048) + 0.5) / 2048
        sample = bsdf.sample(np.broadcast_to(w, u.shape), u)
        same = sample.wo[:, 2] * w[2] > 0
        found.append(
            [
                (sample.weight * sample.pdf[:, None])[sample.delta & side].mean(axis=0)
                if (sample.delta & side).any()
                else np.zeros(3)
                for side in (same, ~same)
            ]
        )
    return np.array(found)[:, 0], np.array(found)[:, 1]


def agrees(bsdf: BSDF, wi: np.ndarray, reflectance: Any, transmittance: Any = 0.0) -> None:
    """Reflectance and transmittance are these, within their errors."""
    tally = Tally()
    for flux, truth in ((bsdf.reflectance, reflectance), (bsdf.transmittance, transmittance)):
        found, error = flux(wi, with_error=True)
        truth = np.broadcast_to(truth if np.ndim(truth) == 2 else np.reshape(truth, (-1, 1)), found.shape)
        tally.add(flux.__name__, found, error, truth, 0, rounding=1e-4)


@pytest.mark.parametrize("wi", [ABOVE, BELOW], ids=["above", "below"])
def test_absorbing_slab_with_smooth_faces(wi: np.ndarray) -> None:
    """R = r + t^2 r a^2 / (1 - r^2 a^2), T = t^2 a / (1 - r^2 a^2), exactly in the delta parts, in the mean as flux."""
    depth = np.array([0.0, 0.2, 1.0])
    bsdf = solve(ur.Dielectric(ior=1.5), ur.Medium(depth=tuple(depth), albedo=0.0), ur.Dielectric(ior=1.0))
    r = fresnel(COSINES, 1.5)[:, None]
    a = np.exp(-depth / refracted(COSINES, 1.5)[:, None])
    series = 1 / (1 - r**2 * a**2)
    truth = r + (1 - r) ** 2 * r * a**2 * series, (1 - r) ** 2 * a * series
    for found, expected in zip(delta(bsdf, wi), truth, strict=True):
        assert np.allclose(found, expected, rtol=2e-5, atol=1e-6)
    agrees(bsdf, wi, *truth)
    assert np.all(bsdf.eval(wi, -wi[::-1]) == 0)


@pytest.mark.parametrize("plates", [1, 3])
def test_pile_of_plates(plates: int) -> None:
    """Stokes 1862: m surfaces that reflect r each reflect m r / (1 + (m - 1) r)."""
    layers = [ur.Dielectric(ior=ior) for _ in range(plates) for ior in (1.5, 1.0)]
    bsdf, m, r = solve(*layers), 2 * plates, fresnel(COSINES, 1.5)
    truth = (m * r / (1 + (m - 1) * r))[:, None]
    for wi in (ABOVE, BELOW):
        reflected, transmitted = delta(bsdf, wi)
        assert np.allclose(reflected, truth, rtol=5e-5) and np.allclose(transmitted, 1 - truth, rtol=5e-5)
        agrees(bsdf, wi, truth, 1 - truth)


def test_smooth_coat_over_smooth_metal() -> None:
    eta, k, depth = 0.2, 3.0, 0.3
    bsdf = solve(
        ur.Dielectric(ior=1.5), ur.Medium(depth=depth, albedo=0.0), ur.Conductor(eta=eta, k=k, alpha=0.0)
    )
    inside = refracted(COSINES, 1.5)
    r, metal = fresnel(COSINES, 1.5), fresnel(inside, complex(eta, -k) / 1.5)
    a2 = np.exp(-2 * depth / inside)
    truth = r + (1 - r) ** 2 * metal * a2 / (1 - r * metal * a2)
    assert np.allclose(delta(bsdf, ABOVE)[0], truth[:, None], rtol=2e-5)
    agrees(bsdf, ABOVE, truth)


@pytest.mark.parametrize("ior", [1.33, 1.5, 3.0])
@pytest.mark.parametrize("albedo", [0.5, 1.0])
def test_smooth_coat_over_diffuse(ior: float, albedo: float) -> None:
    """f = t(wi) t(wo) rho / (pi n^2 (1 - rho R)), R the internal reflectance of diffuse light, by quadrature."""
    bsdf = solve(ur.Dielectric(ior=ior), ur.Diffuse(reflectance=albedo))
    critical = np.sqrt(1 - 1 / ior**2)
    mu, weight = gauss(200, critical, 1)
    inside = 1 - 2 * weight @ (mu * (1 - fresnel(mu, 1 / ior)))
    wi, wo = ABOVE, direction(COSINES[::-1], 2.0)
    t_i, t_o = 1 - fresnel(wi[:, 2], ior), 1 - fresnel(wo[:, 2], ior)
    series = albedo / (1 - albedo * inside)
    tally = Tally()
    found, error = (x[:, 0] for x in bsdf.eval(wi, wo, with_error=True))
    tally.add("eval", found, error, t_i * t_o * series * wo[:, 2] / (np.pi * ior**2), 0, rounding=1e-4)
    agrees(bsdf, wi, fresnel(wi[:, 2], ior) + t_i * (1 - inside) * series)


def test_beer_and_lambert() -> None:
    depth = np.array([0.0, 0.5, 3.0])
    bsdf = solve(ur.Medium(depth=tuple(depth), albedo=0.0))
    truth = np.exp(-depth / COSINES[:, None])
    for wi in (ABOVE, BELOW):
        assert np.allclose(delta(bsdf, wi)[1], truth, rtol=1e-4, atol=1e-12)
        assert np.allclose(bsdf.transmittance(wi), truth, rtol=1e-5, atol=1e-7)
        assert np.all(bsdf.reflectance(wi) == 0)


def test_total_reflection_from_glass() -> None:
    """Everything beyond the critical angle: from glass into air, and from below under a denser film."""
    bsdf = solve(ur.Dielectric(ior=1.0), exterior=1.5)
    assert np.allclose(bsdf.reflectance(ABOVE)[2:], 1) and np.all(bsdf.reflectance(ABOVE)[:2] < 0.9)
    under = solve(ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.33))
    shallow = BELOW[2:]  # sin beyond 1 / 1.33
    assert np.allclose(delta(under, shallow)[0], 1, atol=1e-5)
    agrees(under, shallow, np.ones(len(shallow)))


# ---------------------------------------------------------------------- one layer is that layer alone


def ggx(m: np.ndarray, w: np.ndarray, o: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """D(m), and height-correlated Smith masking (Heitz 2014)."""
    tan2 = 1 / m[:, 2] ** 2 - 1
    density = 1 / (np.pi * alpha**2 * m[:, 2] ** 4 * (1 + tan2 / alpha**2) ** 2)
    lambdas = [0.5 * (np.sqrt(1 + alpha**2 * (1 / v[:, 2] ** 2 - 1)) - 1) for v in (w, o)]
    return density, np.stack(lambdas)


def test_one_rough_interface_is_walter() -> None:
    """Walter et al. 2007, equations 20 and 21, both sides, in numpy; no noise at all."""
    alpha, eta = 0.3, 1.5
    bsdf = solve(ur.Dielectric(ior=eta, alpha=alpha), samples=64)
    rng = np.random.default_rng(3)
    wi, wo = (direction(rng.uniform(0.1, 1, 200), rng.uniform(0, 7, 200)) for _ in range(2))
    value, error = bsdf.eval(wi, wo, with_error=True)
    assert np.all(error == 0)
    m = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
    density, (a, b) = ggx(m, wi, wo, alpha)
    reflected = fresnel((wi * m).sum(1), eta) * density / ((1 + a + b) * 4 * wi[:, 2])
    assert np.allclose(value[:, 0], reflected, rtol=1e-4)
    down = wo * (1, 1, -1)
    m = wi + eta * down
    m *= np.sign(m[:, 2:]) / np.linalg.norm(m, axis=1, keepdims=True)
    density, (a, b) = ggx(m, wi, wo, alpha)
    cos_i, cos_o = (wi * m).sum(1), -(down * m).sum(1)
    seen = (cos_i > 0) & (cos_o > 0)
    with np.errstate(all="ignore"):
        t = cos_i * cos_o / wi[:, 2] * eta**2 * (1 - fresnel(cos_i, eta)) * density / (1 + a + b)
        t = t / (cos_i - eta * cos_o) ** 2 / eta**2  # as radiance
    assert np.allclose(bsdf.eval(wi, down)[:, 0], np.where(seen, t, 0), rtol=2e-4, atol=1e-7)


def test_one_opaque_layer_has_no_noise() -> None:
    wo = direction(COSINES, 2.0)
    found, error = solve(ur.Diffuse(reflectance=(0.1, 0.5, 1.0))).eval(ABOVE, wo, with_error=True)
    assert np.allclose(found, wo[:, 2:] / np.pi * (0.1, 0.5, 1.0), rtol=1e-6) and np.all(error == 0)
    found, error = solve(ur.Conductor(eta=0.2, k=3.0, alpha=0.3)).eval(ABOVE, wo, with_error=True)
    m = (ABOVE + wo) / np.linalg.norm(ABOVE + wo, axis=1, keepdims=True)
    density, (a, b) = ggx(m, ABOVE, wo, 0.3)
    truth = fresnel((ABOVE * m).sum(1), 0.2 - 3j) * density / ((1 + a + b) * 4 * ABOVE[:, 2])
    assert np.allclose(found[:, 0], truth, rtol=1e-4) and np.all(error == 0)


# ----------------------------------------------------------------------------------------- limits

COAT, GREY = ur.Dielectric(ior=1.5, alpha=0.2), ur.Diffuse(reflectance=0.5)
FOG = ur.Medium(depth=0.8, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.4))
HALF = ur.Medium(depth=0.4, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.4))
SAME = {
    "depth 0": ([COAT, ur.Medium(depth=0.0, albedo=0.5), GREY], [COAT, GREY]),
    "depth 1e-6": ([COAT, ur.Medium(depth=1e-6, albedo=0.5), GREY], [COAT, GREY]),
    "equal indices, rough": ([ur.Dielectric(ior=1.0, alpha=0.5), GREY], [GREY]),
    "equal indices inside": ([COAT, ur.Dielectric(ior=1.5, alpha=0.5), FOG, GREY], [COAT, FOG, GREY]),
    "indices that differ by 1e-5": (
        [COAT, ur.Dielectric(ior=1.50001, alpha=0.5), FOG, GREY],
        [COAT, FOG, GREY],
    ),
    "a medium in two halves": ([COAT, HALF, HALF, GREY], [COAT, FOG, GREY]),
    "a slab in two halves": ([HALF, HALF], [FOG]),
    "isotropic is g = 0": (
        [COAT, ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.0)), GREY],
        [COAT, ur.Medium(depth=1.0, albedo=0.9), GREY],
    ),
    "nothing below what lets nothing through": (
        [COAT, ur.Medium(depth=40.0, albedo=0.0), GREY],
        [COAT, ur.Diffuse(reflectance=0.0)],
    ),
    "rotating what is isotropic": (
        [ur.Dielectric(ior=1.5, alpha=(0.2, 0.2), rotation=50.0), GREY],
        [COAT, GREY],
    ),
}


@pytest.mark.parametrize("name", SAME)
def test_two_descriptions_of_one_thing(name: str) -> None:
    one, other = (solve(*layers) for layers in SAME[name])
    tally, wo = Tally(), direction(COSINES[::-1], 1.0)
    if not one.stack.layers[-1].opaque:
        wo = wo * np.array([1, 1, -1]) ** np.arange(len(wo))[:, None]
    for question in (
        lambda bsdf: bsdf.eval(ABOVE, wo, with_error=True),
        lambda bsdf: bsdf.reflectance(ABOVE, with_error=True),
        lambda bsdf: bsdf.transmittance(ABOVE, with_error=True),
    ):
        (a, a_error), (b, b_error) = question(one), question(other)
        tally.add(name, a[:, 0], a_error[:, 0], b[:, 0], b_error[:, 0], rounding=3e-5)


def test_ever_smoother_is_smooth() -> None:
    """Reflectance of a rough coat over a base goes to that of a smooth one as alpha goes to 0."""
    smooth = solve(ur.Dielectric(ior=1.5), GREY).reflectance(ABOVE)[:4, 0]
    distance = [
        np.abs(solve(ur.Dielectric(ior=1.5, alpha=a), GREY).reflectance(ABOVE)[:4, 0] - smooth).max()
        for a in (0.1, 0.01, 1e-3, 1e-4)
    ]
    assert distance[0] > 0.01 and distance[2] < 0.008 and distance[3] < 0.008
