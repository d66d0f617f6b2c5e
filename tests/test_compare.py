"""`ur.compare`: errors that are known beforehand are found, times and sizes are there, and every form says the same."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi.comparison import clock, contenders, measure, questions, reference, svg
from urushi.comparison import report as reports
from urushi.comparison.errors import render_noise
from urushi.comparison.verdict import verdict
from urushi.comparison.words import COLUMNS, cells, nanoseconds, percent, seconds, size, walks
from urushi.errors import UrushiError
from urushi.solvers import BSDF, Sample

pytestmark = needs_llvm

GREY = ur.Stack(
    name="grey", layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=(0.2, 0.5, 0.8))]
)
BRUSHED = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), ur.Conductor(material="Al", alpha=(0.1, 0.4))])
PLATE = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.0)])


class Scaled(BSDF):
    """A BSDF with all its light multiplied by one number."""

    def __init__(self, right: BSDF, factor: float) -> None:
        self.right, self.factor, self.stack = right, factor, right.stack
        self.diagnostics = {"method": "scaled"}

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        value = self.right.eval(wi, wo) * self.factor
        return (value, 0 * value) if with_error else value

    def pdf(self, wi: Any, wo: Any) -> Any:
        return self.right.pdf(wi, wo)

    def sample(self, wi: Any, u: Any) -> Sample:
        found = self.right.sample(wi, u)
        return Sample(found.wo, found.weight * self.factor, found.pdf, found.delta)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        value = self.right.reflectance(wi) * self.factor
        return (value, 0 * value) if with_error else value

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        value = self.right.transmittance(wi) * self.factor
        return (value, 0 * value) if with_error else value


@pytest.fixture(autouse=True, scope="module")
def quickly() -> Iterator[None]:
    """Times that need not be right, where nothing looks at them closely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clock, "SECONDS", 0.003)
        patch.setattr(clock, "ROUNDS", 3)
        yield


@pytest.fixture(scope="module")
def found(quickly: None) -> reports.Report:
    """A report with a contender that is 10 % too bright, as everything here looks at it."""
    bright = Scaled(ur.solve(GREY, "adding", accuracy=2.5e-4), 1.1)
    steps: list[float] = []
    report = ur.compare(
        GREY, contenders=[bright, '{"type": "diffuse", "reflectance": [0.2, 0.4, 0.6]}'], samples=256,
        progress=lambda share, what: steps.append(share),
    )  # fmt: skip
    assert steps == sorted(steps) and steps[-1] == 1.0 and len(steps) > 8
    return report


def test_a_known_error_is_found(found: reports.Report) -> None:
    """10 % too much: 5 % of the light is misplaced (half of the integral), everywhere by a tenth of the value."""
    row = found.row("grey")
    error = row.error
    assert row.kind == "contender" and error is not None
    assert error.misplaced == pytest.approx(0.05, rel=0.05)
    assert error.largest == pytest.approx(0.1, rel=0.02)
    bright = max(max(flux.value) for flux in found.reflectance)
    assert error.reflectance == pytest.approx(0.1 * bright, rel=0.02)
    assert 0.01 < (error.rms or 0) < 0.1 and error.beyond == pytest.approx(error.rms, rel=1e-3)
    assert "leaving at" in error.where and error.wo[2] > 0


def test_methods_are_as_near_as_they_should_be(found: reports.Report) -> None:
    adding, lobes, walk = (found.row(name) for name in ("adding", "lobes", "walk"))
    assert found.reference_method == "adding" and (found.uncertainty or 1) < 1e-3
    for row in (adding, lobes, walk):
        assert row.error is not None and row.kind == "method"
        assert row.eval_ns and row.sample_ns and row.bytes and row.build is not None and row.render_noise
    assert adding.error.rms < 1e-3 and adding.error.reflectance < 1e-3  # type: ignore[union-attr, operator]
    assert lobes.error.reflectance < 0.02  # type: ignore[union-attr]
    # The walk differs by its noise and by nothing else.
    assert walk.error.rms == pytest.approx(walk.error.rms_uncertainty, rel=0.2)  # type: ignore[union-attr]
    assert walk.walk_noise is None and walk.match is None and walk.error.misplaced is None  # type: ignore[union-attr]
    # The definition: one sample's noise, over the root of the samples that there is time for.
    single = (walk.error.rms_uncertainty or 0) * np.sqrt(256)  # type: ignore[union-attr]
    assert lobes.walk_noise == pytest.approx(single / np.sqrt(lobes.eval_ns / walk.eval_ns), rel=0.1)  # type: ignore[operator]
    assert lobes.match == pytest.approx((single / lobes.error.beyond) ** 2, rel=0.1)  # type: ignore[union-attr]
    assert adding.bytes > lobes.bytes == len(ur.io.dumps(GREY, "yaml").encode())  # type: ignore[operator]
    with pytest.raises(UrushiError, match="allowed: adding, lobes, walk, grey, diffuse"):
        found.row("magic")


