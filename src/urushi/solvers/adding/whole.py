"""From a description to a solution: bind, choose nodes, solve, refine."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from numbers import Integral
from typing import Any

import drjit as dr
import numpy as np

from urushi import llvm
from urushi.errors import OutOfReach, UrushiError
from urushi.stack import Stack

from ..arrays import padded
from ..bound import BoundStack
from ..direct import direct, direct_is_certain
from . import build
from .basis import Grid
from .core import Closed
from .delta_m import peaked
from .layers import MediumLayer
from .media import METHODS, Method
from .once import covers, peaks
from .refine import AZIMUTHS, COSINES, GROWTH, MOST_NODES, Seen, difference, exits, refine
from .solution import Solution
from .solver import cut, solve_on
from .spectrum import Spectrum
from .table import SIDES
from .threads import one_thread
from .through import Through, anywhere, met

#: fewest nodes to try a grid with, and most in a panel to begin with
FEWEST, MOST = 24, 160
#: the first steps of `refine` where nodes are close together towards the normal
SHORT = 0.65
#: see `solution`
Keep = Callable[[list[int], Callable[[], Solution]], Solution]


def solution(
    stack: Stack | Spectrum,
    accuracy: float,
    nodes: int | Sequence[int] | None = None,
    progress: Callable[[int, float], Any] | None = None,
    extra: Sequence[float] = (),
    keep: Keep | None = None,
    orders: int | None = None,
    media: Method = METHODS[0],
) -> Solution:
    """The operators of a stack.

    Args:
        stack: the description, or one with the channels that are given beside it.
        accuracy, nodes, progress, orders, media: as in `urushi.solvers.adding.solve`.
        extra: its `indices`.
        keep: asked for every solution: given the numbers of nodes per panel and what makes it, it may have one.
    """
    problem = _Problem(stack, accuracy, extra, orders, media)
    counts = problem.counts(nodes)
    heights = _heights(problem.every.thirds, problem.indices)
    with one_thread():
        found = refine(
            problem.solve if keep is None else lambda n: keep(n, lambda: problem.solve(n)),
            counts,
            accuracy,
            nodes is None,
            progress,
            heights,
            problem.closed,
            1.0 if problem.squeeze == 1 else SHORT,
        )
        return found if orders is None else _with_left_out(problem, found, orders, heights)


def unchecked(stack: Stack, accuracy: float, nodes: Sequence[int]) -> Solution:
    """The operators on so many nodes per panel, whatever their error: what half of `solution` takes."""
    with one_thread():
        return _Problem(stack, accuracy, ()).solve(list(nodes))


def apart(stack: Stack, one: Solution, other: Solution) -> float:
    """By how much two solutions of a stack differ, in energies and relative to the peak of the BSDF (see `refine`)."""
    problem = _Problem(stack, 1e-3, ())
    seen = Seen(one, problem.closed), Seen(other, problem.closed)
    return difference(*seen, _heights(problem.every.thirds, problem.indices))


class _Problem:
    """A stack that is bound, ready to be solved on any nodes."""

    def __init__(
        self,
        stack: Stack | Spectrum,
        accuracy: float,
        extra: Sequence[float],
        orders: int | None = None,
        media: Method = METHODS[0],
    ) -> None:
        llvm.ensure()
        spectrum = stack if isinstance(stack, Spectrum) else Spectrum.of(stack)
        self.every = spectrum.bind(build.solvable)
        self.bound, self.colours = self.every.whole, self.every.channels
        self.phases = build.phase_functions(spectrum.stacks[0])
        self.sharp = any(map(peaked, self.phases))
        self.indices, self.extra = build.indices(self.bound), tuple(extra)
        self.accuracy, self.tolerance = accuracy, 0.1 * accuracy
        self.orders, self.media = orders, media

    @cached_property
    def _plan(self) -> tuple[list[int], float]:
        return build.counts(self.bound, self.phases, self.accuracy, bool(self.extra))

    @property
    def squeeze(self) -> float:
        """How much closer together nodes are towards the normal: where nothing is rough, not at all."""
        smooth = all(interface.delta is True for interface in self.bound.interfaces)
        return 1.0 if smooth else self._plan[1]

    def solve(self, counts: list[int]) -> Solution:
        bound = self.bound
        grid = replace(
            Grid.build([*self.indices, *self.extra], counts, self.squeeze), indices=tuple(self.indices)
        )
        layers = self.every.layers(self.phases, grid, self.tolerance, bool(self.extra), method=self.media)
        found = solve_on(bound, grid, layers, self.colours, self.tolerance, bool(self.extra), self.orders)
        media = [layer for layer in layers if isinstance(layer, MediumLayer)]
        regions = [r for r, medium in enumerate(bound.media) if medium is not None]
        for region, medium in zip(regions, media, strict=True):
            found.forward[region] = medium.truncated.forward
            found.terms[region] = len(medium.truncated.moments)
        return found

    def closed(self, solution: Solution) -> dict[tuple[bool, bool], np.ndarray]:
        """What fades in media, where `refine` looks, if how it does depends on the nodes (see `Seen`)."""
        if not self.sharp or solution.closed_form in ("interface", None):
            return {}
        solution.peaks.update(peaks(self.bound, self.phases, solution.terms))
        thirds = self.every.thirds
        found = {}
        for side in solution.parts:
            if covers(self.bound, *side) or met(self.bound, *side) is not None:
                values = [_values(self.indices, side, Closed(bound, solution).eval) for bound in thirds]
                if len(values) > 1:
                    values = [np.broadcast_to(v, (3, *v.shape[1:])) for v in values]
                found[side] = np.concatenate(values)[: self.colours]
        return found

    def counts(self, nodes: int | Sequence[int] | None) -> list[int]:
        """Nodes per panel to begin with, or those that are asked for."""
        panels = len(Grid.build([*self.indices, *self.extra], FEWEST).panels)
        if nodes is None:
            if sum(self._plan[0]) > MOST_NODES:
                raise OutOfReach(
                    f"accuracy: found {self.accuracy:g}, but the narrowest lobe of the stack would take "
                    f"{sum(self._plan[0])} nodes; allowed: what {MOST_NODES} can do, fixed nodes=..., or another method"
                )
            own = [min(n, MOST) for n in self._plan[0]]
            return own if len(own) == panels else [own[0], *[own[-1]] * (panels - 1)]
        counts: list[Any] = list(nodes) if np.iterable(nodes) else [nodes] * panels
        if len(counts) != panels or not all(isinstance(n, Integral) and int(n) >= 4 for n in counts):
            raise UrushiError(
                f"nodes: found {nodes!r}; allowed: one whole number, or one for each of {panels} "
                "different indices, each at least 4"
            )
        return [int(n) for n in counts]


def _with_left_out(
    problem: _Problem, found: Solution, orders: int, heights: Mapping[tuple[bool, bool], np.ndarray] | None
) -> Solution:
    """A solution of so many orders, told what the others would have changed: fewer nodes know that."""
    counts = [max(int(panel.count / GROWTH), 4) for panel in found.grid.panels]
    all_orders = copy.copy(problem)
    all_orders.orders = None
    every = all_orders.solve(counts)
    error = float(f"{difference(cut(every, orders), every, heights):.2e}")
    said = found.diagnostics | {"fixed_orders": orders, "left_out": error}
    return replace(
        found, diagnostics=said | {"estimated_error": found.diagnostics["estimated_error"] + error}
    )


def _heights(
    thirds: Sequence[BoundStack], indices: Sequence[float]
) -> dict[tuple[bool, bool], np.ndarray] | None:
    """The largest f of what interfaces have a closed form where `refine` looks (see `difference`); None without any.

    Of all channels, three of which each of the stacks has.
    """
    stack = thirds[0]
    smooth = stack.interfaces[0].delta is True and stack.interfaces[-1].delta is True
    if (smooth and not anywhere(stack)) or not direct_is_certain(stack):
        return None
    found = {}
    for side in ((True, True),) if stack.opaque else SIDES:
        every = [_values(indices, side, partial(direct, third)) for third in thirds]
        if met(stack, *side) is not None:
            every += [_values(indices, side, Through(third, {}).eval) for third in thirds]
        found[side] = np.concatenate(every).max(axis=(0, 2, 3))
    return found


def _values(
    indices: Sequence[float], side: tuple[bool, bool], closed: Callable[[Any, Any], Any]
) -> np.ndarray:
    """(C, I, O, A) f of a closed form where `refine` looks."""
    from drjit.llvm.ad import Array3f64, Float64

    mu_o = exits(indices, side)
    up_i, up_o = (1.0 if above else -1.0 for above in side)
    i, o, phi = np.broadcast_arrays(COSINES[:, None, None], mu_o[..., None], AZIMUTHS)
    i, o, phi = (Float64(padded(x)) for x in (i, o, phi))
    wi = Array3f64(-dr.sqrt(1 - i * i), 0, up_i * i)
    sin = dr.sqrt(1 - o * o)
    wo = Array3f64(sin * dr.cos(phi), sin * dr.sin(phi), up_o * o)
    value = np.array(closed(wi, wo)).reshape(-1, len(COSINES), mu_o.shape[1], len(AZIMUTHS))
    found: np.ndarray = value / mu_o[..., None]
    return found
