"""From a description to a solution: bind, choose nodes, solve, refine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from urushi import llvm
from urushi.errors import UrushiError
from urushi.stack import Stack

from . import build
from .basis import Grid
from .layers import MediumLayer
from .refine import refine
from .solution import Solution
from .solver import solve_on
from .threads import one_thread

#: fewest nodes to try a grid with
FEWEST = 24
#: see `solution`
Keep = Callable[[list[int], Callable[[], Solution]], Solution]


def solution(
    stack: Stack,
    accuracy: float,
    nodes: int | Sequence[int] | None = None,
    progress: Callable[[int, float], Any] | None = None,
    extra: Sequence[float] = (),
    keep: Keep | None = None,
) -> Solution:
    """The operators of a stack.

    Args:
        stack, accuracy, nodes, progress: as in `urushi.solvers.adding.solve`.
        extra: its `indices`.
        keep: asked for every solution: given the numbers of nodes per panel and what makes it, it may have one.
    """
    llvm.ensure()
    bound, colours = build.bind_numbers(stack)
    phases = build.phase_functions(stack)
    indices = build.indices(bound)
    tolerance = 0.1 * accuracy

    def on(counts: list[int]) -> Solution:
        grid = replace(Grid.build([*indices, *extra], counts), indices=tuple(indices))
        layers = build.layers(bound, phases, grid, tolerance)
        found = solve_on(bound, grid, layers, colours, tolerance, bool(extra))
        media = [layer for layer in layers if isinstance(layer, MediumLayer)]
        regions = [r for r, medium in enumerate(bound.media) if medium is not None]
        for region, medium in zip(regions, media, strict=True):
            found.forward[region] = medium.truncated.forward
        return found

    panels = len(Grid.build([*indices, *extra], FEWEST).panels)
    own = build.counts(bound, phases, accuracy)
    counts = [own[0], *[own[-1]] * (panels - 1)]
    if nodes is not None:
        counts = [nodes] * len(counts) if isinstance(nodes, int) else list(nodes)
        if len(counts) != panels or min(counts) < 4:
            raise UrushiError(
                f"nodes: found {nodes}; allowed: one number, or one for each of {panels} "
                "different indices, each at least 4"
            )
    with one_thread():
        return refine(
            on if keep is None else lambda n: keep(n, lambda: on(n)),
            counts,
            accuracy,
            nodes is None,
            progress,
        )
