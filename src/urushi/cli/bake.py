"""`urushi bake`: a material solved by adding, in a file that needs no solving any more."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from urushi.cli import common, progress
from urushi.cli.common import WrongUsage
from urushi.errors import MaterialError

if TYPE_CHECKING:
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
    delta: Literal["refuse", "omit"] = typer.Option(
        "refuse", help="With .bsdf: what to do with light that leaves in one direction only."
    ),
) -> None:
    """Solve a material by adding and write the result; interrupted, the same command goes on where it stopped."""
    start = time.perf_counter()
    if not output.name.lower().endswith(ENDINGS):
        raise WrongUsage(f"cannot write {str(output)!r}: the name must end in {' or '.join(ENDINGS)}")
    from urushi.solvers.adding import MOST_ORDERS, reasons_against

    if not 1e-6 <= accuracy <= 0.5:
        raise WrongUsage(f"--accuracy is {accuracy}; allowed: 1e-6 to 0.5")
    if nodes is not None and not 4 <= nodes <= 1000:
        raise WrongUsage(f"--nodes is {nodes}; allowed: 4 to 1000")
    if orders is not None and not 1 <= orders <= MOST_ORDERS:
        raise WrongUsage(f"--orders is {orders}; allowed: 1 to {MOST_ORDERS}")
    fourier = output.name.lower().endswith(".bsdf")
    if delta != "refuse" and not fourier:
        raise WrongUsage("--delta belongs to .bsdf files; a .urushi.npz file has room for all light")
    stack = common.load(material)
    path = common.writable(output, (".bsdf", ".npz"))

    from urushi.errors import UnsupportedStack
    from urushi.solvers.adding.result import AddingBSDF
    from urushi.solvers.adding.whole import solution

    if reasons := reasons_against(stack):
        raise UnsupportedStack("adding", reasons, ["walk"])
    partial = Partial(path, stack, accuracy, nodes, orders)
    try:
        with progress.bar(f"solving {stack.name or path.stem}") as advance:
            shown = _shown(advance, accuracy)
            found = solution(stack, accuracy, nodes, shown, keep=partial.keep, orders=orders)
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
            common.warn("what was solved is kept; the same command goes on from there")
        raise
    partial.remove()
    size = path.stat().st_size
    typer.echo(
        f"wrote {path}  ({size / 1e3:.1f} kB, {found.diagnostics['nodes']} nodes, {found.diagnostics['orders']} "
        f"orders, error {error:.2g}, {time.perf_counter() - start:.1f} s)"
    )


class Partial:
    """The finished refinements of a bake, in hidden files beside its output.

    Args:
        path: the output.
        stack, accuracy, nodes, orders: what is being solved; files of anything else have other names, and are
            not looked at.

    Attributes:
        files: those that were written or used.
    """

    def __init__(
        self, path: Path, stack: Stack, accuracy: float, nodes: int | None, orders: int | None
    ) -> None:
        from urushi import __version__, io

        key = repr((__version__, io.dumps(stack, "json"), accuracy, nodes, orders))
        self.stack, self.error = stack, max(_SPARE * accuracy, 1e-7)
        self.head = path.with_name(f".{path.name}.{hashlib.sha256(key.encode()).hexdigest()[:16]}")
        self.files: list[Path] = []

    def keep(self, counts: list[int], make: Callable[[], Solution]) -> Solution:
        """The solution with these numbers of nodes: from its file, or made and put into one."""
        from urushi.adapters.native.file import packed, read
        from urushi.io import replace

        file = self.head.with_name(f"{self.head.name}.{'-'.join(map(str, counts))}.part")
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
        """Forget it all."""
        for file in self.files:
            file.unlink(missing_ok=True)


def _shown(advance: Callable[[int, int], None], accuracy: float) -> Callable[[int, float], Any]:
    """Progress by the digits that are won from refinement to refinement."""

    def show(_nodes: int, error: float) -> None:
        done = math.log(max(error, 1e-300)) / math.log(accuracy)  # 0 digits to begin with
        advance(int(100 * min(max(done, 0.0), 1.0)), 100)

    return show
