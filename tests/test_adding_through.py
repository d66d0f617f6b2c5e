"""Light that meets one rough interface behind smooth ones and media, in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees
from urushi.adapters import native
from urushi.solvers.adding import build
from urushi.solvers.adding.through import anywhere, met

pytestmark = needs_llvm

ROUGH, GLASS = ur.Dielectric(ior=1.5, alpha=0.2), ur.Dielectric(ior=1.5)
FOG = ur.Medium(depth=0.4, albedo=(0.3, 0.6, 0.9), phase=ur.HenyeyGreenstein(g=0.4))
EXITS = degrees([3, 20, 40, 60, 75]) * [-1, 1, 1]
BELOW, ABOVE = degrees([0, 25, 55, 80]) * [1, 1, -1], degrees([0, 25, 55, 80])


def bound(layers: list[Any]) -> Any:
    return build.bind_numbers(ur.Stack(layers=layers))[0]


def test_what_is_covered() -> None:
    """The first rough one from either side, and the only one for light that passes; `direct` has the outermost."""
    one = bound([GLASS, FOG, ur.Dielectric(ior=1.0, alpha=0.1)])
    assert [met(one, *side) for side in ((True, True), (True, False), (False, True), (False, False))] == [
        1,
        1,
        1,
        None,
    ]
    two = bound([ROUGH, FOG, ur.Dielectric(ior=1.3, alpha=0.1), FOG])
    assert met(two, True, True) is None and met(two, True, False) is None and met(two, False, False) == 1
    for other in (
        [ROUGH],
        [GLASS, FOG],
        [GLASS, ur.Diffuse()],
        [GLASS, ur.Conductor(material="Au", alpha=0.2)],
    ):
        assert not anywhere(bound(other))
    walked = ur.Dielectric(ior=1.5, alpha=0.3, multiple_scattering="walk")
    assert not anywhere(bound([walked, FOG])) and not anywhere(bound([GLASS, walked, FOG]))


@pytest.mark.parametrize(
    "layers",
    [
        pytest.param([ur.Dielectric(ior=1.5, alpha=0.5), FOG], id="fog under rough glass"),
        pytest.param(
            [GLASS, ur.Dielectric(ior=1.0, alpha=0.4)], id="glass, rough below", marks=pytest.mark.slow
        ),
        pytest.param(
            [FOG, ur.Dielectric(ior=1.4, alpha=0.5), FOG, ur.Dielectric(ior=1.2)],
            id="fog around",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_closed_form_or_not_is_the_same_light(layers: list[Any]) -> None:
    """Values and energies agree with those of nodes that hold everything, as all of a stack with `indices` do."""
    stack = ur.Stack(layers=layers)
    few = ur.solve(stack, "adding", nodes=24)
    many = ur.solve(stack, "adding", nodes=48, indices=(1.0,))
    assert "through" in few.diagnostics["closed_form"] and "through" not in many.diagnostics["closed_form"]
    off = []
    for wi in (ABOVE, BELOW):
        assert np.abs(few.reflectance(wi) - many.reflectance(wi)).max() < 2e-3
        assert np.abs(few.transmittance(wi) - many.transmittance(wi)).max() < 2e-3
        for wo in (EXITS, EXITS * [1, 1, -1]):
            i, o = (np.reshape(np.broadcast_arrays(wi[:, None], wo)[k], (-1, 3)) for k in (0, 1))
            one, other = (bsdf.eval(i, o).reshape(len(wi), -1) for bsdf in (few, many))
            off.append(np.abs(one - other) / np.maximum(other.max(axis=1, keepdims=True), 1e-3))
    # Near the kink of total reflection it is the many nodes that are off.
    assert np.median(off) < 1e-3 and np.percentile(off, 90) < 0.02


def test_reading_and_sampling(tmp_path: Path) -> None:
    """What is written is read again, and samples have the density that they say and the light that there is."""
    bsdf = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3), FOG]), "adding", nodes=20)
    native.save(bsdf, tmp_path / "fog.urushi.npz")
    again = native.load(tmp_path / "fog.urushi.npz")
    assert again.diagnostics["closed_form"] == "single, through"
    rng = np.random.default_rng(20)
    for wi in (*ABOVE[1:3], *BELOW[1:3]):
        w = np.tile(wi, (20_000, 1))
        sample = bsdf.sample(w, rng.random((len(w), 3)))
        assert np.allclose(again.eval(w, sample.wo), bsdf.eval(w, sample.wo), rtol=1e-2, atol=1e-3)
        scattered = sample.pdf > 0
        value = bsdf.eval(w[scattered], sample.wo[scattered])
        assert np.allclose(
            value, sample.weight[scattered] * sample.pdf[scattered, None], rtol=1e-6, atol=1e-9
        )
        total = (bsdf.reflectance(wi[None]) + bsdf.transmittance(wi[None]))[0]
        flux = sample.weight * np.where(
            sample.wo[:, 2] * wi[2] > 0, 1, 1.5**2 if wi[2] > 0 else 1.5**-2
        ).reshape(-1, 1)
        error = flux.std(axis=0) / np.sqrt(len(w))
        assert (np.abs(flux.mean(axis=0) - total) < 4 * error + 2e-3).all()
