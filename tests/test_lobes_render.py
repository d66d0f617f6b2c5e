"""Derivatives of a picture by lobes, against differences of pictures."""

from __future__ import annotations

import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

STACK = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.2),
        ur.Medium(depth=0.45, albedo=0.6, phase=ur.HenyeyGreenstein(g=0.6)),
        ur.Conductor(eta=0.2, k=3.9, alpha=0.27),
    ]
)


@pytest.mark.parametrize(
    ("name", "value", "half"),
    [
        pytest.param("layer_0.ior", 1.5, 0.005, marks=pytest.mark.slow),
        pytest.param("layer_1.depth", 0.45, 0.005, marks=pytest.mark.slow),
        pytest.param("layer_2.alpha", 0.27, 0.005, marks=pytest.mark.slow),
    ],
)
def test_in_a_render(tmp_path, name: str, value: float, half: float) -> None:
    """One light far away on a plane, so that eval at one pair of directions is all of the picture."""
    import drjit as dr
    import mitsuba as mi

    import urushi.mitsuba  # noqa: F401 (registers the plugin)

    mi.set_variant("llvm_ad_rgb")
    ur.save(STACK, tmp_path / "stack.yaml")
    look = mi.ScalarTransform4f().look_at([0, -3, 2], [0, 0, 0], [0, 0, 1])
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "bsdf_samples": 0, "emitter_samples": 1},
            "light": {"type": "directional", "direction": [0.1, 0.7, -0.6], "irradiance": 3.0},
            "sensor": {
                "type": "perspective",
                "to_world": look,
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "plane": {
                "type": "rectangle",
                "bsdf": {"type": "layered", "filename": str(tmp_path / "stack.yaml"), "method": "lobes"},
            },
        }
    )
    parameters = mi.traverse(scene)
    key = f"plane.bsdf.{name}"
    assert key in parameters

    def picture(x: object) -> object:
        parameters[key] = x
        parameters.update()
        return dr.mean(mi.render(scene, parameters, spp=4, seed=1)[:, :, 0], axis=None)

    x = mi.Float(value)
    dr.enable_grad(x)
    dr.backward(picture(x))
    ends = [float(picture(mi.Float(value + step)).array[0]) for step in (half, -half)]
    slope = (ends[0] - ends[1]) / (2 * half)
    assert abs(slope) > 1e-3
    # Single precision, and tables whose interpolation has kinks.
    assert float(dr.grad(x)[0]) == pytest.approx(slope, rel=0.1)
