"""Normal maps in the plugin: those of a material file and Mitsuba's own around a layer, in every kind of variant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba
import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from mitsuba_plugin import Asked, layered

pytestmark = needs_llvm

GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.3, "distribution": "ggx"}
GLASS = {"type": "roughdielectric", "alpha": 0.2, "distribution": "ggx", "int_ior": 1.5, "ext_ior": 1.0}
#: of light that Mitsuba drops or turns where a normal is steep
PLAIN = {"flip_invalid_normals": False, "use_shadowing_function": False}
WI = direction(np.array([0.95, 0.8, 0.6, 0.9]), np.array([0.3, 2.0, 4.0, 5.0]))
WO = direction(np.array([0.7, 0.9, 0.8, 0.6]), np.array([3.0, 5.0, 1.0, 2.0]))


def image(mi: Any, *normals: Any) -> dict[str, Any]:
    """A normal map with these columns."""
    columns = np.array(normals, np.float32)
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    texels = np.broadcast_to(0.5 + 0.5 * columns, (4, *columns.shape))
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(texels)),
        "raw": True,
        "filter_type": "nearest",
    }


def mapped(mi: Any, child: dict[str, Any], *normals: Any, **options: Any) -> dict[str, Any]:
    return {"type": "normalmap", "normalmap": image(mi, *normals), "bsdf": child, **options}


@pytest.mark.parametrize("child", [GOLD, GLASS], ids=["metal", "glass"])
def test_around_one_layer_it_is_mitsubas_own(mi: Any, child: dict[str, Any]) -> None:
    """Everywhere on a map of two normals; the layer alone has no noise."""
    tilted = mapped(mi, child, (0.1, -0.05, 1), (-0.2, 0.1, 1), **PLAIN)
    uv = np.array([[0.2, 0.5], [0.2, 0.5], [0.8, 0.5], [0.8, 0.1]])
    wo = WO * np.array([[1, 1, 1 if child is GOLD else -1]])
    truth = Asked.of(mi, mi.load_dict(tilted), WI, uv=uv).value(wo)
    found = Asked.of(mi, layered(mi, layer_0=tilted), WI, uv=uv).value(wo)
    np.testing.assert_allclose(found, truth, rtol=1e-4, atol=1e-5)
    flat = Asked.of(mi, layered(mi, layer_0=child), WI, uv=uv).value(wo)
    assert np.max(np.abs(found - flat)) > 0.01


def test_a_flat_map_changes_nothing(mi: Any) -> None:
    layers = {"layer_0": GLASS, "layer_1": GOLD}
    flat = {name: mapped(mi, child, (0, 0, 1)) for name, child in layers.items()}
    a, b = (Asked.of(mi, layered(mi, samples=4000, **found), WI).value(WO) for found in (layers, flat))
    np.testing.assert_allclose(a, b, rtol=0.05)
    a, b = (Asked.of(mi, layered(mi, method="lobes", **found), WI).value(WO) for found in (layers, flat))
    np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-5)


def test_a_file_has_its_normals_and_their_strength(mi: Any, tmp_path: Path) -> None:
    """`scale` makes slopes steeper; Python says the same by one normal per evaluation."""
    normal = np.array([0.1, -0.2, 1.0])
    texels = np.broadcast_to(0.5 + 0.5 * normal / np.linalg.norm(normal), (4, 4, 3)).astype(np.float32)
    mi.Bitmap(np.ascontiguousarray(texels)).write(str(tmp_path / "normal.exr"))
    gold = ur.Conductor(material="Au", alpha=0.3)
    file = ur.Texture(tmp_path / "normal.exr", scale=2.0)
    ur.save(ur.Stack(layers=[gold.model_copy(update={"normal": file})]), tmp_path / "gold.yaml")
    found = Asked.of(mi, layered(mi, filename=str(tmp_path / "gold.yaml")), WI).value(WO)
    steep = {"layer_0.normal": normal * (2, 2, 1) / 2}
    truth = ur.solve(ur.Stack(layers=[gold]), "walk", parameters=steep).eval(WI, WO)
    np.testing.assert_allclose(found, truth, rtol=2e-3, atol=1e-4)


def test_a_footprint_turns_what_it_covers_into_roughness(mi: Any) -> None:
    """Two slopes of +-0.2 from afar: a flat surface with the variance 0.04 along x, in either method."""
    tilted = mapped(mi, GOLD, (0.2, 0, 1), (-0.2, 0, 1))
    gold = ur.Conductor(material="Au", alpha=0.3, masking="separable", slope_variance=(0.04, 0, 0))
    truth = ur.solve(ur.Stack(layers=[gold]), "walk").eval(WI, WO)
    for method in ("walk", "lobes"):
        seen = layered(mi, footprint=20.0, method=method, layer_0=tilted)
        found = Asked.of(mi, seen, WI, uv=(0.3, 0.3)).value(WO)
        np.testing.assert_allclose(found, truth, rtol=5e-3, atol=1e-4)
    with pytest.raises(RuntimeError, match=r"footprint: found -1\.0"):
        layered(mi, footprint=-1.0, layer_0=tilted)
    noise = {**tilted, "normalmap": {"type": "checkerboard"}}
    with pytest.raises(RuntimeError, match=r"layer_0\.normal.*an image"):
        layered(mi, footprint=1.0, layer_0=noise)


def test_a_file_of_bytes_is_averaged_as_it_is_read(mi: Any, tmp_path: Path) -> None:
    """Bytes of a normal map are numbers, with a footprint as without one: no sRGB curve is taken off them."""
    normal = np.array([0.2, -0.1, 1.0])
    texels = np.rint(255 * (0.5 + 0.5 * normal / np.linalg.norm(normal))).astype(np.uint8)
    mi.Bitmap(np.ascontiguousarray(np.broadcast_to(texels, (4, 8, 3)))).write(str(tmp_path / "normal.png"))
    gold = ur.Conductor(material="Au", alpha=0.3, normal=ur.Texture(tmp_path / "normal.png"))
    ur.save(ur.Stack(layers=[gold]), tmp_path / "gold.yaml")
    near, far = (
        Asked.of(mi, layered(mi, filename=str(tmp_path / "gold.yaml"), method="lobes", **options), WI).value(
            WO
        )
        for options in ({}, {"footprint": 0.5})
    )
    np.testing.assert_allclose(far, near, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral", "scalar_rgb"])
def test_other_variants(variant: str) -> None:
    """The metal that the normal faces: the same geometry, whatever the colours."""
    mitsuba.set_variant(variant)
    try:
        mi = mitsuba
        tilted = mapped(mi, GOLD, (0.1, -0.05, 1), **PLAIN)
        own, ours = mi.load_dict(tilted), layered(mi, layer_0=tilted)
        if variant.startswith("scalar"):
            si = mi.SurfaceInteraction3f()
            si.wi, wo = mi.Vector3f(*WI[0]), mi.Vector3f(*WO[0])
            a, b = (np.array(bsdf.eval(mi.BSDFContext(), si, wo)) for bsdf in (own, ours))
        else:
            waves = (500.0, 550.0, 600.0, 650.0) if "spectral" in variant else ()
            a, b = (Asked.of(mi, bsdf, WI, wavelengths=waves).value(WO) for bsdf in (own, ours))
        np.testing.assert_allclose(a, b, rtol=1e-3)
    finally:
        mitsuba.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in mitsuba.variants() else "scalar_rgb")


def test_a_normal_shows_up_and_can_be_set(mi: Any) -> None:
    import drjit as dr

    stack = layered(mi, layer_0=mapped(mi, GOLD, (0.1, 0, 1)))
    parameters = mi.traverse(stack)
    before = Asked.of(mi, stack, WI).value(WO)
    flat = np.broadcast_to([0.5, 0.5, 1.0], (4, 1, 3))
    parameters["layer_0.normal.data"] = mi.TensorXf(np.ascontiguousarray(flat, np.float32))
    parameters.update()
    after = Asked.of(mi, stack, WI).value(WO)
    np.testing.assert_allclose(after, Asked.of(mi, layered(mi, layer_0=GOLD), WI).value(WO), rtol=1e-3)
    assert np.max(np.abs(before - after)) > 0.01
    dr.eval(after)


def test_derivatives_reach_the_texels(mi: Any) -> None:
    """Against finite differences of all texels at once; lobes have no noise."""
    import drjit as dr

    stack = layered(mi, method="lobes", layer_0=mapped(mi, GLASS, (0.1, 0, 1)), layer_1=GOLD)
    parameters, asked = mi.traverse(stack), Asked.of(mi, stack, WI)
    start = mi.TensorXf(parameters["layer_0.normal.data"])

    def mean(data: Any) -> Any:
        parameters["layer_0.normal.data"] = data
        parameters.update()
        wo = mi.Vector3f(np.ascontiguousarray(WO.T, np.float32))
        return dr.mean(stack.eval(asked.ctx, asked.si, wo).x)

    data = mi.TensorXf(start)
    dr.enable_grad(data)
    dr.backward(mean(data))
    slope = float(np.sum(np.array(dr.grad(data))[..., 0]))
    red = np.array([1.0, 0.0, 0.0], np.float32) * 0.01 + 0 * np.array(start)
    step = [float(mean(mi.TensorXf(np.array(start) + sign * red))[0]) for sign in (1, -1)]
    assert slope == pytest.approx((step[0] - step[1]) / 0.02, rel=0.02)
    assert abs(slope) > 0.01


def test_what_cannot_be_read_is_refused(mi: Any) -> None:
    bump = {"type": "bumpmap", "arbitrary": {"type": "checkerboard"}, "bsdf": GOLD}
    with pytest.raises(RuntimeError, match="heights, not normals"):
        layered(mi, layer_0=bump)
    with pytest.raises(RuntimeError, match="a normal map around a normal map"):
        layered(mi, layer_0=mapped(mi, mapped(mi, GOLD, (0, 0, 1)), (0, 0, 1)))
    with pytest.raises(RuntimeError, match=r"layer_0\.normal is given, and tilted"):
        layered(mi, method="adding", layer_0=mapped(mi, GOLD, (0, 0, 1)))
