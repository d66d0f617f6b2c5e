"""Figures as people see them: nothing overlaps or is cut off, units are named, the same figure gives the same file."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import matplotlib.text
import numpy as np
import pytest

import urushi as ur
from urushi import plot
from urushi.cli.plot import KINDS, ONLY
from urushi.plot import style

SRC = Path(ur.__file__).parent.parent

COAT = ur.Stack(name="coat", layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=0.5)])
SLAB = ur.Stack(name="a slab of glass", layers=[ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.0)])
PLATES = ur.Stack(layers=[ur.Dielectric(ior=1.5 - 0.5 * (k % 2)) for k in range(40)])
DEEP = ur.Stack(
    exterior=1.2,
    layers=[
        ur.Medium(depth=(0.1, 20.0, 3.0), albedo=(0.9, 0.5, 0.1), phase=ur.HenyeyGreenstein(g=0.25)),
        ur.Dielectric(ior=1.4, alpha=(0.4, 0.1), distribution="beckmann", masking="separable", rotation=30),
        ur.Medium(thickness=0.1, sigma_t=(1.0, 2.0, 3.0), albedo=0.2),
        ur.Conductor(eta=(0.2, 0.9, 1.1), k=(3.9, 2.4, 2.2), alpha=0.9),
    ],
)
BLACK = ur.Stack(name="black", layers=[ur.Diffuse(reflectance=0)])


@pytest.fixture(scope="module")
def solved():
    return [ur.solve(stack, "lobes") for stack in (COAT, SLAB)]


@pytest.fixture(scope="module")
def figure(solved):
    """One of `FIGURES`, drawn once."""
    made = {}

    def figure(name):
        if name not in made:
            made[name] = FIGURES[name](solved)
        return made[name]

    return figure


@pytest.fixture
def drawn(monkeypatch):
    """The texts that a figure draws, as (what it says, its box in pixels)."""

    def drawn(figure):
        found = {}
        original = matplotlib.text.Text.draw

        def draw(self, renderer, *args, **options):
            if self.get_visible() and self.get_text().strip():
                found[id(self)] = self.get_text(), self.get_window_extent(renderer)
            return original(self, renderer, *args, **options)

        with style.look(), monkeypatch.context() as patch:
            patch.setattr(matplotlib.text.Text, "draw", draw)
            figure.canvas.draw()
        return list(found.values())

    return drawn


def faults(figure, texts):
    """Which texts overlap, or leave the figure; a pixel is forgiven."""
    width, height = figure.bbox.width, figure.bbox.height
    found = [
        f"{said!r} is cut off"
        for said, box in texts
        if box.x0 < -1 or box.y0 < -1 or box.x1 > width + 1 or box.y1 > height + 1
    ]
    for i, (said, box) in enumerate(texts):
        for other, second in texts[:i]:
            across = min(box.x1, second.x1) - max(box.x0, second.x0)
            along = min(box.y1, second.y1) - max(box.y0, second.y0)
            if across > 1 and along > 1:
                found.append(f"{said!r} over {other!r}")
    return found


FIGURES = {
    "polar": lambda both: plot.polar(both, theta=60),
    "polar, coat": lambda both: plot.polar(both[0], theta=0, log=False),
    "hemisphere": lambda both: plot.hemisphere(both, theta=45, pixels=21),
    "hemisphere, coat": lambda both: plot.hemisphere(both[0], theta=85, log=False, pixels=21),
    "lobe3d": lambda both: plot.lobe3d(both, theta=45),
    "lobe3d, slab": lambda both: plot.lobe3d(both[1], theta=45, log=False),
    "slice": lambda both: plot.slice(both, pixels=8),
    "slice, straight": lambda both: plot.slice(both[0], pixels=8, root=False),
    "albedo": lambda both: plot.albedo(both, steps=3, ledger=True),
    "albedo, coat": lambda both: plot.albedo(both[0], steps=3),
    "curves": lambda both: plot.albedo(both, steps=3),
    "patches": lambda both: plot.patches(both),
    "patches, sky": lambda both: plot.patches(both[0], angles=(0,), sun=None),
    "section": lambda both: plot.section([*both, DEEP]),
    "sections": lambda both: plot.section([*both, DEEP, PLATES, BLACK]),
}


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_overlaps_or_is_cut_off(name, figure, drawn):
    texts = drawn(figure(name))
    assert len(texts) >= 3
    assert faults(figure(name), texts) == []


def test_an_overlap_and_a_cut_are_noticed(drawn):
    figure = style.figure(2, 1)
    figure.text(0.5, 0.5, "one")
    figure.text(0.52, 0.52, "two")
    figure.text(0.95, 0.1, "three and more")
    found = faults(figure, drawn(figure))
    assert len(found) == 2 and "over" in "".join(found) and "cut off" in "".join(found)


UNITS = {
    "polar": ["(1/sr)", "°", "θi = 60°"],
    "hemisphere": ["(1/sr)", "°"],
    "lobe3d": ["(1/sr)", "°"],
    "slice": ["half angle θh", "difference angle θd", "°"],
    "albedo": ["angle of incidence θi", "share of the light", "°"],
    "curves": ["angle of incidence θi", "share of the light", "°"],
    "patches": ["seen from this angle θo from the normal", "°", "#"],
    "section": ["ior 1.5, alpha 0.3", "depth 0.1 20 3", "index 1.2 above", "conductor, rough"],
}


@pytest.mark.parametrize("name", UNITS)
def test_units_and_names_are_said(name, figure, drawn):
    said = " ".join(text for text, _ in drawn(figure(name)))
    for word in [*UNITS[name], "coat", "a slab of glass"]:
        assert word in said, f"{word!r} in {said!r}"


def test_the_same_figure_gives_the_same_file_whatever_the_user_has_set(solved):
    def files(steps):
        return [style.encoded(plot.albedo(solved, steps=steps), format) for format in ("png", "svg")]

    plain = files(3)
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red", "savefig.dpi": 30}):
        before = dict(matplotlib.rcParams)
        again = files(3)
        assert dict(matplotlib.rcParams) == before
    assert plain == again
    assert plain[0] != files(4)[0]


def test_files_are_written_whole(tmp_path):
    figure = plot.section(COAT)
    for ending, head in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        path = tmp_path / f"figure{ending}"
        plot.save(figure, path)
        assert path.read_bytes().startswith(head)
    assert len(list(tmp_path.iterdir())) == 3
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_colours_are_told_apart_without_red_and_green():
    """Distances of the palette as a reader without long-wave cones sees it (Vienot et al. 1999), and in grey steps."""
    codes = np.array([[int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)] for code in style.LINES])
    linear = codes**2.2
    to_lms = np.array(
        [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]]
    )
    lms = linear @ to_lms.T
    lms[:, 0] = 2.02344 * lms[:, 1] - 2.52581 * lms[:, 2]
    seen = np.clip(lms @ np.linalg.inv(to_lms).T, 0, 1) ** (1 / 2.2)
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=-1) + np.eye(len(seen))
    assert apart.min() > 0.12
    assert len(set(map(str, style.DASHES))) == len(style.LINES)


def test_a_notebook_shows_stacks_and_results(solved, monkeypatch):
    page = COAT._repr_html_()
    assert "<svg" in page and "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert solved[0]._repr_png_().startswith(b"\x89PNG")
    lanes = ur.solve(COAT, "lobes", parameters={"layer_0.alpha": np.array([0.1, 0.2])})
    assert lanes._repr_png_() is None
    assert ur.solve(BLACK, "lobes")._repr_png_() is None
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert solved[0]._repr_png_() is None


def test_the_command_line_knows_every_figure():
    assert set(KINDS) == set(plot.__all__) - {"save"}
    for option, kinds in ONLY.items():
        for kind in KINDS:
            if kind in kinds:
                assert option in inspect.signature(getattr(plot, kind)).parameters, f"{option} of {kind}"


def python(code):
    environment = os.environ | {"PYTHONPATH": str(SRC)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_matplotlib_is_imported_late_and_without_pyplot():
    code = (
        "import sys, urushi as ur\n"
        "stack = ur.load('preset:enamel'); stack._repr_html_()\n"
        "early = 'matplotlib' in sys.modules\n"
        "ur.plot.section(stack)\n"
        "print(early, 'matplotlib' in sys.modules, 'matplotlib.pyplot' in sys.modules, 'plot' in dir(ur))"
    )
    assert python(code) == "False True False True"


def test_without_matplotlib_one_sentence_says_how_to_get_it():
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import urushi as ur\n"
        "try: ur.plot\n"
        "except ur.UrushiError as error: print(error)"
    )
    assert "pip install 'urushi[plot]'" in python(code)


@pytest.mark.slow
def test_a_sphere_is_rendered(mi):
    figure = plot.sphere([COAT, "preset:varnished-wood"], size=24, spp=2, method="lobes")
    images = [axes.images[0].get_array() for axes in figure.axes]
    assert len(images) == 2 and all(image.shape == (24, 24, 3) for image in images)
    assert np.abs(images[0].astype(float) - images[1]).mean() > 1
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["coat", "varnished wood"]
