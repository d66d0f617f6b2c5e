"""One thread at a time for the small matrices.

numpy's linear algebra splits every product and every decomposition over all cores. Of matrices of a hundred nodes,
thousands one after another, that makes waiting out of working: on two cores that others use too, thirty times slower;
on many it is no better.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController

_lock = threading.Lock()
_inside = 0
_before: list[tuple[Any, int]] = []


@contextmanager
def one_thread() -> Iterator[None]:
    """While inside, numpy's linear algebra runs on the calling thread.

    May be nested, and used by several threads at once. Serves as a decorator, too.
    """
    global _inside, _before
    with _lock:
        if _inside == 0:
            _before = [(library, library.num_threads) for library in _libraries()]
            for library, _ in _before:
                library.set_num_threads(1)
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                for library, count in _before:
                    library.set_num_threads(count)


@cache
def _libraries() -> list[Any]:
    """The libraries of linear algebra. Found once: looking for them takes longer than a small matrix."""
    return [library for library in ThreadpoolController().lib_controllers if library.user_api == "blas"]