class Cells(HTMLParser):
    """The text of the table and the data of a page; and what it would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.data, self.fetched, self.open = "", [], ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.open = tag
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        for name, value in attributes:
            if name in ("src", "href", "srcset") and not (value or "").startswith("data:"):
                self.fetched.append(value)

    def handle_data(self, data: str) -> None:
        if self.open in ("td", "th") and self.rows:
            self.rows[-1][-1] += data
        if self.open == "script":
            self.data += data

    def handle_endtag(self, tag: str) -> None:
        self.open = ""


def test_page_table_and_json_say_the_same(found: reports.Report, tmp_path: Path) -> None:
    found.save(tmp_path / "a.html")
    found.save(tmp_path / "a.json")
    page = (tmp_path / "a.html").read_text("utf-8")
    cells_of = Cells()
    cells_of.feed(page)
    said = json.loads((tmp_path / "a.json").read_text("utf-8"))
    assert json.loads(cells_of.data) == said
    assert said["reports"][0] == json.loads(json.dumps(found.as_dict()))
    # Every number of the table is one of the JSON, as the table rounds it.
    head, *body = cells_of.rows
    assert head[1:-1] == [row["name"] for row in said["reports"][0]["rows"]]
    lobes = said["reports"][0]["rows"][1]
    by = {row[0]: row[2] for row in body}
    assert by["error"] == percent(lobes["error"]["rms"])
    assert by["misplaced"] == percent(lobes["error"]["misplaced"])
    assert by["eval"] == nanoseconds(lobes["eval_ns"]) and by["on disk"] == size(lobes["bytes"])
    assert by["walk's noise"] == percent(lobes["walk_noise"]) and by["build"] == seconds(lobes["build"])
    assert list(by) == list(COLUMNS)[1:]
    # It needs nothing else: no address, no script that runs.
    assert cells_of.fetched == [] and not re.search(
        r"https?://|@import|url\(", page.replace("http://www.w3.org", "")
    )
    assert page.count("<script") == 1 and 'type="application/json"' in page
    assert (
        page.count("<svg") == 2 and "NaN" not in page and "nan" not in re.findall(r"<svg.*?</svg>", page)[0]
    )


def test_noise_of_a_millisecond() -> None:
    """As many samples as fit into it: one if it takes a millisecond, a thousand if a microsecond."""
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=0.5)])
    bsdf = ur.solve(stack, "lobes")
    one = render_noise(bsdf, 1e6, 0)
    wi, u = np.array([[0.5, 0, 0.75**0.5]]), np.random.default_rng(1).random((1 << 14, 3))
    weight = bsdf.sample(wi, u).weight[:, 0]
    assert one == pytest.approx(weight.std() / weight.mean(), rel=0.1)
    assert render_noise(bsdf, 1e3, 0) == pytest.approx(one / 1000**0.5)


def test_text_says_it_too(found: reports.Report) -> None:
    text = str(found)
    assert found.verdict in text
    for row in found.rows:
        line = next(line for line in text.splitlines() if line.startswith(row.name + " "))
        assert all(cell in line for cell in cells(row))
    assert found.html() == found.html() and "<h1>grey</h1>" in found._repr_html_()


def test_the_verdict_gives_its_reasons(found: reports.Report) -> None:
    said = found.verdict
    for part in (
        "Take adding for",
        "Take the walk in a path tracer",
        "Lobes are ",
        "grey is off by",
        "diffuse is off by",
    ):
        assert part in said
    assert percent(found.row("lobes").error.rms) in said  # type: ignore[union-attr]
    assert found.auto.startswith("adding: ")
    out = reports.Row("adding", "method", "", None, cannot=["layers[1] is brushed"])
    only = verdict([out, found.row("walk")])
    assert "Adding is out: layers[1] is brushed." in only and "Take the walk: it is the one" in only


def test_what_adding_cannot_do_is_held_against_a_long_walk() -> None:
    report = ur.compare(BRUSHED, methods=("adding", "walk"), samples=64, reference_samples=2048)
    assert report.reference_method == "walk" and "standard error" in report.reference
    adding, walk = report.rows
    assert adding.error is None and "anisotropic" in adding.cannot[0] and cells(adding)[1] == "cannot"
    assert walk.error is not None
    assert walk.error.rms == pytest.approx(walk.error.rms_uncertainty, rel=0.3)
    # Brushed ones are asked from two azimuths.
    assert {flux.view for flux in report.reflectance} >= {"30°, azimuth 20°", "30°, azimuth 110°"}
    assert "adding cannot do this" in str(report)


def test_delta_parts_only_are_compared_by_their_fluxes() -> None:
    report = ur.compare(PLATE, methods=("adding", "walk"), samples=64)
    error = report.row("walk").error
    assert error is not None and error.rms is None and error.misplaced is None
    assert error.reflectance < 5 * error.flux_uncertainty and error.transmittance < 5 * error.flux_uncertainty
    exact = report.row("adding").error
    assert exact is not None and exact.reflectance < 1e-4 and exact.transmittance < 1e-4
    assert cells(report.row("walk"))[1] == "-" and "<svg" in report.html()
    assert any("below" in flux.view for flux in report.transmittance)


@pytest.mark.slow
def test_a_stack_that_takes_adding_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    assert reference.within(GREY, 1e-3, 1e-9) is None
    report = ur.compare(GREY, methods=("adding", "walk"), samples=16, reference_samples=256, budget=1e-9)
    assert report.reference_method == "walk" and "longer than" in report.row("adding").cannot[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"methods": ("magic",)}, "methods: found 'magic'"),
        ({"accuracy": 0.1}, "accuracy: found 0.1"),
        ({"samples": 1}, "samples: found 1"),
        ({"contenders": ["principeld"]}, "contender: found 'principeld'"),
        ({"contenders": ['{"type": "difuse"}'], "methods": ("lobes",)}, "Mitsuba refuses"),
        ({"parameters": {"layer_9.alpha": 1.0}}, "layer_9"),
    ],
)
def test_wrong_input(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(UrushiError, match=said):
        ur.compare(GREY, **({"methods": ("lobes",), "reference_samples": 16} | arguments))


def test_contenders_come_from_files_and_are_told_apart(tmp_path: Path, mi: Any) -> None:
    (tmp_path / "a.json").write_text('{"type": "diffuse"}')
    read = contenders.contender(tmp_path / "a.json")
    assert (read.name, read.bytes) == ("a.json", 19)
    assert contenders.contender({"type": "diffuse"}).said == '{"type": "diffuse"}'
    instance = contenders.contender(mi.load_dict({"type": "diffuse"}))
    assert instance.bytes is None and instance.said == "an instance"
    names = [
        one.name
        for one in measure._told_apart([read, read, contenders.Contender("walk", read.bsdf, "", 1)], ["walk"])
    ]
    assert names == ["a.json", "a.json (2)", "walk (2)"]


def test_textures_need_values() -> None:
    with pytest.raises(UrushiError, match=r"layer_0\.alpha and layer_2\.reflectance: a texture.*--set"):
        ur.compare("preset:varnished-wood")


# ------------------------------------------------------------------------------------------- pieces


def test_contenders_take_their_parameters_from_the_stack(mi: Any) -> None:
    """And the colour is the one that reflects as much at normal incidence."""
    solved = ur.solve(GREY, "adding")
    wanted = solved.reflectance([[0.0, 0.0, 1.0]])[0]
    for name in ("principled", "roughplastic", "diffuse"):
        rival = contenders.from_stack(name, GREY, solved)
        assert rival.bsdf.reflectance([[0.0, 0.0, 1.0]])[0] == pytest.approx(wanted, abs=0.01)
        assert rival.said.startswith("parameters from the stack: {")
    plastic = contenders.fitted("plastic", GREY, wanted)
    assert (plastic["type"], plastic["alpha"], plastic["int_ior"]) == ("roughplastic", 0.3, 1.5)
    metal = contenders.fitted("principled", BRUSHED, np.array([0.9, 0.9, 0.9]))
    assert (
        metal["metallic"] == 1.0
        and metal["roughness"] == pytest.approx(0.04**0.25)
        and metal["clearcoat"] == 1.0
    )
    assert contenders.fitted("principled", PLATE, np.ones(3))["spec_trans"] == 1.0
    assert contenders.fitted("plastic", PLATE, np.ones(3))["type"] == "plastic"
    assert contenders.fitted("roughconductor", BRUSHED, np.ones(3))["alpha"] == pytest.approx(0.2)


def test_questions_surround_the_lobes() -> None:
    views = questions.views(PLATE)
    assert [view.above for view in views] == [True] * 4 + [False] * 2
    for view in views:
        assert np.allclose(np.linalg.norm(view.wo, axis=1), 1) and abs(np.linalg.norm(view.wi) - 1) < 1e-12
        assert np.abs(view.wo[:, 2]).min() > questions.LEAST - 1e-9
        mirror = view.wi * (-1, -1, 1)
        assert np.min(np.linalg.norm(view.wo - mirror, axis=1)) < 1e-6
        # A plate of glass in air: straight through.
        assert np.min(np.linalg.norm(view.wo + view.wi, axis=1)) < 1e-6
    assert all((view.wo[:, 2] > 0).all() for view in questions.views(GREY))
    for view in questions.views(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1)])):
        ratio = 1 / 1.5 if view.above else 1.5
        if ratio * np.sin(np.radians(view.theta)) < 1:  # Snell's direction is asked for
            snell = np.append(-ratio * view.wi[:2], 0.0)
            snell[2] = -np.sign(view.wi[2]) * np.sqrt(1 - snell @ snell)
            assert np.min(np.linalg.norm(view.wo - snell, axis=1)) < 1e-6


def test_the_clock_tells_twice_the_work_from_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a stopwatch of its own: 100 and 200 ns a lane, in turn, with a disturbance in all rounds but one."""
    import drjit as dr

    calls: list[tuple[str, int]] = []

    def stopwatch(run: Any, lanes: Any) -> float:
        bsdf, width = run.args[0], dr.width(lanes[0])
        calls.append((bsdf.name, width))
        disturbed = 0.0 if len(calls) % 7 == 3 else 0.5
        return (1 + disturbed) * bsdf.cost * width * (2 if run.func is clock._sampled else 1)

    monkeypatch.setattr(clock, "_timed", stopwatch)
    monkeypatch.setattr(clock, "SECONDS", 0.02)
    monkeypatch.setattr(clock, "ROUNDS", 7)
    one, twice = SimpleNamespace(name="one", cost=1e-7), SimpleNamespace(name="twice", cost=2e-7)
    cost, draw = clock.nanoseconds({"one": one, "twice": twice})  # type: ignore[dict-item]
    assert cost == pytest.approx({"one": 100, "twice": 200})
    assert draw == pytest.approx({"one": 200, "twice": 400})
    assert {width for _, width in calls} == {1 << 12, 1 << 14, 1 << 16, 1 << 18}
    assert [name for name, _ in calls[-4:]] == ["one", "one", "twice", "twice"]


