"""What every test shares: where LLVM comes from, how many threads, and where random numbers start."""

from __future__ import annotations

import importlib
import os
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
def mi():
    """Mitsuba in the variant `llvm_ad_rgb`; skips the test where no LLVM can be had."""
    if LLVM is None:
        pytest.skip(NO_LLVM)
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba
