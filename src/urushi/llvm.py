"""Where Dr.Jit's CPU backend gets LLVM from, settled before Dr.Jit looks for it.

Dr.Jit loads the LLVM shared library the moment `drjit` is imported, takes the first one it finds on the
system, and accepts LLVM 15, which later aborts the whole process. `ensure` therefore runs before that
import and names a library that works, in the order of what a user would expect:

1. `DRJIT_LIBLLVM_PATH`, when the user has set it,
2. the library inside the wheel `karellen-llvm-core`, which is installed with Urushi where it exists,
3. a system LLVM that is new enough.

When Dr.Jit is imported already there is nothing left to choose: `ensure` then reports what it loaded, or
says what to do about it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from urushi.errors import UrushiError

VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"
OLDEST = 16
"""The oldest major version of LLVM that works: Dr.Jit refuses 14, and accepts 15 but then aborts."""

HOW = (
    f"Install the wheel ({'pip install ' + WHEEL}; Linux on x86-64) or LLVM {OLDEST} or newer "
    "(macOS: brew install llvm; Debian, Ubuntu: apt install libllvm19; Windows: the LLVM installer), "
    f"or set {VARIABLE} to the path of its shared library."
)


@dataclass(frozen=True)
class LLVM:
    """An LLVM shared library that Dr.Jit uses or will use.

    Attributes:
        path: the file, or None when Dr.Jit loaded it before Urushi and the system does not say from where.
        origin: who chose it: the variable's name, the wheel's name, "system" or "already loaded".
        version: (major, minor, patch), as far as known; () when it cannot be told.
    """

    path: Path | None
    origin: str
    version: tuple[int, ...]

    def __str__(self) -> str:
        number = ".".join(map(str, self.version)) or "of unknown version"
        return f"LLVM {number} at {self.path or 'an unknown place'} ({self.origin})"


def ensure() -> LLVM:
    """Make sure that Dr.Jit has an LLVM it can use, and say which; call it before importing `drjit`.

    Sets the environment variable `DRJIT_LIBLLVM_PATH` (so that child processes agree) unless Dr.Jit is
    imported already. Cheap to call again.

    Returns:
        The library.

    Raises:
        UrushiError: there is none, the user's choice cannot work, or Dr.Jit was imported earlier and
            loaded one that cannot work. The message says what to do.
    """
    if "drjit" in sys.modules:
        return _loaded(sys.modules["drjit"])
    if chosen := os.environ.get(VARIABLE):
        return _chosen(Path(chosen))
    for library in (*_from_wheel(), *_from_system()):
        if library.version and library.version[0] >= OLDEST:
            os.environ[VARIABLE] = str(library.path)
            return library
    old = sorted({library.version[0] for library in _from_system() if library.version})
    seen = f" The system has only LLVM {', '.join(map(str, old))}, which is too old." if old else ""
    raise UrushiError(f"no LLVM was found that Dr.Jit can use.{seen} {HOW}")


def prepare() -> None:
    """As `ensure`, but without a word when there is none: for the moment of import, when it may not matter."""
    with contextlib.suppress(UrushiError):
        ensure()


@cache
def _loaded(drjit: Any) -> LLVM:
    """What Dr.Jit, imported already, has loaded."""
    version = tuple(drjit.detail.llvm_version())
    path = _mapped()
    if version[0] < 0:
        raise UrushiError(
            "Dr.Jit was imported before Urushi and found no LLVM that works. "
            f"Import urushi.mitsuba before mitsuba and drjit, or set {VARIABLE} in the environment. {HOW}"
        )
    if version[0] < OLDEST:
        raise UrushiError(
            f"Dr.Jit was imported before Urushi and loaded LLVM {version[0]}"
            f"{f' from {path}' if path else ''}; it needs {OLDEST} or newer, older ones abort the process. "
            f"Import urushi.mitsuba before mitsuba and drjit, or set {VARIABLE} in the environment. {HOW}"
        )
    variable = os.environ.get(VARIABLE)
    if variable and (path is None or _same(path, Path(variable))):
        return LLVM(Path(variable), _origin(Path(variable)), version)
    return LLVM(path, "already loaded", version)


def _chosen(path: Path) -> LLVM:
    """The library that the environment variable names."""
    # A bare file name is legitimate too: the dynamic loader then searches its own folders.
    if path.parent != Path(".") and not path.is_file():
        raise UrushiError(f"{VARIABLE} names {path}, and there is no such file. {HOW}")
    for library in _from_wheel():
        if path == library.path:
            return library  # chosen by an earlier call, or by a parent process
    version = _version(path)
    if version and version[0] < OLDEST:
        raise UrushiError(
            f"{VARIABLE} names LLVM {version[0]} ({path}); Dr.Jit needs {OLDEST} or newer, "
            f"older ones abort the process. {HOW}"
        )
    return LLVM(path, _origin(path), version)


def _origin(path: Path) -> str:
    """Who chose `path`: a parent process that asked for the wheel leaves the same trace as a user."""
    return WHEEL if any(_same(path, library.path) for library in _from_wheel()) else VARIABLE


def _same(one: Path, other: Path | None) -> bool:
    return other is not None and os.path.realpath(one) == os.path.realpath(other)


# ------------------------------------------------------------------------------------------ places


def _from_wheel() -> Iterator[LLVM]:
    """The library of the wheel, wherever its files were installed (environment, user, other prefix)."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return
    # The plain names are links that the wheel makes on the next start of Python; the real file is there now.
    for file in sorted(files, key=lambda file: len(file.name), reverse=True):
        if re.fullmatch(r"libLLVM\.so\.[\d.]+|libLLVM\.dylib|LLVM-C\.dll", file.name):
            path = Path(os.path.normpath(str(file.locate())))
            # Asking also proves that the file loads, which it does not until those links are made.
            if path.is_file() and (version := _asked(path)):
                yield LLVM(path, WHEEL, version)


