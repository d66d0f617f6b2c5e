"""The plugin `fourier`: the values of the file in every variant, Mitsuba's chi², its flags, and what it refuses."""

from __future__ import annotations

import gc
from typing import Any

import drjit as dr
import mitsuba
import numpy as np
import pytest

from conftest import LLVM
from fourier_files import COATED, MU, SLAB, kernel, small
from lanes import direction, needs_llvm
from mitsuba_plugin import IMPORTANCE, Asked, context, everywhere, interaction, rows, vectors
from test_mitsuba_sampling import chi2
from urushi.adapters.fourier import (
    blended,
    evaluate,
    fourier_table,
    prepared,
    read_fourier,
    reflectance,
    write_fourier,
)

VARIANTS = [v for v in mitsuba.variants() if v.startswith("scalar") or (LLVM and v.startswith("llvm"))]
RGB = fourier_table(
    MU,
    r_top=kernel(energy=(0.7, 0.4, 0.1)),
    t_down=kernel(energy=(0.1, 0.2, 0.1)),
    r_bottom=kernel(energy=(0.3, 0.1, 0.5)),
    t_up=kernel(energy=(0.2, 0.2, 0.2)),
    eta=1.5,
)


def fourier(mi: Any, path: Any, **options: Any) -> Any:
    import urushi.mitsuba  # noqa: F401  (registers it)

    return mi.load_dict({"type": "fourier", "filename": str(path), **options})


@pytest.fixture
def rgb(tmp_path):
    write_fourier(RGB, tmp_path / "rgb.bsdf")
    return tmp_path / "rgb.bsdf"


@pytest.fixture(autouse=True)
def _variant_as_before():
    before = mitsuba.variant()
    yield
    if before is not None:
        mitsuba.set_variant(before)


def plain(mi: Any, value: Any) -> np.ndarray:
    """The spectrum of one lane, of its Mueller matrix the upper left element."""
    array = np.asarray(np.array(value), np.float64)
    return np.ravel(array[0, 0] if "polarized" in mi.variant() else array)


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_has_the_values_of_the_file(variant, rgb):
    """Grey ones exactly, colours as the variant has them; sample, pdf and the weight fit together."""
    mi = mitsuba
    mi.set_variant(variant)
    wi, wo = direction(0.8, 0.3), direction(-0.6, 2.0)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(*wi.tolist())
    if "spectral" in variant:
        si.wavelengths = type(si.wavelengths)(620.0)
    ctx, one = mi.BSDFContext(), mi.Vector3f(*wo.tolist())
    truth = evaluate(RGB, wi, wo)[0]
    bsdf = fourier(mi, rgb)
    found = plain(mi, bsdf.eval(ctx, si, one))
    if "rgb" in variant:
        np.testing.assert_allclose(found, truth, rtol=1e-5)
    elif "mono" in variant:
        np.testing.assert_allclose(found, truth @ (0.212671, 0.715160, 0.072169), rtol=1e-4)
    else:
        assert truth.min() <= found.min() <= found.max() <= truth.max()
    slab = fourier(mi, SLAB)
    grey = plain(mi, slab.eval(ctx, si, mi.Vector3f(*direction(0.5, 1.0).tolist())))
    np.testing.assert_allclose(
        grey, np.full(len(grey), evaluate(read_fourier(SLAB), wi, direction(0.5, 1.0))[0, 0]), rtol=1e-4
    )
    sample, weight = bsdf.sample(ctx, si, 0.4, mi.Point2f(0.3, 0.6))
    pdf = float(np.ravel(np.array(sample.pdf))[0])
    assert pdf > 0 and float(np.ravel(np.array(bsdf.pdf(ctx, si, sample.wo)))[0]) == pytest.approx(
        pdf, rel=1e-4
    )
    value = plain(mi, bsdf.eval(ctx, si, sample.wo))
    np.testing.assert_allclose(plain(mi, weight), value / pdf, rtol=1e-4)
    assert "Fourier[" in str(bsdf) and "eta = 1.5" in str(bsdf)


@needs_llvm
def test_values_densities_and_weights_of_many(mi, rng, rgb):
    """From both sides to both, in radiance and in importance: against numpy; and the weight is value over density."""
    bsdf, wi, wo = fourier(mi, rgb), everywhere(rng, 3000), everywhere(rng, 3000)
    for mode in ("Radiance", IMPORTANCE):
        asked = Asked.of(mi, bsdf, wi, mode)
        truth = evaluate(RGB, wi, wo, mode=mode.lower())
        np.testing.assert_allclose(asked.value(wo), truth, atol=3e-5)
        sample, weight = asked.sample(rng.random((3000, 3)))
        out, pdf = rows(sample.wo), rows(sample.pdf)
        # A grazing incidence rounds to another interval of nodes now and then.
        np.testing.assert_allclose(asked.density(out), pdf, rtol=2e-3)
        np.testing.assert_allclose(
            weight * pdf[:, None], evaluate(RGB, wi, out, mode=mode.lower()), atol=1e-4
        )
        crossed = wi[:, 2] * out[:, 2] < 0
        eta = np.where(crossed, np.where(wi[:, 2] > 0, 1.5, 1 / 1.5), 1)
        np.testing.assert_allclose(rows(sample.eta), eta, rtol=1e-6)
        flags = mi.BSDFFlags
        kinds = np.where(crossed, int(flags.GlossyTransmission), int(flags.GlossyReflection))
        np.testing.assert_array_equal(rows(sample.sampled_type), kinds)
        np.testing.assert_array_equal(rows(sample.sampled_component), crossed)


