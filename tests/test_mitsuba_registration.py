"""The plugin is there in every variant, however Urushi is imported, and scenes with it load as any others do."""

from __future__ import annotations

import importlib
import subprocess
import sys
import textwrap

import drjit as dr
import mitsuba
import numpy as np
import pytest

from conftest import LLVM
from mitsuba_plugin import layered, rows

VARIANTS = [v for v in mitsuba.variants() if v.startswith("scalar") or (LLVM and v.startswith("llvm"))]
PRESET = {"filename": "preset:enamel-on-gold"}


@pytest.fixture(autouse=True)
def _variant_as_before():
    before = mitsuba.variant()
    yield
    if before is not None:
        mitsuba.set_variant(before)


def first_channel() -> float:
    """One number of the plugin in the current variant: f |cos| of a preset, first channel."""
    mi = mitsuba
    bsdf = layered(mi, **PRESET)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0.0, 0.8)
    if "spectral" in mi.variant():
        si.wavelengths = type(si.wavelengths)(620.0)
    value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(-0.48, 0.36, 0.8))
    return float(np.ravel(np.array(value))[0])


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_knows_the_plugin(variant):
    """It loads, evaluates, samples and prints; and what it says is finite."""
    mi = mitsuba
    mi.set_variant(variant)
    bsdf = layered(mi, **PRESET)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0.0, 0.8)
    if "spectral" in variant:
        si.wavelengths = type(si.wavelengths)(620.0)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, 0.4, mi.Point2f(0.3, 0.6))
    pdf = bsdf.pdf(mi.BSDFContext(), si, sample.wo)
    assert float(np.ravel(np.array(pdf))[0]) == pytest.approx(
        float(np.ravel(np.array(sample.pdf))[0]), rel=1e-4
    )
    assert np.isfinite(np.array(weight)).all() and np.max(np.array(weight)) > 0
    assert 0 < first_channel() < 10
    assert "Layered[" in str(bsdf)


def test_variants_may_be_set_back_and_forth():
    """The same number comes back; all variants of one colour model agree, noise and all."""
    found: dict[str, list[float]] = {}
    for variant in [*VARIANTS, *reversed(VARIANTS)]:
        mitsuba.set_variant(variant)
        found.setdefault(variant, []).append(first_channel())
    for variant, (one, other) in found.items():
        assert one == other, variant
        for scalar in (f"scalar_{colour}" for colour in ("rgb", "spectral", "spectral_polarized")):
            twin = scalar.replace("scalar", "llvm_ad")
            if variant == scalar and twin in found:
                assert one == pytest.approx(found[twin][0], rel=2e-4)
        plain = variant.replace("_polarized", "")
        if plain in found:
            assert one == found[plain][0]


def test_the_module_may_be_reloaded(mi):
    """As Mitsuba 3.10 does it for an entry point, after each change of variant."""
    import urushi.mitsuba

    before = first_channel()
    for variant in ("scalar_rgb", "llvm_ad_mono", "llvm_ad_rgb"):
        mi.set_variant(variant)
        importlib.reload(urushi.mitsuba)
        importlib.reload(urushi.mitsuba)
        assert first_channel() > 0
    assert first_channel() == before


ENTRIES = """
from importlib.metadata import entry_points
names = [entry.value for entry in entry_points(group="mitsuba")]
assert "urushi.mitsuba" in names, names
"""

BEFORE = """
import mitsuba as mi
import urushi.mitsuba
assert mi.variant() is None, mi.variant()
mi.set_variant("scalar_rgb")
mi.load_dict({"type": "layered", "filename": "preset:enamel"})
"""

AFTER = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
import urushi.mitsuba
assert mi.variant() == "scalar_rgb"
mi.load_dict({"type": "layered", "filename": "preset:enamel"})
mi.set_variant("scalar_spectral")
mi.load_dict({"type": "layered", "filename": "preset:enamel"})
"""

PARALLEL = """
import sys, pathlib, tempfile
import urushi.mitsuba
import mitsuba as mi
mi.set_variant(sys.argv[1])
coat = {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0}
base = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
ours = [{"type": "layered", "filename": "preset:varnished-wood"}, {"type": "layered", "layer_0": coat, "layer_1": base}]
scene = {"type": "scene"} | {f"s{i}": {"type": "sphere", "bsdf": ours[i % 2]} for i in range(12)}
for _ in range(3):
    assert len(mi.load_dict(scene, parallel=True).shapes()) == 12
