"""method="lobes": energies, laws, and how far it is from the walk."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from slopes import slopes
from urushi.solvers import lobes

pytestmark = needs_llvm

GOLD = {"eta": 0.2, "k": 3.9}
THETA = np.radians([0.0, 30, 45, 60, 75])
WI = np.stack([np.sin(THETA), 0 * THETA, np.cos(THETA)], axis=1)


def _random(count: int, rng: np.random.Generator) -> np.ndarray:
    w = rng.normal(size=(count, 3))
    w[:, 2] = np.abs(w[:, 2])
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    return w[w[:, 2] > 0.05]


def _stokes(indices: list[float], depths: list[float], eta: complex | None, cos: np.ndarray) -> np.ndarray:
    """Reflectance of a pile of smooth plates by the geometric series, from the base up."""

    def fresnel(n1: complex, n2: complex, c1: np.ndarray) -> np.ndarray:
        c2 = np.sqrt(1 - (n1 / n2) ** 2 * (1 - c1**2) + 0j)
        s, p = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2), (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
        return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)

    cosines = [np.sqrt(1 - (1 - cos**2) / n**2) for n in indices]
    below = fresnel(indices[-1], eta, cosines[-1]) if eta else 0 * cos
    for k in range(len(indices) - 1, 0, -1):
        passed = np.exp(-2 * depths[k - 1] / cosines[k])
        r = fresnel(indices[k - 1], indices[k], cosines[k - 1])
        below = r + (1 - r) ** 2 * below * passed / (1 - r * below * passed)
    return below


# --- energies ---------------------------------------------------------------------------------------------------------


def test_smooth_stacks_are_exact() -> None:
    layers = [
        ur.Dielectric(ior=1.5),
        ur.Medium(depth=0.3, albedo=0.0),
        ur.Dielectric(ior=2.0),
        ur.Medium(depth=0.1, albedo=0.0),
        ur.Conductor(**GOLD),
    ]
    found = lobes.solve(ur.Stack(layers=layers), precision="double").reflectance(WI)[:, 0]
    truth = _stokes([1.0, 1.5, 2.0], [0.3, 0.1], 0.2 - 3.9j, WI[:, 2])
    np.testing.assert_allclose(found, truth, atol=1e-9)


def test_a_diffuse_base_under_a_smooth_coat() -> None:
    """F + (1 - F) (1 - F_i) rho / (1 - F_i rho), with the internal mean F_i: not the 0.470 of a single direction."""
    bsdf = lobes.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Diffuse(0.5)]), precision="double")
    table = bsdf.lobes([0, 0, 1.0])
    diffuse = table.energy[table.kind.index("diffuse"), 0]
    # The printed mean has five digits.
    assert diffuse == pytest.approx(0.96 * 0.5 * (1 - 0.59635) / (1 - 0.5 * 0.59635), abs=5e-6)
    assert diffuse == pytest.approx(0.276, abs=5e-4)


@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.6])
def test_furnace(alpha: float) -> None:
    """Lossless stacks return everything, by their energies and by the integral of eval."""
    complete = {"alpha": alpha, "multiple_scattering": "compensated"}
    mirror = ur.Conductor(material="none", alpha=0.3, multiple_scattering="compensated")
    white = ur.Medium(depth=1.0, albedo=1.0, phase=ur.HenyeyGreenstein(g=0.6))
    stacks = [
        [ur.Dielectric(ior=1.5, **complete), ur.Diffuse(1.0)],
        [ur.Dielectric(ior=1.5, **complete), mirror],
        [ur.Dielectric(ior=1.5, **complete), ur.Dielectric(ior=1.9, **complete), ur.Diffuse(1.0)],
        [ur.Dielectric(ior=1.5, **complete), ur.Dielectric(ior=1.9, **complete), mirror],
        [ur.Dielectric(ior=1.5, **complete), white, ur.Diffuse(1.0)],
        [ur.Dielectric(ior=1.5, **complete), white, mirror],
    ]
    for layers in stacks:
        found = lobes.solve(ur.Stack(layers=layers)).reflectance(WI)
        np.testing.assert_allclose(found, 1, atol=5e-3)
    slab = ur.Stack(layers=[ur.Dielectric(ior=1.5, **complete), ur.Dielectric(ior=1.0, **complete)])
    bsdf = lobes.solve(slab)
    np.testing.assert_allclose(bsdf.reflectance(WI) + bsdf.transmittance(WI), 1, atol=5e-3)


@pytest.mark.parametrize("name", ["plastic", "enamel-on-gold", "brushed-metal-lacquer", "frosted-glass"])
def test_eval_integrates_to_the_energies(name: str, rng: np.random.Generator) -> None:
    bsdf = lobes.solve(ur.load(f"preset:{name}"))
    count = 30_000
    for wi in WI[[1, 3]]:
        found = bsdf.sample(wi[None], rng.random((count, 3)))
        up = found.wo[:, 2:] > 0
        for part, energy in ((up, bsdf.reflectance(wi)), (~up, bsdf.transmittance(wi))):
            weight = found.weight * part
            error = 4 * weight.std(axis=0) / np.sqrt(count) + 5e-3 * np.maximum(energy, 0.1)
            assert np.all(np.abs(weight.mean(axis=0) - energy) < error)


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [pytest.param("enamel-on-gold", marks=pytest.mark.slow), "brushed-metal-lacquer", "plastic"]
)
def test_the_symmetric_form_is_reciprocal(name: str, rng: np.random.Generator) -> None:
    bsdf = lobes.solve(ur.load(f"preset:{name}"), symmetric=True, precision="double")
    wi, wo = _random(200, rng)[:100], _random(200, rng)[:100]
    one = bsdf.eval(wi, wo) / wo[:, 2:]
    other = bsdf.eval(wo, wi) / wi[:, 2:]
    np.testing.assert_allclose(one, other, rtol=1e-5)
    if name != "plastic":  # whose forward form is reciprocal already
        forward = lobes.solve(ur.load(f"preset:{name}"))
        assert not np.allclose(one, forward.eval(wi, wo) / wo[:, 2:], rtol=1e-2)


@pytest.mark.parametrize(
    "layers",
    [
        [ur.Dielectric(ior=1.5, alpha=0.3, distribution="beckmann")],
        [ur.Conductor(**GOLD, alpha=(0.1, 0.4), rotation=30)],
        [ur.Diffuse([0.2, 0.5, 0.8])],
    ],
    ids=["dielectric", "conductor", "diffuse"],
)
def test_a_single_layer_is_that_layer(layers: list, rng: np.random.Generator) -> None:
    stack = ur.Stack(layers=layers)
    wi, wo = _random(200, rng)[:100], _random(200, rng)[:100]
    if not stack.layers[-1].opaque:
        wo[::2, 2] *= -1
    truth = ur.solve(stack, "walk", samples=1).eval(wi, wo)
    np.testing.assert_allclose(lobes.solve(stack).eval(wi, wo), truth, rtol=1e-4, atol=1e-7)


def test_densities_integrate_to_one() -> None:
    from urushi.checks import normalisation

    bsdf = lobes.solve(ur.load("preset:brushed-metal-lacquer"))
    report = normalisation.check(lambda _: bsdf, True)
    assert report.passed, report.text


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in ur.presets() if name != "varnished-wood"])
def test_every_preset(name: str) -> None:
    from urushi.checks import chi2, energy, finiteness, normalisation

    bsdf = lobes.solve(ur.load(f"preset:{name}"))
    for check in (chi2.check, energy.check, finiteness.check, normalisation.check):
        report = check(lambda _: bsdf, True)
        assert report.passed, report.text


def test_what_claims_to_be_reciprocal() -> None:
    """The check of reciprocity judges the symmetric form, and tells of the other."""
    from urushi.checks import reciprocity

    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), ur.Conductor(**GOLD, alpha=0.3)])
    forward, symmetric = (lobes.solve(stack, symmetric=way) for way in (False, True))
    assert not forward.diagnostics["reciprocal"] and symmetric.diagnostics["reciprocal"]
    assert lobes.solve(ur.Stack(layers=stack.layers[:1])).diagnostics["reciprocal"]
    assert reciprocity.check(lambda _: symmetric, True).passed
    assert "does not claim" in reciprocity.check(lambda _: forward, True).text


# --- derivatives and types --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "half"),
    [
        pytest.param("layer_0.alpha", 0.13, 1e-2, marks=pytest.mark.slow),
        pytest.param("layer_0.ior", 1.53, 1e-2, marks=pytest.mark.slow),
        pytest.param("layer_1.depth", 0.5, 1e-3, marks=pytest.mark.slow),
        ("layer_1.albedo", 0.7, 1e-3),
        pytest.param("layer_1.phase.g", 0.55, 1e-3, marks=pytest.mark.slow),
        ("layer_2.alpha", 0.27, 1e-2),
        pytest.param("layer_2.k", 3.9, 1e-3, marks=pytest.mark.slow),
    ],
)
def test_derivatives(name: str, value: float, half: float) -> None:
    from drjit.llvm.ad import Array3f64

    stack = ur.Stack(
        layers=[
            ur.Dielectric(ior=1.53, alpha=0.13),
            ur.Medium(depth=0.5, albedo=0.7, phase=ur.HenyeyGreenstein(g=0.55)),
            ur.Conductor(eta=0.2, k=3.9, alpha=0.27),
        ]
    )
    wi, wo = Array3f64(0.6, 0, 0.8), Array3f64(-0.5, 0.2, 0.71**0.5)

    def values(x: Any) -> tuple:
        bsdf = lobes.solve(stack, parameters={name: x}, precision="double")
        return bsdf.eval(wi, wo).x, bsdf.reflectance(wi).x

    for found, difference in slopes(values, value, half):
        # Energies are counted by samples: what they jump by, tells in differences of the index and of narrow facets.
        assert found == pytest.approx(difference, rel=0.05 if name.startswith("layer_0") else 5e-3, abs=1e-5)


def test_scalar_backend_and_values_per_lane(rng: np.random.Generator) -> None:
    stack = ur.load("preset:enamel-on-gold")
    wi, wo = _random(12, rng)[:4], _random(12, rng)[:4]
    plain = lobes.solve(stack, precision="double").eval(wi, wo)
    scalar = lobes.solve(stack, backend="scalar", precision="double").eval(wi, wo)
    np.testing.assert_allclose(scalar, plain, rtol=1e-9)
    alphas = np.array([0.05, 0.1, 0.2, 0.4])
    coated = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(**GOLD, alpha=0.2)])
    lanes = lobes.solve(coated, parameters={"layer_0.alpha": alphas}, precision="double").eval(wi, wo)
    for k, alpha in enumerate(alphas):
        one = lobes.solve(coated, parameters={"layer_0.alpha": float(alpha)}, precision="double")
        np.testing.assert_allclose(lanes[k], one.eval(wi[k], wo[k]), rtol=1e-9)


def test_the_table_can_be_read() -> None:
    table = lobes.solve(ur.load("preset:enamel-on-gold")).lobes([0.5, 0, np.sqrt(0.75)])
    assert table.kind == ("reflected", "reflected", "forward", "diffuse")
    assert [line.split()[0] for line in repr(table).splitlines()] == ["kind", *table.kind]
    np.testing.assert_allclose(table.direction[0], [-0.5, 0, np.sqrt(0.75)], atol=1e-6)
    bsdf = lobes.solve(ur.load("preset:enamel-on-gold"))
    np.testing.assert_allclose(table.energy.sum(axis=0), bsdf.reflectance([0.5, 0, np.sqrt(0.75)]), rtol=1e-5)


def test_refusals() -> None:
    with pytest.raises(ur.UnsupportedStack, match="normal"):
        lobes.solve(ur.Stack(layers=[ur.Conductor(material="Au", normal=(0.1, 0, 1))]))
    walks = ur.Conductor(material="Au", alpha=0.1, multiple_scattering="walk")
    with pytest.raises(ur.UnsupportedStack, match=r"layers\[0\].multiple_scattering is 'walk'"):
        lobes.solve(ur.Stack(layers=[walks]))
    assert not lobes.reasons_against(ur.Stack(layers=[walks.model_copy(update={"alpha": 0.0})]))
    with pytest.raises(ur.UnsupportedStack, match="diffuse"):
        lobes.solve(ur.load("preset:plastic"), published=True)
    with pytest.raises(ur.UrushiError, match="published"):
        lobes.solve(ur.load("preset:enamel-on-gold"), published=3)
