"""What depends on nothing but numbers that are the same for all lanes is computed once, not in every lane.

A stack without textures has such numbers only: a table of four axes then becomes one of two, a mean over the
hemisphere a number. Results are kept, with the numbers they are for, while these are used; whoever wants
derivatives, has one value per lane, or is inside a symbolic loop or call, computes as before.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

#: how many results are kept
MOST = 512

_lock = threading.Lock()
_kept: OrderedDict[tuple[Any, ...], tuple[Any, Any]] = OrderedDict()


def settled(name: Any, numbers: Sequence[Any], compute: Callable[[], Any]) -> Any:
    """`compute()`, or what it gave before for the very same numbers; None where these are none of this kind.

    Args:
        name: what is computed.
        numbers: all that it depends on: Dr.Jit values.
        compute: gives a Dr.Jit value, or a list of them.
    """
    parts = [part for number in numbers for part in _parts(number)]
    for part in parts:
        if not dr.is_jit_v(part) or dr.width(part) != 1 or dr.grad_enabled(part):
            return None
    if not parts or dr.flag(dr.JitFlag.SymbolicScope):
        return None
    key = (name, *((type(part), part.index) for part in parts))
    with _lock:
        known = _kept.get(key)
        if known is not None:
            _kept.move_to_end(key)
            return known[1]
    found = compute()
    dr.eval(found)
    with _lock:
        _kept[key] = parts, found  # the numbers, too: as long as they are kept, no others have their indices
        if len(_kept) > MOST:
            _kept.popitem(last=False)
    return found


def _parts(number: Any) -> list[Any]:
    if dr.is_array_v(number) and dr.size_v(number) != dr.Dynamic:
        return [number[i] for i in range(dr.size_v(number))]
    return [number]
