"""A part of a solution at any pair of directions: interpolation between nodes, on Dr.Jit arrays.

What is interpolated is the symmetric and everywhere finite

    q(o, i, phi) = k(o <- i, phi) (mu_o + mu_i) / (mu_o n_o^2)

(k the flux density, mu and n of the regions outside; theory (basis.16)), in both polar angles by `stencil`, at fixed
azimuth: each pair of nodes has its own short series in its own stretched azimuth (`warp`). Values below 0, which
interpolation may leave where there is next to no light, become 0 in the sum, never in a term.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, Vector, at_least, at_most
from ..arrays import number_type
from . import warp
from .solution import Block, Part, Solution
from .stencil import Lookup, Stencils, away_and_toward

#: nodes that a direction is interpolated from, in each polar angle
ORDER = 6
#: error of the azimuthal series, relative to the error of the solution: where that is not known, and its range
SHARE, UNKNOWN, LEAST, MOST = 0.03, 1e-5, 1e-6, 1e-3


class Series:
    """The short azimuthal series of all parts of a solution, in numpy.

    Attributes:
        parts: the keys (from above, to above), in the order they are stored in.
        values: for each, (n_out, n_in, C, K) coefficients of q.
        width: for each, (n_out, n_in).
        error: the largest error of a series, relative to the peak of its incident direction.
    """

    def __init__(self, solution: Solution) -> None:
        self.parts = [key for key in SIDES if key in solution.parts]
        error = solution.diagnostics.get("estimated_error")
        tolerance = UNKNOWN if error is None else min(max(SHARE * error, LEAST), MOST)
        fitted: list[tuple[np.ndarray, np.ndarray, float]] = []
        for key in self.parts:
            twin = solution.twin(key, self.parts[: len(fitted)])
            if twin is not None:
                fitted.append(fitted[self.parts.index(twin)])
                continue
            blocks, shape = _blocks(solution, solution.parts[key])
            if key == (False, True) and _reversed(blocks, _blocks(solution, solution.parts[True, False])[0]):
                # The same q the other way, to the last digit: reciprocity is not left to the choice of widths.
                values, width, off = fitted[self.parts.index((True, False))]
                fitted.append((values.transpose(1, 0, 2, 3), width.T, off))
            else:
                fitted.append(warp.fit(blocks, shape, tolerance))
        self.terms: int = max(found[0].shape[-1] for found in fitted)
        self.values: list[np.ndarray] = [
            np.pad(v, ((0, 0),) * 3 + ((0, self.terms - v.shape[-1]),)) for v, _, _ in fitted
        ]
        self.width = [width for _, width, _ in fitted]
        self.error: float = max(off for _, _, off in fitted)

    @property
    def empty(self) -> bool:
        """True if there is nothing but what has closed forms."""
        return not any(values.any() for values in self.values)


#: (from above, to above) in the order of storage
SIDES = ((True, True), (True, False), (False, True), (False, False))


class Table:
    """`Series` between the nodes.

    Args:
        solution: the solved stack.
        series: its series.
        stencils: the nodes outside, in the module and precision to compute in.
        signed: whether values below 0 stay, to be taken off a closed form.
    """

    def __init__(
        self,
        solution: Solution,
        series: Series,
        stencils: Stencils,
        module: Any,
        double: bool,
        signed: bool = False,
    ) -> None:
        number = number_type(module, double)
        self.number, self.signed = number, signed
        self.stencils, self.terms, self.colours = stencils, series.terms, solution.colours
        self.opaque = (True, False) not in solution.parts
        self.counts = [stencils.counts[0], stencils.counts[-1]]
        self.squared_index = [solution.grid.indices[0] ** 2, solution.grid.indices[-1] ** 2]
        sizes = [values.shape[0] * values.shape[1] for values in series.values]
        self.starts = [0, *np.cumsum(sizes)[:-1].tolist()]
        self.values = Lookup(np.concatenate([values.ravel() for values in series.values]), number)
        self.squared_width = Lookup(np.concatenate([width.ravel() ** 2 for width in series.width]), number)

    def eval(self, wi: Vector, wo: Vector) -> list[Array]:
        """Flux density of each colour: what the table holds of f |cos theta_o|, without the factor of radiance."""
        place_i, place_o = self.stencils.place(wi), self.stencils.place(wo)
        away, toward = away_and_toward(wi, wo)
        start, stride, index = self._part(wi.z > 0, wo.z > 0)
        p, zero = self.stencils.order, self.number(0)

        def body(k: Any, *sums: Array) -> tuple[Any, ...]:
            a, b = k // p, k % p
            node_o, flip_o = self.stencils.entry(place_o, a)
            node_i, flip_i = self.stencils.entry(place_i, b)
            pair = start + node_o * stride + node_i
            # The opposite azimuth where one of both lies beyond normal incidence.
            same = flip_o == flip_i
            near, far = (
                dr.select(same, away, toward),
                self.squared_width[pair] * dr.select(same, toward, away),
            )
            x = at_most((far - near) / at_least(far + near, 1e-30), 1)
            weight = self.stencils.weight(place_o, a) * self.stencils.weight(place_i, b)
            first = pair * (self.colours * self.terms)
            found = [total + weight * self._sum(first + c * self.terms, x) for c, total in enumerate(sums)]
            return (k + 1, *found)

        count = type(place_i.first)(0) if not isinstance(place_i.first, int) else 0
        state = (count, *([zero + 0 * wi.x] * self.colours))
        out = dr.while_loop(state, lambda k, *_: k < p * p, body, label="between nodes")[1:]
        mu_i, mu_o = dr.abs(wi.z), dr.abs(wo.z)
        scale = index * mu_o / at_least(mu_i + mu_o, 1e-30)
        lit = (wi.z > 0) & (wo.z > 0) if self.opaque else (wi.z != 0) & (wo.z != 0)
        return [dr.select(lit, (value if self.signed else at_least(value, 0)) * scale, 0) for value in out]

    def _sum(self, first: Any, x: Array) -> Array:
        """Sum of the coefficients from `first` on times cos(k s), x = cos s (Clenshaw 1955)."""
        one: Array = 0 * x
        two: Array = 0 * x
        for k in reversed(range(1, self.terms)):
            one, two = dr.fma(2 * x, one, self.values[first + k] - two), one
        return dr.fma(x, one, self.values[first] - two)

    def _part(self, in_above: Any, out_above: Any) -> tuple[Any, Any, Any]:
        """Where a part begins, its number of incident nodes, and the squared index where its light goes."""
        if self.opaque:
            return self.starts[0], self.counts[0], self.squared_index[0]
        one = dr.select(
            out_above, self._whole(in_above, self.starts[0]), self._whole(in_above, self.starts[1])
        )
        other = dr.select(
            out_above, self._whole(in_above, self.starts[2]), self._whole(in_above, self.starts[3])
        )
        stride = dr.select(
            in_above, self._whole(in_above, self.counts[0]), self._whole(in_above, self.counts[1])
        )
        index = dr.select(out_above, self.squared_index[0], self.squared_index[1])
        return dr.select(in_above, one, other), stride, index

    def _whole(self, like: Any, value: int) -> Any:
        return value if isinstance(like, bool) else dr.uint32_array_t(type(like))(value)


def _blocks(solution: Solution, part: Part) -> tuple[list[Block], tuple[int, int, int]]:
    """A part as cosine series of q, and its shape (C, n_out, n_in)."""
    grid = solution.grid
    region_i, region_o = (0 if part.from_above else -1), (0 if part.to_above else -1)
    mu_i, mu_o = grid.mu[region_i], grid.mu[region_o]
    weight = grid.weights[region_o]
    scale = (mu_o[:, None] + mu_i) / (mu_o * weight * grid.indices[region_o] ** 2)[:, None] / (2 * np.pi)
    blocks = [
        Block(
            block.orders,
            block.first,
            block.values
            * scale[block.first :, block.first :]
            * np.where(np.array(block.orders) > 0, 2.0, 1.0)[:, None, None],
        )
        for block in part.blocks
    ]
    return blocks, (solution.colours, len(mu_o), len(mu_i))


def _reversed(up: list[Block], down: list[Block]) -> bool:
    """Whether two parts are the same q seen both ways, as reciprocity has it."""
    if [(b.orders, b.first) for b in up] != [(b.orders, b.first) for b in down]:
        return False
    most = max((float(np.abs(block.values).max(initial=0)) for block in down), default=0.0)
    return all(
        np.allclose(a.values, np.swapaxes(b.values, 2, 3), rtol=0, atol=1e-7 * most)
        for a, b in zip(up, down, strict=True)
    )
