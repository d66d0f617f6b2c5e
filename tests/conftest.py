"""What every test shares: where LLVM comes from, how many threads, and where random numbers start."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

# Before anything imports Dr.Jit, which takes the first LLVM it finds at that moment.
from urushi import llvm
from urushi.errors import UrushiError

#: what the fixture `tool` is
Tool = Callable[[str], ModuleType]
#: what the fixture `command` is: words after `urushi` -> exit status, standard output, standard error
Command = Callable[..., tuple[int, str, str]]

SEED = 20240731
"""Where all random numbers of the suite start. It is never changed to make a test pass."""

UNDER_XDIST = "PYTEST_XDIST_WORKER" in os.environ

try:
    LLVM = llvm.ensure()
except UrushiError as error:  # the tests that need no LLVM still run
    LLVM = None
    NO_LLVM = str(error)

if UNDER_XDIST and LLVM is not None:
    # Each worker is a process of its own: with all of Dr.Jit's threads as well they would only wait for each
    # other. Not one thread, with which Mitsuba waits for ever when it reads or writes an OpenEXR file.
    import drjit as dr

    dr.set_thread_count(2)


@pytest.fixture
def seed() -> int:
    """The seed of the suite."""
    return SEED


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts anew, from the suite's seed, in every test that asks for it."""
    return np.random.default_rng(SEED)


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Tool:
    """Imports a module of the folder tools, by its name; while the test runs, they find one another."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    return importlib.import_module


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Command:
    """Runs the command line in a folder of its own, which is `tmp_path`."""
    from urushi import cli
    from urushi.cli import common

    monkeypatch.chdir(tmp_path)

    def run(*args: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["urushi", *args])
        monkeypatch.setattr(common, "DEBUG", False)
        status = 0
        try:
            cli.main()
        except SystemExit as end:
            status = int(end.code or 0)
        text = capsys.readouterr()
        return status, text.out, text.err

    return run


@pytest.fixture
def mi():
    """Mitsuba in the variant `llvm_ad_rgb`; skips the test where no LLVM can be had."""
    if LLVM is None:
        pytest.skip(NO_LLVM)
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba
