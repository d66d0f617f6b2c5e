"""Rough diffuse bases in lobes: alone, and under coats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from conftest import Tool
from lanes import direction, hemisphere, needs_llvm
from mitsuba_plugin import Asked, layered, stack_file
from slopes import slopes
from urushi.solvers import lobes

pytestmark = needs_llvm

THETA = np.radians([0.0, 30, 45, 60, 75])
WI = direction(np.cos(THETA), 0.0)
WALK: dict[str, Any] = {"multiple_scattering": "walk"}


def _matte(alpha: Any, **options: Any) -> ur.Diffuse:
    return ur.Diffuse(options.pop("reflectance", 0.8), alpha=alpha, **options)


def _apart(ours: Any, truth: Any, wi: np.ndarray, rng: np.random.Generator) -> float:
    """The integral of |f - truth| |cos| over that of the truth."""
    one = np.repeat(wi[None], 3000, axis=0)
    sample = ours.sample(one, rng.random((3000, 3)))
    a, b = (bsdf.eval(one, sample.wo)[:, 0] / np.maximum(sample.pdf, 1e-9) for bsdf in (ours, truth))
    a, b = (np.where(sample.delta, 0, x) for x in (a, b))
    return float(np.abs(a - b).mean() / b.mean())


# name: layers, largest difference of the reflectance to the walk, and of values to adding, relative to their integral
CASES: dict[str, tuple[list, float, float]] = {
    **{
        f"{alpha} {options}": ([_matte(alpha, **options)], 0.002, 0.03)
        for alpha in (0.1, 0.3, 0.8)
        for options in ({}, WALK, {"distribution": "beckmann"})
    },
    **{
        f"coat {coat}, {alpha} {options}": (
            [ur.Dielectric(ior=1.5, alpha=coat), _matte(alpha, **options)],
            0.006,
            0.03,
        )
        for coat in (0.0, 0.3)
        for alpha in (0.3, 0.8)
        for options in ({}, WALK)
    },
    "coat 0.1": ([ur.Dielectric(ior=1.5, alpha=0.1), _matte(0.8, **WALK)], 0.008, 0.03),
    "coat 2.0": ([ur.Dielectric(ior=2.0, alpha=0.3), _matte(0.5, **WALK)], 0.01, 0.04),
    "three": (
        [ur.Dielectric(ior=1.5, alpha=0.3), ur.Dielectric(ior=2.0, alpha=0.3), _matte(0.5, **WALK)],
        0.006,
        0.02,
    ),
    "absorbing": (
        [ur.Dielectric(ior=1.5, alpha=0.3), ur.Medium(depth=0.5, albedo=0.0), _matte(0.8, **WALK)],
        0.006,
        0.05,
    ),
    "scattering": (
        [
            ur.Dielectric(ior=1.5, alpha=0.3),
            ur.Medium(depth=0.5, albedo=0.95, phase=ur.HenyeyGreenstein(g=0.5)),
            _matte(0.5, **WALK),
        ],
        0.006,
        0.03,
    ),
}
QUICK = ("0.8 {}", "0.3 {'multiple_scattering': 'walk'}", "coat 0.3, 0.8 {}")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES]
)
def test_against_adding(name: str, rng: np.random.Generator) -> None:
    layers, energy, value = CASES[name]
    stack = ur.Stack(layers=layers)
    exact, ours = ur.solve(stack, "adding", accuracy=2e-3), ur.solve(stack, "lobes")
    # Adding knows such bases by samples, and those of one angle are fewer than the walk's.
    truth, error = ur.solve(stack, "walk", samples=1 << 16).reflectance(WI, with_error=True)
    off = ours.reflectance(WI)[:, 0] - truth[:, 0]
    assert np.all(np.abs(off) < energy + 4 * error[:, 0]), np.round(off, 4)
    for wi in WI[[0, 1, 3]]:
        assert _apart(ours, exact, wi, rng) < value


def test_lambert_in_its_place_is_far_off(rng: np.random.Generator) -> None:
    coat = ur.Dielectric(ior=1.5, alpha=0.3)
    exact = ur.solve(ur.Stack(layers=[coat, _matte(0.8, **WALK)]), "adding", accuracy=2e-3)
    plain = ur.solve(ur.Stack(layers=[coat, ur.Diffuse(0.8)]), "lobes")
    assert _apart(plain, exact, WI[1], rng) > 0.1


@pytest.mark.parametrize("alpha", [0.5, (0.2, 0.6)], ids=["alike", "not alike"])
def test_alone_it_is_itself(alpha: Any, rng: np.random.Generator) -> None:
    """Values of the walk, which asks the interface, in colour; facets not alike in all directions, too."""
    stack = ur.Stack(layers=[_matte(alpha, reflectance=[0.2, 0.5, 0.9], **WALK)])
    wi, wo = hemisphere(rng, 24, 0.1), hemisphere(rng, 24, 0.1)
    truth, error = ur.solve(stack, "walk", samples=4096).eval(wi, wo, with_error=True)
    found = ur.solve(stack, "lobes", precision="double").eval(wi, wo)
    most, sum_of_all = (0.025, 0.01) if alpha == 0.5 else (0.06, 0.03)
    assert np.all(np.abs(found - truth) < 5 * error + most * truth)
    assert np.abs(found - truth).sum() < sum_of_all * truth.sum()


@pytest.mark.parametrize("coat", [None, 0.0, 0.1, 0.6])
def test_white_stays_white(coat: float | None, rng: np.random.Generator) -> None:
    layers: list = (
        [] if coat is None else [ur.Dielectric(ior=1.5, alpha=coat, multiple_scattering="compensated")]
    )
    for alpha, kind in ((0.3, "ggx"), (0.8, "ggx"), (0.5, "beckmann")):
        base = _matte(alpha, reflectance=1.0, distribution=kind, **WALK)
        bsdf = lobes.solve(ur.Stack(layers=[*layers, base]))
        np.testing.assert_allclose(bsdf.reflectance(WI), 1, atol=5e-3)
        for wi in WI[[0, 3]]:
            weight = bsdf.sample(wi[None], rng.random((40_000, 3))).weight[:, 0]
            assert abs(weight.mean() - 1) < 4 * weight.std() / 200 + 5e-3


def test_the_ledger_adds_up() -> None:
    """Facets absorb what they do not reflect; what they send into others is lost, if it does not go on."""
    for layers in ([_matte(0.6)], [ur.Dielectric(ior=1.5, alpha=0.2), _matte(0.6)]):
        bsdf = lobes.solve(ur.Stack(layers=layers), precision="double")
        ledger = bsdf.absorption(WI)
        np.testing.assert_allclose(ledger.total, 1, atol=1e-9)
        np.testing.assert_allclose(ledger.reflected, bsdf.reflectance(WI), atol=1e-9)
        if len(layers) == 1:
            np.testing.assert_allclose(ledger.absorbed[0], 0.2, atol=1e-9)
        assert np.all(ledger.lost[len(layers) - 1] > 0.05)
    complete = lobes.solve(ur.Stack(layers=[_matte(0.6, **WALK)]), precision="double").absorption(WI)
    assert np.all(np.abs(complete.lost) < 1e-9)


@pytest.mark.parametrize("coat", [(), (ur.Dielectric(ior=1.5, alpha=0.2),)], ids=["alone", "coated"])
def test_reciprocity(coat: tuple, rng: np.random.Generator) -> None:
    wi, wo = hemisphere(rng, 100, 0.05), hemisphere(rng, 100, 0.05)
    stack = ur.Stack(layers=[*coat, _matte((0.2, 0.6), reflectance=[0.2, 0.5, 0.9], rotation=30.0, **WALK)])
    for symmetric in (True,) if coat else (True, False):
        bsdf = lobes.solve(stack, symmetric=symmetric, precision="double")
        one, other = bsdf.eval(wi, wo) / wo[:, 2:], bsdf.eval(wo, wi) / wi[:, 2:]
        np.testing.assert_allclose(one, other, rtol=1e-5)
    forward = lobes.solve(stack, precision="double").eval(wi, wo) / wo[:, 2:]
    np.testing.assert_allclose(np.median(one / forward, axis=0), 1, atol=0.01)


def test_sampling_follows_its_density() -> None:
    from urushi.checks import chi2, normalisation

    bsdf = lobes.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), _matte(0.6, **WALK)]))
    for check in (chi2.check, normalisation.check):
        report = check(lambda _: bsdf, True)
        assert report.passed, report.text


@pytest.mark.parametrize(
    ("name", "value", "half"), [("layer_1.reflectance", 0.6, 1e-4), ("layer_1.alpha", 0.41, 1e-4)]
)
def test_derivatives(name: str, value: float, half: float) -> None:
    from drjit.llvm.ad import Array3f64

    stack = ur.Stack(layers=[ur.Dielectric(ior=1.53, alpha=0.13), _matte(0.41, **WALK)])
    wi, wo = Array3f64(0.6, 0, 0.8), Array3f64(0.5, 0.2, 0.71**0.5)

    def values(x: Any) -> tuple:
        bsdf = lobes.solve(stack, parameters={name: x}, precision="double")
        return bsdf.eval(wi, wo).x, bsdf.reflectance(wi).x

    for found, difference in slopes(values, value, half):
        assert abs(difference) > 1e-3
        assert found == pytest.approx(difference, rel=2e-3)


def test_values_per_lane_and_smooth_ones(rng: np.random.Generator) -> None:
    """One roughness for each lane; where that is 0 the base is Lambert's."""
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), _matte(0.5, **WALK)])
    wi, wo = hemisphere(rng, 3, 0.1), hemisphere(rng, 3, 0.1)
    alphas = np.array([0.0, 0.2, 0.7])
    lanes = lobes.solve(stack, parameters={"layer_1.alpha": alphas}, precision="double").eval(wi, wo)
    for k, base in enumerate((ur.Diffuse(0.8), _matte(0.2, **WALK), _matte(0.7, **WALK))):
        one = lobes.solve(ur.Stack(layers=[*stack.layers[:1], base]), precision="double")
        np.testing.assert_allclose(lanes[k], one.eval(wi[k], wo[k]), rtol=1e-4 if k == 0 else 1e-9)


