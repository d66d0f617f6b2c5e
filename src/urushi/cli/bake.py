"""`urushi bake`: a material solved by adding, in a file that needs no solving any more."""

from __future__ import annotations

import hashlib
import math
import re
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from urushi.cli import common, progress
from urushi.cli.common import WrongUsage
from urushi.errors import MaterialError

if TYPE_CHECKING:
    from urushi.solvers.adding.media import Method
    from urushi.solvers.adding.solution import Solution
    from urushi.stack import Stack

ENDINGS = (".bsdf", ".urushi.npz")
#: error of what is kept on the way, relative to the accuracy that is asked for
_SPARE = 1e-3


def command(
    material: str = typer.Argument(..., help=common.MATERIAL),
    output: Path = typer.Option(..., "-o", "--output", help="A .urushi.npz file, or a Fourier .bsdf file."),
    accuracy: float = typer.Option(1e-3, help="Error allowed, relative to the peak of the BSDF."),
    nodes: int | None = typer.Option(None, help="A fixed number of directions instead, whatever the error."),
    orders: int | None = typer.Option(
        None, help="A fixed number of azimuthal orders instead, whatever the error."
    ),
    media: str | None = typer.Option(
        None, help="How media are solved: ordinates (the usual), doubling, or riccati; to the same result."
    ),
    delta: Literal["refuse", "omit"] = typer.Option(
        "refuse", help="With .bsdf: what to do with light that leaves in one direction only."
    ),
) -> None:
    """Solve a material by adding and write the result. Interrupted, the same command goes on where it stopped."""
    start = time.perf_counter()
    if not output.name.lower().endswith(ENDINGS):
        raise WrongUsage(f"cannot write {str(output)!r}: the name must end in {' or '.join(ENDINGS)}")
    common.adding_options("adding", accuracy, nodes, orders, media)
    fourier = output.name.lower().endswith(".bsdf")
    if delta != "refuse" and not fourier:
        raise WrongUsage("--delta belongs to .bsdf files; a .urushi.npz file has room for all light")
    stack = common.load(material)
    common.has_media(media, stack)
    path = common.writable(output, (".bsdf", ".npz"))

    from urushi.errors import UnsupportedStack
    from urushi.solvers.adding import media_method, reasons_against
    from urushi.solvers.adding.result import AddingBSDF
    from urushi.solvers.adding.whole import solution

    if reasons := reasons_against(stack):
        raise UnsupportedStack("adding", reasons, ["walk"])
    method = media_method(media)
    partial = Partial(path, stack, accuracy, nodes, orders, method)
    if waiting := partial.waiting():
        typer.echo(f"going on from {_files(waiting)} of an interrupted bake", err=True)
    try:
        with progress.bar(f"solving {stack.name or path.stem}") as advance:
            shown = _shown(advance, accuracy)
            found = solution(stack, accuracy, nodes, shown, keep=partial.keep, orders=orders, media=method)
        bsdf = AddingBSDF(stack, found)
        error = found.diagnostics["estimated_error"]
        if fourier:
            from urushi.adapters.fourier import write_fourier
            from urushi.adapters.fourier.export import fourier_of

            table, more = fourier_of(bsdf, accuracy=accuracy, delta=delta)
            write_fourier(table, path)
            error += more
        else:
            from urushi.adapters import native

            spare = native.spare(bsdf)
            native.save(bsdf, path, error=spare)
            error += spare
    except KeyboardInterrupt:
        if partial.files:
            common.warn(
                f"what was solved is kept in {_files(partial.files)}; the same command goes on from there, and "
                f"removes them. To give it up: rm {shlex.quote(str(path.parent))}/{shlex.quote(partial.head)}.*.part"
            )
        raise
    partial.remove()
    size = path.stat().st_size
    typer.echo(
        f"wrote {path}  ({size / 1e3:.1f} kB, {found.diagnostics['nodes']} nodes, {found.diagnostics['orders']} "
        f"orders, error {error:.2g}, {time.perf_counter() - start:.1f} s)"
    )
    if others := partial.others():
        typer.echo(f"there still are {_files(others)} of unfinished bakes with other options", err=True)


