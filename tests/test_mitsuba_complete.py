"""`complete_roughconductor` and `complete_roughdielectric`: the built-in parameters, and a furnace that stays white."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from lanes import direction, needs_llvm
from mitsuba_plugin import Asked, layered
from test_mitsuba_sampling import chi2

pytestmark = needs_llvm

HOW = ["compensated", "walk"]
MIRROR = {"type": "complete_roughconductor", "material": "none", "distribution": "ggx"}
GLASS = {"type": "complete_roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "distribution": "ggx"}


def load(mi: Any, plugin: dict[str, Any], **options: Any) -> Any:
    import urushi.mitsuba  # noqa: F401  (registers them)

    return mi.load_dict(plugin | options)


def mean_weight(mi: Any, bsdf: Any, cos: float, count: int = 1 << 17) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the weights of samples, and its standard error: all that leaves on either side."""
    w = direction(abs(cos), 0.7) * [1, 1, np.sign(cos)]
    asked = Asked.of(mi, bsdf, np.repeat(w[None], count, axis=0), "Importance")
    _, weight = asked.sample(np.random.default_rng(4).random((count, 3)))
    return weight.mean(axis=0), weight.std(axis=0) / np.sqrt(count)


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.5, 1.0])
def test_a_furnace_stays_white(mi, how, distribution, alpha):
    """A mirror reflects all, glass passes on the rest; single scattering loses half of it at the roughest."""
    given = {"distribution": distribution, "alpha": alpha, "multiple_scattering": how}
    for plugin, angles in ((MIRROR, (0.9, 0.2)), (GLASS, (0.9, 0.2, -0.8))):
        bsdf = load(mi, plugin, **given)
        for cos in angles:
            mean, error = mean_weight(mi, bsdf, cos)
            assert np.all(np.abs(mean - 1) < 5 * error + 3e-3), (plugin["type"], cos, mean, error)
    if alpha == 1.0 and distribution == "ggx":
        built_in = mi.load_dict(
            {"type": "roughconductor", "material": "none", "alpha": 1.0, "distribution": "ggx"}
        )
        assert mean_weight(mi, built_in, 0.9)[0][0] < 0.5


@pytest.mark.parametrize("plugin", [MIRROR | {"material": "Cu"}, GLASS], ids=["conductor", "dielectric"])
def test_the_parameters_are_those_of_the_built_in_plugin(mi, plugin):
    """Under the same names, and sharp lobes are the same lobes."""
    alike = {**plugin, "alpha": 0.02}
    built_in = mi.load_dict({**alike, "type": plugin["type"].removeprefix("complete_")})
    ours = load(mi, alike)
    names = {name for name in mi.traverse(built_in).keys() if "specular" not in name}  # noqa: SIM118
    assert {name.split(".")[0] for name in mi.traverse(ours).keys()} >= {  # noqa: SIM118
        name.split(".")[0] for name in names if name.startswith(("alpha", "k"))
    }
    wi = np.repeat(direction(0.8, 0.3)[None], 200, axis=0)
    rng = np.random.default_rng(6)
    wo = wi * [-1, -1, 1] + 0.02 * rng.normal(size=wi.shape)
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    one, other = Asked.of(mi, ours, wi).value(wo), Asked.of(mi, built_in, wi).value(wo)
    np.testing.assert_allclose(one, other, rtol=0.02, atol=0.02 * other.max())


@pytest.mark.parametrize("how", HOW)
def test_samples_fall_where_the_density_says(mi, how):
    gold = load(mi, MIRROR, material="Au", alpha=0.6, multiple_scattering=how)
    assert chi2(mi, gold, direction(0.7, 0.4))
    glass = load(mi, GLASS, alpha=0.6, multiple_scattering=how)
    assert chi2(mi, glass, direction(0.7, 0.4))


