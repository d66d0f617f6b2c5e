"""Derivatives in reverse mode beside differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


def slopes(values: Callable[[Any], Sequence[Any]], value: float, half: float) -> list[tuple[float, float]]:
    """Of each of some values, by Dr.Jit in reverse mode and by a central difference, in double precision.

    Args:
        values: of a parameter, a number of one lane each.
        value, half: the parameter, and how far to go to either side of it.
    """
    import drjit as dr
    from drjit.llvm.ad import Float64

    high, low = ([v[0] for v in values(Float64(value + step))] for step in (half, -half))
    found = []
    for k, (above, below) in enumerate(zip(high, low, strict=True)):
        x = Float64(value)
        dr.enable_grad(x)
        dr.backward(values(x)[k])
        found.append((float(dr.grad(x)[0]), float(above - below) / (2 * half)))
    return found
