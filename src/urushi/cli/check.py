"""`urushi check`: what a material file says, and whether the material obeys the laws of physics."""

from __future__ import annotations

import typer
from rich.console import Console
from rich.table import Table

from urushi import llvm
from urushi.cli import common


def command(
    material: str = typer.Argument(..., help=common.MATERIAL),
    method: str = typer.Option("walk", "--method", "-m", help="The method whose answers are checked."),
    thorough: bool = typer.Option(
        False, "--thorough", help="More samples and more directions; takes longer."
    ),
) -> None:
    """Describe a material and check it: energy, reciprocity, normalisation and the rest."""
    common.known_method(method)
    stack = common.load(material)
    typer.echo(stack.describe())
    llvm.ensure()
    console = Console(stderr=True)
    with console.status("checking"):
        from urushi import checks

        reports = checks.run(stack, method=method, quick=not thorough)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("")
    table.add_column("check")
    table.add_column("found", justify="right")
    table.add_column("limit", justify="right")
    table.add_column("", overflow="fold")
    for report in reports:
        mark = "[green]✓[/]" if report.passed else "[bold red]✗[/]"
        found, limit = (f"{value:.4g}" for value in (report.number, report.limit))
        table.add_row(mark, report.name, found, limit, report.text.replace("[", r"\["))
    typer.echo()
    Console(highlight=False).print(table)
    failed = [report.name for report in reports if not report.passed]
    if failed:
        common.fail(f"{len(failed)} of {len(reports)} checks failed: {', '.join(failed)}")
        raise typer.Exit(1)
    typer.echo(f"\n{len(reports)} checks passed")
