"""Interfaces with normals of their own, in the walk: eval, sample and the fluxes tell of the same light, none is lost,
and one interface alone is classical normal mapping."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from quadrature import sphere
from urushi import checks
from urushi.errors import MaterialError
from urushi.solvers import BSDF

pytestmark = needs_llvm

N, M = (0.3, 0.1, 1.0), (-0.2, -0.5, 1.0)
STEEP = tuple(direction(0.5, 0.4))  # 60 degrees
FOG = ur.Medium(depth=0.8, albedo=(0.9, 0.7, 0.5), phase=ur.HenyeyGreenstein(g=0.5))
COAT = ur.Dielectric(ior=1.5, alpha=0.2, normal=N)
CLEAR = ur.Dielectric(ior=1.5, normal=N)
STACKS = {
    "rough over diffuse": [COAT, ur.Diffuse(reflectance=0.9, normal=M)],
    "smooth over gold": [CLEAR, FOG, ur.Conductor(material="Au", alpha=0.3, normal=M)],
    "smooth inside": [
        ur.Dielectric(ior=1.3, alpha=0.2),
        ur.Dielectric(ior=1.7, normal=N),
        FOG,
        ur.Conductor(material="Au", alpha=0.3),
    ],
    "pane": [COAT, FOG, ur.Dielectric(ior=1.3, alpha=0.3, normal=M)],
    "steep": [ur.Dielectric(ior=1.5, alpha=(0.2, 0.4), rotation=30, normal=STEEP)],
}
WO, AREA = sphere(64, 64)


def solve(layers: list[Any], samples: int = 64, **options: Any) -> BSDF:
    return ur.solve(ur.Stack(layers=layers), "walk", samples=samples, **options)


@pytest.mark.parametrize("name", STACKS)
def test_eval_sample_and_flux_tell_of_the_same_light(name: str, rng: np.random.Generator) -> None:
    """The integral of eval (with the delta parts of sample), the mean weight of sample, and the traced flux."""
    bsdf, many, n = (
        solve(STACKS[name], mode="importance"),
        solve(STACKS[name], 4096, mode="importance"),
        1 << 14,
    )
    opaque = bsdf.stack.layers[-1].opaque
    for w in direction(np.array([0.95, 0.4, -0.6]), 2.0):
        if w[2] < 0 and opaque:
            continue
        sample = bsdf.sample(np.broadcast_to(w, (n, 3)), rng.random((n, 3)))
        value, error = bsdf.eval(np.broadcast_to(w, WO.shape), WO, with_error=True)
        fluxes = [many.reflectance(w, with_error=True)]
        fluxes += [(np.zeros(3), np.zeros(3))] if opaque else [many.transmittance(w, with_error=True)]
        for same, (flux, spread) in zip((True, False), fluxes, strict=True):
            weight = sample.weight * ((sample.wo[:, 2] * w[2] > 0) == same)[:, None]
            noise = weight.std(axis=0) / np.sqrt(n)
            assert np.all(np.abs(weight.mean(axis=0) - flux) < 5 * np.hypot(noise, spread) + 1e-4)
            here = (WO[:, 2] * w[2] > 0) == same
            sharp = (weight * sample.delta[:, None]).std(axis=0) / np.sqrt(n)
            found = (value * AREA[:, None])[here].sum(axis=0) + (weight * sample.delta[:, None]).mean(axis=0)
            own = np.sqrt(np.square(error * AREA[:, None])[here].sum(axis=0))
            # The grid of directions is good to a hundredth.
            assert np.all(np.abs(found - flux) < 5 * (sharp + np.hypot(own, spread)) + 0.01 * flux + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smooth over gold", "pane", "steep", "smooth pane"])
def test_every_check_passes_and_reciprocity_is_not_claimed(name: str) -> None:
    layers = {**STACKS, "smooth pane": [CLEAR, FOG, ur.Dielectric(ior=1.3, alpha=0.3, normal=M)]}[name]
    reports = checks.run(ur.Stack(layers=layers), "walk")
    assert all(report.passed for report in reports), reports
    assert [report.name for report in reports if not report.claimed] == ["reciprocity"]


def test_no_light_is_lost_at_any_tilt() -> None:
    """Interfaces that keep all light keep it: mirrors and panes, and a white base, with normals of up to 60 degrees."""
    white = ur.Dielectric(ior=1.5, alpha=0.3, multiple_scattering="walk", normal=STEEP)
    for layers in (
        [ur.Dielectric(ior=1.5, normal=STEEP)],
        [ur.Conductor(material="none", normal=STEEP)],
        [CLEAR, ur.Diffuse(reflectance=1.0, normal=M)],
        [CLEAR, ur.Dielectric(ior=1.0, normal=M)],
        [white],
    ):
        bsdf, wi = solve(layers, 2048), direction(np.array([0.99, 0.6, 0.1]), np.array([0.1, 3.0, 0.5]))
        (r, dr), (t, dt) = (f(wi, with_error=True) for f in (bsdf.reflectance, bsdf.transmittance))
        assert np.all(np.abs(r + t - 1) < 5 * np.hypot(dr, dt) + 1e-5), (layers, r + t)


def test_a_rim_does_not_glow(rng: np.random.Generator) -> None:
    """Ripples seen at grazing angles send no light back to the side of the viewer, and much to the other."""
    slopes = 0.15 * rng.normal(size=(4096, 2))
    given = {"layer_0.normal": np.concatenate([slopes, np.ones((4096, 1))], axis=1)}
    layers = [ur.Dielectric(ior=1.5, alpha=0.05), ur.Medium(depth=9.0, albedo=0.0), ur.Diffuse(reflectance=0)]
    bsdf = solve(layers, 1, parameters=given)
    viewer, lights = direction(0.1, 0.0), (direction(0.4, 0.5), direction(0.1, np.pi))
    wi, *wo = (np.broadcast_to(w, (4096, 3)) for w in (viewer, *lights))
    same, other = (bsdf.eval(wi, w)[:, 0].mean() for w in wo)
    assert other > 0.1 and same < 1e-3 * other, (same, other)


def test_a_flat_normal_changes_nothing_but_noise() -> None:
    wi, wo = direction(np.array([0.9, 0.5, -0.7]), 0.3), direction(np.array([0.8, -0.4, 0.6]), 2.0)
    plain = [ur.Dielectric(ior=1.5, alpha=0.2), FOG, ur.Dielectric(ior=1.3, alpha=0.3)]
    flat = [
        layer.model_copy(update={"normal": (0, 0, 1)}) if hasattr(layer, "normal") else layer
        for layer in plain
    ]
    flat[0] = flat[0].model_copy(update={"normal": (0, 0, 0.5)})  # of any length
    (a, da), (b, db) = (solve(layers, 20000).eval(wi, wo, with_error=True) for layers in (plain, flat))
    assert np.all(np.abs(a - b) < 5 * np.hypot(da, db))
    assert np.allclose(solve(plain).pdf(wi, wo), solve(flat).pdf(wi, wo), rtol=2e-2)


def test_one_interface_is_classical_normal_mapping() -> None:
    """f cos(n, o) in the frame of the normal, wherever both directions lie in front of it."""
    n = np.array(N) / np.linalg.norm(N)
    s = np.array([1.0, 0, 0]) - n[0] * n
    frame = np.stack([s / np.linalg.norm(s), np.cross(n, s / np.linalg.norm(s)), n])
    wi, wo = direction(np.array([0.9, 0.6]), 0.3), direction(np.array([0.8, 0.9]), 2.0)
    gold = ur.Conductor(material="Au", alpha=(0.1, 0.4), rotation=20)
    tilted = solve([gold.model_copy(update={"normal": N})]).eval(wi, wo)
    assert np.allclose(tilted, solve([gold]).eval(wi @ frame.T, wo @ frame.T), rtol=1e-4)


def test_a_tilted_mirror_sends_light_where_it_should(rng: np.random.Generator) -> None:
    wi, n = direction(0.9, 1.0), np.array(N) / np.linalg.norm(N)
    sample = solve([ur.Conductor(material="Au", normal=N)]).sample(wi, rng.random(3))
    assert sample.delta and np.allclose(sample.wo, 2 * (wi @ n) * n - wi, atol=1e-5)
    # A pane bends light by Snell's law about its own normal.
    u = rng.random((200, 3))
    sample = solve([CLEAR]).sample(np.broadcast_to(wi, u.shape), u)
    through = sample.wo[:, 2] < 0
    assert sample.delta.all() and through.any() and not through.all()
    across = [np.linalg.norm(np.cross(w, n)) for w in (wi, sample.wo[through][0])]
    assert across[0] == pytest.approx(1.5 * across[1], rel=1e-4)


def test_normals_of_each_evaluation_and_wrong_ones() -> None:
    layers = [ur.Dielectric(ior=1.5, alpha=0.2), ur.Diffuse(reflectance=0.5)]
    wi, wo = direction(np.array([0.9, 0.9]), 0.3), direction(np.array([0.8, 0.8]), 2.0)
    given = {"layer_0.normal": np.array([N, M]), "layer_1.normal": np.array(M)}
    many = solve(layers, parameters=given, samples=4000).eval(wi, wo)
    for i, normal in enumerate((N, M)):
        one = [layers[0].model_copy(update={"normal": normal}), layers[1].model_copy(update={"normal": M})]
        alone, error = solve(one, samples=4000).eval(wi, wo, with_error=True)
        assert np.all(np.abs(many[i] - alone[i]) < 6 * error[i])
    for wrong, said in (
        (np.array([[0, 0, 1], [0, 1, 0]]), "z is below"),
        (np.array([[0, 0, 1], [0, 1.5, 1]]), "above 1"),
        (np.array([0.0, 1.0]), r"allowed: \(3,\) or \(N, 3\)"),
        (0.5, "three numbers"),
        (np.array([0, 0, np.nan]), "not finite"),
    ):
        with pytest.raises(MaterialError, match=said):
            solve(layers, parameters={"layer_0.normal": wrong}).eval(wi, wo)
    with pytest.raises(MaterialError, match=r"slope_variance.*covariance is too large"):
        solve(layers, parameters={"layer_0.slope_variance": (0.1, 0.1, 0.2)}).eval(wi, wo)


@pytest.mark.parametrize("depth", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_derivatives_with_respect_to_a_normal(depth: int) -> None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    lanes = 80000
    wi, wo = Array3f(0.3, 0.1, 0.9), Array3f(-0.2, 0.4, 0.9)
    wi, wo = dr.normalize(wi + dr.zeros(Array3f, lanes)), dr.normalize(wo + dr.zeros(Array3f, lanes))
    layers = [ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=0.8)][:depth]

    def mean(x: Any) -> Any:
        normal = Array3f(x, Float(0.1), Float(1))
        given = {f"layer_{i}.normal": normal for i in range(depth)}
        bsdf = solve(layers, 8, parameters=given)
        # Other random numbers in every lane, by a step that single precision can see.
        return dr.mean(bsdf.eval(wi + Array3f(dr.arange(Float, lanes) * 1e-7, 0, 0), wo).x)

    x = Float(0.1)
    dr.enable_grad(x)
    dr.backward(mean(x))
    step = (float(mean(Float(0.12))[0]) - float(mean(Float(0.08))[0])) / 0.04
    assert float(x.grad[0]) == pytest.approx(step, rel=0.06, abs=2e-3)


def test_a_variance_of_slopes_is_roughness() -> None:
    """alpha^2 + 2 variance, along the axes of their sum; a smooth interface becomes rough."""
    wi, wo = direction(np.array([0.9, 0.5]), 0.3), direction(np.array([0.8, 0.9]), 2.0)
    gold = ur.Conductor(material="Au", alpha=(0.3, 0.1))
    wide = ur.Conductor(material="Au", alpha=(0.5, np.sqrt(0.01 + 0.03)))
    found = solve([gold.model_copy(update={"slope_variance": (0.08, 0.015, 0.0)})]).eval(wi, wo)
    assert np.allclose(found, solve([wide]).eval(wi, wo), rtol=1e-4)
    turned = ur.Conductor(material="Au", alpha=(0.2, 1e-3), rotation=45)
    found = solve([ur.Conductor(material="Au", slope_variance=(0.01, 0.01, 0.01 - 5e-7))]).eval(wi, wo)
    assert np.allclose(found, solve([turned]).eval(wi, wo), rtol=2e-2, atol=1e-5)
