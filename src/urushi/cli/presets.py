"""`urushi presets`: the materials that come with Urushi, as a table or one as its file."""

from __future__ import annotations

import typer
from rich.console import Console
from rich.table import Table

from urushi.cli import common


def command(
    name: str | None = typer.Argument(None, help="Print the file of this one; a good start for your own."),
) -> None:
    """List the materials that come along, or print the file of one."""
    import urushi

    if name is not None:
        common.load(f"preset:{name.removeprefix('preset:')}")
        typer.echo(_file(name.removeprefix("preset:")), nl=False)
        return
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("preset", "what it is", "layers"):
        table.add_column(heading, overflow="fold")
    for preset in urushi.presets():
        stack = urushi.load(f"preset:{preset}")
        layers = " / ".join(layer.kind.replace("_", " ") for layer in stack.layers)
        table.add_row(f"[bold]{preset}[/]", " ".join(stack.description.split()), layers)
    Console(highlight=False).print(table)


def _file(name: str) -> str:
    from importlib import resources

    return (resources.files("urushi") / "materials" / f"{name}.yaml").read_text("utf-8")
