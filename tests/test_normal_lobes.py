"""Normals and their variance in lobes: where lobes point, how wide they are, and what filtering is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from quadrature import sphere
from urushi.errors import UnsupportedStack

pytestmark = needs_llvm

N = (0.2, 0.1, 1.0)
COAT, GOLD = ur.Dielectric(ior=1.5, alpha=0.15), ur.Conductor(material="Au", alpha=0.2)
PAINT = ur.Diffuse(reflectance=0.6)
WO, AREA = sphere(48, 48, 0, 1)


def tilted(*layers: Any, which: int) -> ur.Stack:
    found = [
        layer.model_copy(update={"normal": N}) if i == which else layer for i, layer in enumerate(layers)
    ]
    return ur.Stack(layers=found)


@pytest.mark.parametrize(
    ("layers", "which", "most"),
    [((COAT, GOLD), 0, 0.45), ((COAT, GOLD), 1, 0.45), ((COAT, PAINT), 1, 0.06)],
    ids=["coat", "base", "diffuse base"],
)
def test_lobes_point_where_the_walk_sends_light(layers: Any, which: int, most: float) -> None:
    """Nearer to the walk, by far, than lobes that ignore the normal; their middle within some degrees."""
    stack = tilted(*layers, which=which)
    wi = np.broadcast_to(direction(0.9, 2.0), WO.shape)
    truth = ur.solve(stack, "walk", samples=64).eval(wi, WO)
    found, ignored = (ur.solve(s, "lobes").eval(wi, WO) for s in (stack, ur.Stack(layers=layers)))
    ours, flat = (
        np.sqrt(np.sum(AREA[:, None] * (x - truth) ** 2) / np.sum(AREA[:, None] * truth**2))
        for x in (found, ignored)
    )
    assert ours < most and ours < 0.7 * flat, (ours, flat)
    middle = [np.sum((AREA * x[:, 1])[:, None] * WO, axis=0) for x in (found, truth)]
    a, b = (m / np.linalg.norm(m) for m in middle)
    assert np.degrees(np.arccos(a @ b)) < 7


def test_the_lobe_of_one_interface_is_exact_and_density_is_that_of_sampling(rng: np.random.Generator) -> None:
    stack, wi = tilted(GOLD, which=0), np.broadcast_to(direction(0.7, 1.0), WO.shape)
    one, other = (ur.solve(stack, method) for method in ("lobes", "walk"))
    assert np.allclose(one.eval(wi, WO), other.eval(wi, WO), rtol=1e-4, atol=1e-6)
    sample = one.sample(wi, rng.random(wi.shape))
    assert np.allclose(one.pdf(wi, sample.wo), sample.pdf, rtol=1e-2)
    assert np.allclose(sample.weight * sample.pdf[:, None], one.eval(wi, sample.wo), rtol=1e-2, atol=1e-6)
    # The density integrates to 1, and samples are where the light is.
    fine, area = sphere(96, 192, 0, 1)
    assert np.sum(area * one.pdf(wi[:1], fine)) == pytest.approx(1, abs=5e-3)
    assert np.mean(sample.weight) < 1.2 and np.std(sample.weight) < 0.6


def test_what_has_no_lobe_is_refused() -> None:
    with pytest.raises(UnsupportedStack, match="interface 0 from the top has a normal and is smooth"):
        ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, normal=N), GOLD]), "lobes")
    with pytest.raises(UnsupportedStack, match="leave out symmetric"):
        ur.solve(tilted(COAT, GOLD, which=1), "lobes", symmetric=True)
    with pytest.raises(UnsupportedStack, match=r"layers\[1\]\.normal is given, which the published"):
        ur.solve(tilted(COAT, GOLD, which=1), "lobes", published=True)
    with pytest.raises(UnsupportedStack, match="mixes azimuthal orders"):
        ur.solve(tilted(COAT, GOLD, which=1), "adding")
    bsdf = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, normal=N, slope_variance=(0.01, 0.01, 0)), GOLD]))
    assert np.all(bsdf.eval(WO, WO) >= 0)


def test_a_variance_of_slopes_widens_every_lobe_of_its_interface() -> None:
    wi = direction(0.9, 0.0)
    plain = ur.solve(ur.Stack(layers=[COAT, GOLD]), "lobes").lobes(wi)
    wide = ur.solve(
        ur.Stack(layers=[COAT, GOLD]), "lobes", parameters={"layer_1.slope_variance": (0.02, 0.0, 0.0)}
    ).lobes(wi)
    # The lobe of the coat stays; that of the base is wider along x: the roughness of gold is (0.2^2 + 2 * 0.02)^(1/2).
    assert np.allclose(plain.alpha[0], wide.alpha[0], rtol=1e-3)
    assert wide.alpha[1].max() > 1.2 * plain.alpha[1].max()
    assert wide.alpha[1].min() == pytest.approx(plain.alpha[1].min(), rel=0.06)


def test_filtering_keeps_the_look_of_a_normal_map_from_afar() -> None:
    """Against the walk at many texels, of a map for each interface: three times as near as with the mean alone."""
    rng = np.random.default_rng(3)
    count, pairs = 1024, 64
    maps = rng.normal(size=(2, count, 2)) * (0.12, 0.05)
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.08), ur.Conductor(material="Al", alpha=0.15)])
    wi = direction(rng.uniform(0.4, 1, pairs), rng.uniform(0, 7, pairs))
    wo = wi * (-1, -1, 1) + 0.25 * rng.normal(
        size=wi.shape
    )  # around the mirror direction, where the lobes are
    wo[:, 2] = np.abs(wo[:, 2])
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    # Not quite the same directions, or all texels have the same random numbers.
    near = np.repeat(wo, count, axis=0) + 1e-4 * rng.normal(size=(pairs * count, 3))
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    upright = np.ones((count, 1))
    given = {
        f"layer_{i}.normal": np.tile(np.concatenate([slopes, upright], axis=1), (pairs, 1))
        for i, slopes in enumerate(maps)
    }
    truth = ur.solve(stack, "walk", samples=4, parameters=given).eval(np.repeat(wi, count, axis=0), near)
    truth = truth.reshape(pairs, count, 3).mean(axis=1)
    given = {f"layer_{i}.normal": (*slopes.mean(axis=0), 1.0) for i, slopes in enumerate(maps)}
    unfiltered = ur.solve(stack, "lobes", parameters=given).eval(wi, wo)
    for i, slopes in enumerate(maps):
        (xx, xy), (_, yy) = np.cov(slopes.T, bias=True)
        given[f"layer_{i}.slope_variance"] = (xx, yy, xy)
    filtered = ur.solve(stack, "lobes", parameters=given).eval(wi, wo)
    errors = [np.sqrt(np.mean((x - truth) ** 2) / np.mean(truth**2)) for x in (filtered, unfiltered)]
    assert errors[0] < 0.22 and errors[0] < 0.4 * errors[1], errors


def test_energy_compensation_knows_a_widened_interface() -> None:
    """The same as an interface that is described with the sum of both roughnesses."""
    wi, wo = direction(np.array([0.9, 0.4]), 1.0), direction(np.array([0.6, 0.7]), 3.0)
    made: dict[str, Any] = {"material": "Au", "multiple_scattering": "compensated"}
    one = ur.Conductor(alpha=0.2, slope_variance=(0.3, 0.0, 0.0), **made)
    other = ur.Conductor(alpha=(0.8, 0.2), **made)
    a, b = (ur.solve(ur.Stack(layers=[layer]), "walk").eval(wi, wo) for layer in (one, other))
    assert np.allclose(a, b, rtol=1e-3)
