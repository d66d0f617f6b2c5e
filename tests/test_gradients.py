"""Derivatives of the walk, against central differences of its own (unbiased) values with many more samples."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur

STACK = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.2),
        ur.Medium(depth=0.5, albedo=0.7, phase=ur.HenyeyGreenstein(g=0.6)),
        ur.Conductor(eta=0.2, k=3.9, alpha=0.3),
    ]
)
SMOOTH = ur.Stack(
    layers=[ur.Dielectric(ior=1.5), ur.Medium(depth=0.5, albedo=0.7), ur.Dielectric(ior=1.3), ur.Diffuse(0.5)]
)

# name, value, half the width of the difference
CASES = [
    (STACK, "layer_0.alpha", 0.2, 0.01),
    (STACK, "layer_0.ior", 1.5, 0.01),
    (STACK, "layer_1.depth", 0.5, 0.02),
    (STACK, "layer_1.albedo", 0.7, 0.03),
    (STACK, "layer_1.phase.g", 0.6, 0.03),
    (STACK, "layer_2.alpha", 0.3, 0.01),
    (STACK, "layer_2.k", 3.9, 0.2),
    (SMOOTH, "layer_1.depth", 0.5, 0.02),
    (SMOOTH, "layer_2.ior", 1.3, 0.01),
    (SMOOTH, "layer_3.reflectance", 0.5, 0.03),
]


def _directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs around one, all a little different so that their noise is."""
    theta = 0.5 + 2e-2 * np.arange(count) / count
    wi = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    wo = np.stack([-np.sin(theta + 0.2), 0.1 + 0 * theta, 0 * theta], axis=1)
    wo[:, 2] = np.sqrt(1 - (wo**2).sum(axis=1))
    return wi, wo


def _slope(stack: ur.Stack, name: str, value: float, half: float, reflectance: bool) -> tuple[float, float]:
    """Central difference of the mean over the pairs, and its standard error."""
    wi, wo = _directions(2000)
    ends = []
    for end in (value + half, value - half):
        bsdf = ur.solve(stack, samples=1024, seed=3, parameters={name: end})
        mean, error = (
            bsdf.reflectance(wi, with_error=True) if reflectance else bsdf.eval(wi, wo, with_error=True)
        )
        ends.append((mean[:, 0].mean(), np.sqrt((error[:, 0] ** 2).sum()) / len(wi)))
    (high, high_error), (low, low_error) = ends
    return (high - low) / (2 * half), np.hypot(high_error, low_error) / (2 * half)


def _gradient(stack: ur.Stack, name: str, value: float, reflectance: bool) -> tuple[float, float]:
    """Reverse-mode derivative of the same mean, and its standard error over eight runs."""
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    wi, wo = (Array3f(np.ascontiguousarray(d.T)) for d in _directions(20_000))
    slopes = []
    for seed in range(8):
        x = Float(value)
        dr.enable_grad(x)
        bsdf = ur.solve(stack, samples=1, seed=seed, parameters={name: x})
        result = bsdf.reflectance(wi) if reflectance else bsdf.eval(wi, wo)
        dr.backward(dr.mean(result.x))
        slopes.append(dr.grad(x)[0])
    return float(np.mean(slopes)), float(np.std(slopes, ddof=1) / np.sqrt(len(slopes)))


def _cases() -> list:
    """Every parameter, by eval and by reflectance; compiling each in reverse takes long, so most are slow tests."""
    quick = {("layer_0.alpha", False), ("layer_1.albedo", True), ("layer_2.ior", False)}
    return [
        pytest.param(
            *case,
            reflectance,
            id=f"{len(case[0].layers)}-{case[1]}-{'reflectance' if reflectance else 'eval'}",
            marks=() if (case[1], reflectance) in quick else pytest.mark.slow,
        )
        for case in CASES
        for reflectance in (False, True)
    ]


@pytest.mark.parametrize(("stack", "name", "value", "half", "reflectance"), _cases())
def test_reverse_mode(stack: ur.Stack, name: str, value: float, half: float, reflectance: bool) -> None:
    slope, slope_error = _slope(stack, name, value, half, reflectance)
    gradient, gradient_error = _gradient(stack, name, value, reflectance)
    # 1 % for the curvature that a central difference does not see.
    assert abs(gradient - slope) < 5 * np.hypot(slope_error, gradient_error) + 0.01 * abs(slope)


def test_several_samples_and_forward_mode() -> None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    wi, wo = (Array3f(np.ascontiguousarray(d.T)) for d in _directions(5000))
    slopes = []
    for reverse in (True, False):
        x = Float(0.2)
        dr.enable_grad(x)
        result = ur.solve(STACK, samples=4, parameters={"layer_0.alpha": x}).eval(wi, wo)
        mean = dr.mean(result.x)
        if reverse:
            dr.backward(mean)
            slopes.append(dr.grad(x)[0])
        else:
            dr.forward(x)
            slopes.append(dr.grad(mean)[0])
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-3)


def test_values_do_not_change_when_gradients_are_wanted() -> None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    wi, wo = (Array3f(np.ascontiguousarray(d.T)) for d in _directions(1000))
    x = Float(0.2)
    plain = np.array(ur.solve(STACK, samples=1, parameters={"layer_0.alpha": x}).eval(wi, wo))
    dr.enable_grad(x)
    live = np.array(dr.detach(ur.solve(STACK, samples=1, parameters={"layer_0.alpha": x}).eval(wi, wo)))
    np.testing.assert_allclose(live, plain, rtol=1e-4, atol=1e-7)


def test_in_a_render() -> None:
    """The plugin, through Mitsuba's path replay: the first sweeps are differentiated, so up to a tenth is lost."""
    import drjit as dr

    import urushi.mitsuba  # noqa: F401

    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 2},
            "sensor": {
                "type": "perspective",
                "fov": 10,
                "to_world": mi.ScalarTransform4f().look_at([0, -3, 3], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "plane": {"type": "rectangle", "bsdf": {"type": "layered", "filename": "preset:enamel"}},
            "light": {"type": "constant"},
        }
    )
    parameters = mi.traverse(scene)
    name = "plane.bsdf.layer_1.depth"

    def mean(spp: int, seed: int) -> object:
        return dr.mean(mi.render(scene, parameters, spp=spp, seed=seed)[:, :, 0], axis=None)

    dr.enable_grad(parameters[name])
    dr.backward(mean(512, 0))
    gradient = dr.grad(parameters[name])[0]
    dr.disable_grad(parameters[name])
    ends = []
    for depth in (0.55, 0.45):
        parameters[name] = mi.Float(depth)
        parameters.update()
        ends.append(mean(2048, 1).array[0])  # type: ignore[attr-defined]
    slope = (ends[0] - ends[1]) / 0.1
    assert gradient == pytest.approx(slope, rel=0.12)