bsdf = '<bsdf type="layered"><string name="filename" value="preset:varnished-wood"/></bsdf>'
shape = f'<shape type="sphere">{bsdf}</shape>'
path = pathlib.Path(tempfile.mkdtemp()) / "scene.xml"
path.write_text(f'<scene version="3.0.0">{12 * shape}</scene>')
for _ in range(3):
    assert len(mi.load_file(str(path), parallel=True).shapes()) == 12
"""


def run(code: str, *arguments: str) -> None:
    """Run a program of its own: it may hang or leave a variant behind, and it starts without one."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("code", [BEFORE, AFTER, ENTRIES], ids=["before", "after", "entry point"])
def test_it_is_registered_whenever_the_import_comes(code):
    """Before a variant is set (and it sets none), after one, and by the entry point of Mitsuba 3.10."""
    run(code)


@pytest.mark.parametrize(
    "variant",
    ["scalar_rgb", pytest.param("llvm_ad_rgb", marks=pytest.mark.skipif(not LLVM, reason="no LLVM"))],
)
def test_scenes_load_in_parallel(variant):
    """Several threads instantiate the plugin at once, and its textures with it; no thread waits for ever."""
    run(PARALLEL, variant)


def test_a_relative_file_is_looked_for_beside_the_scene(mi, tmp_path, monkeypatch):
    """The folder of the XML file, not the working directory; the value is that of the stack in the file."""
    folder = tmp_path / "far" / "away"
    folder.mkdir(parents=True)
    (folder / "red.yaml").write_text("urushi: 1\nlayers:\n  - diffuse: {reflectance: [0.8, 0.2, 0.1]}\n")
    monkeypatch.chdir(tmp_path)
    layered(mi, **PRESET)
    bsdf = '<bsdf type="layered"><string name="filename" value="red.yaml"/></bsdf>'
    (folder / "scene.xml").write_text(f'<scene version="3.0.0"><shape type="sphere">{bsdf}</shape></scene>')
    for path in (folder / "scene.xml", "far/away/scene.xml"):
        found = mi.load_file(str(path)).shapes()[0].bsdf()
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(0, 0, 1)
        value = rows(found.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)))
        np.testing.assert_allclose(value[0] * np.pi, [0.8, 0.2, 0.1], rtol=1e-6)


def test_xml_says_what_a_dictionary_says(mi):
    """Nested children, a medium, numbers and strings: the same object in both forms, to the last bit of its values."""
    import urushi.mitsuba  # noqa: F401

    xml = mi.load_string("""
        <bsdf version="3.0.0" type="layered" id="paint">
            <integer name="samples" value="3"/> <integer name="seed" value="5"/> <string name="method" value="auto"/>
            <integer name="max_depth" value="9"/> <float name="thickness_1" value="0.5"/>
            <bsdf type="roughdielectric" name="layer_0"><float name="alpha" value="0.2"/></bsdf>
            <medium type="homogeneous" name="layer_1">
                <float name="sigma_t" value="2"/> <rgb name="albedo" value="0.1 0.5 0.9"/>
                <phase type="hg"><float name="g" value="0.3"/></phase>
            </medium>
            <bsdf type="diffuse" name="layer_2"><rgb name="reflectance" value="0.4 0.5 0.6"/></bsdf>
        </bsdf>""")
    medium = {
        "type": "homogeneous",
        "sigma_t": 2.0,
        "albedo": {"type": "rgb", "value": [0.1, 0.5, 0.9]},
        "phase": {"type": "hg", "g": 0.3},
    }
    plain = layered(
        mi,
        id="paint",
        **{"samples": 3, "seed": 5, "method": "auto", "max_depth": 9, "thickness_1": 0.5},
        layer_0={"type": "roughdielectric", "alpha": 0.2},
        layer_1=medium,
        layer_2={"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}},
    )
    assert str(xml) == str(plain)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    values = [rows(b.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0.6, 0.8))) for b in (xml, plain)]
    np.testing.assert_array_equal(*values)
    assert values[0].min() > 0
