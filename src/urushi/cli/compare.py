"""`urushi compare`: methods and other BSDFs on a material, against the truth, with times and a verdict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table

from urushi.cli import common, progress
from urushi.cli.common import WrongUsage

if TYPE_CHECKING:
    from urushi.comparison import Report

METHODS = "adding,lobes,walk"


def command(
    materials: list[str] = typer.Argument(..., metavar="MATERIAL...", help=common.MATERIAL),
    methods: str = typer.Option(METHODS, "--methods", "-m", help="Which, separated by commas."),
    rivals: list[str] | None = typer.Option(
        None,
        "--with",
        help="Another BSDF: Mitsuba's as JSON; a .bsdf, .urushi.npz, .json or .xml file; or principled, roughplastic, "
        "plastic, roughconductor, diffuse with parameters from the material. May be given again.",
    ),
    values: list[str] | None = typer.Option(
        None, "--set", help="A value in place of the file's, as layer_0.alpha=0.1; textures need one."
    ),
    accuracy: float = typer.Option(1e-3, help="Asked of adding; the reference is finer."),
    samples: int = typer.Option(1024, help="Of the walk, as it is compared."),
    budget: float = typer.Option(60.0, help="Seconds that one solve by adding may take."),
    json: Path | None = typer.Option(None, "--json", help="Write all numbers to this file."),
    html: Path | None = typer.Option(None, "--html", help="Write one page, with figures, to this file."),
) -> None:
    """Compare methods, and any other BSDF, on materials. Errors, noise, times, and a verdict for each."""
    asked = [name.strip() for name in methods.split(",") if name.strip()]
    if not asked:
        raise WrongUsage(f"--methods is {methods!r}; allowed: some of {METHODS}")
    for name in asked:
        if name not in METHODS.split(","):
            raise WrongUsage(f"--methods is {methods!r}; allowed: some of {METHODS}")
    if not 1e-6 <= accuracy <= 1e-2:
        raise WrongUsage(f"--accuracy is {accuracy}; allowed: 1e-6 to 1e-2")
    if samples < 2:
        raise WrongUsage(f"--samples is {samples}; allowed: 2 or more")
    if budget <= 0:
        raise WrongUsage(f"--budget is {budget}; allowed: more than 0 seconds")
    given = common.values(values)
    stacks = [common.load(material) for material in materials]
    json = common.writable(json, (".json",)) if json is not None else None
    html = common.writable(html, (".html",)) if html is not None else None

    from urushi.adapters.answer import answer, is_answer
    from urushi.comparison import compare
    from urushi.comparison.contenders import FITTED
    from urushi.comparison.measure import described
    from urushi.comparison.report import save

    stacks = [described(stack, given) for stack in stacks]  # all of them, before anything long begins
    contenders: list[Any] = []
    for rival in rivals or ():
        if rival not in FITTED and not is_answer(rival):
            raise WrongUsage(
                f"--with is {rival!r}; allowed: {', '.join(FITTED)}, a Mitsuba BSDF as JSON, or a .bsdf, .urushi.npz, "
                ".json or .xml file"
            )
        if rival not in FITTED:
            common.named(answer, rival)  # before anything long begins
        contenders.append(rival)
    reports: list[Report] = []
    for i, stack in enumerate(stacks):
        with progress.bar(f"comparing {stack.name or materials[i]}") as advance:

            def told(share: float, _what: str, advance: Any = advance) -> None:
                advance(round(1000 * share), 1000)

            report = compare(
                stack,
                asked,
                contenders,
                accuracy=accuracy,
                samples=samples,
                budget=budget,
                figures=html is not None,
                progress=told,
            )
        if i:
            typer.echo()
        _print(report)
        reports.append(report)
    for path in (json, html):
        if path is not None:
            save(reports, path)
            typer.echo(f"wrote {path}")


def _print(report: Report) -> None:
    from urushi.comparison.words import COLUMNS, cells

    console = Console(highlight=False)
    console.print(report.name, style="bold", markup=False)
    console.print(f"against {report.reference}", markup=False)
    # What a terminal has no room for goes below one another: every column a line, every method a column.
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("")
    for row in report.rows:
        table.add_column(row.name, justify="right", overflow="fold")
    columns = list(zip(*(cells(row) for row in report.rows), strict=True))
    for name, found in list(zip(COLUMNS, columns, strict=True))[1:]:
        table.add_row(name, *found)
    console.print(table)
    for row in report.rows:
        if row.error is None:
            console.print(f"{row.name} cannot do this: {'; '.join(row.cannot)}", markup=False)
    console.print(report.verdict, markup=False)
