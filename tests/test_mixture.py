"""What lobes and the walk sample from: one direction, of the lobe that a lane chooses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from conftest import LLVM
from lanes import needs_llvm

if LLVM is not None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    from urushi.solvers.lobes.result import LobesBSDF
    from urushi.solvers.mixture import Mixture
    from urushi.solvers.walk.proposal import propose
    from urushi.solvers.walk.result import WalkBSDF

pytestmark = needs_llvm

HAZE = ur.Medium(depth=0.5, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.6))
STACKS = {
    "brushed": [
        ur.Dielectric(ior=1.5, alpha=(0.1, 0.3)),
        ur.Conductor(material="Au", alpha=(0.2, 0.05), rotation=30),
    ],
    "hazy sheet": [ur.Dielectric(ior=1.5, alpha=0.1), HAZE, ur.Dielectric(ior=1.0, alpha=0.2)],
    "smooth coat": [ur.Dielectric(ior=1.5), ur.Conductor(material="Au", alpha=0.2)],
}


def of_lobes(stack: ur.Stack, wi: Array3f) -> Mixture:
    bsdf = LobesBSDF(stack)
    return bsdf._quick_core(bsdf._module, False).mixture(wi)


def of_walk(stack: ur.Stack, wi: Array3f) -> Mixture:
    bsdf = WalkBSDF(stack)
    return propose(bsdf._core(bsdf._module)[0].stack, wi)


@pytest.mark.parametrize("mixture_of", [of_lobes, of_walk])
@pytest.mark.parametrize("name", list(STACKS))
def test_every_lobe_is_sampled_as_by_itself(name: str, mixture_of: Any, rng: np.random.Generator) -> None:
    wi = Array3f(0.5, -0.3, 0.66**0.5)
    count = 64
    v, w = (Float(rng.random(count).astype(np.float32)) for _ in range(2))
    mixture = mixture_of(ur.Stack(layers=STACKS[name]), wi)
    shares = [float(np.ravel(np.array(lobe.share))[0]) for lobe in mixture.lobes]
    ends = np.cumsum([0.0, *shares])
    for lobe, share, start in zip(mixture.lobes, shares, ends, strict=False):
        if share > 1e-4:
            middle = dr.full(Float, start + share / 2, count)
            found, _, _, delta = mixture.sample(wi, Array3f(middle, v, w))
            np.testing.assert_allclose(np.array(found), np.array(lobe.sample(wi, v, w)), atol=1e-5)
            assert delta is False or not dr.any(delta)
    assert sum(share > 1e-4 for share in shares) >= 3 or name == "smooth coat"


@pytest.mark.parametrize("method", ["lobes", "walk"])
@pytest.mark.parametrize("backend", ["llvm", "scalar"])
def test_nothing_is_sampled_where_no_light_goes(backend: str, method: str) -> None:
    bsdf = ur.solve(ur.Stack(layers=STACKS["brushed"]), method=method, backend=backend)
    sample = bsdf.sample([[0.6, 0.0, -0.8]], [[0.5, 0.5, 0.5]])
    assert sample.pdf[0] == 0
    np.testing.assert_array_equal(sample.weight, 0)
    np.testing.assert_allclose(np.linalg.norm(sample.wo, axis=1), 1, atol=1e-6)
