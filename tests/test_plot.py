"""Figures show what the solvers say: every curve, image, area and patch is compared with the numbers behind it."""

from __future__ import annotations

import re

import numpy as np
import pytest

import urushi as ur
from urushi import plot
from urushi.errors import UrushiError
from urushi.plot import colour, subjects
from urushi.plot.albedo import shares
from urushi.plot.hemisphere import image as disc_image
from urushi.plot.lobe3d import grid
from urushi.plot.polar import DECADES, curve, scale
from urushi.plot.slice import image as slice_image
from urushi.plot.slice import pair
from urushi.solvers import BSDF

COAT = ur.Stack(
    name="coat", layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=(0.8, 0.4, 0.1))]
)
SLAB = ur.Stack(name="slab", layers=[ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.0)])
INTO_GLASS = ur.Stack(name="into glass", layers=[ur.Dielectric(ior=1.5)])
MILK = ur.Stack(
    name="milk",
    layers=[ur.Dielectric(ior=1.4, alpha=0.3), ur.Medium(depth=0.4, albedo=0.8), ur.Dielectric(ior=1.0)],
)


@pytest.fixture(scope="module")
def coat():
    return ur.solve(COAT, "lobes")


@pytest.fixture(scope="module")
def slab():
    return ur.solve(SLAB, "lobes")


@pytest.fixture(scope="module")
def walked():
    return ur.solve(COAT, "walk", samples=16)


def luminance(values):
    return values @ np.array([0.2126, 0.7152, 0.0722])


def named(axes, gid):
    """The artists of that gid."""
    return axes.findobj(lambda artist: artist.get_gid() == gid)


def numbers(axes):
    """The radial ticks of a polar figure: (value, distance from the centre)."""
    found = []
    for text in axes.texts:
        said = text.get_text()
        if "°" not in said and said:
            value = 10.0 ** float(said[5:-2]) if said.startswith("$") else float(said)
            found.append((value, -text.get_position()[0]))
    return np.array(found)


# -------------------------------------------------------------------------------------------- polar


def test_the_linear_polar_curve_is_eval(coat):
    """The distance from the centre, read off the figure's own ticks, is f |cos theta_o|."""
    (axes,) = plot.polar(coat, theta=40, log=False).axes
    (line,) = named(axes, "curve-0")
    x, y = line.get_data()
    ticks = numbers(axes)
    unit = ticks[0, 0] / ticks[0, 1]
    np.testing.assert_allclose(ticks[:, 0], unit * ticks[:, 1], rtol=1e-5)
    middle = np.hypot(x, y) > 1e-6
    wo = np.stack([x, 0 * x, y], axis=1)[middle]
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    t = np.radians(40.0)
    wi = np.array([[-np.sin(t), 0, np.cos(t)]])  # from the left
    expected = luminance(coat.eval(wi, wo))
    np.testing.assert_allclose(unit * np.hypot(x, y)[middle], expected, rtol=1e-4)
    assert x[np.argmax(np.hypot(x, y))] > 0  # the highlight is on the right


def test_the_logarithmic_radius_shows_four_decades(coat):
    (axes,) = plot.polar(coat, theta=40, log=True).axes
    ticks = numbers(axes)
    steps = np.diff(ticks[:, 1]) / np.diff(np.log10(ticks[:, 0]))
    np.testing.assert_allclose(steps, 1 / DECADES, rtol=1e-6)
    (line,) = named(axes, "curve-0")
    radius = np.hypot(*line.get_data())
    value = ticks[0, 0] * 10 ** (DECADES * (radius - ticks[0, 1]))
    shown = curve(subjects.Subject(coat, ""), subjects.incident(40.0), 0.0)[1]
    np.testing.assert_allclose(value[radius > 1e-6], shown[radius > 1e-6], rtol=1e-5)
    assert scale(1.0, True)(np.array([1e-9, -1.0])).tolist() == [0, 0]


