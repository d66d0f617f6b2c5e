"""Energies of stacks with two roughnesses: they hang on azimuths all the way, and light is followed with its own."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

GOLD = {"eta": 0.2, "k": 3.9}
COMPLETE = {"multiple_scattering": "compensated"}


def _glass(ior: float, *alpha: float, turn: float = 0.0, **more: object) -> ur.Dielectric:
    return ur.Dielectric(ior=ior, alpha=alpha, rotation=turn, **more)


def _metal(*alpha: float, turn: float = 0.0, **more: object) -> ur.Conductor:
    return ur.Conductor(**{**GOLD, **more}, alpha=alpha, rotation=turn)


def _directions(azimuths: tuple[float, ...], thetas: tuple[float, ...], side: int = 1) -> np.ndarray:
    phi, theta = (x.ravel() for x in np.meshgrid(*map(np.radians, (azimuths, thetas)), indexing="ij"))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), side * np.cos(theta)], axis=1)


def _solved(layers: list, **options: object):
    return ur.solve(ur.Stack(layers=layers), "lobes", **{"precision": "double", **options})


#: layers, the side of the light, and what the walk reflects (2^19 paths, 5e-4) at azimuths 0, 45, 90 and 30, 75 degrees
TRUTH = {
    "bare metal": (
        [_metal(0.115, 0.235)],
        1,
        [0.9051, 0.8317, 0.9015, 0.82, 0.8976, 0.821],
    ),
    "dielectric from its denser side": (
        [_glass(1.308, 0.206, 0.629)],
        -1,
        [0.0499, 0.6331, 0.0519, 0.5284, 0.0513, 0.3356],
    ),
    "coat on metal": (
        [_glass(1.716, 0.144, 0.264), _metal(0.115, 0.235)],
        1,
        [0.6523, 0.5149, 0.6608, 0.535, 0.6669, 0.5599],
    ),
    "smooth coat on metal": (
        [ur.Dielectric(ior=1.5), _metal(0.05, 0.3)],
        1,
        [0.8019, 0.6242, 0.804, 0.7685, 0.8038, 0.7989],
    ),
    "coat, medium, metal across": (
        [_glass(1.5, 0.1, 0.3), ur.Medium(depth=0.5, albedo=0.0), _metal(0.05, 0.3, turn=90)],
        1,
        [0.2235, 0.2771, 0.2183, 0.1879, 0.212, 0.1434],
    ),
    "three frames": (
        [_glass(1.5, 0.1, 0.3, turn=30), _glass(2.0, 0.25, 0.05, turn=70), _metal(0.1, 0.2, turn=120)],
        1,
        [0.6001, 0.489, 0.6017, 0.5214, 0.593, 0.4334],
    ),
    "sheet": (
        [_glass(1.5, 0.1, 0.3, turn=30), _glass(1.0, 0.25, 0.05, turn=90)],
        1,
        [0.0795, 0.3502, 0.0798, 0.3297, 0.0866, 0.3208],
    ),
}


@pytest.mark.parametrize("name", TRUTH)
def test_reflectance(name: str) -> None:
    """To 0.008; with the roughness in the plane of incidence, or the mean one, 0.02 to 0.13 for all of these."""
    layers, side, truth = TRUTH[name]
    bsdf = _solved(layers)
    assert bsdf.diagnostics["energies"] == "direction by direction"
    found = bsdf.reflectance(_directions((0, 45, 90), (30, 75), side)).mean(axis=1)
    np.testing.assert_allclose(found, truth, atol=8e-3)


def test_nothing_is_lost() -> None:
    """Complete facets on a mirror reflect everything, sheets transmit what they do not reflect, ledgers sum to 1."""
    wi = _directions((0, 20, 75), (1, 40, 80))
    white = [_glass(1.5, 0.1, 0.5, turn=20, **COMPLETE), _metal(0.1, 0.4, eta=0.0, k=3.0, **COMPLETE)]
    np.testing.assert_allclose(_solved(white).reflectance(wi), 1, atol=2e-3)
    sheet = _solved([white[0], _glass(1.0, 0.4, 0.1, **COMPLETE)])
    np.testing.assert_allclose(sheet.reflectance(wi) + sheet.transmittance(wi), 1, atol=2e-3)
    haze = ur.Medium(depth=0.5, albedo=0.8, phase=ur.HenyeyGreenstein(g=0.6))
    for layers in ([_metal(0.1, 0.4)], [_glass(1.5, 0.1, 0.5, turn=20), haze, _metal(0.1, 0.4)]):
        bsdf = _solved(layers)
        ledger = bsdf.absorption(wi)
        np.testing.assert_allclose(ledger.reflected, bsdf.reflectance(wi), atol=1e-9)
        np.testing.assert_allclose(ledger.total, 1, atol=1e-6)
        assert ledger.lost.min() > -2e-3 and ledger.absorbed.min() > -2e-3


def test_turning_all_turns_the_answer() -> None:
    """Also past right angles, and where axes differ; nothing else is special about x."""
    phi = np.array([0.0, 30, 90])

    def at(turn: float) -> np.ndarray:
        layers = [_glass(1.6, 0.1, 0.3, turn=turn), _metal(0.05, 0.2, turn=turn + 40)]
        return _solved(layers).reflectance(_directions(tuple(phi + turn), (20, 70)))

    np.testing.assert_allclose(at(0), at(77), atol=2e-3)
    across = [_glass(1.6, 0.3, 0.1, turn=90), _metal(0.2, 0.05, turn=130)]
    np.testing.assert_allclose(
        _solved(across).reflectance(_directions((0, 30, 90), (20, 70))), at(0), atol=3e-3
    )


@pytest.mark.parametrize("name", ["alpha", "rotation"])
def test_derivatives(name: str) -> None:
    """In what widens and in what turns, against differences."""
    import drjit as dr
    from drjit.llvm.ad import Array2f64, Array3f64, Float64

    stack = ur.Stack(layers=[_glass(1.5, 0.1, 0.2), _metal(0.1, 0.3, turn=25)])
    wi = Array3f64(*map(float, _directions((20,), (70,))[0]))
    value, half = {"alpha": (0.3, 0.015), "rotation": (25.0, 3.0)}[name]

    def energy(x: Float64) -> Float64:
        given = Array2f64(0.1, x) if name == "alpha" else x
        bsdf = ur.solve(stack, "lobes", parameters={f"layer_1.{name}": given}, precision="double")
        assert bsdf.diagnostics["energies"] == "direction by direction"
        return bsdf.reflectance(wi)[0]

    x = Float64(value)
    dr.enable_grad(x)
    found = energy(x)
    dr.backward(found)
    ends = [energy(Float64(value + step))[0] for step in (half, -half)]
    assert dr.grad(x)[0] == pytest.approx((ends[0] - ends[1]) / (2 * half), rel=0.05)


@pytest.mark.parametrize(
    ("name", "key", "error"),
    [
        ("bare metal", "layer_0.k", 0.017),
        ("coat on metal", "layer_0.ior", 0.05),
        ("smooth coat on metal", "layer_0.ior", 0.13),
        ("sheet", "layer_0.ior", 0.04),
    ],
)
def test_the_recursion(name: str, key: str, error: float) -> None:
    """With one number for each lane: deeper interfaces have the mean roughness, not that in the plane outside."""
    layers, side, truth = TRUTH[name]
    value = getattr(layers[0], key.split(".")[1])
    bsdf = _solved(layers, parameters={key: np.full(6, float(value))})
    assert bsdf.diagnostics["energies"] == "recursion"
    found = bsdf.reflectance(_directions((0, 45, 90), (30, 75), side)).mean(axis=1)
    np.testing.assert_allclose(found, truth, atol=error)
