"""`urushi check` as a program: what it takes, what it prints, and its exit status."""

from __future__ import annotations

import json
from typing import Any

import pytest

from conftest import Command
from lanes import needs_llvm

pytestmark = needs_llvm

#: the density of its samples is not that of `pdf`, nor does it integrate to 1
WRONG = '{"type": "principledthin", "roughness": 0.5, "spec_trans": 0.5, "diff_trans": 0.4}'


@pytest.fixture
def run(command: Command, mi: Any) -> Command:
    return command


def test_a_right_bsdf_and_a_wrong_one(run: Any) -> None:
    status, out, err = run("check", '{"type": "diffuse", "reflectance": [0.9, 0.5, 0.1]}')
    assert status == 0 and "7 checks passed" in out and err == ""
    status, out, err = run("check", WRONG)
    assert status == 1 and "checks failed: " in err and "normalisation" in err
    # What it prints to look closer runs as it stands.
    lines = [
        line[4:]
        for line in out.partition("look closer, in Python:\n")[2].splitlines()
        if line.startswith("    ")
    ]
    assert len(lines) >= 5
    exec("\n".join(lines), {})


def test_as_json(run: Any) -> None:
    status, out, _ = run("check", WRONG, "--json")
    said = json.loads(out)
    assert status == 1 and said["passed"] is False and said["material"] == WRONG
    outcomes = {check["name"]: check["outcome"] for check in said["checks"]}
    assert outcomes["normalisation"] == "failed" and outcomes["energy"] == "passed" and len(outcomes) == 7
    assert all(check["found"] is None or isinstance(check["found"], float) for check in said["checks"])


def test_a_textured_material_with_values(run: Any) -> None:
    """And the method that `auto` takes, with its reason."""
    arguments = (
        "check",
        "preset:varnished-wood",
        "--set",
        "layer_2.reflectance=0.4,0.2,0.1",
        "--method",
        "lobes",
    )
    status, _, err = run(*arguments)
    assert status == 1 and "layer_0.alpha is a texture" in err
    status, out, err = run(*arguments, "--set", "layer_0.alpha=0.12")
    assert "varnished wood" in out.lower() and status in (0, 1), err


def test_what_a_form_does_not_claim_is_no_failure(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from urushi import checks

    report = checks.Report.of("reciprocity", 9.0, 5.0, "off", "bsdf", claimed=False)
    monkeypatch.setattr(checks, "run_on", lambda answers, quick, progress: [report])
    status, out, _ = run("check", '{"type": "diffuse"}', "--json")
    assert status == 0 and json.loads(out)["checks"][0]["outcome"] == "not claimed"
    status, out, _ = run("check", '{"type": "diffuse"}')
    assert status == 0 and "0 checks passed, 1 not claimed" in out


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["{"], "is no JSON"),
        (['{"type": "difuse"}'], "Mitsuba refuses"),
        (["nope.xml"], "there is no file"),
        (["nope.yaml"], "there is no material file"),
        (['{"type": "diffuse"}', "--method", "walk"], "checked as it is"),
        (["preset:plastic", "--bsdf", "wall"], "is a material"),
        (["preset:plastic", "--method", "wlak"], "--method is 'wlak'"),
        (["preset:plastic", "--set", "layer_0.alpha"], "--set is 'layer_0.alpha'"),
    ],
)
def test_wrong_usage(run: Any, args: list[str], said: str) -> None:
    status, _, err = run("check", *args)
    assert status == 2 and said in err and "Traceback" not in err