def test_a_band_is_two_standard_errors_to_each_side(walked):
    (axes,) = plot.polar(walked, theta=40, log=False).axes
    (band,) = named(axes, "band-0")
    (line,) = named(axes, "curve-0")
    radius = np.hypot(*line.get_data())
    count = len(radius)
    corners = np.hypot(*band.get_xy()[: 2 * count].T)
    outer, inner = corners[:count], corners[count:][::-1]
    degrees, value, error = curve(subjects.Subject(walked, ""), subjects.incident(40.0), 0.0)
    assert error.max() > 0.001
    unit = value.max() / radius.max()
    np.testing.assert_allclose((outer - radius) * unit, 2 * error, atol=1e-6)
    low = radius * unit > 2 * error
    np.testing.assert_allclose((radius - inner)[low] * unit, 2 * error[low], atol=1e-6)
    t = np.radians(degrees[100:110])
    wo = np.stack([-np.sin(t), -np.sin(t) * 0.0, np.cos(t)], axis=1)  # bit by bit: it seeds the walk
    expected = luminance(walked.eval(subjects.incident(40.0), wo, with_error=True)[1])
    np.testing.assert_allclose(error[100:110], expected, rtol=1e-6)


def test_several_materials_and_methods_are_overlaid(coat):
    figure = plot.polar([coat, SLAB], method=["lobes", "walk"], samples=4, log=True)
    (axes,) = figure.axes
    assert all(named(axes, f"curve-{i}") for i in range(3)) and not named(axes, "curve-3")
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    assert said[0] == "coat, lobes"
    assert said[1].startswith("slab, lobes") and said[2].startswith("slab, walk")


@pytest.mark.parametrize("theta", [0.0, 50.0])
def test_delta_arrows_carry_what_the_slab_does(slab, theta):
    parts = subjects.arrows(subjects.Subject(slab, ""), wi := subjects.incident(theta))
    assert len(parts) == 2
    up = next(part for part in parts if part.direction[2] > 0)
    down = next(part for part in parts if part.direction[2] < 0)
    np.testing.assert_allclose(up.energy, slab.reflectance(wi)[0], rtol=1e-4)
    np.testing.assert_allclose(down.energy, slab.transmittance(wi)[0], rtol=1e-4)
    np.testing.assert_allclose(up.direction, wi[0] * [-1, -1, 1], atol=1e-6)
    said = plot.polar(slab, theta=theta).legends[0].get_texts()[0].get_text()
    assert f"mirror {up.energy[0]:.3g}" in said and f"straight through {down.energy[0]:.3g}" in said


def test_a_delta_part_is_told_as_flux_not_as_radiance():
    """Into glass, radiance has the factor 1 / 1.5^2, which is no energy."""
    bsdf = ur.solve(INTO_GLASS, "lobes")
    one = subjects.Subject(bsdf, "")
    energies = [part.energy[0] for part in subjects.arrows(one, subjects.incident(30.0))]
    assert sum(energies) == pytest.approx(1.0, abs=1e-4)
    assert subjects.refracted(one, 30.0) == pytest.approx(np.degrees(np.arcsin(0.5 / 1.5)))


# ------------------------------------------------------------------------------- images and bodies


def test_a_pixel_of_the_hemisphere_is_eval(coat):
    wi = subjects.incident(30.0, 180.0)
    found, error = disc_image(subjects.Subject(coat, ""), wi, True, 11, "red")
    assert not np.nanmax(error)
    assert np.isnan(found[0, 0]) and np.isfinite(found[5]).all()
    x, y = 2 * 8.5 / 11 - 1, 1 - 2 * 3.5 / 11  # column 8, row 3
    t, p = np.hypot(x, y) * np.pi / 2, np.arctan2(y, x)
    wo = np.array([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]])
    assert found[3, 8] == pytest.approx(coat.eval(wi, wo)[0, 0], rel=1e-5)
    assert found[5, 7] > found[5, 3]  # light comes from the left


def test_the_hemisphere_marks_the_light_and_both_sides():
    figure = plot.hemisphere(MILK, theta=45, method="lobes", pixels=21)
    above, below = figure.axes[:2]
    (light,) = named(above, "incident")
    assert light.get_xdata()[0] == pytest.approx(-0.5) and light.get_ydata()[0] == pytest.approx(0, abs=1e-9)
    assert not named(below, "incident") and named(below, "mirror")
    shown = [axes.images[0].get_array() for axes in (above, below)]
    peak = max(float(np.nanmax(values)) for values in shown)
    assert figure.axes[2].get_ylim()[1] == pytest.approx(peak)
    assert all(float(np.nanmin(values)) >= peak * 0.99e-4 for values in shown)


