"""Sheets with rough faces: light straight through both has a narrow lobe that no closed form holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees
from urushi.adapters import native
from urushi.solvers.adding.refine import AIM, GROWTH, _pace, _step

pytestmark = needs_llvm


def sheet(*alphas: float, fog: bool = False, **more: Any) -> ur.Stack:
    """Glass of index 1.5, empty or not, with these faces."""
    upper, lower = (ur.Dielectric(ior=n, alpha=a, **more) for n, a in zip((1.5, 1.0), alphas, strict=True))
    within = [ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.5))] if fog else []
    return ur.Stack(layers=[upper, *within, lower])


def off(one: Any, other: Any) -> float:
    """The largest difference, relative to the peak for the same angle of incidence, near straight on and elsewhere."""
    worst = 0.0
    exits = np.concatenate([np.linspace(-0.3, 0.3, 41), [-1.3, -1.0, -0.6, 0.6, 1.0, 1.3]])
    for theta in np.radians([0.0, 3.0, 12.0, 30.0, 50.0, 65.0, 78.0]):
        angle = np.clip(theta + exits, -1.48, 1.48)[:, None]
        azimuth = np.radians([0.0, 3.0, 20.0, 90.0])
        x, y = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)
        wo = np.stack([-x, y, -np.cos(angle) + 0 * x], axis=-1).reshape(-1, 3)
        for side in (1.0, -1.0):
            wi = np.tile([np.sin(theta), 0.0, np.cos(theta)], (len(wo), 1))
            f = [b.eval(wi, wo * [1, 1, side])[:, 0] / np.abs(wo[:, 2]) for b in (one, other)]
            worst = max(worst, np.abs(f[0] - f[1]).max() / f[1].max())
    return worst


def honest(stack: ur.Stack, nodes: int) -> None:
    """Few nodes, and the error told is what half as many more say it is."""
    bsdf = ur.solve(stack, "adding")
    counts = [panel.count for panel in bsdf.solution.grid.panels]
    assert sum(counts) <= nodes and bsdf.diagnostics["estimated_error"] <= 1e-3
    finer = ur.solve(stack, "adding", nodes=[int(1.5 * n) for n in counts], accuracy=1e-4)
    # A tenth of the accuracy is what the orders left out may hold.
    assert off(bsdf, finer) < 1.5 * bsdf.diagnostics["estimated_error"] + 1e-4
    wi = degrees([0, 20, 50, 75])
    assert np.abs(bsdf.transmittance(wi) - finer.transmittance(wi)).max() < 1e-4


def test_a_sheet_takes_few_nodes(tmp_path: Path) -> None:
    """Which are closer together towards the normal, and are read from files as such."""
    stack = sheet(0.15, 0.15)
    found = ur.solve(stack, "adding").diagnostics
    assert found["nodes"] <= 120 and found["estimated_error"] <= 1e-3
    bsdf = ur.solve(stack, "adding", nodes=[30, 10])
    assert bsdf.solution.grid.panels[0].squeeze < 1
    native.save(bsdf, tmp_path / "sheet.urushi.npz", error=1e-5)
    again = native.load(tmp_path / "sheet.urushi.npz")
    assert again.solution.grid.panels == bsdf.solution.grid.panels and off(again, bsdf) < 4e-3
    # What is to be put on something has the nodes of any other stack.
    assert ur.solve(stack, "adding", nodes=8, indices=(1.0,)).solution.grid.panels[0].squeeze == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stack", "nodes"),
    [
        pytest.param(sheet(0.15, 0.15, fog=True), 120, id="0.15"),
        pytest.param(sheet(0.1, 0.1), 110, id="0.1"),
        pytest.param(sheet(0.05, 0.05, distribution="beckmann", fog=True), 260, id="0.05"),
        pytest.param(
            ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.0, alpha=0.1)]), 280, id="lower"
        ),
    ],
)
def test_sharper_sheets(stack: ur.Stack, nodes: int) -> None:
    """As rough glass is, and sharper."""
    honest(stack, nodes)


@pytest.mark.parametrize("pace", [0.2, 0.5, 0.7])
@pytest.mark.parametrize("steps", [(1.0, 1.0), (0.65, 0.65), (1.0, 0.5)])
def test_the_pace_of_errors(pace: float, steps: tuple[float, float]) -> None:
    """It is found from changes over whole and shorter steps, and none faster or slower is believed in."""
    errors = 0.1 * pace ** np.array([0.0, steps[0], sum(steps)])
    before, change = -np.diff(errors)
    found = _pace([np.array([before, 1.0, 0.0]), np.array([change, 0.0, 1.0])], steps)
    assert found == pytest.approx([pace, 1 / 6, 0.75], rel=2e-3)
    longer = 0.1 * pace ** np.cumsum([0.0, *steps, 0.8])
    first, _, last = -np.diff(longer)
    assert _pace([np.array([x]) for x in (first, 0.0, last)], [*steps, 0.8]) == pytest.approx(pace, rel=2e-3)
    step = _step(errors[2:], found[:1], errors[2] * pace**0.8 / AIM)
    assert 0.8 <= step <= 0.86 and _step(errors[2:], found[:1], 1e-9) == 1.0
    assert GROWTH == 1.5
