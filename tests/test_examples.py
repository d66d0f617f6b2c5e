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
    "three_methods": (
        r"within (\S+) of .* by (\d+)% to (\d+)%; .* by (\S+) of",
        [(0, 0.005), (0, 3), (5, 60), (0, 3)],
    ),
    "enamel_photograph": (
        r"back (\d+)% of red .* (\d+)% of green\n.*back (\d+)%",
        [(61, 65), (10, 12), (9, 11)],
    ),
    "brushed_lacquer": (r"nickel (\S+) times .* and (\S+) times", [(1.45, 1.6), (1.35, 1.5)]),
    "varnished_wood": (
        r"highlight by (\d+)%, .* by (\d+)%\n.*highlight by (\d+)%, .* by (\d+)%",
        [(0, 3), (0, 10), (60, 150), (0, 10)],
    ),
    "normal_filtering": (
        r"is (\d+)% off by the walk, (\d+)% by lobes\n.*is (\d+)% off",
        [(4, 15), (5, 18), (35, 55)],
    ),
    "presets": (r"^(\d+) of the presets", [(8, 8)]),
    "which_method": (
        r"in (\S+) s and (\S+) s, the walk in (\S+) s and (\S+) s; .* by (\S+)% and (\S+)%",
        [(0, 60), (0, 60), (0, 600), (0, 600), (0, 0.2), (0.5, 8)],
    ),
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


LONG = (
    "brushed_lacquer",
    "enamel_photograph",
    "normal_filtering",
    "presets",
    "skin_apart",
    "three_methods",
    "varnished_wood",
    "wet_stone",
    "which_method",
)


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