def test_the_body_is_eval(coat):
    wi = subjects.incident(30.0, 180.0)
    wo, value, _ = grid(subjects.Subject(coat, ""), wi, True, "luminance", (4, 5))
    np.testing.assert_allclose(np.linalg.norm(wo, axis=-1), 1)
    np.testing.assert_allclose(value[2], luminance(coat.eval(wi, wo[2])), rtol=1e-6)
    assert (value[-1] == 0).all()


def test_half_and_difference_angles():
    th, td = (a.ravel() for a in np.meshgrid(np.radians([5.0, 40.0, 80.0]), np.radians([10.0, 60.0])))
    wi, wo = pair(th, td)
    half = wi + wo
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    np.testing.assert_allclose(np.arccos(half[:, 2]), th)
    np.testing.assert_allclose(np.arccos((wi * half).sum(1)), td)
    normal_side = np.stack([np.cos(th), 0 * th, -np.sin(th)], axis=1)  # phi_d = 90: no component along this
    np.testing.assert_allclose((wi * normal_side).sum(1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(wi, axis=1), 1)


@pytest.mark.parametrize("root", [False, True])
def test_the_slice_is_pi_f(coat, root):
    found, _ = slice_image(subjects.Subject(coat, ""), 8, root)
    row, column = 5, 6
    at = (column + 0.5) / 8
    th, td = 90 * (at**2 if root else at), 90 * (1 - (row + 0.5) / 8)
    wi, wo = pair(np.radians([th]), np.radians([td]))
    np.testing.assert_allclose(found[row, column], np.pi * coat.eval(wi, wo)[0] / wo[0, 2], rtol=1e-5)


# --------------------------------------------------------------------------------------- energy, colour


@pytest.mark.parametrize("method", ["lobes", "walk"])
def test_the_areas_are_the_ledger_and_add_up_to_one(method):
    figure = plot.albedo(MILK, method=method, samples=256, steps=4)
    (axes,) = figure.axes
    t = np.radians(np.linspace(0, 88, 4))
    wi = np.stack([np.sin(t), 0 * t, np.cos(t)], axis=1)
    options = {"samples": 256} if method == "walk" else {}
    bsdf = ur.solve(MILK, method, **options)
    entries = shares(subjects.Subject(bsdf, ""), wi)
    assert [entry.name.split()[0] for entry in entries][::3] == ["reflected", "transmitted"]
    np.testing.assert_allclose(entries[0].value, luminance(bsdf.absorption(wi).reflected), rtol=1e-6)
    total, base, error = 0.0, 0.0, 0.0
    for entry in entries[::-1]:
        (area,) = named(axes, entry.name)
        corners = area.get_paths()[0].vertices
        for i, angle in enumerate(np.linspace(0, 88, 4)):
            ys = corners[np.isclose(corners[:, 0], angle), 1]
            assert np.ptp(ys) == pytest.approx(entry.value[i], abs=1e-9)
            if i == 1:
                assert ys.min() == pytest.approx(base)
                base = ys.max()
        total, error = total + entry.value, error + entry.error
    assert np.all(np.abs(total - 1) < 4 * error + 1e-6)
    assert (error > 0).all() if method == "walk" else (error == 0).all()


def test_the_curves_are_reflectance_and_transmittance():
    bsdf = ur.solve(MILK, "lobes")
    (axes,) = plot.albedo([bsdf, COAT], method="lobes", steps=3).axes
    t = np.radians([0.0, 44.0, 88.0])
    wi = np.stack([np.sin(t), 0 * t, np.cos(t)], axis=1)
    (r,), (through,) = named(axes, "curve-0-r"), named(axes, "curve-0-t")
    np.testing.assert_allclose(r.get_ydata(), luminance(bsdf.reflectance(wi)), rtol=1e-6)
    np.testing.assert_allclose(through.get_ydata(), luminance(bsdf.transmittance(wi)), rtol=1e-6)
    assert named(axes, "curve-1-r") and not named(axes, "curve-1-t")


def test_a_bsdf_without_layers_is_drawn_as_a_curve(coat):
    class Plain(type(coat)):
        absorption = BSDF.absorption

    plain = Plain(COAT)
    (axes,) = plot.albedo(plain, steps=3).axes
    assert named(axes, "curve-0-r")
    with pytest.raises(UrushiError, match="knows nothing of what is inside"):
        plot.albedo(plain, steps=3, ledger=True)


def test_patches_have_the_colour_of_the_albedo():
    grey = ur.Stack(name="grey", layers=[ur.Diffuse(reflectance=0.5)])
    figure = plot.patches([grey, COAT], angles=(0, 60), method="lobes")
    (axes,) = figure.axes
    for half in (0, 1):  # a diffuse surface looks alike in every light
        (box,) = named(axes, f"0-1-{half}")
        np.testing.assert_allclose(box.get_facecolor()[:3], 0.7354, atol=2e-4)  # sRGB of 0.5
    assert "#bcbcbc" in [text.get_text() for text in axes.texts]
    (box,) = named(axes, "1-0-0")
    albedo = ur.solve(COAT, "lobes").reflectance([[0, 0, 1]])[0]
    np.testing.assert_allclose(box.get_facecolor()[:3], colour.encoded(albedo), atol=1e-5)


def test_pictures_say_how_noisy_they_are(walked, coat):
    """The median relative standard error, which is that of eval; nothing where there is no noise."""
    value, error = slice_image(subjects.Subject(walked, ""), 8, True)
    expected = f"noise ±{100 * np.median(error / value):.2g} %"
    assert expected in plot.slice(walked, pixels=8).axes[0].get_title(loc="left")
    at = (np.arange(8) + 0.5) * 90 / 8
    wi, wo = pair(*(np.radians(a.ravel()) for a in np.meshgrid(at**2 / 90, at)))
    mean, sigma = walked.eval(wi, wo, with_error=True)
    assert np.median(error / value) == pytest.approx(np.median(sigma / mean), rel=0.15)
    assert "noise ±" in plot.lobe3d(walked).axes[0].get_title()
    assert "noise ±" in plot.patches(walked).axes[0].get_yticklabels()[0].get_text()
    assert any("noise ±" in text.get_text() for text in plot.hemisphere(walked, pixels=21).axes[0].texts)
    assert "noise" not in plot.slice(coat, pixels=8).axes[0].get_title(loc="left")


def test_srgb():
    assert colour.code(np.array([0.0, 1.0, 2.0])) == "#00ffff"
    bright = colour.encoded(np.array([0.5, 1.0, 8.0]), tonemap=True)
    assert bright[0] == pytest.approx(0.7354, abs=1e-4) and bright[1] < 1 and bright[2] <= 1


# --------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda: plot.polar([]), "empty list"),
        (lambda: plot.polar(3), "found int"),
        (lambda: plot.polar([COAT, 3]), "found int"),
        (lambda: plot.polar(COAT, theta=90), "theta: found 90"),
        (lambda: plot.polar(COAT, phi=np.nan), "phi: found nan"),
        (lambda: plot.polar(COAT, method=[]), "method: found none"),
        (lambda: plot.polar(COAT, method="wlak"), "did you mean 'walk'"),
        (lambda: plot.polar(COAT, method="lobes", channel="uv"), "channel: found 'uv'"),
        (lambda: plot.polar(COAT, method="lobes", labels="coat"), "labels: found one text"),
        (lambda: plot.polar(COAT, method="lobes", labels=["a", "b"]), "labels: found 2"),
        (lambda: plot.polar([COAT] * 8, method="lobes"), "at most 7"),
        (lambda: plot.hemisphere(SLAB, method="lobes", pixels=21), "all light is in delta parts"),
        (lambda: plot.hemisphere(COAT, pixels=3), "pixels: found 3"),
        (lambda: plot.slice(COAT, exposure=0), "exposure: found 0"),
        (lambda: plot.slice(COAT, pixels=2), "pixels: found 2"),
        (lambda: plot.albedo(COAT, steps=1), "steps: found 1"),
        (lambda: plot.patches(COAT, angles=(95,)), "angles: found [95]"),
        (lambda: plot.patches(COAT, sun=88), "sun: found 88"),
        (lambda: plot.section([COAT] * 9), "at most 8"),
        (lambda: plot.sphere(COAT, spp=0), "spp of 1 or more"),
        (lambda: plot.sphere(COAT, method="wlak"), "method: found 'wlak'"),
        (lambda: plot.sphere(COAT, shape="cube"), "found 'cube'"),
        (lambda: plot.sphere(COAT, labels=["a", "b"]), "a list of 1"),
        (lambda: plot.save(plot.section(COAT), "a.jpg"), "must end in .png"),
        (lambda: plot.save(plot.section(COAT), "no/such/folder/a.png"), "cannot write"),
    ],
)
def test_a_wrong_input_is_told_in_words(draw, words):
    with pytest.raises(UrushiError, match=re.escape(words)):
        draw()
