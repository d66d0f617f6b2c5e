"""How far the energies of lobes are from those of adding: the bounds of docs/method-lobes.md."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

GOLD = {"eta": 0.2, "k": 3.9}
THETA = np.radians([0.0, 30, 45, 60, 75])
WI = np.stack([np.sin(THETA), 0 * THETA, np.cos(THETA)], axis=1)


def _glass(alpha: float, ior: float = 1.5) -> ur.Dielectric:
    return ur.Dielectric(ior=ior, alpha=alpha)


def _metal(alpha: float) -> ur.Conductor:
    return ur.Conductor(**GOLD, alpha=alpha)


def _hazy(depth: float, g: float) -> ur.Medium:
    return ur.Medium(depth=depth, albedo=0.95, phase=ur.HenyeyGreenstein(g=g))


ABSORBING = ur.Medium(depth=0.5, albedo=0.0)

# name: layers, the largest difference of reflectance and transmittance up to 75 degrees
CASES: dict[str, tuple[list, float]] = {
    **{
        f"coat {a} on metal {b}": ([_glass(a), _metal(b)], 0.01)
        for a in (0.1, 0.3)
        for b in (0.0, 0.1, 0.3, 0.8)
    },
    **{
        f"coat {a} on metal {b}": ([_glass(a), _metal(b)], 0.015)
        for a in (0.5, 0.8)
        for b in (0.0, 0.1, 0.3, 0.8)
    },
    "smooth coat on metal 0.3": ([_glass(0.0), _metal(0.3)], 0.01),
    "coat 1.3 on metal 0.1": ([_glass(0.1, 1.3), _metal(0.1)], 0.01),
    "coat 2.0 on metal 0.2": ([_glass(0.3, 2.0), _metal(0.2)], 0.01),
    "coat 0.05 on metal 0.2": ([_glass(0.05), _metal(0.2)], 0.01),
    "coat 0.2 on metal 0.05": ([_glass(0.2), _metal(0.05)], 0.01),
    **{f"coat {a} on diffuse": ([_glass(a), ur.Diffuse(0.8)], 0.01) for a in (0.1, 0.3, 0.8)},
    **{f"coat {a}, absorbing, metal": ([_glass(a), ABSORBING, _metal(0.2)], 0.008) for a in (0.1, 0.3, 0.8)},
    **{
        f"coat, g {g} of depth {depth}, metal": ([_glass(0.1), _hazy(depth, g), _metal(0.2)], 0.011)
        for g in (0.3, 0.5, 0.7, 0.8, 0.9)
        for depth in (0.2, 0.5, 1.0, 2.0)
    },
    "coat 0.1, g 0.5, diffuse": ([_glass(0.1), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.004),
    "coat 0.8, g 0.5, diffuse": ([_glass(0.8), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.004),
    "coat, absorbing, diffuse": ([_glass(0.1), ABSORBING, ur.Diffuse(0.9)], 0.005),
    **{
        f"three {a} {b} {c}": ([_glass(a), _glass(b, 2.0), _metal(c)], 0.02)
        for a, b, c in ((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.1, 0.3, 0.1), (0.3, 0.1, 0.2), (0.8, 0.8, 0.8))
    },
    "three, the upper denser": ([_glass(0.1, 1.8), _glass(0.1, 1.4), _metal(0.1)], 0.011),
    "three, on diffuse": ([_glass(0.1), _glass(0.2, 2.0), ur.Diffuse(0.8)], 0.005),
    "three, the upper denser, on diffuse": (
        [_glass(0.071, 1.96), _glass(0.078, 1.54), ur.Diffuse(0.86)],
        0.005,
    ),
    "four": ([_glass(0.1, 1.3), _glass(0.1, 1.6), _glass(0.1, 2.0), _metal(0.1)], 0.015),
    "four, one thinner": ([_glass(0.1, 2.0), _glass(0.1, 1.5), _glass(0.1, 2.0), _metal(0.1)], 0.026),
    # drawn at random, and nothing is fitted to them
    "three, drawn, much denser above": ([_glass(0.034, 2.13), _glass(0.089, 1.38), _metal(0.219)], 0.022),
    "three, drawn, denser below": ([_glass(0.038, 1.6), _glass(0.026, 2.17), _metal(0.036)], 0.012),
    "coat, hazy, metal, drawn": ([_glass(0.067, 1.86), _hazy(0.15, 0.36), _metal(0.12)], 0.01),
    **{
        f"sheet {a} {b}": ([_glass(a), _glass(b, 1.0)], 0.015)
        for a, b in ((0.1, 0.1), (0.3, 0.3), (0.1, 0.4), (0.4, 0.1), (0.2, 0.0), (0.8, 0.8))
    },
    "sheet, absorbing": ([_glass(0.1), ABSORBING, _glass(0.3, 1.0)], 0.015),
    "sheet, scattering": ([_glass(0.1), _hazy(0.5, 0.5), _glass(0.3, 1.0)], 0.008),
}
MIRROR = {"eta": 0.0, "k": 3.0, "multiple_scattering": "compensated"}


@pytest.mark.parametrize("g", [0.0, 0.9, -0.5])
def test_nothing_is_lost_in_media(g: float) -> None:
    """Moments and beams keep all light between them, at nodes of the tables and off them."""
    medium = ur.Medium(depth=0.77, albedo=1.0, phase=ur.HenyeyGreenstein(g=g))
    coat = ur.Dielectric(ior=1.6, alpha=0.15, multiple_scattering="compensated")
    for base in (ur.Diffuse(1.0), ur.Conductor(**MIRROR, alpha=0.25)):
        white = ur.solve(ur.Stack(layers=[coat, medium, base]), "lobes").reflectance(WI)
        np.testing.assert_allclose(white, 1, atol=1e-3)
    sheet = ur.solve(ur.Stack(layers=[coat, medium, coat.model_copy(update={"ior": 1.0})]), "lobes")
    np.testing.assert_allclose(sheet.reflectance(WI) + sheet.transmittance(WI), 1, atol=1e-3)


def test_nothing_is_lost_between_interfaces() -> None:
    coats = [
        ur.Dielectric(ior=n, alpha=a, multiple_scattering="compensated") for n, a in ((2.0, 0.1), (1.4, 0.2))
    ]
    for layers in (coats, coats[::-1]):
        white = ur.solve(ur.Stack(layers=[*layers, ur.Conductor(**MIRROR, alpha=0.3)]), "lobes").reflectance(
            WI
        )
        np.testing.assert_allclose(white, 1, atol=1e-3)


QUICK = (
    "coat 0.3 on metal 0.1",
    "coat 0.3 on metal 0.8",
    "coat 0.3 on diffuse",
    "three 0.3 0.3 0.3",
    "coat, hazy, metal, drawn",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES]
)
def test_energies(name: str) -> None:
    layers, limit = CASES[name]
    stack = ur.Stack(layers=layers)
    exact, lobes = ur.solve(stack, "adding", accuracy=1e-3), ur.solve(stack, "lobes")
    off = lobes.reflectance(WI)[:, 0] - exact.reflectance(WI)[:, 0]
    assert np.abs(off).max() < limit, np.round(off, 4)
    if not layers[-1].opaque:
        off = lobes.transmittance(WI)[:, 0] - exact.transmittance(WI)[:, 0]
        assert np.abs(off).max() < limit, np.round(off, 4)