def test_tints(mi):
    """They multiply, each on its side."""
    plain = load(mi, GLASS, alpha=0.5)
    tinted = load(
        mi,
        GLASS,
        alpha=0.5,
        specular_reflectance={"type": "rgb", "value": [1.0, 0.5, 0.2]},
        specular_transmittance={"type": "rgb", "value": [0.1, 0.9, 0.3]},
    )
    wi = np.repeat(direction(0.8, 0.3)[None], 2, axis=0)
    wo = np.stack([direction(0.6, 3.0), direction(0.7, 3.3) * [1, 1, -1]])
    one, other = Asked.of(mi, plain, wi).value(wo), Asked.of(mi, tinted, wi).value(wo)
    np.testing.assert_allclose(other / one, [[1.0, 0.5, 0.2], [0.1, 0.9, 0.3]], rtol=1e-4)


def test_a_stack_takes_them_as_layers(mi):
    """As the same layers in a file would be."""
    coat = GLASS | {"alpha": 0.4}
    nested = layered(mi, samples=1, layer_0=coat, layer_1=MIRROR | {"material": "Au", "alpha": 0.5})
    text = str(nested)
    assert (
        "dielectric" in text
        and "conductor" in text
        and nested.stack.layers[0].multiple_scattering == "compensated"
    )
    white = layered(mi, layer_0=coat, layer_1=MIRROR | {"alpha": 0.5})
    mean, error = mean_weight(mi, white, 0.7)
    assert np.all(np.abs(mean - 1) < 5 * error + 3e-3), (mean, error)
    with pytest.raises(RuntimeError, match="specular_reflectance other than 1"):
        layered(mi, layer_0=MIRROR | {"alpha": 0.5, "specular_reflectance": 0.5})


def test_textured_roughness_and_derivatives(mi):
    bitmap = mi.Bitmap(np.array([[0.1, 0.6]], np.float32)[..., None])
    image = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest"}
    textured = load(mi, MIRROR, alpha=image)
    wi, wo = direction(0.8, 0.3)[None], direction(0.7, 3.2)[None]
    for u, alpha in ((0.25, 0.1), (0.75, 0.6)):
        plain = load(mi, MIRROR, alpha=alpha)
        here = Asked.of(mi, textured, wi, uv=(u, 0.5)).value(wo)
        np.testing.assert_allclose(here, Asked.of(mi, plain, wi).value(wo), rtol=1e-4)
    gold = load(mi, MIRROR, material="Au", alpha=0.4)
    parameters = mi.traverse(gold)
    values = {}
    for alpha in (0.39, 0.4, 0.41):
        parameters["alpha.value"] = mi.Float(alpha)
        dr.enable_grad(parameters["alpha.value"])
        parameters.update()
        asked = Asked.of(mi, gold, wi)
        value = gold.eval(asked.ctx, asked.si, mi.Vector3f(*map(float, wo[0])))[0]
        dr.backward(dr.sum(value))
        values[alpha] = (
            float(np.array(dr.detach(value))[0]),
            float(np.array(dr.grad(parameters["alpha.value"]))[0]),
        )
    slope = (values[0.41][0] - values[0.39][0]) / 0.02
    assert values[0.4][1] == pytest.approx(slope, rel=0.02)


def test_what_they_refuse(mi):
    with pytest.raises(RuntimeError, match=r"multiple_scattering.*found 'yes'; allowed: compensated, walk"):
        load(mi, GLASS, alpha=0.3, multiple_scattering="yes")
    with pytest.raises(RuntimeError, match="alfa"):
        load(mi, GLASS, alfa=0.3)
    with pytest.raises(RuntimeError):
        load(mi, MIRROR, material="unobtainium", alpha=0.3)


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral", "llvm_ad_spectral", "llvm_ad_mono"])
def test_other_variants(mi, variant):
    import mitsuba

    before = mi.variant()
    try:
        mitsuba.set_variant(variant)
        gold = load(mi, MIRROR, material="Au", alpha=0.5)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(0.6, 0.0, 0.8)
        if "spectral" in variant:
            si.wavelengths = type(si.wavelengths)(600.0)
        sample, weight = gold.sample(mi.BSDFContext(), si, 0.4, mi.Point2f(0.3, 0.6))
        pdf = gold.pdf(mi.BSDFContext(), si, sample.wo)
        np.testing.assert_allclose(np.ravel(np.array(pdf)), np.ravel(np.array(sample.pdf)), rtol=1e-4)
        assert 0 < np.max(np.array(weight)) < 2
    finally:
        mitsuba.set_variant(before)
