"""Textured layers in a render: each part of a plane is the untextured plane of the value that is there."""

from __future__ import annotations

from typing import Any

import mitsuba
import numpy as np
import pytest

from lanes import needs_llvm
from mitsuba_plugin import mean, picture, stack_file

pytestmark = needs_llvm

SIGMAS = 5.5

FIRST, SECOND = ([0.9, 0.2, 0.1], [0.1, 0.3, 0.8])


def colour(value: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": value}


def checks(first: Any, second: Any) -> dict[str, Any]:
    """An image of two by two squares. (Mitsuba's own checkerboard puts numbers where it does not put colours.)"""
    squares = np.array([[first, second], [second, first]], np.float32).reshape(2, 2, -1)
    image = mitsuba.Bitmap(squares)
    return {"type": "bitmap", "bitmap": image, "raw": True, "filter_type": "nearest"}


COAT = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.2, "int_ior": 1.5, "ext_ior": 1.0}
METAL = {"type": "roughconductor", "distribution": "ggx", "material": "Au"}
WHITE = {"type": "diffuse", "reflectance": 0.8}

# What lies in the plane, with both values, the first or the second.
TEXTURED = {
    "reflectance": (
        lambda v: [COAT, {"type": "diffuse", "reflectance": v}],
        lambda: (checks(FIRST, SECOND), colour(FIRST), colour(SECOND)),
    ),
    "roughness of the coat": (lambda v: [COAT | {"alpha": v}, WHITE], lambda: (checks(0.1, 0.5), 0.1, 0.5)),
    "roughness of metal": (lambda v: [METAL | {"alpha": v}], lambda: (checks(0.1, 0.5), 0.1, 0.5)),
    "one axis of it": (
        lambda v: [METAL | {"alpha_u": v, "alpha_v": 0.2}],
        lambda: (checks(0.1, 0.5), 0.1, 0.5),
    ),
}


def shown(mi: Any, texture: dict[str, Any]) -> np.ndarray:
    """What Mitsuba's own diffuse plane shows of a texture: (height, width, 3), without noise."""
    bsdf = {"type": "diffuse", "reflectance": texture}
    return picture(mi, bsdf, spp=16, type="aov", aovs="albedo:albedo")[..., -3:]


@pytest.mark.parametrize("name", TEXTURED)
def test_each_half_of_a_textured_plane_is_its_untextured_twin(mi, name):
    make, values = TEXTURED[name]
    both, first, second = (
        picture(
            mi, {"type": "layered"} | {f"layer_{i}": layer for i, layer in enumerate(make(value))}, seed=seed
        )
        for seed, value in enumerate(values())
    )
    white = shown(mi, checks(1.0, 0.0))[..., 0] > 0.5
    assert white.mean() == 0.5
    for mask, twin in ((white, first), (~white, second)):
        (found, spread), (truth, error) = mean(both[mask]), mean(twin)
        assert np.all(np.abs(found - truth) < SIGMAS * np.hypot(spread, error) + 1e-6), name
        assert np.all(np.hypot(spread, error) < 0.02 * truth)
    assert np.abs(mean(first)[0] - mean(second)[0]).max() > 0.02


def test_images_of_a_material_file_lie_where_mitsuba_puts_them(mi, tmp_path):
    """Albedo of a medium and roughness of a coat from images, sRGB-encoded and raw: quarter by quarter."""
    shades = np.array([[[255, 128, 0], [10, 200, 90]], [[60, 60, 60], [0, 0, 250]]], np.uint8)
    roughnesses = np.array([[51, 255], [102, 26]], np.uint8)
    for name, values in (("colour", shades), ("rough", roughnesses[..., None])):
        mi.Bitmap(np.ascontiguousarray(values.repeat(8, 0).repeat(8, 1))).write(str(tmp_path / f"{name}.png"))
    layers = [
        "dielectric: {ior: 1.5, alpha: {texture: rough.png, scale: 0.5}}",
        "medium: {depth: 1.0, albedo: {texture: colour.png}}",
        "diffuse: {reflectance: 0.5}",
    ]
    image = picture(mi, stack_file(tmp_path, layers))
    mitsubas = shown(mi, {"type": "bitmap", "filename": str(tmp_path / "colour.png")})
    encoded = shades / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    seen = []
    for y, x in ((0, 0), (0, 1), (1, 0), (1, 1)):
        # The pixels inside a quarter, wherever Mitsuba shows it; at its edges the image is interpolated.
        inside = np.all(np.abs(mitsubas - linear[y, x]) < 0.01, axis=-1)
        assert 20 < np.count_nonzero(inside) <= 64
        found, spread = mean(image[inside])
        seen.append(found)
        layers[0] = f"dielectric: {{ior: 1.5, alpha: {roughnesses[y, x] / 255 * 0.5}}}"
        layers[1] = f"medium: {{depth: 1.0, albedo: {[round(float(c), 6) for c in linear[y, x]]}}}"
        truth, error = mean(picture(mi, stack_file(tmp_path, layers), seed=1))
        assert np.all(np.abs(found - truth) < SIGMAS * np.hypot(spread, error) + 1e-5), (y, x)
    assert np.ptp(seen, axis=0).max() > 0.1