def _from_system() -> list[LLVM]:
    """The LLVM libraries of the system, newest first."""
    libraries = {}
    for path in _candidates():
        real = Path(os.path.realpath(path))
        if real not in libraries and real.is_file():
            libraries[real] = LLVM(path, "system", _version(real))
    return sorted(libraries.values(), key=lambda library: library.version, reverse=True)


def _candidates() -> Iterator[Path]:
    """Files that may be an LLVM shared library, in the places where systems put them."""
    if sys.platform == "win32":
        roots = [os.environ.get("PROGRAMFILES", r"C:\Program Files"), os.environ.get("LOCALAPPDATA", "")]
        yield from (Path(root, "LLVM", "bin", "LLVM-C.dll") for root in roots if root)
        yield from (Path(folder, "LLVM-C.dll") for folder in os.environ.get("PATH", "").split(os.pathsep))
        return
    if sys.platform == "darwin":
        for root in ("/opt/homebrew", "/usr/local"):
            yield from Path(root, "opt").glob("llvm*/lib/libLLVM*.dylib")
        yield from Path("/opt/local/libexec").glob("llvm-*/lib/libLLVM*.dylib")
        return
    folders = [Path(f) for f in os.environ.get("LD_LIBRARY_PATH", "").split(":") if f]
    folders += [Path("/usr/lib64"), Path("/usr/lib"), Path("/usr/local/lib"), Path("/lib64")]
    folders += sorted(Path("/usr/lib").glob("*-linux-gnu*"))
    folders += sorted(Path("/usr/lib").glob("llvm*/lib*")) + sorted(Path("/usr/lib64").glob("llvm*/lib*"))
    if "CONDA_PREFIX" in os.environ:
        folders.append(Path(os.environ["CONDA_PREFIX"], "lib"))
    for folder in folders:
        yield from sorted(folder.glob("libLLVM*.so*"))


def _mapped() -> Path | None:
    """The LLVM library that is loaded into this process, where the system tells (Linux)."""
    try:
        lines = Path("/proc/self/maps").read_text("utf-8", "replace").splitlines()
    except OSError:
        return None
    for line in lines:
        name = line.split(maxsplit=5)[-1]
        if re.match(r"libLLVM[-.\d]", Path(name).name):
            return Path(name)
    return None


# --------------------------------------------------------------------------------------- versions


def _version(path: Path) -> tuple[int, ...]:
    """The version of an LLVM library, from its name where possible, else by asking it; () if unknown."""
    real = Path(os.path.realpath(path))
    if named := re.fullmatch(r"libLLVM[-.](?:so\.)?(\d+(?:\.\d+)*)(?:\.so.*|\.dylib)?", real.name):
        return tuple(map(int, named[1].split(".")))
    # Homebrew keeps the version in the folder: .../Cellar/llvm/19.1.7/lib/libLLVM.dylib
    if placed := re.search(r"/llvm(?:@\d+)?/(\d+)\.(\d+)\.(\d+)[^/]*/lib/", real.as_posix()):
        return tuple(map(int, placed.groups()))
    return _asked(path)


def _asked(path: Path) -> tuple[int, ...]:
    """Load the library and ask; the function exists since LLVM 16, so one without it is older."""
    try:
        get = ctypes.CDLL(str(path)).LLVMGetVersion
    except OSError:
        return ()
    except AttributeError:
        return (OLDEST - 1,)
    numbers = [ctypes.c_uint() for _ in range(3)]
    get(*map(ctypes.byref, numbers))
    return tuple(number.value for number in numbers)