def test_a_textured_roughness_in_the_plugin(mi: Any, tmp_path: Path) -> None:
    rough = np.repeat(np.repeat(np.array([[51, 153]], np.uint8), 16, axis=0), 8, axis=1)[..., None]
    mi.Bitmap(np.ascontiguousarray(rough)).write(str(tmp_path / "rough.png"))
    layers = [
        "dielectric: {ior: 1.5, alpha: 0.2}",
        "diffuse: {reflectance: 0.6, alpha: {texture: rough.png}}",
    ]
    plugin = layered(mi, filename=stack_file(tmp_path, layers)["filename"], method="lobes")
    wi, wo = direction(np.array([0.8, 0.8]), 0.3), direction(np.array([0.7, 0.7]), 0.8)
    found = Asked.of(mi, plugin, wi, uv=np.array([[0.25, 0.5], [0.75, 0.5]])).value(wo)
    for k, alpha in enumerate((0.2, 0.6)):
        stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), _matte(alpha, reflectance=0.6)])
        np.testing.assert_allclose(found[k], lobes.solve(stack).eval(wi[k], wo[k]), rtol=2e-3)
    assert abs(found[0, 0] / found[1, 0] - 1) > 0.03


def test_with_a_normal_of_its_own(rng: np.random.Generator) -> None:
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), _matte(0.8, normal=(0.2, 0.1, 1.0))])
    wi, wo = hemisphere(rng, 60, 0.2), hemisphere(rng, 60, 0.2)
    truth = ur.solve(stack, "walk", samples=1024).eval(wi, wo)
    assert np.abs(lobes.solve(stack).eval(wi, wo) - truth).sum() < 0.022 * truth.sum()


