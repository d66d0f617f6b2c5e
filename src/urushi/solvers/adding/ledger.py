"""The ledger of adding: fluxes between the layers, and what is missing of them behind each.

What layers do together says nothing of what goes on between them. But the same operators, put together from the bottom
up, tell the reflection of all that lies below every layer, and with it the light that travels down and up there
(`urushi.adding.within`). What goes into a layer less what comes out is what it keeps. Azimuths do not matter: order 0
is enough. A stack that scatters nothing needs no nodes at all, its ledger is one of plain numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from urushi.stack import Stack

from ...adding import Slab, within
from ...interfaces import Interface
from ...optics.random import generator
from ..arrays import mapped, padded
from ..bound import BoundStack
from ..ledger import Ledger, coloured, filed, owners
from ..smooth import cosines, layers
from . import build
from .basis import Grid
from .operator import OPERATORS, Operator, identity
from .smooth import nothing
from .solution import Solution
from .threads import one_thread

#: Gauss points along each random number of a facet: its mean absorption is good to 1e-5
POINTS = 32


@dataclass(frozen=True)
class Place:
    """A layer of the pile: an interface, or the medium of a region."""

    medium: bool
    number: int
    layer: int | None


@dataclass(frozen=True)
class Interior:
    """What of the light from every node goes where.

    Attributes:
        stack: the description.
        bound: the same in double precision.
        grid: the nodes; None where nothing scatters, and no nodes are needed.
        shares: by side that the light comes from, (2 + places + 1, C, n): reflected, transmitted, kept in every place,
            and how much of the last is lost between facets.
        order: nodes that a direction is interpolated from.
    """

    stack: Stack
    bound: BoundStack
    grid: Grid | None
    shares: dict[bool, np.ndarray]
    order: int

    @classmethod
    @one_thread()
    def solve(cls, stack: Stack, solution: Solution, order: int) -> Interior:
        """The light inside a solved stack.

        Args:
            order: nodes that a direction is interpolated from.
        """
        bound, _ = build.bind_numbers(stack)
        still = all(interface.delta is True for interface in bound.interfaces)
        if still and not any(medium is not None and medium.scatters for medium in bound.media):
            return cls(stack, bound, None, {}, order)
        grid = solution.grid
        tolerance = 0.1 * float(solution.diagnostics.get("accuracy", 1e-3))
        every = build.layers(bound, build.phase_functions(stack), grid, tolerance)
        pile = [
            nothing(grid.count(place.number)) if layer is None else layer.slab(range(1), 0)
            for place, layer in zip(_places(stack), every, strict=True)
        ]
        shares = {True: _shares(pile, len(grid.mu[0]), _taken(bound, grid))}
        if not bound.opaque:
            upside_down = [slab.turned_over() for slab in reversed(pile)]
            below = _shares(upside_down, len(grid.mu[-1]), None)
            below[2:-1] = below[2:-1][::-1]
            shares[False] = below
        return cls(stack, bound, grid, shares, order)

    def ledger(self, wi: np.ndarray) -> Ledger:
        """The ledger for directions (N, 3)."""
        places = _places(self.stack)
        found = self._closed(wi, len(places)) if self.grid is None else self._interpolated(wi)
        absorbed: dict[int, np.ndarray] = {}
        lost: dict[int, np.ndarray] = {}
        for place, kept in zip(places, found[2:-1], strict=True):
            if place.layer is None:
                continue
            if place.medium:
                absorbed[place.layer] = kept
            elif self.bound.interfaces[place.number].opaque:
                absorbed[place.layer], lost[place.layer] = kept - found[-1], found[-1]
            else:
                lost[place.layer] = kept
        return filed(self.stack, wi, (found[0], found[1]), absorbed, lost)

    def _interpolated(self, wi: np.ndarray) -> list[np.ndarray]:
        """(N, C) every share, between the nodes."""
        assert self.grid is not None
        one = next(iter(self.shares.values()))
        found = np.zeros((len(one), len(wi), one.shape[1]))
        for above, shares in self.shares.items():
            here = (wi[:, 2] > 0) == above
            region = 0 if above else len(self.grid.indices) - 1
            stencil = self.grid.stencil(region, np.minimum(np.abs(wi[here, 2]), 1), self.order)
            found[:, here] = np.einsum("xcnk,nk->xnc", shares[:, :, stencil.node], stencil.even)
        return [coloured(share) for share in found]

    def _closed(self, wi: np.ndarray, places: int) -> list[np.ndarray]:
        """The same of a stack that scatters nothing, in closed form."""
        from drjit.llvm import ad

        found: list[np.ndarray] = []
        for above in (True, False):
            here = (wi[:, 2] > 0) == above
            if not here.any():
                continue

            def run(w: Any, above: bool = above) -> tuple[Any, ...]:
                pile = layers(self.bound, cosines(self.bound, w, above))
                pile = pile if above else [slab.turned_over() for slab in reversed(pile)]
                down, up = within(pile, 1.0)
                kept = _kept(down, [*up, 0.0])
                return up[0], down[-1], *(kept if above else reversed(kept))

            values = [coloured(x) for x in mapped(run, (wi[here],), ad, True)]
            found = found or [np.zeros((len(wi), x.shape[1])) for x in values]
            for whole, part in zip(found, values, strict=True):
                whole[here] = part
        assert len(found) == 2 + places
        return [*found, np.zeros_like(found[0])]


def _places(stack: Stack) -> list[Place]:
    """The layers of the pile, top down: an interface, the medium below it where there is one, an interface, ..."""
    interfaces, media = owners(stack)
    found = []
    for k, layer in enumerate(interfaces):
        found.append(Place(False, k, layer))
        if k + 1 < len(media) and media[k + 1] is not None:
            found.append(Place(True, k + 1, media[k + 1]))
    return found


def _shares(pile: list[Slab], n: int, taken: np.ndarray | None) -> np.ndarray:
    """(3 + places, C, n) shares of light from above (see `Interior`), for `taken` (C, n_base) or None of the base."""
    down, up = within(pile, identity(n), OPERATORS)
    albedos = [[light.albedo() for light in lights] for lights in (down, up)]
    kept = _kept(albedos[0], [*albedos[1], np.zeros((1, n))])
    shadowed = np.zeros((1, n))
    if taken is not None:
        arriving: Operator = down[-2]
        shadowed = kept[-1] - (taken[:, :, None] * arriving.matrix(0)).sum(axis=1)
    found = [albedos[1][0], albedos[0][-1], *kept, shadowed]
    colours = max(len(share) for share in found)
    return np.array([np.broadcast_to(share, (colours, n)) for share in found])


def _kept(down: list[Any], up: list[Any]) -> list[Any]:
    """What goes into every layer less what comes out."""
    return [
        above + from_below - back - on
        for (above, on), (back, from_below) in zip(pairwise(down), pairwise(up), strict=True)
    ]


def _taken(stack: BoundStack, grid: Grid) -> np.ndarray | None:
    """(C, n) what facets of the base absorb of the light from each node; None where nothing is lost between them."""
    base: Interface = stack.interfaces[-1]
    if not base.opaque:
        return None
    from drjit.llvm.ad import Array3f64, Float64, UInt

    mu = grid.mu[len(stack.interfaces) - 1]
    x, weight = np.polynomial.legendre.leggauss(POINTS)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    cos, u1, u2 = (padded(a) for a in np.meshgrid(mu, x, x, indexing="ij"))
    w = Array3f64(padded(np.sqrt((1 - cos) * (1 + cos))), 0, cos)
    rng = generator(w, [*w, Float64(u1), Float64(u2)], 0, UInt(0))
    event = base.sample(w, (Float64(0.5), Float64(u1), Float64(u2)), True, rng=rng)
    taken = base.absorbs(w, event)
    if taken is None:
        return None
    values = numbers_of(taken + 0 * w.x).reshape(-1, len(mu), POINTS, POINTS)
    return np.einsum("cnij,i,j->cn", values, weight, weight)


def numbers_of(value: Any) -> np.ndarray:
    """(C, N) a number or a colour for every lane, out of Dr.Jit."""
    return np.atleast_2d(np.array(value, dtype=float))
