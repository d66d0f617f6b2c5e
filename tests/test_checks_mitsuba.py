"""The checks on BSDFs of Mitsuba's: right ones pass, a broken one written in Python is found out, fault by fault."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from fourier_files import COATED
from lanes import needs_llvm
from urushi import checks
from urushi.adapters.answer import answer, is_answer
from urushi.adapters.mitsuba.contender import MitsubaBSDF
from urushi.errors import UrushiError

pytestmark = needs_llvm

RIGHT = {
    "diffuse": {"type": "diffuse", "reflectance": [0.9, 0.5, 0.1]},
    "twosided": {"type": "twosided", "bsdf": {"type": "diffuse"}},
    "dielectric": {"type": "dielectric"},
    "roughdielectric": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3},
    "roughconductor": {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.2},
    "plastic": {"type": "plastic"},
    "principled": {"type": "principled", "roughness": 0.4},
    "mask": {"type": "mask", "opacity": 0.4, "bsdf": {"type": "diffuse"}},
    "layered": {"type": "layered", "filename": "preset:plastic", "method": "lobes"},
}
#: laws that a right BSDF of Mitsuba's does not keep
EXCEPT = {"layered": {"reciprocity"}}


#: those that show all there is: a metal, glass
FEW = ("roughdielectric", "roughconductor")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in FEW else [pytest.mark.slow]) for name in RIGHT]
)
def test_right_ones_pass(name: str, mi: Any) -> None:
    reports = checks.run(answer(RIGHT[name]))
    failed = {report.name: report.text for report in reports if not report.passed}
    assert set(failed) <= EXCEPT.get(name, set()), failed


def broken(mi: Any, fault: str, reflectance: float = 0.995) -> MitsubaBSDF:
    """A white diffuse BSDF with one thing wrong, as somebody might write it."""
    import drjit as dr

    class Broken(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]

        def value(self, si: Any, wo: Any) -> Any:
            value = mi.Color3f(reflectance / dr.pi) * wo.z
            if fault == "lost cosine":
                value /= dr.maximum(wo.z, 1e-4)
            if fault == "gain":
                value *= 1.01
            if fault == "not reciprocal":
                value *= 1 - 0.05 * si.wi.z
            if fault == "nan at grazing":
                value = dr.select(si.wi.z < 1e-3, dr.nan, value)
            if fault == "negative":
                value = dr.select(wo.x > 0.99, -0.01, value)
            return value

        def density(self, wo: Any) -> Any:
            return dr.maximum(wo.z, 0) / dr.pi

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            louder = 1.02 if fault == "eval is not what sample carries" else 1.0
            return dr.select((si.wi.z > 0) & (wo.z > 0), louder * self.value(si, wo), 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            density = self.density(wo) * (1.01 if fault == "wrong pdf" else 1.0)
            return dr.select((si.wi.z > 0) & (wo.z > 0), density, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            bs = dr.zeros(mi.BSDFSample3f)
            if fault == "leaning":
                sample2 = mi.Point2f(sample2.x**1.1, sample2.y)
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf, bs.eta = self.pdf(ctx, si, bs.wo), 1.0
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))
            bs.sampled_component = 0
            weight = self.value(si, bs.wo) / dr.maximum(self.density(bs.wo), 1e-20)
            return bs, dr.select((si.wi.z > 0) & (bs.pdf > 0), weight, 0)

        def to_string(self) -> str:
            return "Broken[]"

    return MitsubaBSDF(Broken(mi.Properties()), name=fault or "right")


FAULTS = {
    "lost cosine": "reciprocity",
    "gain": "energy",
    "wrong pdf": "normalisation",
    "not reciprocal": "reciprocity",
    "nan at grazing": "finite",
    "negative": "not negative",
    "eval is not what sample carries": "agreement",
    "leaning": "chi2",
}


def test_the_python_bsdf_is_right_without_a_fault(mi: Any) -> None:
    reports = checks.run(broken(mi, ""))
    assert [report.text for report in reports if not report.passed] == []


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found(fault: str, mi: Any) -> None:
    wrong = broken(mi, fault)
    report = checks.CHECKS[FAULTS[fault]](checks.answers_of(wrong), True)
    assert not report.passed, report
    eval(report.closer, {"bsdf": wrong, "checks": checks, "np": np})


def test_every_check_has_a_fault() -> None:
    assert set(FAULTS.values()) == set(checks.CHECKS)


# ------------------------------------------------------------------------------------- what it says


def test_values_are_those_of_mitsuba(mi: Any) -> None:
    """Radiance through glass: f / n^2 is the same both ways, and flux is the mean of what is sampled."""
    glass = answer(
        {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3, "int_ior": 1.5, "ext_ior": 1.0}
    )
    wi, wo = np.array([[0.6, 0.0, 0.8]]), np.array([[-0.2, 0.1, -np.sqrt(0.95)]])
    assert glass.diagnostics["index_below"] == pytest.approx(1.5)
    there, back = glass.eval(wi, wo), glass.eval(wo, wi)
    assert there / abs(wo[0, 2]) == pytest.approx(back / abs(wi[0, 2]) / 1.5**2, rel=1e-4)
    total = glass.reflectance(wi, with_error=True), glass.transmittance(wi, with_error=True)
    assert total[0][0] + total[1][0] == pytest.approx(0.98, abs=0.03)
    assert 0 < total[0][1].max() < 3e-3 and glass.reflectance(wi[0]).shape == (3,)
    walk = ur.solve(
        ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3, masking="separable")]), "walk", samples=4096
    )
    value, error = walk.reflectance(wi, with_error=True)
    assert np.all(np.abs(value - total[0][0]) < 4 * np.hypot(error, total[0][1]))
    # One row serves all of the other; Dr.Jit in, Dr.Jit out.
    assert glass.eval(wi, np.repeat(wo, 4, axis=0)).shape == (4, 3)
    assert np.allclose(np.array(glass.eval(mi.Vector3f(wi[0]), mi.Vector3f(wo[0]))).T, there, rtol=1e-5)


def test_what_passes_and_from_where_light_is_seen(mi: Any) -> None:
    sides = {
        name: answer(RIGHT[name]).stack.layers[0] for name in ("diffuse", "twosided", "mask", "principled")
    }
    assert sides["diffuse"].opaque and sides["principled"].opaque
    assert not sides["twosided"].opaque and not sides["mask"].opaque
    mask = answer(RIGHT["mask"])
    up, error = mask.transmittance([[0.0, 0.0, -1.0]], with_error=True)
    assert np.all(np.abs(up - 0.6) < 5 * error + 1e-6)
    assert (
        mask.sample([[0.0, 0.0, 1.0]], [[0.99, 0.5, 0.5]]).delta
        != mask.sample([[0, 0, 1]], [[0.1, 0.5, 0.5]]).delta
    )


def test_more_draws_are_nearer(mi: Any) -> None:
    glass = answer(RIGHT["roughdielectric"])
    few, many = (
        glass.with_samples(n).reflectance([[0.6, 0, 0.8]], with_error=True)[1].max() for n in (256, 65536)
    )
    assert many < few / 8 and glass.samples == 1 << 14


# ------------------------------------------------------------------------------------- where it comes from

SCENE = """<scene version="3.0.0">
<texture type="checkerboard" id="tiles"><rgb name="color0" value="0.2 0.2 0.2"/></texture>
<bsdf type="twosided" id="wall"><bsdf type="diffuse"><ref id="tiles" name="reflectance"/></bsdf></bsdf>
<shape type="sphere"><bsdf type="dielectric" id="glass"/></shape></scene>"""
ONE = '<bsdf version="3.0.0" type="diffuse"/>'


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mi: Any) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    Path("one.xml").write_text(ONE)
    Path("one.json").write_text(json.dumps(RIGHT["diffuse"]))
    Path("two.json").write_text(json.dumps({"a": RIGHT["diffuse"], "b": RIGHT["plastic"]}))
    Path("material.json").write_text('{"urushi": 1, "layers": [{"diffuse": {"reflectance": 0.5}}]}')
    return tmp_path


def test_bsdfs_from_files(files: Path) -> None:
    assert answer("scene.xml", "wall").diagnostics["plugin"].startswith("TwoSided")
    assert answer("scene.xml", "glass").stack.name == "glass"
    assert answer("one.xml").stack.name == "one"
    assert np.allclose(answer("one.json").reflectance([[0, 0, 1]]), [[0.9, 0.5, 0.1]], atol=1e-5)
    assert answer("two.json", "b").diagnostics["plugin"].startswith("SmoothPlastic")
    assert answer(str(COATED)).stack.name == COATED.name
    solved = ur.solve("preset:dry-stone", "adding")
    from urushi.adapters import native

    native.save(solved, "stone.urushi.npz")
    read = answer("stone.urushi.npz")
    assert read.reflectance([[0, 0, 1]]) == pytest.approx(solved.reflectance([[0, 0, 1]]), abs=1e-4)
    assert answer(read) is read


@pytest.mark.parametrize(
    ("word", "yes"),
    [
        ('{"type": "diffuse"}', True),
        ("scene.xml", True),
        ("one.json", True),
        ("material.json", False),
        ("a.urushi.npz", True),
        ("a.bsdf", True),
        ("preset:plastic", False),
        ("a.yaml", False),
    ],
)
def test_which_words_are_bsdfs(files: Path, word: str, yes: bool) -> None:
    assert is_answer(word) is yes


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: answer('{"type": "diffuse"'), "is no JSON"),
        (lambda: answer('{"type": "difuse"}'), "Mitsuba refuses"),
        (lambda: answer('{"type": "sphere"}'), "allowed: a BSDF"),
        (lambda: answer({"type": "diffuse"}, "wall"), "allowed with a file"),
        (lambda: answer("scene.xml"), "say one of: wall, glass"),
        (lambda: answer("scene.xml", "floor"), "no BSDF 'floor'; say one of: wall, glass"),
        (lambda: answer("two.json", "c"), "it has: a, b"),
        (lambda: answer("nope.xml"), "there is no file"),
        (lambda: answer("nope.obj"), "allowed: a file ending in"),
        (lambda: answer(str(COATED), "wall"), "without a name"),
        (lambda: answer(3), "found a int"),
        (lambda: answer({"type": "diffuse"}, samples=1), "at least 2"),
        (lambda: answer({"type": "diffuse"}, eta=-1.0), "a positive number"),
    ],
)
def test_what_cannot_be_an_answer(files: Path, make: Callable[[], Any], said: str) -> None:
    with pytest.raises(UrushiError, match=said.replace("[", r"\[")):
        make()


def test_another_variant_is_refused(mi: Any) -> None:
    bsdf = mi.load_dict({"type": "diffuse"})
    mi.set_variant("scalar_rgb")
    try:
        with pytest.raises(UrushiError, match="variant: found scalar_rgb"):
            MitsubaBSDF(bsdf)
    finally:
        mi.set_variant("llvm_ad_rgb")