def test_the_clock_times_the_kernels_of_what_is_asked() -> None:
    """What was compiled and run before does not count; what this asks for does."""
    bsdf = ur.solve(GREY, "walk", samples=4)
    lanes = clock._lanes(4096, 0)
    assert clock._timed(lambda _: lanes[0], lanes) == 0.0, "already computed"
    assert clock._timed(lambda given: bsdf.eval(given[0], given[1]), lanes) > 0.0


def test_charts() -> None:
    line = svg.Series("a<b", [1.0, 10.0, 100.0], [1e-3, 0.0, 1e-1], slot=1)
    text = svg.chart([line], svg.Axis("time (ns)", log=True), svg.Axis("error", log=True), 'a "chart"')
    assert text.count("<rect") - 1 == 2 + 1, (
        "a logarithmic axis has no place for 0; one mark stands in the legend"
    )
    assert "a&lt;b" in text and "a &quot;chart&quot;" in text and "nan" not in text
    assert svg.chart([svg.Series("none", [], [])], svg.Axis("x"), svg.Axis("y"), "t") == ""
    flat = svg.chart(
        [svg.Series("zero", [0.0, 30.0], [0.0, 0.0], [0.1, 0.1])], svg.Axis("x"), svg.Axis("y"), "t"
    )
    assert flat.count('stroke-width="1.5"') == 2


def test_numbers_as_people_read_them() -> None:
    assert [percent(v) for v in (None, 0.0, 1e-7, 0.0123, 0.996, 99.0)] == [
        "-", "0 %", "< 0.001 %", "1.2 %", "100 %", "> 1000 %",
    ]  # fmt: skip
    assert [seconds(v) for v in (None, 0.012, 1.23, 45.6)] == ["-", "12 ms", "1.2 s", "46 s"]
    assert [nanoseconds(v) for v in (3.456, 1234.0)] == ["3.46 ns", "1.23 µs"]
    assert [size(v) for v in (None, 12, 34567, 2_586_798)] == ["-", "12 B", "34.6 kB", "2.59 MB"]
    assert [walks(v) for v in (None, 0.3, 12345.6, 2.28e6)] == ["-", "< 1", "12,346", "2.3e6"]


def test_a_file_that_cannot_be_written(found: reports.Report, tmp_path: Path) -> None:
    with pytest.raises(UrushiError, match=r"allowed: a name ending in \.json or \.html"):
        found.save(tmp_path / "a.txt")
    with pytest.raises(UrushiError, match="cannot be written"):
        found.save(tmp_path / "no" / "a.json")