@needs_llvm
@pytest.mark.parametrize(
    ("path", "cos"), [(SLAB, 0.7), (SLAB, 1.0), (SLAB, -0.3), (COATED, 0.8), (COATED, 0.3)]
)
def test_mitsubas_chi2(mi, path, cos):
    """Samples fall where the density says, also in the file whose series ring."""
    assert chi2(mi, fourier(mi, path), direction(cos, 0.4))


@needs_llvm
def test_mitsubas_chi2_finds_a_fault(mi, tmp_path, monkeypatch):
    """Two per cent too much on one side, too little on the other."""
    monkeypatch.chdir(tmp_path)  # where Mitsuba leaves its account of a failure
    assert not chi2(
        mi,
        fourier(mi, COATED),
        direction(0.8, 0.4),
        fault=lambda density, wo: density * (1 + 0.02 * dr.sign(wo.x)),
    )


@needs_llvm
def test_the_albedo_is_the_reflectance(mi, rng, rgb):
    bsdf, wi = fourier(mi, rgb), everywhere(rng, 200)
    found = rows(bsdf.eval_diffuse_reflectance(interaction(mi, wi)))
    np.testing.assert_allclose(found, reflectance(RGB, wi)[0], atol=1e-5)


@needs_llvm
def test_parts_that_were_not_asked_for_are_dark(mi, rng, rgb):
    bsdf, wi, wo = fourier(mi, rgb), everywhere(rng, 300), everywhere(rng, 300)
    si, flags, reflected = interaction(mi, wi), mi.BSDFFlags, wi[:, 2] * wo[:, 2] > 0
    assert bsdf.component_count() == 2
    whole = rows(bsdf.eval(context(mi), si, vectors(mi, wo)))
    for wanted, options in (
        (reflected, {"type_mask": +flags.GlossyReflection}),
        (~reflected, {"type_mask": +flags.GlossyTransmission}),
        (reflected, {"component": 0}),
        (~reflected, {"component": 1}),
    ):
        ctx = context(mi, **options)
        np.testing.assert_allclose(
            rows(bsdf.eval(ctx, si, vectors(mi, wo))), whole * wanted[:, None], rtol=1e-6
        )
        pdf = rows(bsdf.pdf(ctx, si, vectors(mi, wo)))
        assert (pdf[wanted] > 0).all() and not pdf[~wanted].any()
        sample, weight = bsdf.sample(ctx, si, mi.Float(rng.random(300)), mi.Point2f(rng.random((2, 300))))
        there = (wi[:, 2] * rows(sample.wo)[:, 2] > 0) == (wanted == reflected).all()
        assert not rows(weight)[~there].any() and rows(weight)[there].max() > 0


@needs_llvm
def test_flags_say_what_is_in_the_file(mi, tmp_path):
    flags = mi.BSDFFlags
    both = +flags.FrontSide | flags.BackSide
    for blocks, expected in (
        ({"r_top": kernel()}, [flags.GlossyReflection | flags.FrontSide]),
        ({"r_bottom": kernel()}, [flags.GlossyReflection | flags.BackSide]),
        (
            {"r_top": kernel(), "t_up": kernel(), "t_down": kernel()},
            [
                flags.GlossyReflection | flags.FrontSide,
                flags.GlossyTransmission | both | flags.NonSymmetric,
            ],
        ),
    ):
        path = tmp_path / "flags.bsdf"
        write_fourier(fourier_table(MU, **blocks, eta=1.3), path)
        bsdf = fourier(mi, path)
        assert [int(bsdf.flags(i)) for i in range(bsdf.component_count())] == [int(e) for e in expected]


@needs_llvm
def test_colours_become_spectra_that_look_like_them(mi, rgb):
    """Grey is grey at every wavelength; others have their colour under Mitsuba's own sensor, to 2 %."""
    mi.set_variant("llvm_ad_spectral")
    wavelengths = np.linspace(360, 830, 471)
    nm = [wavelengths.astype(np.float32)] * 4
    observer = np.array(mi.cie1931_xyz(mi.Float(nm[0])))
    si = interaction(mi, np.repeat(direction(1.0)[None], 471, axis=0), wavelengths=nm)
    light = rows(mi.load_dict({"type": "d65"}).eval(si))[:, 0]
    plugin = fourier(mi, rgb)
    for colour in ([0.5, 0.5, 0.5], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.9, 0.6, 0.2], [0.1, 0.1, 0.6]):
        y = float(np.dot(colour, (0.212671, 0.715160, 0.072169)))
        value = rows(plugin._coloured([mi.Float(v) for v in (y, colour[0], colour[2])], si, True))[:, 0]
        assert value.min() >= -1e-6 and value.max() <= max(colour) + 1e-4
        xyz = (observer * value * light).sum(axis=1) / (observer[1] * light).sum()
        found = np.array(mi.xyz_to_srgb(mi.Color3f(*xyz.tolist()))).ravel()
        np.testing.assert_allclose(found, colour, atol=0.02 * max(colour))
        if len(set(colour)) == 1:
            np.testing.assert_allclose(value, 0.5, atol=1e-4)


