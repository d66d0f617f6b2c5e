"""How far the energies of lobes are from those of adding: the bounds of docs/method-lobes.md.

Stacks of several interfaces or of particles are followed direction by direction where their numbers are the same for
all lanes; the recursion answers for the others, and for all where numbers differ.
"""

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

#: the largest difference of reflectance and transmittance up to 75 degrees of what is followed
FOLLOWED = 0.002

# name: layers, the same of the recursion
CASES: dict[str, tuple[list, float]] = {
    **{
        f"coat {a} on metal {b}": ([_glass(a), _metal(b)], 0.006)
        for a in (0.1, 0.3)
        for b in (0.0, 0.1, 0.3, 0.8)
    },
    **{
        f"coat {a} on metal {b}": ([_glass(a), _metal(b)], 0.012)
        for a in (0.5, 0.8)
        for b in (0.0, 0.1, 0.3, 0.8)
    },
    "smooth coat on metal 0.3": ([_glass(0.0), _metal(0.3)], 0.0025),
    "coat 1.3 on metal 0.1": ([_glass(0.1, 1.3), _metal(0.1)], 0.0035),
    "coat 2.0 on metal 0.2": ([_glass(0.3, 2.0), _metal(0.2)], 0.005),
    "coat 0.05 on metal 0.2": ([_glass(0.05), _metal(0.2)], 0.005),
    "coat 0.2 on metal 0.05": ([_glass(0.2), _metal(0.05)], 0.006),
    **{f"coat {a} on diffuse": ([_glass(a), ur.Diffuse(0.8)], 0.0015) for a in (0.1, 0.3, 0.8)},
    **{f"coat {a}, absorbing, metal": ([_glass(a), ABSORBING, _metal(0.2)], 0.006) for a in (0.1, 0.3, 0.8)},
    **{
        f"coat, g {g} of depth {depth}, metal": ([_glass(0.1), _hazy(depth, g), _metal(0.2)], 0.0095)
        for g in (0.3, 0.5, 0.7, 0.8, 0.9)
        for depth in (0.2, 0.5, 1.0, 2.0)
    },
    "coat 0.1, g 0.5, diffuse": ([_glass(0.1), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.0015),
    "coat 0.8, g 0.5, diffuse": ([_glass(0.8), _hazy(1.0, 0.5), ur.Diffuse(0.5)], 0.0015),
    "coat, absorbing, diffuse": ([_glass(0.1), ABSORBING, ur.Diffuse(0.9)], 0.001),
    **{
        f"three {a} {b} {c}": ([_glass(a), _glass(b, 2.0), _metal(c)], 0.02)
        for a, b, c in ((0.1, 0.1, 0.1), (0.3, 0.3, 0.3), (0.1, 0.3, 0.1), (0.3, 0.1, 0.2), (0.8, 0.8, 0.8))
    },
    "three, the upper denser": ([_glass(0.1, 1.8), _glass(0.1, 1.4), _metal(0.1)], 0.01),
    "three, on diffuse": ([_glass(0.1), _glass(0.2, 2.0), ur.Diffuse(0.8)], 0.0025),
    "three, the upper denser, on diffuse": (
        [_glass(0.071, 1.96), _glass(0.078, 1.54), ur.Diffuse(0.86)],
        0.004,
    ),
    "four": ([_glass(0.1, 1.3), _glass(0.1, 1.6), _glass(0.1, 2.0), _metal(0.1)], 0.0135),
    "four, one thinner": ([_glass(0.1, 2.0), _glass(0.1, 1.5), _glass(0.1, 2.0), _metal(0.1)], 0.025),
    # drawn at random, and nothing is fitted to them
    "three, drawn, much denser above": ([_glass(0.034, 2.13), _glass(0.089, 1.38), _metal(0.219)], 0.021),
    "three, drawn, denser below": ([_glass(0.038, 1.6), _glass(0.026, 2.17), _metal(0.036)], 0.011),
    "coat, hazy, metal, drawn": ([_glass(0.067, 1.86), _hazy(0.15, 0.36), _metal(0.12)], 0.006),
    **{
        f"sheet {a} {b}": ([_glass(a), _glass(b, 1.0)], 0.0125)
        for a, b in ((0.1, 0.1), (0.3, 0.3), (0.1, 0.4), (0.4, 0.1), (0.2, 0.0), (0.8, 0.8))
    },
    "sheet, absorbing": ([_glass(0.1), ABSORBING, _glass(0.3, 1.0)], 0.007),
    "sheet, scattering": ([_glass(0.1), _hazy(0.5, 0.5), _glass(0.3, 1.0)], 0.008),
}
CASES["half-space"] = [_glass(0.161, 1.27), _glass(0.072, 1.04)], 0.095
# of alphas up to 0.8, drawn as well
CASES["three, drawn, rough"] = [_glass(0.66, 1.58), _glass(0.644, 1.28), _metal(0.365)], 0.012
CASES["four, drawn, much thinner below"] = (
    [_glass(0.024, 1.82), _glass(0.054, 1.58), _glass(0.031, 1.38), _metal(0.294)],
    0.048,
)
CASES["half-space of three, drawn"] = [_glass(0.16, 1.72), _glass(0.023, 1.32), _glass(0.048, 1.16)], 0.18
CASES["smooth coat, g 0.9, smooth metal"] = (
    [
        _glass(0.0),
        ur.Medium(depth=0.5, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.9)),
        _metal(0.0),
    ],
    0.075,
)
CASES["coat, Rayleigh, metal"] = (
    [
        _glass(0.2),
        ur.Medium(depth=0.7, albedo=0.9, phase=ur.Rayleigh()),
        _metal(0.1),
    ],
    0.01,
)
# What adding says of stacks that it takes long for: reflectance and transmittance, of azimuthal order 0 alone.
KNOWN = {
    "three 0.1 0.3 0.1": [[0.71184, 0.65486, 0.58959, 0.52972, 0.51733]],
    "three, drawn, rough": [[0.24675, 0.226, 0.20558, 0.18762, 0.1849]],
    "four, drawn, much thinner below": [[0.72948, 0.7069, 0.68333, 0.66824, 0.70518]],
    "half-space": [
        [0.02308, 0.02515, 0.03583, 0.08856, 0.25118],
        [0.97185, 0.96607, 0.9466, 0.85556, 0.56322],
    ],
    "half-space of three, drawn": [
        [0.08554, 0.08895, 0.10169, 0.14382, 0.24491],
        [0.90786, 0.89959, 0.87501, 0.79781, 0.6064],
    ],
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
    "coat 0.3 on diffuse",
    "three 0.3 0.3 0.3",
    "half-space",
)


