"""What every method makes of arguments: none at all, and ones that it has to refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

SLAB = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Medium(depth=1.0, albedo=0.5)])
NONE, UP = np.zeros((0, 3)), np.array([[0.0, 0.0, 1.0]])
METHODS = [("walk", {"samples": 4}), ("walk", {"samples": 1}), ("adding", {"nodes": 8}), ("lobes", {})]


@pytest.mark.parametrize(("method", "options"), METHODS)
def test_no_directions_have_no_values(method: str, options: dict[str, Any]) -> None:
    bsdf = ur.solve(SLAB, method, **options)
    for wo in (NONE, UP):
        assert bsdf.eval(NONE, wo).shape == bsdf.eval(wo, NONE).shape == (0, 3)
        assert bsdf.pdf(NONE, wo).shape == (0,)
    assert bsdf.reflectance(NONE).shape == bsdf.transmittance(NONE).shape == (0, 3)
    assert bsdf.absorption(NONE).absorbed[1].shape == (0, 3)
    drawn = bsdf.sample(NONE, NONE)
    assert drawn.wo.shape == drawn.weight.shape == (0, 3) and drawn.pdf.shape == drawn.delta.shape == (0,)
    if options.get("samples") != 1:
        assert [x.shape for x in bsdf.reflectance(NONE, with_error=True)] == [(0, 3)] * 2


@pytest.mark.parametrize("method", ["walk", "adding", "lobes"])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (5, "parameters: found 5; allowed: a mapping"),
        ({"layer_1.albedo": "x"}, "layer_1.albedo: found 'x'; allowed: numbers"),
        ({"layer_1.albedo": []}, "layer_1.albedo: found no values; allowed: at least one"),
        ({"layer_1.albdo": 0.5}, "did you mean 'layer_1.albedo'"),
    ],
)
def test_parameters_that_are_none(method: str, given: Any, message: str) -> None:
    with pytest.raises(ur.UrushiError, match=message):
        ur.solve(SLAB, method, parameters=given)


@pytest.mark.parametrize(
    "options",
    [{"nodes": n} for n in (2.5, "12", [12, "a"], [12, 3], float("nan"), True)]
    + [{"indices": n} for n in (2.0, None, [0.5], "ab")]
    + [{"accuracy": n} for n in (None, True, float("nan"), "0.1")],
)
def test_numbers_for_adding_that_are_none(options: dict[str, Any]) -> None:
    (name,) = options
    with pytest.raises(ur.UrushiError, match=f"{name}: found .*; allowed: "):
        ur.solve(SLAB, "adding", **options)


def test_numbers_of_numpy_are_numbers() -> None:
    found = ur.solve(SLAB, "adding", nodes=np.int64(8), accuracy=np.float32(0.01), indices=np.array([1.5]))
    assert found.diagnostics["accuracy"] == pytest.approx(0.01)


@pytest.mark.parametrize("symmetric", [False, True])
def test_what_is_asked_inside_a_loop_may_be_asked_outside(symmetric: bool) -> None:
    """Nothing is kept of what a symbolic loop records, which would end the process."""
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float, UInt

    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), ur.Diffuse(reflectance=0.5)])
    bsdf = ur.solve(stack, "lobes", symmetric=symmetric)
    wi, wo = Array3f(Float([0.6, 0.6]), 0, 0.8), Array3f(Float([0.0, -0.6]), 0, Float([1.0, 0.8]))
    _, inside = dr.while_loop(
        (UInt(0), 0 * wi.x), lambda i, _: i < 3, lambda i, sum_: (i + 1, sum_ + bsdf.eval(wi, wo).x)
    )
    np.testing.assert_allclose(np.array(inside), 3 * np.array(bsdf.eval(wi, wo).x), rtol=1e-5)
