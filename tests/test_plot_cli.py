"""`urushi plot`: what it writes, and that wrong usage is found before anything is solved."""

from __future__ import annotations

from functools import partial

import pytest

MATERIAL = """\
urushi: 1
name: varnish
layers:
  - dielectric: {ior: 1.5, alpha: 0.1}
  - diffuse: {reflectance: [0.5, 0.3, 0.1]}
"""


@pytest.fixture
def run(command, tmp_path):
    """`urushi plot`, where there is a material."""
    (tmp_path / "varnish.yaml").write_text(MATERIAL)
    return partial(command, "plot")


def test_a_figure_of_two_materials_goes_where_it_is_asked(run, tmp_path):
    assert run(
        "varnish.yaml", "preset:wet-stone", "-m", "lobes", "--log", "--theta", "30", "-o", "new/a.svg"
    ) == (
        0,
        "wrote new/a.svg\n",
        "",
    )
    assert (tmp_path / "new" / "a.svg").read_bytes().startswith(b"<?xml")


def test_the_name_says_what_is_in_it(run, tmp_path):
    assert run("varnish.yaml", "--kind", "section") == (0, "wrote out/varnish-section.png\n", "")
    first = (tmp_path / "out" / "varnish-section.png").read_bytes()
    assert run("varnish.yaml", "-k", "section", "--dpi", "60")[0] == 0
    second = (tmp_path / "out" / "varnish-section.png").read_bytes()
    assert first.startswith(b"\x89PNG") and len(second) < len(first)


def test_options_arrive(run, monkeypatch):
    from urushi import plot

    calls = []

    def polar(materials, **options):
        calls.append((len(materials), options))
        return plot.section(materials[0])

    monkeypatch.setattr(plot, "polar", polar)
    monkeypatch.setattr(plot, "albedo", polar)
    words = "--theta 20 --phi 5 --linear --channel red --samples 8 -m walk -m lobes --label a --label b"
    assert run("varnish.yaml", *words.split())[0] == 0
    expected = {"theta": 20, "phi": 5, "log": False, "channel": "red", "samples": 8}
    assert calls == [(1, {**expected, "method": ["walk", "lobes"], "labels": ["a", "b"]})]
    assert run("varnish.yaml", "varnish.yaml", "-k", "albedo", "--ledger")[0] == 0
    assert calls[1] == (2, {"ledger": True})


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ["varnish.yaml", "--kind", "pollar"],
            "--kind is 'pollar'; did you mean 'polar'? allowed: polar, hemisphere, lobe3d, slice,",
        ),
        (["varnish.yaml", "--kind", "pollar"], "did you mean 'polar'?"),
        (["varnish.yaml", "-m", "wlak"], "--method is 'wlak'"),
        (["varnish.yaml", "--theta", "95"], "--theta is 95; allowed: 0 to 89.5"),
        (
            ["varnish.yaml", "-k", "albedo", "--theta", "5"],
            "--theta means nothing with --kind albedo; it is for polar",
        ),
        (["varnish.yaml", "-k", "slice", "--log"], "--log/--linear means nothing"),
        (["varnish.yaml", "--ledger"], "--ledger/--curves means nothing with --kind polar; it is for albedo"),
        (["varnish.yaml", "-k", "section", "-m", "lobes"], "--method means nothing"),
        (["varnish.yaml", "--samples", "1"], "--samples is 1"),
        (["varnish.yaml", "--samples", "8", "-m", "lobes"], "with the walk among the methods"),
        (["varnish.yaml", "-k", "sphere", "--spp", "0"], "--spp is 0"),
        (["varnish.yaml", "--channel", "uv"], "--channel is 'uv'"),
        (["varnish.yaml", "--dpi", "5"], "--dpi is 5"),
        (["varnish.yaml", "-o", "a.jpg"], "must end in .png or .svg or .pdf"),
        (["preset:nope"], "there is no preset 'nope'"),
        (["nothing.yaml"], "there is no material file 'nothing.yaml'"),
        (["nothing.bsdf"], "there is no file 'nothing.bsdf'"),
    ],
)
def test_wrong_usage_is_told_and_exits_with_2(run, tmp_path, args, words):
    status, out, error = run(*args)
    assert (status, out) == (2, "") and words in error
    assert not list(tmp_path.glob("**/*.png"))


def test_what_cannot_be_drawn_exits_with_1(run):
    status, _, error = run("preset:varnished-wood")
    assert status == 1 and "is a texture" in error
    status, _, error = run("varnish.yaml", "-m", "lobes", "--label", "a", "--label", "b")
    assert status == 1 and "labels: found 2" in error
