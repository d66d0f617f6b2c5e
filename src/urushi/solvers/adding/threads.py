"""One thread at a time for the small matrices.

OpenBLAS, which numpy brings along, splits every product and every decomposition over all cores. Of matrices of a
hundred nodes, thousands one after another, that makes waiting out of working: on two cores that others use too,
thirty times slower; on many it is no better. There is no switch for it in numpy, but in the library itself.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_lock = threading.Lock()
_inside = 0
_before = 0


@contextmanager
def one_thread() -> Iterator[None]:
    """While inside, numpy's linear algebra runs on the calling thread; without effect where numpy has another library.

    May be nested, and used by several threads at once. Serves as a decorator, too.
    """
    global _inside, _before
    found = _switch()
    if found is None:
        yield
        return
    read, write = found
    with _lock:
        if _inside == 0:
            _before = read()
            write(1)
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                write(_before)


@cache
def _switch() -> tuple[Callable[[], int], Callable[[int], Any]] | None:
    """How to read and set the number of threads of the OpenBLAS beside numpy."""
    for path in sorted(Path(f"{Path(np.__file__).parent}.libs").glob("*openblas*")):
        try:
            library = ctypes.CDLL(str(path))
        except OSError:
            continue
        for name in (
            "scipy_openblas_{}_num_threads64_",
            "scipy_openblas_{}_num_threads",
            "openblas_{}_num_threads",
        ):
            if hasattr(library, name.format("set")):
                return getattr(library, name.format("get")), getattr(library, name.format("set"))
    return None
