"""The site: its pages are all there, equations are numbered and cited as they are, and it builds without a warning."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import urushi

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PACKAGE = Path(urushi.__file__).parent
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)
LABEL = re.compile(r"^```\{math\}\n:label: (\S+)$", re.MULTILINE)
#: "theory (adding.3)", as docstrings cite equations
CITED = re.compile(r"theory\s+\(((?:[a-z]+\.\d+(?:,\s+|\s+to\s+)?)+)\)")
#: "Grant & Hunt 1969", "Guo et al. (2018)": the first author and the year
NAME = re.compile(
    r"\b((?:van de |de )?[A-Z][\w'-]+)"
    r"((?:, (?:de |d')?[A-Z][\w'-]+)*(?: (?:&|and) (?:de |d')?[A-Z][\w'-]+)?(?: et al\.)?)"
    r"(?:'s)?,? \(?((?:18|19|20)\d\d)\b(?!-)"
)
#: words that stand before a year and are no authors
NOT_AUTHORS = {"SIGGRAPH", "Asia", "EGSR", "I3D", "JCGT", "LEAN", "Smith", "Stanford"} | {
    *("After", "All", "At", "By", "From", "In", "Of", "Over", "Since", "The", "To", "With")
}


def theory() -> dict[str, list[str]]:
    """Chapter -> the labels of its equations, in order."""
    return {
        path.stem: LABEL.findall(path.read_text("utf-8")) for path in sorted((DOCS / "theory").glob("*.md"))
    }


def docstrings() -> dict[str, str]:
    """The source of every module, lines joined: docstrings and comments are cited from alike."""
    return {
        str(path.relative_to(PACKAGE)): re.sub(r"\s+(?:# )?", " ", path.read_text("utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    }


def test_every_page_is_in_the_contents():
    entries = [
        re.sub(r"^.* <(.*)>$", r"\1", line.strip())
        for block in TOCTREE.findall((DOCS / "index.md").read_text("utf-8"))
        for line in block.splitlines()
        if line.strip() and not line.startswith(":")
    ]
    notebooks = [path for path in DOCS.glob("*.ipynb")]
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in [*PAGES, *notebooks]} - {"index"}
    assert len(entries) == len(set(entries)) and set(entries) == pages


def test_equations_are_numbered_in_order():
    chapters = theory()
    assert set(chapters) == {"adding", "basis", "lobes", "walk"}
    for chapter, labels in chapters.items():
        assert labels == [f"{chapter}.{n + 1}" for n in range(len(labels))] and len(labels) > 10


def test_references_to_equations_lead_somewhere():
    known = {label for labels in theory().values() for label in labels}
    for path in PAGES:
        found = set(re.findall(r"\{eq\}`([^`]+)`", path.read_text("utf-8")))
        assert found <= known, f"{path.name}: {sorted(found - known)}"


def test_docstrings_cite_equations_that_exist():
    known = {label for labels in theory().values() for label in labels}
    cited: set[str] = set()
    for name, text in docstrings().items():
        found = {label for group in CITED.findall(text) for label in re.findall(r"[a-z]+\.\d+", group)}
        assert found <= known, f"{name}: {sorted(found - known)}"
        cited |= found
    for chapter in theory():
        assert len([label for label in cited if label.startswith(chapter)]) >= 3, chapter


def cited_works(text: str) -> set[tuple[str, str]]:
    """(first author, year) of everything that a text cites."""
    found = ((first.removesuffix("'s"), year) for first, _, year in NAME.findall(text))
    return {(first, year) for first, year in found if first not in NOT_AUTHORS}


def test_whoever_is_cited_is_in_the_bibliography():
    listed = cited_works(
        " ".join(re.findall(r"\*\*([^*]+)\*\*", (DOCS / "bibliography.md").read_text("utf-8")))
    )
    assert len(listed) > 40
    texts = docstrings()
    for path in [*PAGES, *sorted(PACKAGE.rglob("*.yaml"))]:
        if path.name not in ("bibliography.md", "changelog.md"):
            texts[path.name] = re.sub(r"\s+(?:# +)?", " ", path.read_text("utf-8"))
    missing = {(name, work) for name, text in texts.items() for work in cited_works(text) - listed}
    assert not missing
    assert cited_works("after Nobody et al. (1999), section 3") == {("Nobody", "1999")}


def test_included_parts_of_other_files_are_there():
    for path in PAGES:
        text = path.read_text("utf-8")
        for target, options in re.findall(
            r"^```\{include\} (\S+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL
        ):
            whole = (path.parent / target).read_text("utf-8")
            marks = dict(re.findall(r'^:(start-after|end-before): "(.*)"$', options, re.MULTILINE))
            start = whole.index(marks["start-after"]) if "start-after" in marks else 0
            assert "end-before" not in marks or whole.index(marks["end-before"]) > start


def validation_faults(found: dict[str, Any]) -> list[str]:
    """Where the stored comparisons do not bear out what the page says of them."""
    faults = [f"no {key}" for key in ("date", "processor", "urushi") if key not in found["machine"]]
    for name, source in found["sources"].items():
        walk, adding = (source["methods"][method]["values"] for method in ("walk", "adding"))
        faults += [
            f"{name}: walk {key}" for key, one in walk.items() if one["rms"] > 1.3 or one["worst"] > 4.5
        ]
        faults += [
            f"{name}: adding {key}"
            for key, one in adding.items()
            if one["largest"] > max(2.5e-3, 5 * one["known"])
        ]
    for name, one in found["presets"].items():
        if "walk" in one and one["worst"] > 4.5:
            faults.append(f"{name}: walk")
    return faults


def test_the_stored_validation_is_whole_and_says_what_the_page_says():
    found = json.loads((DOCS / "data" / "validation.json").read_text("utf-8"))
    kept = {path.stem for path in (ROOT / "tests" / "data").glob("*.json")}
    assert set(found["sources"]) <= kept and len(found["sources"]) == 6
    assert set(found["presets"]) == set(urushi.presets())
    assert validation_faults(found) == []
    found["sources"]["pbrt"]["methods"]["adding"]["values"]["f"]["largest"] = 0.01
    found["sources"]["guo"]["methods"]["walk"]["values"]["f"]["worst"] = 6.0
    assert validation_faults(found) == ["guo: walk f", "pbrt: adding f"]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("furo") is None, reason="needs the extra 'docs'")
def test_the_site_builds_without_a_warning_and_a_broken_reference_is_one(tmp_path):
    def build(source: Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
        return subprocess.run(
            [*command, str(source), str(tmp_path / "html")], capture_output=True, text=True, cwd=ROOT
        )

    done = build(DOCS)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "html" / "theory" / "adding.html").read_text("utf-8")
    assert "<math" in page and "(adding.5)" in page and "cdn" not in page.lower()
    for name in ("src", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    copy = shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns("_build"))
    start = copy / "start.md"
    start.write_text(
        start.read_text("utf-8") + "\nAnd [more](nowhere.md), $\\nonsense$, {eq}`walk.99`.\n", "utf-8"
    )
    done = build(copy)
    assert done.returncode != 0
    for complaint in ("nowhere.md", "nonsense", "walk.99"):
        assert complaint in done.stderr
