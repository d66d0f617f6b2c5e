"""The command line: `urushi --help`.

Each command is a file; it checks what it was given before it starts anything long, and imports what is heavy
only when it runs. Exit status: 0 done, 1 failed, 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import sys

import typer

from urushi.cli import bake, check, common, compare, info, plot, presets, render, schema
from urushi.errors import UrushiError

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

app = typer.Typer(
    name="urushi",
    help="Layered materials for rendering.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for module in (render, plot, compare, check, bake, presets, schema, info):
    app.command(name=module.__name__.rpartition(".")[2])(module.command)


def _version(show: bool) -> None:
    if show:
        from urushi import __version__

        typer.echo(f"urushi {__version__}")
        raise typer.Exit


@app.callback()
def options(
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Show the version."
    ),
) -> None:
    """Layered materials for rendering."""
    common.DEBUG = debug


def main() -> None:
    """Run the command line on `sys.argv`, and exit."""
    try:
        app(prog_name="urushi")
    except UrushiError as error:
        if common.DEBUG:
            raise
        common.fail(str(error))
        sys.exit(2 if isinstance(error, common.WrongUsage) else 1)
    except (KeyboardInterrupt, SystemExit) as end:
        if isinstance(end, SystemExit) and end.code != INTERRUPTED:
            raise
        common.fail("interrupted; nothing was written")
        sys.exit(INTERRUPTED)
