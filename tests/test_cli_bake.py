"""`urushi bake`: what it writes, its exit status, and that an interrupted bake goes on where it stopped."""

from __future__ import annotations

import fnmatch
from functools import partial

import numpy as np
import pytest

import urushi as ur
from outside import degrees
from urushi import cli
from urushi.adapters import fourier, native
from urushi.solvers.adding import whole

MATERIAL = """\
urushi: 1
name: varnish
layers:
  - dielectric: {ior: 1.5, alpha: 0.4}
  - diffuse: {reflectance: [0.5, 0.3, 0.1]}
"""


@pytest.fixture
def run(command, tmp_path):
    (tmp_path / "varnish.yaml").write_text(MATERIAL)
    (tmp_path / "smooth.yaml").write_text(MATERIAL.replace(", alpha: 0.4", ""))
    (tmp_path / "brushed.yaml").write_text(MATERIAL.replace("0.4", "[0.1, 0.4]"))
    return partial(command, "bake")


def names(folder):
    return sorted(p.name for p in folder.iterdir() if p.suffix != ".yaml")


def test_a_native_file_is_written_and_replaced(run, tmp_path):
    (tmp_path / "v.urushi.npz").write_bytes(b"old")
    status, out, err = run("varnish.yaml", "-o", "v.urushi.npz", "--accuracy", "0.02")
    assert (status, err) == (0, "") and "wrote v.urushi.npz" in out
    bsdf = native.load(tmp_path / "v.urushi.npz")
    assert bsdf.stack == ur.load(tmp_path / "varnish.yaml")
    assert bsdf.diagnostics["estimated_error"] <= 0.02
    assert names(tmp_path) == ["v.urushi.npz"]


def test_a_fourier_file_is_written(run, tmp_path):
    status, _, err = run("varnish.yaml", "-o", "v.bsdf", "--nodes", "12", "--accuracy", "0.02")
    assert (status, err) == (0, "")
    table = fourier.read_fourier(tmp_path / "v.bsdf")
    bsdf = ur.solve(ur.load(tmp_path / "varnish.yaml"), "adding", nodes=12, accuracy=0.02)
    wi, wo = degrees(30), degrees(30, 180)
    assert np.allclose(fourier.evaluate(table, wi, wo), bsdf.eval(wi, wo), rtol=0.05)
    assert names(tmp_path) == ["v.bsdf"]


def test_orders_are_fixed(run, tmp_path):
    (tmp_path / "gold.yaml").write_text(
        MATERIAL.replace("diffuse: {reflectance: [0.5, 0.3, 0.1]}", "conductor: {material: Au}")
    )
    status, out, err = run("gold.yaml", "-o", "v.urushi.npz", "--nodes", "8", "--orders", "3")
    assert (status, err) == (0, "") and " 3 orders" in out
    assert native.load(tmp_path / "v.urushi.npz").diagnostics["orders"] == 3


def test_media_are_solved_as_asked(run, tmp_path, monkeypatch):
    asked = []
    own = whole.build.layers
    monkeypatch.setattr(
        whole.build, "layers", lambda *args, **given: asked.append(given["method"]) or own(*args, **given)
    )
    (tmp_path / "fog.yaml").write_text("urushi: 1\nlayers: [{medium: {depth: 0.5, albedo: 0.9}}]\n")
    args = ["fog.yaml", "-o", "v.urushi.npz", "--nodes", "6"]
    assert run(*args, "--media", "doubling")[0] == 0 and set(asked) == {"doubling"}
    asked.clear()
    assert run(*args)[0] == 0 and set(asked) == {"ordinates"}


def test_the_name_is_kept_as_it_was_written(run, tmp_path):
    for name in ("v.BSDF", "v.Urushi.NPZ"):
        status, out, _ = run("varnish.yaml", "-o", name, "--nodes", "8", "--accuracy", "0.05")
        assert status == 0 and f"wrote {name} " in out
    assert names(tmp_path) == ["v.BSDF", "v.Urushi.NPZ"]
    assert native.load(tmp_path / "v.Urushi.NPZ").stack == ur.load(tmp_path / "varnish.yaml")


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["-o", "v.exr"], ".urushi.npz"),
        (["-o", "v.npz"], ".urushi.npz"),
        (["-o", "v.bsdf", "--accuracy", "0"], "--accuracy"),
        (["-o", "v.bsdf", "--nodes", "1"], "--nodes"),
        (["-o", "v.bsdf", "--orders", "0"], "--orders"),
        (["-o", "v.urushi.npz", "--delta", "omit"], "--delta"),
        (["-o", "v.bsdf", "--media", "dubling"], "did you mean 'doubling'?"),
        (["-o", "v.bsdf", "--media", "doubling"], "no layer of varnish is a medium"),
    ],
)
def test_wrong_usage_is_found_before_anything_is_solved(run, tmp_path, monkeypatch, args, said):
    monkeypatch.setattr(whole, "solution", None)
    status, _, err = run("varnish.yaml", *args)
    assert status == 2 and said in err and names(tmp_path) == []


