"""More channels than three: every one as if it were solved alone."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi.errors import MaterialError, UrushiError

pytestmark = needs_llvm

COUNT = 7
DEPTH = np.linspace(0.1, 1.5, COUNT)
ALBEDO = np.linspace(0.9, 0.3, COUNT)
SLAB = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.4),
        ur.Medium(depth=0.5, albedo=0.5, phase=ur.HenyeyGreenstein(g=0.4)),
        ur.Dielectric(ior=1.0),
    ]
)
GIVEN = {"layer_1.depth": DEPTH, "layer_1.albedo": ALBEDO}


@pytest.fixture(scope="module")
def several():
    return ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN)


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    wi, wo = np.random.default_rng(3).normal(size=(2, count, 3))
    return tuple(w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))  # type: ignore[return-value]


def test_every_channel_is_solved_as_if_alone(several):
    wi, wo = directions(50)
    for c in (0, 3, COUNT - 1):
        alone = ur.solve(
            SLAB, "adding", nodes=12, parameters={"layer_1.depth": DEPTH[c], "layer_1.albedo": ALBEDO[c]}
        )
        np.testing.assert_allclose(several.eval(wi, wo)[:, c], alone.eval(wi, wo)[:, 0], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(several.reflectance(wi)[:, c], alone.reflectance(wi)[:, 0], rtol=1e-9)
        np.testing.assert_allclose(several.transmittance(wi)[:, c], alone.transmittance(wi)[:, 0], rtol=1e-9)
    assert several.eval(wi, wo).shape == (50, COUNT)


def test_samples_weigh_what_they_carry(several):
    """The mean weight is what leaves on both sides, delta parts included, where no index scales it."""
    importance = ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN, mode="importance")
    wi = np.array([[0.6, 0.0, 0.8]])
    u = np.random.default_rng(8).random((200_000, 3))
    drawn = importance.sample(wi, u)
    both = importance.reflectance(wi)[0] + importance.transmittance(wi)[0]
    mean, error = drawn.weight.mean(axis=0), drawn.weight.std(axis=0) / np.sqrt(len(u))
    assert np.all(np.abs(mean - both) < 5 * error + 2e-4), (mean, both, error)
    assert drawn.delta.any() and not drawn.delta.all()
    smooth = ~drawn.delta
    np.testing.assert_allclose(
        importance.pdf(np.broadcast_to(wi, (smooth.sum(), 3)), drawn.wo[smooth]), drawn.pdf[smooth], rtol=1e-6
    )


def test_what_does_not_fit_together():
    with pytest.raises(MaterialError, match=r"layer_1\.albedo.*found shape \(4,\); allowed: one number or 7"):
        ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN | {"layer_1.albedo": np.full(4, 0.5)})
    with pytest.raises(UrushiError, match="numpy arrays where there are more than three channels"):
        import drjit as dr
        from drjit.llvm.ad import Array3f64

        wi = Array3f64(0, 0, 1)
        dr.eval(wi)
        ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN).eval(wi, wi)


def test_diagnostics_are_the_worst_of_all(several):
    assert several.diagnostics["channels"] == COUNT and several.diagnostics["solutions"] == 3
    assert several.diagnostics["estimated_error"] == max(
        p.diagnostics["estimated_error"] for p in several.parts
    )


@pytest.mark.parametrize("count", [1, 2, 4])
def test_any_number_of_channels(count):
    """One value in an array is a number; two are no roughness; a third that is not full has as many as there are."""
    wi, wo = directions(20)
    given = {"layer_1.albedo": ALBEDO[:count]}
    found = ur.solve(SLAB, "adding", nodes=8, parameters=given)
    last = ur.solve(SLAB, "adding", nodes=8, parameters={"layer_1.albedo": ALBEDO[count - 1]})
    values = found.eval(wi, wo)
    assert values.shape == (20, 3 if count == 1 else count)
    np.testing.assert_allclose(values[:, -1], last.eval(wi, wo)[:, 0], rtol=1e-6, atol=1e-9)


def test_colours_are_no_channels():
    """What the description says in red, green and blue says nothing of seven wavelengths."""
    for layer, name in (
        (ur.Conductor(material="Au", alpha=0.3), "eta"),
        (ur.Diffuse((0.8, 0.5, 0.2)), "reflectance"),
    ):
        stack = ur.Stack(layers=[*SLAB.layers[:2], layer])
        with pytest.raises(MaterialError, match=rf"layer_2\.{name}: found a colour.*7 channels"):
            ur.solve(stack, "adding", nodes=8, parameters=GIVEN)
