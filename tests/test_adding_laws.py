"""The laws on the operators of whole stacks: energy and reciprocity; and adding against the walk on every preset."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees
from urushi.solvers.adding import reasons_against
from urushi.solvers.adding.refine import difference
from urushi.solvers.adding.whole import unchecked

pytestmark = needs_llvm

HOW = "compensated"
LOSSLESS = {
    "three rough dielectrics over a rough mirror": [
        ur.Dielectric(ior=1.5, alpha=0.3, multiple_scattering=HOW),
        ur.Dielectric(ior=1.8, alpha=0.5, multiple_scattering=HOW),
        ur.Dielectric(ior=1.2, alpha=0.2, multiple_scattering=HOW),
        ur.Conductor(material="none", alpha=0.4, multiple_scattering=HOW),
    ],
    "a rough slab that scatters": [
        ur.Dielectric(ior=1.5, alpha=0.3, multiple_scattering=HOW),
        ur.Medium(depth=3.0, albedo=1.0, phase=ur.HenyeyGreenstein(g=0.6)),
        ur.Dielectric(ior=1.0, alpha=0.2, multiple_scattering=HOW),
    ],
    "smooth glass over white": [
        ur.Dielectric(ior=1.5),
        ur.Medium(depth=1.0, albedo=1.0, phase=ur.Rayleigh()),
        ur.Diffuse(reflectance=1.0),
    ],
    "a slab alone": [ur.Medium(depth=50.0, albedo=1.0, phase=ur.HenyeyGreenstein(g=0.8))],
}


@pytest.mark.parametrize("name", LOSSLESS)
def test_lossless_stacks_conserve_energy(name: str) -> None:
    """To 1e-6, from either side, between the nodes as well."""
    bsdf = ur.solve(ur.Stack(layers=LOSSLESS[name]), "adding", nodes=16)
    wi = degrees([0, 13, 41, 67, 85])
    for w in (wi,) if bsdf.stack.layers[-1].opaque else (wi, wi * [1, 1, -1]):
        whole = bsdf.reflectance(w) + bsdf.transmittance(w)
        assert np.abs(whole - 1).max() < 1e-6, whole - 1


@pytest.mark.parametrize("name", [*LOSSLESS, "coloured"])
def test_the_stored_operators_are_reciprocal(name: str) -> None:
    """A[o, i] / W_o = A'[i, o] / W_i, with W the etendue of the nodes, in every order."""
    coloured = [
        ur.Dielectric(ior=1.4, alpha=0.2),
        ur.Medium(depth=(0.3, 0.6, 1.0), albedo=(0.9, 0.5, 0.2), phase=ur.HenyeyGreenstein(g=-0.4)),
        ur.Dielectric(ior=1.7, alpha=0.4),
    ]
    solved = ur.solve(ur.Stack(layers=LOSSLESS.get(name, coloured)), "adding", nodes=12)
    found, grid = solved.matrices, solved.solution.grid
    for above in (True, False):
        for up in (True, False):
            if solved.stack.layers[-1].opaque and not (above and up):
                continue
            for order in range(min(found.orders, 9)):
                there = (
                    found.operator(order, above, up) / grid.etendue[: len(found.mu[0 if up else -1])][:, None]
                )
                back = (
                    found.operator(order, up, above)
                    / grid.etendue[: len(found.mu[0 if above else -1])][:, None]
                )
                size = np.abs(there).max() + 1e-12
                assert np.abs(there - np.swapaxes(back, 1, 2)).max() < 1e-6 * size, (above, up, order)


PRESETS = [name for name in ur.presets() if not reasons_against(ur.load(f"preset:{name}"))]


def test_most_presets_can_be_added() -> None:
    assert len(PRESETS) >= 12


@pytest.mark.slow
@pytest.mark.parametrize("name", PRESETS)
def test_adding_and_the_walk_agree(name: str) -> None:
    """Reflectance and transmittance to 0.3 %, every direction within its error."""
    solved = ur.solve(f"preset:{name}", "adding")
    walk = ur.solve(f"preset:{name}", "walk", samples=1 << 16)
    wi = degrees([0, 20, 40, 60, 75])
    sides = [wi] if solved.stack.layers[-1].opaque else [wi, wi * [1, 1, -1]]
    for w in sides:
        for flux in ("reflectance", "transmittance"):
            value, error = getattr(walk, flux)(w, with_error=True)
            away = np.abs(getattr(solved, flux)(w) - value)
            assert np.all(away < 4.5 * error + 3e-3 * value + 1e-5), (flux, (away - 4.5 * error).max())
        rng = np.random.default_rng(7)
        wo = rng.normal(size=(40, 3))
        wo /= np.linalg.norm(wo, axis=1, keepdims=True)
        for one in w[1:4]:
            value, error = walk.eval(np.repeat(one[None], 40, axis=0), wo, with_error=True)
            found = solved.eval(np.repeat(one[None], 40, axis=0), wo)
            peak = max(found.max(), value.max())
            assert np.all(np.abs(found - value) <= 5 * error + 2e-3 * peak), (
                one,
                np.abs(found - value).max(),
            )


def test_smooth_stacks_converge_as_told() -> None:
    """Order 5 and more from 8 nodes on: the page on adding says so."""
    slab = [ur.Dielectric(ior=1.5), ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.5))]
    stack = ur.Stack(layers=[*slab, ur.Dielectric(ior=1.0)])
    best = unchecked(stack, 1e-5, [48, 29])
    errors = [difference(unchecked(stack, 1e-5, [n, max(int(0.6 * n) + 1, 6)]), best) for n in (8, 12, 18)]
    assert order(errors[0], errors[1]) > 4.5 and order(errors[1], errors[2]) > 5, errors


@pytest.mark.slow
def test_rough_stacks_converge_as_told() -> None:
    """Order 3 once the lobe is resolved."""
    coated = [ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(material="Au", alpha=0.2)]
    stack = ur.Stack(layers=coated)
    best = unchecked(stack, 1e-5, [64, 39])
    errors = [difference(unchecked(stack, 1e-5, [n, int(0.6 * n) + 1]), best) for n in (18, 27, 40)]
    assert 2.5 < order(errors[0], errors[2], 40 / 18) < 4.5, errors


def order(before: float, after: float, growth: float = 1.5) -> float:
    return float(np.log(before / after) / np.log(growth))
