"""`urushi compare` as a program: what it takes, what it writes, and its exit status."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from conftest import Command
from lanes import needs_llvm
from urushi.comparison import clock

pytestmark = needs_llvm

MATERIAL = """\
urushi: 1
name: varnish
layers:
  - dielectric: {ior: 1.5, alpha: 0.3}
  - diffuse: {reflectance: [0.5, 0.3, 0.1]}
"""


@pytest.fixture
def run(command: Command, monkeypatch: pytest.MonkeyPatch, mi: Any) -> Command:
    monkeypatch.setattr(clock, "SECONDS", 0.003)
    monkeypatch.setattr(clock, "ROUNDS", 2)
    Path("varnish.yaml").write_text(MATERIAL)
    return command


def test_a_table_a_page_and_numbers(run: Any) -> None:
    status, out, err = run(
        "compare", "varnish.yaml", "--methods", "lobes,walk", "--samples", "64", "--with", "diffuse",
        "--html", "sub/a.html", "--json", "a.json",
    )  # fmt: skip
    assert status == 0, err
    for word in ("varnish", "against adding", "misplaced", "lobes", "walk", "diffuse", "wrote"):
        assert word in out
    said = json.loads(Path("a.json").read_text())
    assert [row["name"] for row in said["reports"][0]["rows"]] == ["lobes", "walk", "diffuse"]
    page = Path("sub/a.html").read_text("utf-8")
    # The stack and the lobes are drawn, as pictures in the page itself.
    assert page.count('src="data:image/png;base64,') == 3 and "The stack" in page


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["nope.yaml"], "there is no material file 'nope.yaml'"),
        (["preset:nope"], "there are:"),
        (["varnish.yaml", "--methods", "magic"], "--methods is 'magic'"),
        (["varnish.yaml", "--methods", ","], "--methods is ','"),
        (["varnish.yaml", "--with", "magic"], "--with is 'magic'"),
        (["varnish.yaml", "--with", '{"type":'], "is no JSON"),
        (["varnish.yaml", "--with", "nope.bsdf"], "there is no file"),
        (["varnish.yaml", "--accuracy", "1"], "--accuracy is 1"),
        (["varnish.yaml", "--samples", "1"], "--samples is 1"),
        (["varnish.yaml", "--budget", "0"], "--budget is 0"),
        (["varnish.yaml", "--set", "layer_0.alpha=x"], "--set is 'layer_0.alpha=x'"),
        (["varnish.yaml", "--json", "a.txt"], "the name must end in .json"),
        (["varnish.yaml", "--html", "a.json"], "the name must end in .html"),
    ],
)
def test_wrong_usage_is_found_before_anything_long(
    run: Any, monkeypatch: pytest.MonkeyPatch, args: list[str], said: str
) -> None:
    monkeypatch.setattr("urushi.comparison.compare", lambda *a, **o: pytest.fail("it compared"))
    status, _, err = run("compare", *args)
    assert status == 2 and said in err and "Traceback" not in err


def test_textures_need_values(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urushi.comparison.compare", lambda *a, **o: pytest.fail("it compared"))
    status, _, err = run("compare", "varnish.yaml", "preset:varnished-wood")
    assert status == 1 and "--set layer_0.alpha=" in err
