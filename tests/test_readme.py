"""What the documentation says is true: its examples run, its tables are current, its source tree is the real one."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import urushi as ur
from urushi.cli import app
from urushi.description.layers import LAYERS
from urushi.description.phases import PHASES

PACKAGE = Path(ur.__file__).parent
ROOT = PACKAGE.parent.parent
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
DOCS = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
PAGES = ["README.md", *(path.relative_to(ROOT).as_posix() for path in DOCS)]


def blocks(page: str) -> list[tuple[str, str]]:
    """(language, text) of every fenced block of a page."""
    return BLOCK.findall((ROOT / page).read_text("utf-8"))


@pytest.fixture
def registries():
    """What pages register is forgotten after them."""
    from urushi.interfaces import INTERFACES
    from urushi.optics.phase import PHASE_FUNCTIONS
    from urushi.solvers import SOLVERS

    kept = [(one, dict(one)) for one in (LAYERS, PHASES, INTERFACES, PHASE_FUNCTIONS, SOLVERS)]
    yield
    for one, before in kept:
        one.clear()
        one.update(before)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)])
def test_every_example_runs(page, mi, registries, tmp_path, monkeypatch):
    """In order, in one folder and one namespace: a YAML block becomes the file that the others read."""
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    seen = set()
    for language, text in blocks(page):
        seen.add(language)
        if language == "yaml":
            Path("enamel.yaml").write_text(text, "utf-8")
            ur.load("enamel.yaml")
        elif language == "python":
            exec(compile(text, page, "exec", dont_inherit=True), namespace)
        elif language == "xml":
            import urushi.mitsuba  # noqa: F401, as the pages say

            scene = f'<scene version="3.0.0">{text}</scene>'
            loaded = mi.load_string(scene, parallel=False)
            assert "Layered" in str(loaded) or "Fourier" in str(loaded)
        else:
            assert language == "text", f"{page}: nothing tests a block of {language}"
    assert seen - {"text"}
    if page == "README.md":
        assert seen == {"yaml", "python", "xml", "text"}
        assert ur.load("enamel.yaml") == namespace["stack"]
        value, error = namespace["value"], namespace["error"]
        assert isinstance(value, np.ndarray) and value.shape == error.shape == (1, 3)
        assert np.all(error < 0.05 * value)


def test_the_examples_are_as_short_as_they_look():
    yaml, python = (
        next(text for language, text in blocks("README.md") if language == which)
        for which in ("yaml", "python")
    )
    assert len(yaml.splitlines()) <= 10 and len(python.splitlines()) <= 10


def test_the_source_tree_is_the_real_one():
    tree = next(text for language, text in blocks("README.md") if language == "text")
    said = {line.split()[0] for line in tree.splitlines() if line.startswith("  ")}
    real = {path.name + "/" * path.is_dir() for path in PACKAGE.iterdir() if path.name != "__pycache__"}
    assert said == real


def test_every_command_is_in_the_overview():
    text = (ROOT / "README.md").read_text("utf-8")
    for command in app.registered_commands:
        assert f"`urushi {command.name}" in text


def test_the_tables_are_current(tool):
    """And one that is not is noticed."""
    done = subprocess.run(
        [sys.executable, "tools/make_docs.py", "--check"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(PACKAGE.parent)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    make_docs = tool("make_docs")
    page = "<!-- table: diffuse -->\n| old |\n<!-- end -->\n"
    assert "reflectance" in make_docs.current(page) and "old" not in make_docs.current(page)


def test_the_pictures_are_small():
    pictures = [path for path in (ROOT / "docs" / "images").rglob("*") if path.is_file()]
    sizes = {path.name: path.stat().st_size for path in pictures}
    assert pictures and max(sizes.values()) < 1_500_000 and sum(sizes.values()) < 8_000_000, sizes
