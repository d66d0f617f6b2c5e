"""What the commands share: how errors look, how a material is named on the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from urushi.errors import MaterialError, UrushiError, close

if TYPE_CHECKING:
    from urushi.stack import Stack

DEBUG = False
"""Whether `--debug` was given."""

MATERIAL = "A material file (.yaml, .json), or preset:NAME."


class WrongUsage(UrushiError):
    """The command line asks for something that cannot be; exit status 2."""


def fail(text: str) -> None:
    """Say in one line, on standard error, what went wrong."""
    _say("error", "bold red", text)


def warn(text: str) -> None:
    """Say in one line, on standard error, what the user should know about a result."""
    _say("warning", "bold yellow", text)


def _say(kind: str, style: str, text: str) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"{kind}: ", style=style, end="")
    console.print(text, markup=False)


def load(material: str) -> Stack:
    """The stack that the command line names.

    Raises:
        WrongUsage: there is no such preset or file.
        MaterialError: the file is not a valid description.
    """
    import urushi

    if material.startswith("preset:"):
        names = urushi.presets()
        if (name := material.removeprefix("preset:")) not in names:
            raise WrongUsage(
                f"there is no preset {name!r}; {close(name, names)}there are: {', '.join(names)}"
            )
    elif not Path(material).is_file():
        hint = f"; the preset of that name is preset:{material}" if material in urushi.presets() else ""
        raise WrongUsage(f"there is no material file {material!r}{hint}")
    return urushi.load(material)


def named(make: Callable[..., Any], *arguments: Any) -> Any:
    """What the command line names by words that `make` understands.

    Raises:
        WrongUsage: it does not. A file that is damaged stays a `MaterialError`.
    """
    try:
        return make(*arguments)
    except MaterialError:
        raise
    except UrushiError as error:
        raise WrongUsage(str(error)) from None


def values(given: Sequence[str] | None) -> dict[str, Any]:
    """What `--set NAME=VALUE` says: numbers, or colours as 0.4,0.2,0.1.

    Raises:
        WrongUsage: another form.
    """
    found: dict[str, Any] = {}
    for text in given or ():
        name, _, value = text.partition("=")
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            raise WrongUsage(
                f"--set is {text!r}; allowed: NAME=NUMBER or NAME=RED,GREEN,BLUE, such as layer_0.alpha=0.1"
            ) from None
        found[name.strip()] = numbers if len(numbers) > 1 else numbers[0]
    return found


def writable(path: Path, suffixes: tuple[str, ...]) -> Path:
    """`path`, after its ending and its folder have been checked and the folder made if need be.

    Raises:
        WrongUsage: another ending, or a place that cannot be written to.
    """
    import os

    if path.suffix.lower() not in suffixes:
        raise WrongUsage(f"cannot write {str(path)!r}: the name must end in {' or '.join(suffixes)}")
    if path.is_dir():
        raise WrongUsage(f"cannot write {str(path)!r}: it is a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WrongUsage(f"cannot make the folder {str(path.parent)!r}: {error.strerror}") from None
    if not os.access(path.parent, os.W_OK):
        raise WrongUsage(f"cannot write to the folder {str(path.parent)!r}")
    return path


def known_method(method: str) -> None:
    """Refuse a name that is no method."""
    from urushi.solvers import SOLVERS

    names = [*SOLVERS, "auto"]
    if method not in names:
        raise WrongUsage(f"--method is {method!r}; {close(method, names)}allowed: {', '.join(names)}")


def adding_options(
    method: str, accuracy: float | None, nodes: int | None, orders: int | None, media: str | None
) -> dict[str, Any]:
    """What was said of what only the method adding takes, by name.

    Raises:
        WrongUsage: another method, or a value out of range.
    """
    from urushi.solvers.adding import MOST_ORDERS, media_method

    given = {"accuracy": accuracy, "nodes": nodes, "orders": orders, "media": media}
    given = {name: value for name, value in given.items() if value is not None}
    for name, value in given.items():
        if method != "adding":
            raise WrongUsage(f"--{name} is {value} with --method {method}; allowed: with --method adding")
    if accuracy is not None and not 1e-6 <= accuracy <= 0.5:
        raise WrongUsage(f"--accuracy is {accuracy}; allowed: 1e-6 to 0.5")
    if nodes is not None and not 4 <= nodes <= 1000:
        raise WrongUsage(f"--nodes is {nodes}; allowed: 4 to 1000")
    if orders is not None and not 1 <= orders <= MOST_ORDERS:
        raise WrongUsage(f"--orders is {orders}; allowed: 1 to {MOST_ORDERS}")
    try:
        media_method(media)
    except UrushiError as error:
        raise WrongUsage(f"--{error}") from None
    return given


def has_media(media: str | None, stack: Stack) -> None:
    """Refuse to be told how media are solved where there are none."""
    if media is not None and not any(layer.is_medium for layer in stack.layers):
        raise WrongUsage(f"--media is {media}, and no layer of {stack.name or 'this material'} is a medium")
