"""The benchmarks run, and their page says what was measured."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.fixture
def run(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import run

    yield run
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def test_a_quick_run_writes_its_page(run, mi, tmp_path):
    assert run.main(["--quick", "--only", "noise", "--only", "evaluation", "-o", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert set(results) == {"machine", "noise", "evaluation", "efficiency"}
    for label, case in results["noise"]["cases"].items():
        assert all(0.0 < noise < 10.0 for noise in case["noise"])
        assert results["efficiency"][label]["by_yardsticks"] > 1.0
    page = (tmp_path / "README.md").read_text("utf-8")
    assert "Noise of one evaluation" in page and "yardsticks" in page


def test_the_committed_page_belongs_to_the_committed_results(run):
    results = json.loads((FOLDER / "results.json").read_text("utf-8"))
    assert set(results) - {"machine", "note", "efficiency"} <= set(run.PARTS)
    assert run.page(results) == (FOLDER / "README.md").read_text("utf-8")


def test_the_first_value_of_lobes_is_timed_once_it_is_compiled(run, mi):
    import start

    begun = time.perf_counter()
    found = start._first_value(start._stacks()["coat on metal"], 3)
    assert 0.0 < 2 * found < time.perf_counter() - begun  # of three, the median, and the one that compiles
    named = {"first_value": {"a name": found}, "first_pass_cold": 1.0, "first_pass_warm": 1.0, "import": 0.1}
    assert start.table(named)[-1] == f"| lobes, to the first value: a name | {found:.1g} |"


def test_each_benchmark_is_a_small_file():
    for path in FOLDER.glob("*.py"):
        assert len(path.read_text("utf-8").splitlines()) < 150, path.name
