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
_limit: Any = None


@contextmanager
def one_thread() -> Iterator[None]:
    """While inside, numpy's linear algebra runs on the calling thread.

    May be nested, and used by several threads at once. Serves as a decorator, too.
    """
    global _inside, _limit
    with _lock:
        if _inside == 0:
            _limit = _controller().limit(limits=1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _limit.restore_original_limits()


@cache
def _controller() -> ThreadpoolController:
    """Found once: looking for the libraries takes longer than a small matrix."""
    return ThreadpoolController()
