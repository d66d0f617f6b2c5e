"""Rough interfaces that hardly refract: they reflect next to nothing, and both sides only exchange their light."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees

pytestmark = needs_llvm

WI = degrees([0, 30, 60, 80])


@pytest.mark.parametrize(
    ("ior", "alpha", "distribution"),
    [(1.1, 0.5, "ggx"), (1.1, 0.225, "beckmann"), (1.02, 0.3, "ggx"), (1.005, 0.1, "beckmann")],
)
def test_nodes_are_found_for_a_weak_coat(ior: float, alpha: float, distribution: str) -> None:
    """The solver ends, and what it finds is what many nodes say."""
    coat = ur.Dielectric(ior=ior, alpha=alpha, distribution=distribution)
    stack = ur.Stack(layers=[coat, ur.Medium(depth=0.2, albedo=0.76), ur.Diffuse(reflectance=0.957)])
    found, fine = ur.solve(stack, "adding", accuracy=1e-2), ur.solve(stack, "adding", nodes=60)
    assert np.abs(found.reflectance(WI) - fine.reflectance(WI)).max() < 5e-3


def test_a_complete_coat_keeps_its_light() -> None:
    """Over white nothing is lost but what the nodes cannot tell."""
    coat = ur.Dielectric(ior=1.02, alpha=0.3, multiple_scattering="compensated")
    bsdf = ur.solve(ur.Stack(layers=[coat, ur.Diffuse(reflectance=1.0)]), "adding")
    assert np.abs(bsdf.reflectance(WI) - 1).max() < 1e-3