def _off(bsdf: object, name: str) -> np.ndarray:
    """(A, 1 or 2) lobes less adding: reflectance, and transmittance if there is any."""
    stack = ur.Stack(layers=CASES[name][0])
    found = [bsdf.reflectance(WI)[:, 0]]
    if not stack.layers[-1].opaque:
        found.append(bsdf.transmittance(WI)[:, 0])
    if name in KNOWN:
        return np.transpose(found) - np.transpose(KNOWN[name])
    exact = ur.solve(stack, "adding", accuracy=1e-3)
    truth = [exact.reflectance(WI)[:, 0], exact.transmittance(WI)[:, 0]]
    return np.transpose(found) - np.transpose(truth[: len(found)])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES]
)
def test_energies(name: str) -> None:
    layers, limit = CASES[name]
    lobes = ur.solve(ur.Stack(layers=layers), "lobes")
    followed = lobes.diagnostics["energies"] != "recursion"
    assert followed == (not _simple(layers))
    off = _off(lobes, name)
    assert np.abs(off).max() < (FOLLOWED if followed else limit), np.round(off, 4)


def _simple(layers: list) -> bool:
    """One interface that light goes through, and no particles."""
    glass = sum(layer.kind == "dielectric" for layer in layers)
    return glass == 1 and not any(layer.kind == "medium" and layer.albedo for layer in layers)


#: those that hang on what a rough mirror sends back down to, and on what crossings add to the width of light in between
QUICK_RECURSION = ("three 0.1 0.3 0.1", "three, drawn, rough")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK_RECURSION else pytest.mark.slow)
        for name, (layers, _) in CASES.items()
        if not _simple(layers)
    ],
)
def test_energies_of_the_recursion(name: str) -> None:
    """One number for each lane."""
    layers, limit = CASES[name]
    alphas = np.full(len(WI), layers[0].alpha)
    lobes = ur.solve(ur.Stack(layers=layers), "lobes", parameters={"layer_0.alpha": alphas})
    assert lobes.diagnostics["energies"] == "recursion"
    off = _off(lobes, name)
    assert np.abs(off).max() < limit, np.round(off, 4)
