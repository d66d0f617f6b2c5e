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
    **{f"coat {a}, absorbing, metal": ([_glass(a), ABSORBING, _metal(0.2)], 0.012) for a in (0.1, 0.3, 0.8)},
    **{
        f"coat, g {g} of depth {depth}, metal": ([_glass(0.1), _hazy(depth, g), _metal(0.2)], 0.023)
        for g in (0.3, 0.5, 0.7, 0.8, 0.9)
        for depth in (0.2, 0.5, 1.0, 2.0)
    },
    "coat 0.1, g 0.5, diffuse": ([_glass(0.1), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.015),
    "coat 0.8, g 0.5, diffuse": ([_glass(0.8), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.015),
    **{
        f"three {a} {b} {c}": ([_glass(a), _glass(b, 2.0), _metal(c)], 0.022)
        for a, b, c in ((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.1, 0.3, 0.1), (0.3, 0.1, 0.2), (0.8, 0.8, 0.8))
    },
    "three, the upper denser": ([_glass(0.1, 1.8), _glass(0.1, 1.4), _metal(0.1)], 0.022),
    "three, on diffuse": ([_glass(0.1), _glass(0.2, 2.0), ur.Diffuse(0.8)], 0.01),
    **{
        f"sheet {a} {b}": ([_glass(a), _glass(b, 1.0)], 0.015)
        for a, b in ((0.1, 0.1), (0.3, 0.3), (0.1, 0.4), (0.4, 0.1), (0.2, 0.0), (0.8, 0.8))
    },
    "sheet, absorbing": ([_glass(0.1), ABSORBING, _glass(0.3, 1.0)], 0.015),
    "sheet, scattering": ([_glass(0.1), _hazy(0.5, 0.5), _glass(0.3, 1.0)], 0.03),
}
QUICK = ("coat 0.3 on metal 0.1", "coat 0.3 on metal 0.8", "coat 0.3 on diffuse", "three 0.3 0.3 0.3")


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
