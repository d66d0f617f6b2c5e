"""What leaves rough slabs on the far side: how wide it is in the plane of incidence and across it, and its middle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import urushi as ur
from conftest import Tool
from lanes import needs_llvm

pytestmark = needs_llvm

ANGLES = np.linspace(-1.55, 1.55, 241)


def _slab(alpha: float, medium: bool = False) -> ur.Stack:
    between = [ur.Medium(depth=0.5, albedo=0.0)] if medium else []
    return ur.Stack(
        layers=[ur.Dielectric(ior=1.5, alpha=alpha), *between, ur.Dielectric(ior=1.0, alpha=alpha)]
    )


def _profiles(bsdf: object, theta: float) -> list[tuple[float, float]]:
    """(root mean square width, mean) in radians of f |cos| along two great circles through the refracted direction:
    in the plane of incidence, and across it."""
    s, c, t = np.sin(theta), np.cos(theta), ANGLES
    wi = np.tile([s, 0, c], (2 * len(t), 1))
    plane = np.stack([-np.sin(t), 0 * t, -np.cos(t)], axis=1)
    across = np.stack([-s * np.cos(t), np.sin(t), -c * np.cos(t)], axis=1)
    found = []
    for value in bsdf.eval(wi, np.concatenate([plane, across]))[:, 0].reshape(2, -1):
        mean = (value @ t) / value.sum()
        found.append((np.sqrt(value @ (t - mean) ** 2 / value.sum()), mean))
    return found


def _compare(stack: ur.Stack, degrees: float, rel: tuple[float, float]) -> None:
    """Relative tolerances of the width in the plane of incidence and across."""
    theta = np.radians(degrees)
    ours = _profiles(ur.solve(stack, "lobes"), theta)
    truth = _profiles(ur.solve(stack, "walk", samples=1024), theta)
    for (width, mean), (true_width, true_mean), most in zip(ours, truth, rel, strict=True):
        assert width == pytest.approx(true_width, rel=most)
        assert mean == pytest.approx(true_mean, abs=0.25 * true_width)


def test_rough_glass() -> None:
    """Derivatives alone say 46 per cent more."""
    _compare(_slab(0.2), 45.0, (0.1, 0.1))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [1.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize(("alpha", "medium"), [(0.1, False), (0.2, False), (0.3, False), (0.2, True)])
def test_slabs(alpha: float, medium: bool, degrees: float) -> None:
    _compare(_slab(alpha, medium), degrees, (0.13, 0.17) if degrees > 45 else (0.11, 0.11))


def test_what_went_to_and_fro_is_a_lobe_of_its_own() -> None:
    """A seventh at 60 degrees, nothing where it is absorbed; both together carry what is transmitted."""
    wi = [[np.sin(np.radians(60)), 0.0, 0.5]]
    shares = []
    for medium in (False, True):
        bsdf = ur.solve(_slab(0.2, medium), "lobes")
        table = bsdf.lobes(wi)
        (one,), (late,) = (
            np.flatnonzero([k == kind for k in table.kind]) for kind in ("transmitted", "delayed")
        )
        whole = table.energy[one] + table.energy[late]
        np.testing.assert_allclose(whole, bsdf.transmittance(wi)[0], rtol=1e-4)
        assert np.all(table.alpha[late] > 1.3 * table.alpha[one])
        shares.append(table.energy[late, 0] / whole[0])
    assert 0.12 < shares[0] < 0.2 and shares[1] < 0.03
    complete = [ur.Dielectric(ior=ior, alpha=0.2, multiple_scattering="compensated") for ior in (1.5, 1.0)]
    bsdf = ur.solve(ur.Stack(layers=complete), "lobes")
    np.testing.assert_allclose(bsdf.reflectance(wi) + bsdf.transmittance(wi), 1, atol=5e-3)


@pytest.mark.parametrize(("degrees", "along", "across"), [(0.0, 2.0, 2.0), (60.0, 1.4, 2.375)])
def test_what_went_to_and_fro_is_wider_across(degrees: float, along: float, across: float) -> None:
    """Twice as rough at normal incidence; of the plane of incidence 2 - 0.8 sin^2, across it 2 + 0.5 sin^2."""
    theta = np.radians(degrees)
    table = ur.solve(_slab(0.2), "lobes", precision="double").lobes([[np.sin(theta), 0.0, np.cos(theta)]])
    shapes = []
    for kind in ("transmitted", "delayed"):
        (k,) = np.flatnonzero([name == kind for name in table.kind])
        turned = abs(np.cos(np.radians(table.axis[k]))) < 0.5
        shapes.append(table.alpha[k, ::-1] if turned else table.alpha[k])
    np.testing.assert_allclose(shapes[1] / shapes[0], (along, across), rtol=1e-3)


def test_nothing_prefers_an_azimuth_at_normal_incidence() -> None:
    lobes = ur.solve(_slab(0.2), "lobes").lobes([[0.0, 0.0, 1.0]])
    (k,) = (i for i, kind in enumerate(lobes.kind) if kind == "transmitted")
    assert lobes.alpha[k, 0] == pytest.approx(lobes.alpha[k, 1], rel=1e-5)
    np.testing.assert_allclose(lobes.direction[k], [0, 0, -1], atol=1e-5)


def test_what_leaves_turns_with_the_light() -> None:
    """The same at every azimuth, with interfaces that have axes turned along, too."""
    for alpha in (0.2, (0.1, 0.3)):
        found = []
        for turn in (0.0, 70.0):
            layers = [ur.Dielectric(ior=ior, alpha=alpha, rotation=turn) for ior in (1.5, 1.0)]
            phi = np.radians(turn)
            wi, wo = ([0.5, 0.3, 0.8], [-0.45, -0.1, -0.9])
            wi, wo = (
                np.array(
                    [[v[0] * np.cos(phi) - v[1] * np.sin(phi), v[0] * np.sin(phi) + v[1] * np.cos(phi), v[2]]]
                )
                / np.linalg.norm(v)
                for v in (wi, wo)
            )
            found.append(ur.solve(ur.Stack(layers=layers), "lobes", precision="double").eval(wi, wo)[0, 0])
        assert found[0] == pytest.approx(found[1], rel=1e-6)


@pytest.mark.parametrize("theta", [0.0, 0.6, 1.5])
def test_derivatives_are_finite(theta: float) -> None:
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    alpha = Float64(0.2)
    dr.enable_grad(alpha)
    bsdf = ur.solve(_slab(0.2), "lobes", parameters={"layer_0.alpha": alpha}, precision="double")
    wi = Array3f64(*(Float64(float(x)) for x in (np.sin(theta), 0.0, np.cos(theta))))
    value = bsdf.eval(wi, Array3f64(*(Float64(x) for x in (-0.3, 0.05, -float(np.sqrt(1 - 0.0925))))))
    dr.backward(dr.sum(value[0]) if dr.depth_v(value) > 1 else dr.sum(value))
    assert np.isfinite(np.array(dr.grad(alpha))).all() and abs(np.array(dr.grad(alpha))[0]) > 0


def test_a_sample_of_the_table_is_made_anew(tool: Tool) -> None:
    lobe_exits = tool("lobe_exits")
    from urushi.solvers.lobes import axes, tables

    with np.load(Path(tables.__file__).parent / "data" / "exits.npz") as file:
        shipped = file["exits"] * tables.STEP
    assert shipped.shape[1:5] == (
        axes.EXIT_INDICES,
        axes.EXIT_ROUGHNESSES,
        axes.EXIT_WIDTHS,
        axes.EXIT_COSINES,
    )
    k, a, w, nodes = 2, np.array([2, 4]), np.array([1]), slice(-6, None)
    for side, eta in enumerate((axes.ratios(axes.EXIT_INDICES)[k], 1 / axes.ratios(axes.EXIT_INDICES)[k])):
        made = lobe_exits.exits(
            float(eta),
            axes.squares(axes.EXIT_ROUGHNESSES)[a],
            axes.squares(axes.EXIT_WIDTHS)[w],
            axes.exit_cosines()[nodes],
        )
        np.testing.assert_allclose(shipped[side, k][np.ix_(a, w)][..., nodes, :], made, atol=0.02)
