"""`urushi check`: what a material file says, and whether the material, or any BSDF, obeys the laws of physics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table

from urushi import llvm
from urushi.cli import common, progress
from urushi.cli.common import WrongUsage

if TYPE_CHECKING:
    from urushi.checks import Answers, Report

WHAT = (
    "A material file or preset:NAME; or a BSDF: Mitsuba's as JSON or in a .json or .xml file, a Fourier .bsdf file, "
    "a solved .urushi.npz file."
)


def command(
    material: str = typer.Argument(..., help=WHAT),
    method: str | None = typer.Option(
        None, "--method", "-m", help="The method whose answers are checked; else walk."
    ),
    bsdf: str | None = typer.Option(None, help="The id of the BSDF in a scene file."),
    values: list[str] | None = typer.Option(
        None, "--set", help="A value in place of the file's, as layer_0.alpha=0.1; textures need one."
    ),
    thorough: bool = typer.Option(
        False, "--thorough", help="More samples and more directions; takes longer."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print the outcome as JSON and nothing else."),
) -> None:
    """Check a material or a BSDF by the laws of physics. Exit status 1 if one is broken."""
    heading, origin, answers = _asked(material, method, bsdf, common.values(values))
    if not as_json:
        typer.echo(heading)
    with progress.bar("checking") as advance:
        from urushi import checks

        reports = checks.run_on(answers, quick=not thorough, progress=advance)
    failed = [report.name for report in reports if not report.passed]
    if as_json:
        typer.echo(json.dumps(_data(material, origin, reports), indent=2))
        raise typer.Exit(1 if failed else 0)
    typer.echo()
    Console(highlight=False).print(_table(reports))
    if failed:
        typer.echo("\nlook closer, in Python:")
        typer.echo("    import numpy as np\n    import urushi as ur\n    from urushi import checks")
        for line in (origin, *(report.closer for report in reports if not report.passed and report.closer)):
            typer.echo(f"    {line}")
        common.fail(f"{len(failed)} of {len(reports)} checks failed: {', '.join(failed)}")
        raise typer.Exit(1)
    unclaimed = sum(not report.claimed for report in reports)
    typer.echo(f"\n{len(reports) - unclaimed} checks passed" + f", {unclaimed} not claimed" * bool(unclaimed))


def _asked(
    material: str, method: str | None, bsdf: str | None, values: dict[str, Any]
) -> tuple[str, str, Answers]:
    """What to say of it, the line of Python that makes it, and what the checks take."""
    from urushi.adapters.answer import answer, is_answer

    if is_answer(material):
        if method is not None or values:
            raise WrongUsage("--method and --set belong to a material; a BSDF is checked as it is")
        if not material.lstrip().startswith("{") and not Path(material).is_file():
            raise WrongUsage(f"there is no file {material!r}")
        found = common.named(answer, material, bsdf)
        more = f", {bsdf!r}" if bsdf else ""
        origin = f"from urushi.adapters.answer import answer; bsdf = answer({material!r}{more})"
        from urushi.checks import answers_of

        return found.stack.describe(), origin, answers_of(found)
    if bsdf is not None:
        raise WrongUsage(f"--bsdf names a BSDF of a scene file, and {material!r} is a material")
    method = method or "walk"
    common.known_method(method)
    stack = common.load(material)
    llvm.ensure()
    from urushi.checks import SAMPLING, answers_of
    from urushi.solvers import SOLVERS, choose

    options = {"parameters": values} if values else {}
    heading = stack.describe()
    if method == "auto":
        choice = choose(stack, SOLVERS, options)
        method, heading = choice.method, f"{heading}\nmethod {choice.why}"
    more = ", samples=65536" * (method in SAMPLING) + (f", parameters={values!r}" if values else "")
    origin = f"bsdf = ur.solve({material!r}, {method!r}{more})"
    return heading, origin, answers_of(stack, method, **options)


def _table(reports: list[Report]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("")
    table.add_column("check")
    table.add_column("found", justify="right")
    table.add_column("limit", justify="right")
    table.add_column("", overflow="fold")
    for report in reports:
        mark = "[green]✓[/]" if report.passed else "[bold red]✗[/]"
        if not report.claimed:
            mark = "[yellow]-[/]"
        found, limit = (f"{value:.4g}" for value in (report.number, report.limit))
        table.add_row(mark, report.name, found, limit, report.text.replace("[", r"\["))
    return table


def _data(material: str, origin: str, reports: list[Report]) -> dict[str, Any]:
    """The outcome for a machine; numbers that are none are null, as JSON has no others."""

    def number(value: float) -> float | None:
        return value if abs(value) < float("inf") else None

    checks = [
        {
            "name": report.name,
            "outcome": ("passed" if report.passed else "failed") if report.claimed else "not claimed",
            "found": number(report.number),
            "limit": number(report.limit),
            "text": report.text,
            "closer": report.closer,
        }
        for report in reports
    ]
    passed = all(report.passed for report in reports)
    return {"material": material, "python": origin, "passed": passed, "checks": checks}