def test_a_sample_of_the_tables_is_made_anew(tool: Tool) -> None:
    lobe_matte = tool("lobe_matte")
    from urushi.solvers.lobes import axes, matte, tables

    with np.load(Path(tables.__file__).parent / "data" / "matte.npz") as file:
        shipped = {name: np.array(file[name], float) for name in file}
    alphas = axes.squares(matte.ONCE[0])
    assert {name.split("_")[0] for name in shipped} == {"ggx", "beckmann"}
    for kind in ("ggx", "beckmann"):
        w, o = lobe_matte.places(matte.ONCE)
        once = lobe_matte.once(w[::4], o[::4], float(alphas[6]), kind)
        np.testing.assert_allclose(shipped[f"{kind}_once"][6, ::4, ..., 0] * matte.COARSE, once, atol=5e-4)
        again = lobe_matte.again((1, 3, 3, 3), float(alphas[6]), kind, 1, 1 << 11)
        kept = shipped[f"{kind}_again"][6, ::4, ::4, ::2] * matte.STEP
        np.testing.assert_allclose(kept[1:, 1:], again[1:, 1:], atol=0.03)
        first, later = shipped[f"{kind}_once"] * matte.COARSE, shipped[f"{kind}_again"] * matte.STEP
        made = lobe_matte.cones(first, later, alphas[5:7], kind, (2, *matte.CONES[1:]))
        np.testing.assert_allclose(
            shipped[f"{kind}_cones"][5:7, ..., :2] * matte.STEP, made[..., :2], atol=1e-3
        )
