"""The tutorial runs from its first cell to its last, and shows what it holds."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest

from lanes import needs_llvm

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def runner(tool):
    """tools/run_notebook.py."""
    return tool("run_notebook")


def kinds(cell: dict) -> list[list[str]]:
    return [sorted(output.get("data", ["text"])) for output in cell["outputs"]]


@pytest.mark.slow
@needs_llvm
def test_the_tutorial_runs(runner):
    stored = json.loads(runner.TUTORIAL.read_text("utf-8"))
    code = [cell for cell in stored["cells"] if cell["cell_type"] == "code"]
    assert 8 <= len(code) <= 15
    fresh = runner.run(copy.deepcopy(stored))
    ran = [cell for cell in fresh["cells"] if cell["cell_type"] == "code"]
    for old, new in zip(code, ran, strict=True):
        assert kinds(old) == kinds(new) != [], "run tools/run_notebook.py"
        assert "-Infinity" not in json.dumps(new) and "nan" not in str(new["outputs"][0].get("text", ""))


def test_what_a_cell_raises_is_noticed(runner):
    with pytest.raises(ZeroDivisionError):
        runner.shown("1 / 0", "cell 1", {})


def test_what_cells_show(runner):
    """What is printed, then what the last line is worth; the names of one cell are known in the next."""
    namespace: dict[str, object] = {}
    assert runner.shown("x = 2", "cell 1", namespace) == []
    printed, value = runner.shown("print('a')\nx + 1", "cell 2", namespace)
    assert printed["text"] == ["a\n"] and value["data"] == {"text/plain": ["3"]}