@needs_llvm
def test_a_grid_of_parameters(mi, rng, tmp_path):
    table, path = small(3, (2, 3)), tmp_path / "grid.bsdf"
    write_fourier(table, path)
    wi, wo = everywhere(rng, 100), everywhere(rng, 100)
    bsdf = fourier(mi, path, parameter_0=0.25, parameter_1=0.9)
    np.testing.assert_allclose(
        Asked.of(mi, bsdf, wi).value(wo), evaluate(blended(table, (0.25, 0.9)), wi, wo), atol=1e-5
    )
    for options, message in (
        ({}, r"found no parameters; allowed: parameter_0 \(0 to 1\), parameter_1 \(0.1 to 1\)"),
        ({"parameter_0": 0.5}, "found parameter_0; allowed"),
        ({"parameter_0": 0.5, "parameter_1": 3.0}, r"parameters\[1\]: found 3.0; allowed: 0.1 to 1"),
    ):
        with pytest.raises(Exception, match=message):
            fourier(mi, path, **options)
    with pytest.raises(Exception, match="found parameter_0; allowed: none, as the file has none"):
        fourier(mi, SLAB, parameter_0=1.0)


@needs_llvm
def test_what_is_refused(mi, tmp_path):
    broken = tmp_path / "broken.bsdf"
    broken.write_bytes(SLAB.read_bytes()[:-4])
    for path, options, message in (
        (tmp_path / "none.bsdf", {}, r"none\.bsdf: cannot be read: No such file"),
        (broken, {}, r"broken\.bsdf: size: found 11180 bytes; allowed: 11184"),
        ("", {}, "filename: found ''"),
        (SLAB, {"etta": 1.0}, "did you mean 'eta'"),
        (SLAB, {"eta": -1.0}, r"eta: found -1\.0; allowed: a positive number"),
    ):
        with pytest.raises(Exception, match=message):
            fourier(mi, path, **options)


@needs_llvm
def test_an_index_in_place_of_layerlabs(mi):
    """Files of layerlab say 1 whatever they hold: the factor of radiance comes from the parameter."""
    wi, wo = direction(0.8), direction(-0.7, np.pi)
    plain_, bent = (
        Asked.of(mi, fourier(mi, SLAB, **o), wi[None]).value(wo[None]) for o in ({}, {"eta": 1.5})
    )
    np.testing.assert_allclose(bent, plain_ / 2.25, rtol=1e-5)


@needs_llvm
def test_the_same_file_is_prepared_once(mi, monkeypatch):
    """As long as one plugin has it; the memory goes with the last."""
    calls: list[int] = []
    inner = prepared.prepare
    monkeypatch.setattr(prepared, "prepare", lambda *a: calls.append(1) or inner(*a))
    gc.collect()
    first, second = fourier(mi, COATED), fourier(mi, COATED)
    assert len(calls) == 1 and first.tables is second.tables
    del first, second
    gc.collect()
    fourier(mi, COATED)
    assert len(calls) == 2


@needs_llvm
def test_a_white_table_in_a_white_room(mi, tmp_path):
    """Rendered by path tracing: a base that reflects nine tenths, lit from everywhere, is nine tenths as bright."""
    mu = np.sin(np.linspace(0.01, np.pi / 2, 60))
    path = tmp_path / "lambert.bsdf"
    lambert = np.broadcast_to(0.9 / np.pi * mu[:, None], (1, 1, 60, 60))
    write_fourier(fourier_table(mu, r_top=lambert), path)
    fourier(mi, path)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "light": {"type": "constant"},
            "shape": {"type": "rectangle", "bsdf": {"type": "fourier", "filename": str(path)}},
            "camera": {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            },
        }
    )
    pixels = np.array(mi.render(scene, spp=64))
    np.testing.assert_allclose(pixels.mean(), 0.9, rtol=2e-3)


@needs_llvm
def test_a_relative_file_is_looked_for_beside_the_scene(mi, tmp_path, rgb, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    fourier(mi, rgb)
    text = (
        '<shape type="sphere"><bsdf type="fourier"><string name="filename" value="rgb.bsdf"/></bsdf></shape>'
    )
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
    bsdf = mi.load_file(str(tmp_path / "scene.xml")).shapes()[0].bsdf()
    wi, wo = direction(0.8)[None], direction(0.5, 2.0)[None]
    np.testing.assert_allclose(Asked.of(mi, bsdf, wi).value(wo), evaluate(RGB, wi, wo), rtol=1e-4)


def test_what_is_prepared_is_one_bsdf():
    with pytest.raises(Exception, match="found 1 and 2 bases"):
        prepared.prepared(small(1, (2,)))