class Partial:
    """The finished refinements of a bake, in hidden files beside its output.

    They are called ``.OUTPUT.MATERIAL-OPTIONS.NODES.part``, with a digest of the material (and of the version that
    solves it) and one of the options: the same command finds them again, another one leaves them alone. Those of
    another material are out of date as soon as the output is written.

    Args:
        path: the output.
        stack, accuracy, nodes, orders, media: what is being solved, and how.

    Attributes:
        head: what the names of its files begin with.
        files: those that were written or used.
    """

    def __init__(
        self,
        path: Path,
        stack: Stack,
        accuracy: float,
        nodes: int | None,
        orders: int | None,
        media: Method,
    ) -> None:
        from urushi import __version__, io

        self.path, self.stack, self.error = path, stack, max(_SPARE * accuracy, 1e-7)
        self._material = f".{path.name}.{_digest(__version__, io.dumps(stack, 'json'))}"
        self.head = f"{self._material}-{_digest(accuracy, nodes, orders, media)}"
        self.files: list[Path] = []

    def _found(self) -> list[Path]:
        """All such files beside the output, whatever bake they are of."""
        name = re.compile(re.escape(f".{self.path.name}.") + r"[0-9a-f]{12}-[0-9a-f]{12}\.\d+(-\d+)*\.part")
        return sorted(file for file in self.path.parent.iterdir() if name.fullmatch(file.name))

    def waiting(self) -> list[Path]:
        """Those of an earlier run of this very bake."""
        return [file for file in self._found() if file.name.startswith(f"{self.head}.")]

    def others(self) -> list[Path]:
        """Those of this material with other options."""
        return [file for file in self._found() if not file.name.startswith(f"{self.head}.")]

    def keep(self, counts: list[int], make: Callable[[], Solution]) -> Solution:
        """The solution with these numbers of nodes: from its file, or made and put into one."""
        from urushi.adapters.native.file import packed, read
        from urushi.io import replace

        file = self.path.with_name(f"{self.head}.{'-'.join(map(str, counts))}.part")
        try:
            told, found = read(file)
            if (
                told.stack == self.stack
                and told.channels is None
                and [panel.count for panel in found.grid.panels] == counts
            ):
                self.files.append(file)
                return found
        except MaterialError:
            pass  # none yet, or damaged: solved anew
        found = make()
        try:
            replace(file, packed(self.stack, found, self.error))
        except OSError as fault:
            raise MaterialError(f"cannot be written: {fault.strerror or fault}", file=str(file)) from None
        self.files.append(file)
        return found

    def remove(self) -> None:
        """Forget it all, and what is out of date."""
        stale = [file for file in self.others() if not file.name.startswith(f"{self._material}-")]
        for file in (*self.waiting(), *stale):
            file.unlink(missing_ok=True)


def _digest(*given: Any) -> str:
    return hashlib.sha256(repr(given).encode()).hexdigest()[:12]


def _files(files: list[Path]) -> str:
    """How many, how large, and where."""
    size = sum(file.stat().st_size for file in files)
    count = "1 file" if len(files) == 1 else f"{len(files)} files"
    first = re.sub(r"\.[\d-]+\.part$", ".*.part", files[0].name)
    return f"{count} ({size / 1e3:.1f} kB, {files[0].with_name(first)})"


def _shown(advance: Callable[[int, int], None], accuracy: float) -> Callable[[int, float], Any]:
    """Progress by the digits that are won from refinement to refinement."""

    def show(_nodes: int, error: float) -> None:
        done = math.log(max(error, 1e-300)) / math.log(accuracy)  # 0 digits to begin with
        advance(int(100 * min(max(done, 0.0), 1.0)), 100)

    return show
