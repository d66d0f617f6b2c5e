"""`mi.traverse`: what the parameters are called, and that setting them is as good as loading others."""

from __future__ import annotations

import drjit as dr
import mitsuba
import numpy as np
import pytest

from conftest import LLVM
from mitsuba_plugin import OTHER, Asked, above, layered, write
from urushi.errors import MaterialError

NAMES = {
    "layer_0.ior": "ior",
    "layer_0.alpha": "alpha",
    "layer_1.depth": "depth",
    "layer_1.albedo": "albedo",
    "layer_1.phase.g": "g",
    "layer_2.k": "k",
    "layer_2.alpha_u": "u",
    "layer_2.alpha_v": "v",
}


def test_the_names_are_those_of_the_description(mi, tmp_path):
    parameters = mi.traverse(layered(mi, filename=write(tmp_path)))
    others = {"layer_0.rotation", "layer_2.rotation", "layer_2.eta"}
    assert set(dict(parameters).keys()) == set(NAMES) | others
    textured = layered(mi, filename="preset:varnished-wood")
    names = set(dict(mi.traverse(textured)).keys())
    assert {"layer_0.alpha.data", "layer_1.depth", "layer_1.albedo", "layer_2.reflectance.data"} <= names


def everything(mi, bsdf, wi, wo, u, uv) -> tuple[np.ndarray, ...]:
    asked = Asked.of(mi, bsdf, wi, uv=uv)
    sample, weight = asked.sample(u)
    return asked.value(wo), asked.density(wo), np.array(sample.wo).T, weight


@pytest.mark.parametrize("name", [*NAMES, "all at once"])
def test_setting_a_value_is_loading_a_stack_with_it(mi, rng, tmp_path, name):
    """eval, pdf and sample give the same bits; and others than before."""
    wi, wo, u, uv = above(rng, 500), above(rng, 500), rng.random((500, 3)), rng.random((500, 2))
    changes = OTHER if name == "all at once" else {NAMES[name]: OTHER[NAMES[name]]}
    bsdf = layered(mi, filename=write(tmp_path))
    before = everything(mi, bsdf, wi, wo, u, uv)
    parameters = mi.traverse(bsdf)
    for key, ours in NAMES.items():
        if ours in changes:
            value = changes[ours]
            parameters[key] = mi.Color3f(*value) if isinstance(value, list) else value
    parameters.update()
    found = everything(mi, bsdf, wi, wo, u, uv)
    truth = everything(mi, layered(mi, filename=write(tmp_path, **changes)), wi, wo, u, uv)
    for one, other in zip(found, truth, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.mean(before[0] != found[0]) > 0.5


@pytest.mark.skipif(not LLVM, reason="no LLVM")
def test_a_rough_surface_may_become_smooth_and_back(mi, rng, tmp_path):
    """The flags follow, and so does what is sampled."""
    bsdf = layered(mi, filename=write(tmp_path))
    parameters, flags = mi.traverse(bsdf), mi.BSDFFlags
    seen = [bool(mi.has_flag(bsdf.flags(), flags.DeltaReflection))]
    for alpha in (0.0, 0.3):
        parameters["layer_0.alpha"] = alpha
        parameters.update()
        sample, _ = Asked.of(mi, bsdf, above(rng, 2000)).sample(rng.random((2000, 3)))
        some = bool(np.any(np.array(sample.sampled_type) & int(flags.DeltaReflection)))
        assert some == bool(mi.has_flag(bsdf.flags(), flags.DeltaReflection))
        assert (bsdf.component_count() == 2) == some
        seen.append(some)
    assert seen == [False, True, False]


def test_values_can_be_set_in_scalar_variants(tmp_path):
    """Where numbers are plain floats, which Mitsuba cannot set in a plugin of Python's."""
    mi = mitsuba
    mi.set_variant("scalar_rgb")
    ctx, si = mi.BSDFContext(), dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    bsdf = layered(mi, filename=write(tmp_path))
    other = layered(mi, filename=write(tmp_path, alpha=0.35, albedo=[0.2, 0.6, 0.9]))
    parameters = mi.traverse(bsdf)
    parameters["layer_0.alpha"] = 0.35
    parameters["layer_1.albedo"] = mi.Color3f(0.2, 0.6, 0.9)
    parameters.update()
    values = [np.array(b.eval(ctx, si, mi.Vector3f(-0.6, 0, 0.8))) for b in (bsdf, other)]
    np.testing.assert_allclose(*values, rtol=1e-6)
    np.testing.assert_allclose(np.array(parameters["layer_0.alpha"]), 0.35)


def test_it_prints_what_it_is(mi, tmp_path):
    """Every option, every layer, every value that it has now."""
    bsdf = layered(mi, filename=write(tmp_path), samples=3, seed=7, max_depth=20)
    parameters = mi.traverse(bsdf)
    parameters["layer_0.alpha"] = 0.125
    parameters.update()
    text = str(bsdf)
    for words in (
        *("samples = 3", "seed = 7", "max_depth = 20", "method = walk", "exterior = 1.0"),
        *(
            "dielectric ggx correlated",
            "ior = 1.5",
            "alpha = 0.125",
            "medium henyey_greenstein",
            "depth = 0.7",
        ),
        *(
            "albedo = 0.8, 0.5, 0.3",
            "phase.g = 0.4",
            "eta = 0.2, 0.9, 1.4",
            "k = 3",
            "alpha_u = 0.1",
            "alpha_v = 0.3",
        ),
    ):
        assert words in text, words
    assert "Bitmap" in str(layered(mi, filename="preset:varnished-wood"))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("layer_0.alpha", -1.0, r"layers\[0\]\.alpha: found -1\.0"),
        ("layer_0.ior", float("nan"), r"layers\[0\]\.ior: found"),
        ("layer_1.albedo", [0.1, -2.0, 0.1], r"layers\[1\]\.albedo\[1\]: found -2\.0"),
        ("layer_1.phase.g", 2.0, r"layers\[1\]\.phase\.g: found 2\.0"),
        ("layer_2.alpha_v", 1.5, r"layers\[2\]\.alpha\[1\]: found 1\.5"),
    ],
)
def test_a_value_that_no_file_may_have_is_refused(mi, tmp_path, key, value, said):
    parameters = mi.traverse(layered(mi, filename=write(tmp_path)))
    parameters[key] = mi.Color3f(*value) if isinstance(value, list) else value
    with pytest.raises(MaterialError, match=said):
        parameters.update()


def test_bounds_are_those_of_single_precision(mi, tmp_path):
    """1e-4 is a little less in single precision than it is in the description, which allows it."""
    parameters = mi.traverse(layered(mi, filename=write(tmp_path)))
    parameters["layer_0.alpha"] = 1e-4
    parameters.update()
    assert parameters["layer_0.alpha"] == np.float32(1e-4)