@pytest.mark.parametrize(
    ("material", "said"), [("smooth.yaml", "delta='omit'"), ("brushed.yaml", "anisotropic")]
)
def test_what_cannot_be_baked_is_said(run, tmp_path, material, said):
    status, _, err = run(material, "-o", "v.bsdf", "--nodes", "12")
    assert status == 1 and said in err and "v.bsdf" not in names(tmp_path)


def test_the_error_that_is_told_is_that_of_the_file(run, tmp_path):
    _, out, _ = run("varnish.yaml", "-o", "v.urushi.npz", "--accuracy", "0.02")
    told = native.load(tmp_path / "v.urushi.npz").diagnostics
    assert f"error {told['estimated_error'] + told['file_error']:.2g}," in out


def test_a_full_disk_is_said(run, tmp_path, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ur.io, "replace", full)
    status, _, err = run("varnish.yaml", "-o", "v.urushi.npz", "--nodes", "8")
    assert status == 1 and "No space left on device" in err and names(tmp_path) == []


def test_an_interrupted_bake_goes_on_where_it_stopped(run, tmp_path, monkeypatch):
    """Refinements that were finished are not solved again; those of another bake, and damaged ones, are no use."""
    solved = []
    solve_on = whole.solve_on

    def counted(*args):
        if len(solved) == stop:
            raise KeyboardInterrupt
        solved.append(len(args[1].s))
        return solve_on(*args)

    monkeypatch.setattr(whole, "solve_on", counted)
    stop = 1
    command = ["varnish.yaml", "-o", "v.urushi.npz", "--accuracy", "0.005"]
    status, _, err = run(*command)
    assert status == cli.INTERRUPTED and "goes on from there" in err
    (part,) = names(tmp_path)
    assert (
        part.endswith(".part")
        and f"1 file ({(tmp_path / part).stat().st_size / 1e3:.1f} kB, .v.urushi.npz." in err
    )
    assert fnmatch.fnmatch(f"./{part}", err.split("rm ")[1].split()[0])  # what it says removes it
    solved.clear()
    stop = None
    _, _, err = run("varnish.yaml", "-o", "v.urushi.npz", "--accuracy", "0.01")
    assert "there still are 1 file" in err and part.partition("-")[0] in err
    anew = list(solved)
    assert names(tmp_path) == [part, "v.urushi.npz"]  # another accuracy: nothing of it is used
    solved.clear()
    run(*command, "--orders", "2")
    assert solved and names(tmp_path) == [part, "v.urushi.npz"]  # nor with other orders
    solved.clear()
    content = (tmp_path / part).read_bytes()
    status, _, err = run(*command)
    assert status == 0 and names(tmp_path) == ["v.urushi.npz"]
    assert "going on from 1 file" in err and part.partition("-")[0] in err
    resumed = list(solved)
    assert anew[0] not in resumed and len(resumed) > 0
    solved.clear()
    (tmp_path / part).write_bytes(content[:100])
    assert run(*command)[0] == 0
    assert solved == [anew[0], *resumed] and names(tmp_path) == ["v.urushi.npz"]
    again = native.load(tmp_path / "v.urushi.npz")
    assert again.diagnostics["estimated_error"] <= 0.005
    # Of another material it is out of date as soon as the output is written; what only looks like it stays.
    (tmp_path / part).write_bytes(content)
    (tmp_path / ".v.urushi.npz.mine.part").write_bytes(b"")
    (tmp_path / "varnish.yaml").write_text(MATERIAL.replace("0.5", "0.6"))
    status, _, err = run(*command)
    assert (status, err) == (0, "") and names(tmp_path) == [".v.urushi.npz.mine.part", "v.urushi.npz"]
