"""Renders with the plugin against truth from outside: path-traced geometry, furnaces, Mitsuba's glass, the solver."""

from __future__ import annotations

import mitsuba
import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from mitsuba_plugin import SIDE, mean, picture, stack_file

pytestmark = needs_llvm

SIGMAS = 5.5


# Reflectance at 0, 30, 60 and 80 degrees, with its standard error, of Mitsuba's volumetric path tracer on two real
# planes with a medium of the index between them (separable masking; unlimited depth).
GEOMETRY = {
    "coated diffuse": (
        ["dielectric: {ior: 1.5, alpha: 0.1, masking: separable}", "diffuse: {reflectance: 0.5}"],
        {0: (0.30995, 0.00016), 30: (0.31124, 0.00016), 60: (0.34113, 0.00018), 80: (0.44781, 0.00024)},
    ),
    "coated diffuse with scattering medium": (
        [
            "dielectric: {ior: 1.5, alpha: 0.1, masking: separable}",
            "medium: {depth: 0.5, albedo: 0.7, phase: {henyey_greenstein: {g: 0.5}}}",
            "diffuse: {reflectance: 0.5}",
        ],
        {0: (0.19904, 0.00015), 30: (0.19968, 0.00016), 60: (0.23279, 0.00019), 80: (0.36369, 0.00026)},
    ),
}


@pytest.mark.parametrize("name", GEOMETRY)
def test_a_plane_reflects_what_real_geometry_does(mi, tmp_path, name):
    """Under a uniform sky, from four angles."""
    layers, rows = GEOMETRY[name]
    bsdf = stack_file(tmp_path, layers)
    for theta, (truth, error) in rows.items():
        found, spread = mean(picture(mi, bsdf, theta=theta))
        assert abs(found[0] - truth) < SIGMAS * np.hypot(spread[0], error), (theta, found, truth)
        assert spread[0] < 0.005 * truth


@pytest.mark.parametrize("alpha", [0.0, 0.02])
def test_a_lossless_coat_on_white_vanishes_in_a_furnace(mi, tmp_path, alpha):
    """All light comes back, whatever way it took: every pixel is 1 (a rougher coat loses what facets shadow)."""
    layers = [f"dielectric: {{ior: 1.5, alpha: {alpha}}}", "diffuse: {reflectance: 1.0}"]
    for theta in (0, 60):
        found, spread = mean(picture(mi, stack_file(tmp_path, layers), theta=theta))
        assert np.all(np.abs(found - 1) < SIGMAS * spread + 5e-4)
        assert np.all(spread < 0.005)


def test_a_ball_of_glass_vanishes_in_a_furnace(mi, tmp_path):
    """In and out again: what passes is scaled by eta², and back; nothing is lost but the paths that end."""
    glass = stack_file(tmp_path, ["dielectric: {ior: 1.5}"])
    image = picture(mi, glass, ball=True, max_depth=64, rr_depth=1000, spp=32)
    np.testing.assert_allclose(image, 1, rtol=1e-3)


def test_a_ball_of_rough_glass_is_mitsubas(mi):
    """`roughdielectric` as the one layer and by itself, in the same furnace."""
    glass = {"type": "roughdielectric", "alpha": 0.3, "int_ior": 1.5, "ext_ior": 1.0, "distribution": "ggx"}
    one, other = (
        picture(mi, bsdf, ball=True, spp=4096, seed=seed)
        for seed, bsdf in enumerate((glass, {"type": "layered", "layer_0": glass}))
    )
    disc = np.hypot(*(np.indices((SIDE, SIDE)) - (SIDE - 1) / 2)) < 0.3 * SIDE
    difference, error = mean((one - other)[disc])
    assert np.all(np.abs(difference) < SIGMAS * error), (difference, error)
    assert np.all(error < 0.004), error
    assert one[disc].mean() < 0.97


def test_twosided_shows_it_from_below_as_well(mi):
    bsdf = {"type": "layered", "filename": "preset:urushi-red"}
    above, below = (
        mean(picture(mi, {"type": "twosided", "bsdf": bsdf}, theta=40, below=low, seed=int(low)))
        for low in (False, True)
    )
    assert np.all(np.abs(above[0] - below[0]) < SIGMAS * np.hypot(above[1], below[1]))
    assert np.all(above[0] > 0.01)
    assert not picture(mi, bsdf, theta=40, below=True, spp=4).any()


def test_a_spectral_render_has_the_colour_of_an_rgb_one():
    """Roughly: a saturated colour has no smooth spectrum that is as saturated, and metals are measured."""
    found = []
    for variant in ("llvm_ad_rgb", "llvm_ad_spectral"):
        mitsuba.set_variant(variant)
        found.append(
            mean(
                picture(mitsuba, {"type": "layered", "filename": "preset:enamel-on-gold"}, theta=30, spp=512)
            )[0]
        )
    mitsuba.set_variant("llvm_ad_rgb")
    np.testing.assert_allclose(found[1][:3], found[0][:3], atol=0.2 * found[0].max())
    assert found[0][0] > 1.5 * found[0][2]


def test_the_albedo_image_is_the_reflectance(mi):
    """The `albedo` channel of Mitsuba's `aov` integrator, for denoisers, against the solver."""
    theta = 50
    stack = ur.load("preset:urushi-red")
    wi = direction(np.cos(np.radians(theta)))[None]
    truth, error = ur.solve(stack, method="walk", samples=1 << 15, backend="llvm").reflectance(
        wi, with_error=True
    )
    bsdf = {"type": "layered", "filename": "preset:urushi-red"}
    found, spread = mean(picture(mi, bsdf, theta=theta, type="aov", aovs="albedo:albedo", spp=128))
    assert np.all(np.abs(found[-3:] - truth[0]) < SIGMAS * np.hypot(spread[-3:], error[0]))
    assert np.all(spread[-3:] < 0.02 * found[-3:])
