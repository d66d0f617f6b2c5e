"""Where LLVM comes from: the user's choice wins, then the wheel, then a system LLVM that works, then a
sentence that says what to do. Dr.Jit takes LLVM once per process, so each case runs in its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from urushi import llvm

SRC = Path(llvm.__file__).parent.parent
WHEEL = next(llvm._from_wheel(), None)
OLD = next((found for found in llvm._from_system() if found.version and found.version[0] < llvm.OLDEST), None)

needs_wheel = pytest.mark.skipif(WHEEL is None, reason="the wheel does not exist for this platform")
needs_old = pytest.mark.skipif(OLD is None, reason="this system has no LLVM that is too old")

# Importing the package chooses an LLVM already: the choice is undone where another one is to be seen.
UNDO = "import os; from urushi import llvm; os.environ.pop(llvm.VARIABLE, None);"
HIDE_WHEEL = UNDO + "llvm._from_wheel = lambda: iter(());"
HIDE_ALL = HIDE_WHEEL + "llvm._candidates = lambda: iter(());"
TRY = """
from urushi import llvm
from urushi.errors import UrushiError
try:
    print(llvm.ensure())
except UrushiError as error:
    print("UrushiError:", error)
"""
COMPUTE = "import drjit as dr; from drjit.llvm.ad import Float; print(dr.sum(dr.arange(Float, 4))[0]);"


def python(code: str, **variables: str) -> str:
    """The output of `code` in a fresh Python without the variable; fails when that process fails."""
    environment = {name: value for name, value in os.environ.items() if name != llvm.VARIABLE}
    environment |= {"PYTHONPATH": str(SRC), **variables}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@needs_wheel
def test_the_wheel_is_used_by_default_and_works():
    text = python(TRY + COMPUTE + "print(llvm.ensure())")
    before, value, after = text.splitlines()
    assert llvm.WHEEL in before and str(WHEEL.path) in before
    assert value == "6.0"
    assert after == before


@needs_wheel
def test_a_child_process_agrees_about_the_origin():
    assert llvm.WHEEL in python(TRY, **{llvm.VARIABLE: str(WHEEL.path)})


@needs_wheel
def test_the_users_choice_wins(tmp_path):
    mine = tmp_path / WHEEL.path.name
    mine.symlink_to(WHEEL.path)
    assert str(mine) in python(TRY, **{llvm.VARIABLE: str(mine)})


def test_a_choice_that_does_not_exist_is_said(tmp_path):
    text = python(TRY, **{llvm.VARIABLE: str(tmp_path / "libLLVM.so")})
    assert text.startswith("UrushiError:") and "no such file" in text and llvm.VARIABLE in text


@needs_old
def test_a_choice_that_is_too_old_is_refused():
    text = python(TRY, **{llvm.VARIABLE: str(OLD.path)})
    assert text.startswith("UrushiError:") and f"LLVM {OLD.version[0]}" in text


def test_without_any_the_error_says_what_to_do():
    text = python(HIDE_ALL + TRY)
    assert text.startswith("UrushiError:") and "no LLVM was found" in text and "install" in text


@needs_old
def test_an_old_system_llvm_is_never_taken():
    newer = [found for found in llvm._from_system() if found.version and found.version[0] >= llvm.OLDEST]
    text = python(HIDE_WHEEL + TRY)
    if newer:
        assert "(system)" in text
    else:
        assert text.startswith("UrushiError:") and "too old" in text and str(OLD.version[0]) in text


@needs_old
def test_drjit_imported_first_with_an_old_llvm_is_said():
    """Dr.Jit loads LLVM when it is imported; afterwards only a sentence can help."""
    text = python("import drjit;" + TRY, **{llvm.VARIABLE: str(OLD.path)})
    assert text.splitlines()[-1].startswith("UrushiError: Dr.Jit was imported before Urushi")


@needs_wheel
def test_drjit_imported_first_with_a_good_llvm_is_fine():
    text = python("import drjit;" + TRY + COMPUTE, **{llvm.VARIABLE: str(WHEEL.path)})
    assert llvm.WHEEL in text and text.endswith("6.0")


def test_finding_llvm_imports_nothing_heavy():
    text = python(TRY + "import sys; print([m for m in ('drjit', 'mitsuba', 'numpy') if m in sys.modules])")
    assert text.endswith("[]")


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.23.1", (23, 1)),
        ("libLLVM-15.so.1", (15,)),
        ("libLLVM-15.so", (15,)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM.so.19.1", (19, 1)),
        ("libLLVM-17.dylib", (17,)),
        ("Cellar/llvm/19.1.7/lib/libLLVM.dylib", (19, 1, 7)),
        ("Cellar/llvm@18/18.1.8_1/lib/libLLVM.dylib", (18, 1, 8)),
        ("libLLVM.so", ()),
    ],
)
def test_the_version_is_read_from_the_name(tmp_path, name, version):
    file = tmp_path / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"")
    assert llvm._version(file) == version


def test_preparing_is_silent_where_ensuring_is_not():
    text = python(HIDE_ALL + "print(llvm.prepare())\n" + TRY)
    assert text.splitlines()[0] == "None" and "UrushiError" in text
