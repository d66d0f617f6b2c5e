"""Slabs that let next to nothing through: what passes keeps its digits, so that the solver finds an end."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm


@pytest.mark.parametrize(("albedo", "depth"), [(0.9, 300.0), (0.15, 150.0)])
def test_what_passes_fades_as_the_slowest_mode(albedo: float, depth: float) -> None:
    """exp(-k depth), with 1 = a / (2 k) log((1 + k) / (1 - k)) for isotropic particles (Chandrasekhar 1950)."""
    passed = []
    for part in (0.8, 1.0):
        slab = ur.Stack(layers=[ur.Medium(depth=part * depth, albedo=albedo)])
        bsdf = ur.solve(slab, "adding", accuracy=1e-4)
        assert bsdf.diagnostics["nodes"] <= 40
        passed.append(bsdf.transmittance([0.0, 0.0, 1.0])[0])
    k = brentq(lambda k: albedo / (2 * k) * np.log((1 + k) / (1 - k)) - 1, 1e-9, 1 - 1e-15)
    slope = np.log(passed[0] / passed[1]) / (0.2 * depth)
    assert abs(slope - k) < (1e-4 if albedo > 0.5 else 0.01), (slope, k)
