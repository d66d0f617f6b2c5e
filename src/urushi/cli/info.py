"""`urushi info`: what is installed, which backends work, and where LLVM came from."""

from __future__ import annotations

import platform
import sys
from importlib import metadata

from rich.console import Console
from rich.table import Table

from urushi import llvm
from urushi.errors import UrushiError


def command() -> None:
    """Show versions, backends and where LLVM came from."""
    table = Table.grid(padding=(0, 2))
    rows = [("urushi", _version("urushi")), ("Python", f"{platform.python_version()} ({sys.platform})")]
    rows += [(name, _version(name)) for name in ("mitsuba", "drjit", "numpy", "scipy")]
    try:
        found = llvm.ensure()
        rows.append(
            ("LLVM", f"{'.'.join(map(str, found.version)) or 'unknown version'}, from {found.origin}")
        )
        rows.append(("", str(found.path or "")))
    except UrushiError as error:
        rows.append(("LLVM", f"none: {error}"))
    try:
        import drjit as dr
        import mitsuba as mi

        backends = {"LLVM": dr.JitBackend.LLVM, "CUDA": dr.JitBackend.CUDA}
        able = [name for name, backend in backends.items() if dr.has_backend(backend)]
        rows.append(("backends", ", ".join(able) or "none"))
        rows.append(("threads", str(dr.thread_count())))
        rows.append(("variants", ", ".join(mi.variants())))
    except ImportError as error:
        rows.append(("Mitsuba", f"cannot be imported: {error}"))
    for name, value in rows:
        table.add_row(f"[bold]{name}[/]", value.replace("[", r"\["))
    Console(soft_wrap=True, highlight=False).print(table)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        import urushi

        return urushi.__version__ if name == "urushi" else "not installed"
