"""The built-in scene: closed and well-oriented shapes, lights and shapes that all render, sane exposure; and
the pictures that are written."""

from __future__ import annotations

import os

import numpy as np
import pytest

from urushi.adapters import lathe
from urushi.adapters import scene as builtin

SHAPES = {"ball": lathe.ball, "bowl": lathe.bowl, "sphere": lathe.sphere, "stand": lathe.stand}
WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}


@pytest.mark.parametrize("name", SHAPES)
def test_a_turned_shape_encloses_a_volume_and_its_normals_point_out(name):
    """The signed volume is positive, and no triangle faces against its shading normals."""
    position, normal, uv, faces = lathe.revolve(SHAPES[name](), segments=64)
    a, b, c = (position[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    assert np.sum(a * cross) / 6.0 > 0.1
    shading = normal[faces].sum(axis=1)
    # At the axis triangles shrink to nothing; everywhere else both normals must agree.
    area = np.linalg.norm(cross, axis=1)
    big = area > 1e-9
    cos = np.sum(cross * shading, axis=1)[big] / (area * np.linalg.norm(shading, axis=1))[big]
    assert cos.min() > 0.5
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    assert uv.min() >= 0.0 and uv.max() <= 1.0


def test_a_sphere_turned_inside_out_is_noticed():
    """The planted fault of the test above: the profile walked the other way."""
    position, _, _, faces = lathe.revolve(lathe.sphere()[::-1], segments=64)
    a, b, c = (position[faces[:, i]] for i in range(3))
    assert np.sum(a * np.cross(b - a, c - a)) < 0.0


def test_the_sphere_is_a_sphere():
    position, normal, _, faces = lathe.revolve(lathe.sphere())
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 1.0, atol=1e-12)
    assert np.max(np.abs(normal - position)) < 2e-2
    a, b, c = (position[faces[:, i]] for i in range(3))
    assert np.sum(a * np.cross(b - a, c - a)) / 6.0 == pytest.approx(4.0 / 3.0 * np.pi, rel=1e-3)


def test_a_ply_file_says_what_was_written(mi, tmp_path):
    shape = lathe.revolve(lathe.sphere(16), segments=8)
    path = tmp_path / "sphere.ply"
    lathe.write_ply(path, *shape)
    params = mi.traverse(mi.load_dict({"type": "ply", "filename": str(path)}))
    for key, expected in zip(
        ("vertex_positions", "vertex_normals", "vertex_texcoords"), shape[:3], strict=True
    ):
        np.testing.assert_allclose(np.array(params[key]), expected.ravel(), atol=1e-6)
    np.testing.assert_array_equal(np.array(params["faces"]), shape[3].ravel())


@pytest.mark.parametrize("light", builtin.LIGHTS)
def test_every_light_is_exposed(mi, light):
    """A white ball is bright and not burnt out, and nothing is invalid."""
    loaded = mi.load_dict(builtin.scene(WHITE, size=(32, 24), light=light))
    image = np.array(mi.render(loaded, spp=32, seed=1))
    assert image.shape == (24, 32, 3)
    assert np.all(np.isfinite(image)) and image.min() >= 0.0
    ball = image[7:15, 12:20]
    assert 0.3 < ball.mean() < 1.1


@pytest.mark.parametrize("shape", builtin.SHAPES)
def test_every_shape_is_seen(mi, shape):
    """A black hero darkens the middle of a picture that a white one brightens."""
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
    means = []
    for bsdf in (black, WHITE):
        loaded = mi.load_dict(builtin.scene(bsdf, size=(32, 32), shape=shape))
        means.append(np.array(mi.render(loaded, spp=8, seed=1))[14:20, 12:20].mean())
    assert means[0] < 0.01 and means[1] > 0.3


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="candle"):
        builtin.scene(WHITE, light="candle")
    with pytest.raises(ValueError, match="teapot"):
        builtin.scene(WHITE, shape="teapot")


# ---------------------------------------------------------------------------------------- pictures


def test_a_picture_in_passes_has_the_mean_of_one_pass(mi, seed):
    from urushi.adapters import picture

    scene = mi.load_dict(builtin.scene(WHITE, size=(24, 24), light="constant"))
    seen = []
    image = picture.render(scene, 50, seed, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (50, 50) and len(seen) > 5
    again = picture.render(scene, 50, seed)
    # Threads add to the film in any order, so that the last bit may differ.
    np.testing.assert_allclose(image, again, rtol=1e-5)
    other = picture.render(scene, 50, seed + 1)
    assert np.mean(np.abs(image / other - 1.0) > 1e-3) > 0.2
    np.testing.assert_allclose(image.mean(), other.mean(), rtol=0.02)


def test_exr_is_linear_and_png_is_srgb(mi, tmp_path):
    from urushi.adapters import picture

    image = np.zeros((4, 5, 3), np.float32)
    image[0, 0], image[1, 1], image[2, 2] = 0.5, 7.0, np.nan
    picture.write(image, tmp_path / "a.exr", {"urushi.seed": "3"})
    picture.write(image, tmp_path / "a.png")
    bitmap = mi.Bitmap(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(np.array(bitmap), image)
    assert bitmap.metadata()["urushi.seed"] == "3"
    pixels = np.array(mi.Bitmap(str(tmp_path / "a.png")))
    assert pixels.shape == (4, 5, 3) and pixels.dtype == np.uint8
    assert pixels[0, 0, 0] == 188  # sRGB of one half
    assert pixels[1, 1, 0] == 255 and pixels[2, 2, 0] == 0
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "a.png"]


def test_the_tone_curve_rises_and_never_burns_out_early():
    from urushi.adapters.picture import SHOULDER, tonemap

    x = np.linspace(0.0, 1.5, 600, dtype=np.float32)
    y = tonemap(np.repeat(x[None, :, None], 3, axis=2))[0, :, 0].astype(int)
    assert np.all(np.diff(y) >= 0)
    exact = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    below = x <= SHOULDER
    np.testing.assert_array_equal(y[below], (exact[below] * 255 + 0.5).astype(int))
    assert y[np.searchsorted(x, 1.0)] < 250


def test_a_failed_write_leaves_nothing(mi, tmp_path, monkeypatch):
    from urushi.adapters import picture

    def fail(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(picture.os, "replace", fail)
    with pytest.raises(KeyboardInterrupt):
        picture.write(np.zeros((2, 2, 3), np.float32), tmp_path / "a.png")
    assert os.listdir(tmp_path) == []


def test_exr_is_written_with_a_single_thread(mi, tmp_path):
    """Mitsuba alone waits for ever then; the second thread is for it."""
    import drjit as dr

    from urushi.adapters import picture

    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        picture.write(np.ones((2, 3, 3), np.float32), tmp_path / "a.exr")
        assert np.array(mi.Bitmap(str(tmp_path / "a.exr"))).shape == (2, 3, 3)
    finally:
        dr.set_thread_count(max(2, before))
