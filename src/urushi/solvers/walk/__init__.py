"""The walk: position-free Monte Carlo, unbiased for any stack.

The sum of all ways through a stack is a geometric series; the walk samples it term by term. It follows one path of
light through interfaces and media, without caring where along the surface it wanders, and at every event asks how much
would leave along wo. The mean of many paths is the truth, whatever the layers; the rest is variance.

    walk       one path and what it says about f(wi, wo)            exit     where a path must head to leave along wo
    trace      one path and where its light ends up                 core     all of it, as a BSDF on Dr.Jit arrays
    sharp      light between smooth interfaces that are not parallel
    coated     one path between a coat and a rough metal            ends     at which end it begins
    opposite   which of two facets it meets                         stages   many paths, packed together on the way
    proposal   where to send samples: a mixture of known density

Sources: Pharr & Hanrahan 2000; Guo, Hasan & Zhao 2018.
"""

from __future__ import annotations

import sys
from typing import Any

from urushi import llvm
from urushi.stack import Stack

#: what `solve` takes besides the stack
OPTIONS = ("samples", "seed", "max_depth", "parameters", "backend", "precision", "mode")


def reasons_against(_stack: Stack) -> list[str]:
    """What of a stack the walk cannot do: nothing."""
    return []


def solve(stack: Stack, **options: Any) -> Any:
    """A `WalkBSDF`; see `urushi.solvers.walk.result.WalkBSDF` for the options."""
    if "drjit" not in sys.modules:
        llvm.prepare()  # before Dr.Jit takes the first LLVM it finds
    from .result import WalkBSDF

    return WalkBSDF(stack, **options)
