"""The command line: what it prints, its exit status, and that wrong usage is found before anything is rendered."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import urushi
from urushi.adapters import scene as builtin
from urushi.checks import Report
from urushi.cli import common, render

SRC = Path(urushi.__file__).parent.parent

MATERIAL = """\
urushi: 1
name: varnish
description: a test
layers:
  - dielectric: {ior: 1.5, alpha: 0.1}
  - diffuse: {reflectance: [0.5, 0.3, 0.1]}
"""

SCENE = """\
<scene version="3.0.0">
  <default name="spp" value="4"/>
  <integrator type="path"/>
  <include filename="materials.xml"/>
  <bsdf type="twosided" id="wall"><bsdf type="diffuse"/></bsdf>
  <shape type="sphere"><ref id="red"/></shape>
  <emitter type="constant"/>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,-6,0" target="0,0,0" up="0,0,1"/></transform>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film>
  </sensor>
</scene>
"""

INCLUDED = """\
<scene version="3.0.0">
  <bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.6 0 0"/></bsdf>
</scene>
"""


@pytest.fixture
def run(command, tmp_path):
    """The command line, where there are a material and a scene."""
    (tmp_path / "varnish.yaml").write_text(MATERIAL)
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "materials.xml").write_text(INCLUDED)
    return command


@pytest.fixture
def stand_in(monkeypatch):
    """A blue diffuse BSDF in the place of the plugin, so that these tests are about the command alone."""
    calls = []

    def bsdf(material, method, samples):
        import mitsuba as mi

        calls.append((material, method, samples))
        colour = mi.ScalarColor3d([0.0, 0.0, 0.6])
        return {"type": "diffuse", "reflectance": mi.load_dict({"type": "rgb", "value": colour})}

    monkeypatch.setattr(render, "_bsdf", bsdf)
    return calls


def python(code: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(SRC)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


# --------------------------------------------------------------------------------- the whole program


def test_help_names_every_command_and_imports_nothing_heavy():
    text = python(
        "import sys; sys.argv = ['urushi', '--help']\n"
        "from urushi import cli\n"
        "try: cli.main()\n"
        "except SystemExit as end: print('status', end.code)\n"
        "print([m for m in ('drjit', 'mitsuba', 'matplotlib', 'scipy') if m in sys.modules])"
    )
    for name in ("render", "check", "presets", "schema", "info", "status 0"):
        assert name in text
    assert text.endswith("[]")


def test_version_and_wrong_usage(run):
    assert run("--version")[:2] == (0, f"urushi {urushi.__version__}\n")
    assert run("polish")[0] == 2
    assert run("render")[0] == 2
    assert run("render", "varnish.yaml", "--light", "candle")[0] == 2


def test_an_error_is_one_clean_line_and_debug_shows_where(run, tmp_path):
    (tmp_path / "bad.yaml").write_text(MATERIAL.replace("1.5", "-1"))
    status, out, err = run("check", "bad.yaml")
    assert status == 1 and out == ""
    assert err.startswith("error: ") and "layers[0]" in err and "Traceback" not in err
    assert len(err.splitlines()) == 1
    with pytest.raises(urushi.MaterialError):
        run("--debug", "check", "bad.yaml")


def test_an_interrupt_exits_as_shells_have_it(run, monkeypatch):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(common, "load", interrupted)
    status, _, err = run("check", "varnish.yaml")
    assert status == 130 and "interrupted" in err


# ----------------------------------------------------------------------------------------- commands


def test_info_says_what_is_installed(run):
    status, out, _ = run("info")
    assert status == 0
    for word in ("urushi", "mitsuba", "drjit", "LLVM", "threads", "llvm_ad_rgb"):
        assert word in out


def test_presets_lists_all_and_prints_one(run):
    status, out, _ = run("presets")
    assert status == 0 and all(name in out for name in urushi.presets())
    for name in urushi.presets()[:1]:
        status, out, _ = run("presets", name)
        assert status == 0 and "layers:" in out
        assert run("presets", f"preset:{name}")[1] == out
    status, _, err = run("presets", "no-such")
    assert status == 2 and "no-such" in err and urushi.presets()[0] in err


def test_schema_goes_to_the_terminal_or_to_a_file(run, tmp_path):
    status, out, _ = run("schema")
    assert status == 0 and json.loads(out) == urushi.schema()
    assert run("schema", "-o", "sub/urushi.json")[0] == 0
    assert json.loads((tmp_path / "sub/urushi.json").read_text()) == urushi.schema()
    assert run("schema", "-o", "urushi.txt")[0] == 2


def test_check_describes_and_reports(run, monkeypatch):
    def checks(passed):
        report = Report("energy", passed, 0.99, 1.0, "at [0, 0, 1]", "bsdf.reflectance([[0, 0, 1]])")
        return lambda answers, quick, progress: [report]

    for passed, status in ((True, 0), (False, 1)):
        monkeypatch.setattr("urushi.checks.run_on", checks(passed))
        got, out, err = run("check", "varnish.yaml")
        assert got == status
        assert "varnish" in out and "energy" in out and "0.99" in out and "[0, 0, 1]" in out
        assert ("failed: energy" in err) is not passed
        assert ("    bsdf.reflectance([[0, 0, 1]])" in out) is not passed


# ------------------------------------------------------------------------------------------- render


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["nope.yaml"], "nope.yaml"),
        (["preset:nope"], "there are:"),
        (["varnish.yaml", "--spp", "0"], "--spp is 0"),
        (["varnish.yaml", "--method", "wlak"], "--method is 'wlak'"),
        (["varnish.yaml", "--seed", "-1"], "--seed is -1"),
        (["varnish.yaml", "--size", "12x0"], "--size is '12x0'"),
        (["varnish.yaml", "--size", "wide"], "--size is 'wide'"),
        (["varnish.yaml", "--samples", "0"], "--samples is 0"),
        (["varnish.yaml", "--samples", "4", "--method", "lobes"], "--method lobes"),
        (
            ["varnish.yaml", "--orders", "4"],
            "--orders is 4 with --method walk; allowed: with --method adding",
        ),
        (["varnish.yaml", "--media", "riccati", "-m", "lobes"], "--media is riccati with --method lobes"),
        (["varnish.yaml", "--media", "riccati", "-m", "adding"], "no layer of varnish is a medium"),
        (["varnish.yaml", "--media", "ricati", "-m", "adding"], "did you mean 'riccati'?"),
        (["varnish.yaml", "--nodes", "2", "-m", "adding"], "--nodes is 2; allowed: 4 to 1000"),
        (["varnish.yaml", "--accuracy", "1", "-m", "adding"], "--accuracy is 1.0"),
        (["varnish.yaml", "-o", "a.jpg"], ".png or .exr"),
        (["varnish.yaml", "-o", "scene.xml/a.png"], "cannot make the folder"),
        (["varnish.yaml", "-o", "folder.png"], "it is a folder"),
        (["varnish.yaml", "--variant", "scalar_rgb"], "llvm_ad_rgb"),
        (["varnish.yaml", "--material", "red"], "--scene"),
        (["varnish.yaml", "--scene", "nope.xml"], "there is no scene file"),
        (["varnish.yaml", "--scene", "scene.xml"], "red, wall"),
        (["varnish.yaml", "--scene", "scene.xml", "--material", "blue"], "red, wall"),
        (["varnish.yaml", "--scene", "scene.xml", "--material", "red", "--light", "sky"], "--light"),
    ],
)
def test_wrong_usage_is_found_before_rendering(run, stand_in, monkeypatch, tmp_path, args, said):
    from urushi.adapters import picture

    monkeypatch.setattr(picture, "render", lambda *a: pytest.fail("it rendered"))
    (tmp_path / "folder.png").mkdir()
    status, _, err = run("render", *args)
    assert status == 2
    assert said in err and len(err.splitlines()) == 1


def test_render_writes_a_picture_of_the_material(run, stand_in, tmp_path, mi):
    status, out, err = run(
        "render", "varnish.yaml", "--size", "24x16", "--spp", "4", "--light", "constant", "--samples", "2"
    )
    assert status == 0, err
    assert "out/varnish.png" in out.replace(os.sep, "/") and "24x16, 4 spp" in out
    assert stand_in == [("varnish.yaml", "walk", 2)]
    pixels = np.array(mi.Bitmap(str(tmp_path / "out/varnish.png"))).astype(int)
    assert pixels.shape == (16, 24, 3)
    middle = pixels[6:8, 11:13].mean(axis=(0, 1))
    assert middle[2] > 2 * middle[0]  # the stand-in is blue


def test_render_hands_on_what_adding_takes(run, monkeypatch):
    from urushi.adapters import picture

    given = {}
    monkeypatch.setattr(render.stage, "builtin", lambda bsdf, *_: given.update(bsdf))
    monkeypatch.setattr(picture, "render", lambda *_: np.ones((2, 2, 3), np.float32))
    fog = "urushi: 1\nlayers: [{medium: {depth: 0.5, albedo: 0.9}}]\n"
    Path("fog.yaml").write_text(fog)
    args = ["--accuracy", "0.02", "--nodes", "9", "--orders", "3", "--media", "doubling"]
    status, _, err = run("render", "fog.yaml", "-m", "adding", *args)
    assert status == 0, err
    assert {name: given[name] for name in ("accuracy", "nodes", "orders", "media")} == {
        "accuracy": 0.02,
        "nodes": 9,
        "orders": 3,
        "media": "doubling",
    }
    given.clear()
    assert run("render", "fog.yaml", "-m", "adding")[0] == 0
    assert set(given) == {"type", "filename", "method"}


def test_render_replaces_a_material_of_a_scene_file(run, stand_in, tmp_path, mi):
    """The named BSDF comes from an included file; its place is taken, and nothing else changes."""
    args = ["--scene", str(tmp_path / "scene.xml"), "--material", "red", "-o", "a.EXR"]
    status, out, err = run("render", "varnish.yaml", *args)
    assert status == 0, err
    assert "12x8, 4 spp" in out
    bitmap = mi.Bitmap("a.EXR")
    middle = np.array(bitmap)[3:5, 5:7, :3].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0.0, 0.0, 0.6], atol=0.02)
    assert bitmap.metadata()["urushi.material"] == "varnish.yaml"
    status, out, _ = run("render", "varnish.yaml", *args, "--size", "6", "--spp", "2")
    assert status == 0 and "6x6, 2 spp" in out


def test_a_scene_that_cannot_be_built_is_said_in_one_line(run, stand_in, tmp_path):
    (tmp_path / "broken.xml").write_text(SCENE.replace('shape type="sphere"', 'shape type="teapot"'))
    status, _, err = run("render", "varnish.yaml", "--scene", "broken.xml", "--material", "red")
    assert status == 1 and err.startswith("error: ") and "teapot" in err and "Traceback" not in err
    (tmp_path / "broken.xml").write_text("<scene")
    status, _, err = run("render", "varnish.yaml", "--scene", "broken.xml", "--material", "red")
    assert status == 1 and "broken.xml" in err and "Traceback" not in err


def test_the_choices_are_those_of_the_built_in_scene():
    hints = get_type_hints(render.command)
    for option, names in (("light", builtin.LIGHTS), ("shape", builtin.SHAPES)):
        literal = get_args(hints[option])[0]
        assert set(get_args(literal)) == set(names)


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal")
def test_ctrl_c_leaves_nothing_half_written(tmp_path):
    code = (
        "import sys; from urushi import cli; from urushi.cli import render\n"
        "def bsdf(*args): print('rendering', flush=True); return {'type': 'diffuse'}\n"
        "render._bsdf = bsdf\n"
        "sys.argv = 'urushi render varnish.yaml --spp 1000000 --size 64 -o a.png'.split()\n"
        "cli.main()"
    )
    (tmp_path / "varnish.yaml").write_text(MATERIAL)
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(SRC)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout.readline() == "rendering\n"
        time.sleep(2.0)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert os.listdir(tmp_path) == ["varnish.yaml"]
