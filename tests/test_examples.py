"""The scripts of the gallery run, are short, and say in their headline what they found."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest

from lanes import needs_llvm

pytest.importorskip("matplotlib")
pytestmark = needs_llvm

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "examples"
SHARED = "gallery"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != SHARED)
#: what is in the headline of each, and where each number has to lie
HEADLINES = {
    "pile_of_plates": (r"by (\S+), the walk by (\S+) of", [(0, 1e-12), (0, 5)]),
    "wet_stone": (r"leaves (\d+)% .* inside (\d+)%\n.* at most (\S+)", [(40, 60), (20, 40), (0, 0.01)]),
    "colour_shift": (r"within (\S+) of .* off by (\S+)\n.*and (\d+)%", [(0, 3e-3), (0.15, 0.25), (34, 34)]),
    "skin_apart": (
        r"absorbs (\d+)% of green and (\d+)%.*\n.*it (\d+)%.*without (\d+)%",
        [(30, 40), (10, 16), (37, 43), (55, 63)],
    ),
    "lost_energy": (r"loses (\d+)% .* and (\d+)%.*\n.*most (\S+)%", [(67, 71), (58, 68), (0, 8)]),
    "naive_lobes": (
        r"up to (\d+)% .* lobe (\S+) times.*\n.*up to (\S+) too",
        [(105, 120), (3, 6), (0.1, 0.3)],
    ),
}


@pytest.fixture
def shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scripts find what they share beside them, as when they are called."""
    monkeypatch.syspath_prepend(str(FOLDER))
    yield
    sys.modules.pop(SHARED, None)


LONG = ("skin_apart", "wet_stone")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in SCRIPTS]
)
def test_an_example_draws_what_it_says(name: str, shared: None, tmp_path, monkeypatch) -> None:
    out = tmp_path / f"{name}.png"
    monkeypatch.setattr(sys, "argv", [str(FOLDER / f"{name}.py"), "-o", str(out), "--quick"])
    headlines = []
    import gallery

    titled = gallery.titled
    monkeypatch.setattr(
        gallery, "titled", lambda figure, *text: headlines.append(text) or titled(figure, *text)
    )
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    assert out.read_bytes().startswith(b"\x89PNG") and out.stat().st_size > 20_000
    pattern, bounds = HEADLINES[name]
    found = re.search(pattern, "\n".join(headlines[0]))
    assert found, headlines
    for value, (low, high) in zip(found.groups(), bounds, strict=True):
        assert low <= float(value) <= high, headlines


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_is_short_and_in_the_gallery(name: str) -> None:
    assert len((FOLDER / f"{name}.py").read_text("utf-8").splitlines()) <= 60
    page = (ROOT / "docs" / "gallery.md").read_text("utf-8")
    assert f"`{name}.py`" in page and f"(images/gallery/{name}.png)" in page
    assert (ROOT / "docs" / "images" / "gallery" / f"{name}.png").stat().st_size > 50_000
