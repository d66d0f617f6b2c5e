"""`urushi schema`: the JSON schema of a material file, for an editor."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from urushi.cli import common


def command(
    output: Path | None = typer.Option(None, "-o", "--output", help="A .json file; else standard output."),
) -> None:
    """Print the JSON schema of a material file. For completion and checking in an editor."""
    import urushi

    text = json.dumps(urushi.schema(), indent=2, ensure_ascii=False) + "\n"
    if output is None:
        typer.echo(text, nl=False)
    else:
        path = common.writable(output, (".json",))
        path.write_text(text, "utf-8")
        typer.echo(f"wrote {path}")
