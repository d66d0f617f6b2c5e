"""The built-in scene: one object of the material on a neutral stage, for looking at it.

The hero shows what a material does: a broad convex part for the base colour and the highlights, a dish and a
groove for interreflection, a rim for grazing angles. It stands on a floor with a faint checkerboard, so that a
transmitting material has something to show, in front of a backdrop without a horizon.

Nothing is downloaded and nothing is read from the package: the geometry is turned by `lathe`, the floor's
texture is computed here. z is up; lengths are in radii of the ball. Exposure is part of the scene: a white
diffuse ball comes out a little below 1, so a picture needs no adjustment afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from urushi.adapters import lathe

SHAPES = lathe.SHAPES
LIGHTS = ("studio", "sky", "constant")

DEPTH = 12
"""Longest path of the renders: enough for light to enter a transmitting hero, wander and leave."""


def scene(
    bsdf: dict[str, Any],
    *,
    size: tuple[int, int] = (512, 512),
    light: str = "studio",
    shape: str = "ball",
    spp: int = 64,
) -> dict[str, Any]:
    """A scene for `mitsuba.load_dict`; a variant must be set.

    Args:
        bsdf: the material of the hero, as a Mitsuba dictionary (or an instantiated BSDF).
        size: width and height of the picture in pixels.
        light: one of `LIGHTS`: softboxes, a clear sky with the sun, or the same light from everywhere.
        shape: one of `SHAPES`: the shader ball on its stand, a lacquer bowl, or a plain sphere.
        spp: samples per pixel.

    Raises:
        ValueError: an unknown light or shape.
    """
    if light not in LIGHTS or shape not in SHAPES:
        raise ValueError(f"light is one of {LIGHTS}, shape one of {SHAPES}; got {light!r}, {shape!r}")
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "sensor": _camera(size, spp),
        **_hero(bsdf, shape),
        **_stage("floor" if light == "sky" else "sweep"),
        **{"studio": _studio, "sky": _sky, "constant": _constant}[light](),
    }


def _camera(size: tuple[int, int], spp: int) -> dict[str, Any]:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": 23.0,
        "fov_axis": "smaller",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[0.0, -7.4, 3.1], target=[0, 0, 1.02], up=[0, 0, 1]
        ),
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "pixel_format": "rgb",
            "rfilter": {"type": "gaussian"},
        },
        "sampler": {"type": "independent", "sample_count": spp},
    }


def _hero(bsdf: dict[str, Any], shape: str) -> dict[str, Any]:
    import mitsuba as mi

    to_world = mi.ScalarTransform4f()
    if shape != "bowl":
        to_world = to_world.translate([0.0, 0.0, 1.10])
    if shape == "ball":  # leans towards the camera and the key light, so that dish and groove are seen
        to_world = to_world.rotate([0, 0, 1], -22.0).rotate([1, 0, 0], 34.0)
    hero = {"type": "ply", "filename": lathe.ply(shape), "to_world": to_world, "bsdf": bsdf}
    if shape == "bowl":
        return {"hero": hero}
    satin = {"type": "roughplastic", "alpha": 0.22, "diffuse_reflectance": _grey(0.035)}
    return {"hero": hero, "stand": {"type": "ply", "filename": lathe.ply("stand"), "bsdf": satin}}


def _stage(form: str) -> dict[str, Any]:
    """The floor, with a backdrop ("sweep") or without ("floor"); its half-unit squares fade with distance."""
    import mitsuba as mi

    pixels, unit = 1536, 12.0  # the texture's square covers `unit` of the floor, centred on the origin
    at = (np.arange(pixels) + 0.5) / pixels * unit - 0.5 * unit
    x, y = np.meshgrid(at, -at)
    checks = 1.0 - 2.0 * ((np.floor(2.0 * x) + np.floor(2.0 * y)) % 2)
    fade = np.clip(1.0 - (np.hypot(x, y) / 5.0) ** 2, 0.0, 1.0) ** 2
    grey = 0.34 * (1.0 + 0.20 * checks * fade)
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.repeat(grey[..., None], 3, axis=2).astype(np.float32)),
        "raw": True,
        "wrap_mode": "clamp",
    }
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}
    return {"stage": {"type": "ply", "filename": lathe.ply(form), "bsdf": bsdf}}


# ------------------------------------------------------------------------------------------ lights


def _studio() -> dict[str, Any]:
    """A large key softbox from the left, a tall strip from the right, one overhead behind, and a faint fill.

    The sampling weights follow what each light adds to the picture; they change its noise, not its mean.
    """
    return {
        "key": _softbox([-5.8, -3.6, 4.4], [0, 0, 1.0], (1.7, 2.2), radiance=13.0, weight=3.0),
        "strip": _softbox([6.0, -0.6, 3.2], [0, 0, 1.2], (0.55, 2.6), radiance=11.0, weight=1.0),
        "back": _softbox([0.6, 4.6, 7.2], [0, 0, 0.8], (3.2, 1.1), radiance=9.0, weight=2.0),
        "fill": {"type": "constant", "radiance": _grey(0.22), "sampling_weight": 0.5},
    }


def _softbox(
    origin: list[float], target: list[float], half: tuple[float, float], radiance: float, weight: float
) -> dict[str, Any]:
    """A rectangle of half-extents `half` that shines towards `target`."""
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 0, 1])
    return {
        "type": "rectangle",
        "to_world": to_world.scale([*half, 1.0]),
        "bsdf": {"type": "diffuse", "reflectance": _grey(0.0)},
        "emitter": {"type": "area", "radiance": _grey(radiance), "sampling_weight": weight},
    }


def _sky() -> dict[str, Any]:
    """A clear sky, the sun high behind the camera's left shoulder.

    The sun is a sphere of three degrees that is sampled by itself: the emitter `sunsky` draws it together with
    the sky, which takes many times the samples for the same noise.
    """
    toward = np.array([-0.55, -0.62, 0.62]) / np.linalg.norm([-0.55, -0.62, 0.62])
    return {
        "sky": {
            "type": "sunsky",
            "sun_direction": list(toward),
            "turbidity": 3.0,
            "sky_scale": 2.9,
            "sun_scale": 0.0,
        },
        "sun": {
            "type": "sphere",
            "center": list(200.0 * toward),
            "radius": 200.0 * np.sin(np.radians(1.5)),
            "emitter": {
                "type": "area",
                "radiance": {"type": "rgb", "value": [1800.0, 1600.0, 1320.0]},
                "sampling_weight": 2.0,
            },
        },
    }


def _constant() -> dict[str, Any]:
    """The same radiance from everywhere: no highlights, the plain directional albedo."""
    return {"everywhere": {"type": "constant", "radiance": _grey(1.0)}}


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [value, value, value]}
