"""A solution as a BSDF on Dr.Jit arrays: what the Python result and a renderer's plugin both stand on."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np

from ...media import BoundGraded
from ...optics.vectors import Array, Vector, at_least, channels
from ..arrays import number_type, padded
from ..bound import BoundStack
from ..direct import direct, direct_is_certain
from ..facet_lobe import Lobe
from ..smooth import has_delta, smooth_energy, straight
from .cells import LUMINANCE, Cells
from .once import Once, attenuation, covers
from .proposal import Delta, Proposal
from .solution import Block, Solution
from .stencil import Lookup, Stencils
from .table import ORDER, SIDES, Series, Table
from .through import Through


class Prepared:
    """What is computed for a solution once, in numpy, as it is first asked for; it serves every module and precision.

    Args:
        solution: the solved stack.
        stack: the same stack bound in Dr.Jit's LLVM arrays in double precision.
        order: nodes that a direction is interpolated from, even.
    """

    def __init__(self, solution: Solution, stack: BoundStack, order: int = ORDER) -> None:
        self.solution, self.stack, self.order = solution, stack, order
        above, below = len(solution.grid.mu[0]), 0 if stack.opaque else len(solution.grid.mu[-1])
        self.above, self.rows = above, above + below

    @cached_property
    def series(self) -> Series:
        """The table of values."""
        return Series(self.solution)

    @cached_property
    def cells(self) -> Cells:
        """Where the light goes, for sampling: this takes longer than all else."""
        closed = Closed(self.stack, self.solution)
        return Cells.build(self.solution, self.series, closed.density if closed.more else None)

    @cached_property
    def face(self) -> np.ndarray:
        """(R,) luminance of the outermost interface's own lobe, for light from each incident node."""
        found, colours = np.zeros(self.rows), self.solution.colours
        weights = LUMINANCE if colours == 3 else np.full(colours, 1 / colours)
        closed = Closed(self.stack, self.solution)
        for (from_above, to_above), part in self.solution.parts.items():
            outer = self.stack.interfaces[0 if from_above else -1]
            if from_above == to_above and closed.interface and outer.delta is not True:
                i = self._incident(from_above)
                found[i] = np.maximum(_flux(part.rest, colours, i.stop - i.start) @ weights, 0)
        return found

    @cached_property
    def totals(self) -> np.ndarray:
        """(R, 2, C) flux that leaves above and below for light from each node, delta parts included."""
        colours = self.solution.colours
        found = np.zeros((self.rows, 2, colours))
        for (from_above, to_above), part in self.solution.parts.items():
            i = self._incident(from_above)
            found[i, 0 if to_above else 1] = _flux(part.whole(), colours, i.stop - i.start)
            if part.delta is not None:
                found[i, 0 if to_above else 1][: part.delta.shape[1]] += part.delta.T
        return found

    @cached_property
    def scatters(self) -> bool:
        """False if there are delta parts only."""
        return any(block.values.any() for part in self.solution.parts.values() for block in part.whole())

    def _incident(self, above: bool) -> slice:
        return slice(0, self.above) if above else slice(self.above, self.rows)


class Closed:
    """What a solution leaves to closed forms.

    Attributes:
        interface: whether it leaves one meeting with an outermost interface.
        more: whether there is anything else than reflection by such an interface.

    Args:
        stack, solution: the stack in any module and precision, and what was solved of it.
        number: the type of a number in these; by default LLVM in double precision.
    """

    def __init__(self, stack: BoundStack, solution: Solution, number: Any = None) -> None:
        self.stack, self.colours = stack, solution.colours
        self.interface = solution.closed_form is not None and direct_is_certain(stack)
        self.once = None
        kept = {}
        if solution.peaks:
            from drjit.llvm.ad import Float64

            here = Float64 if number is None else number
            kept = {region: (peak, Lookup(peak.values, here)) for region, peak in solution.peaks.items()}
        sides = [(True, True)] if stack.opaque else SIDES
        known = solution.closed_form in ("single", "single, through")
        if known and any(covers(stack, *side) for side in sides):
            self.once = Once(stack, attenuation(stack, solution.forward), kept)
        self.through = None
        if solution.closed_form in ("through", "single, through"):
            self.through = Through(stack, attenuation(stack, solution.forward))
        passes = len(stack.interfaces) == 1 and not stack.opaque and stack.interfaces[0].delta is not True
        self.more = self.once is not None or self.through is not None or (self.interface and passes)

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """Flux density from wi to wo."""
        value: Array = 0 * wi.x
        if self.interface:
            value = value + direct(self.stack, wi, wo)
        if self.once is not None:
            value = value + self.once.eval(wi, wo)
        if self.through is not None:
            value = value + self.through.eval(wi, wo)
        return value

    def density(
        self, mu_i: np.ndarray, mu_o: np.ndarray, phi: np.ndarray, from_above: bool, to_above: bool
    ) -> np.ndarray:
        """(C, N) flux density, less reflection by an outermost interface, between these cosines and sides (N,)."""
        from drjit.llvm.ad import Array3f64

        sin_i, sin_o = (np.sqrt((1 - mu) * (1 + mu)) for mu in (mu_i, mu_o))
        sides = mu_i if from_above else -mu_i, mu_o if to_above else -mu_o
        wi = Array3f64(padded(-sin_i), padded(0 * sin_i), padded(sides[0]))
        wo = Array3f64(padded(sin_o * np.cos(phi)), padded(sin_o * np.sin(phi)), padded(sides[1]))
        value: Array = 0 * wi.x
        if self.once is not None:
            value = value + self.once.eval(wi, wo)
        if self.through is not None:
            value = value + self.through.eval(wi, wo)
        if self.interface and from_above != to_above:
            value = value + direct(self.stack, wi, wo)
        found = np.atleast_2d(np.array(value))  # grey where what has a closed form is
        return np.broadcast_to(found, (self.colours, found.shape[1]))


class AddingCore:
    """A solution in one module and precision. All arrays are evaluated: `eval` and the others may be traced anywhere.

    Args:
        prepared: the solution.
        stack: the same stack with its numbers, in that module and precision.
        spectrum: type of a colour, or of a number where the solution has one channel.
        module, double: the Dr.Jit module, and whether to compute in double precision.
        radiance: scale transmitted light as radiance (n_wi / n_wo)^2; False for importance (flux).
        sampling: make at once what `sample`, `pdf` and `peak` need. Otherwise the first of them does, which then must
            not be traced.
    """

    def __init__(
        self,
        prepared: Prepared,
        stack: BoundStack,
        spectrum: Any,
        module: Any,
        double: bool,
        radiance: bool = True,
        sampling: bool = True,
    ) -> None:
        self._prepared, self._types = prepared, (module, double)
        self.solution = solution = prepared.solution
        number = number_type(module, double)
        self.stack, self.spectrum, self.radiance = stack, spectrum, radiance
        self.colours = solution.colours
        self.closed = Closed(stack, solution, number)
        regions = (0,) if stack.opaque else (0, -1)
        self.stencils = Stencils(solution.grid, regions, prepared.order, module, double)
        empty = prepared.series.empty
        # What light scattered once in the mean medium has too much is taken off in the table.
        signed = self.closed.once is not None and any(isinstance(m, BoundGraded) for m in stack.media)
        self.table = (
            None if empty else Table(solution, prepared.series, self.stencils, module, double, signed)
        )
        self.scatters = prepared.scatters
        self.above = prepared.above
        self.totals = Lookup(prepared.totals, number)
        self.has_delta = has_delta(stack)
        if sampling:
            self.make_sampling()

    def make_sampling(self) -> None:
        """Make what `sample`, `pdf` and `peak` need, if that was not done."""
        assert self.proposal and self.peaks

    @cached_property
    def proposal(self) -> Proposal:
        """What `sample` draws from."""
        return Proposal(self._prepared.cells, self._prepared.face, *self._types)

    @cached_property
    def peaks(self) -> Lookup:
        """The largest f for each node and channel."""
        return Lookup(self._prepared.cells.peak, number_type(*self._types))

    # --- values ------------------------------------------------------------------------------------------------

    def scale(self, wi: Vector, wo: Vector) -> Array:
        """What turns flux into what was asked for: `BoundStack.scale` for radiance, 1 for importance."""
        return self.stack.scale(wi, wo) if self.radiance else 1.0

    def eval(self, wi: Vector, wo: Vector) -> Array:
        """f |cos wo| without the delta parts."""
        wi, wo = dr.detach(wi), dr.detach(wo)
        value = self._colour(self.tabulated(wi, wo)) + self.closed.eval(wi, wo)
        if self.table is not None and self.table.signed:
            value = at_least(value, 0)
        return self.finished(dr.select((wi.z != 0) & (wo.z != 0), value * self.scale(wi, wo), 0))

    def tabulated(self, wi: Vector, wo: Vector) -> list[Array]:
        """The flux density of each channel that has no closed form."""
        return [0 * wi.x] * self.colours if self.table is None else self.table.eval(wi, wo)

    def at(self, stack: BoundStack) -> AddingCore:
        """The same tables with the closed forms of another bound stack: with the values of a place, say."""
        found = copy.copy(self)
        number = number_type(*self._types)
        found.stack, found.closed = stack, Closed(stack, self.solution, number)
        return found

    def delta_chances(self, wi: Vector) -> tuple[Array, Array]:
        """Probabilities that `sample` takes the mirror direction, and Snell's."""
        mixture = self.proposal.mixture(wi, self.delta(wi), self._faces(wi))
        return mixture.mirror, mixture.straight

    def finished(self, value: Array) -> Array:
        """A value in the type that was asked for."""
        return value if channels(value) else self.spectrum(value)

    def peak(self, wi: Vector) -> Array:
        """The largest f that the nodes around wi know, in flux (no factor of radiance)."""
        (one, two), _ = self.proposal.around(dr.detach(wi))
        n = self.colours
        rows = [at_least(self.peaks[one * n + c], self.peaks[two * n + c]) for c in range(n)]
        return self.finished(self._colour(rows))

    def reflectance(self, wi: Vector) -> Array:
        """Flux that leaves on the side of wi, delta parts included."""
        return self.finished(self._flux(dr.detach(wi), True))

    def transmittance(self, wi: Vector) -> Array:
        """Flux that leaves on the other side (no factor of radiance), delta parts included."""
        return self.finished(self._flux(dr.detach(wi), False))

    def _flux(self, wi: Vector, same: bool) -> Array:
        if not self.scatters:
            return smooth_energy(self.stack, wi)[0 if same else 1]
        return self._colour(self.fluxes(wi, same))

    def fluxes(self, wi: Vector, same: bool) -> list[Array]:
        """What leaves on the side of wi, or on the other one, in each channel; where anything is scattered at all."""
        place = self.stencils.place(wi)
        sums = [0 * wi.x] * self.colours
        row_of = 0 if self.stack.opaque else dr.select(wi.z > 0, 0, self.above)
        up = (wi.z > 0) if same else (wi.z <= 0)
        for k in range(self.stencils.order):
            node, _ = self.stencils.entry(place, k)
            weight = self.stencils.weight(place, k)
            first = ((node + row_of) * 2 + dr.select(up, 0, 1)) * self.colours
            sums = [value + weight * self.totals[first + c] for c, value in enumerate(sums)]
        lit = (wi.z > 0) if self.stack.opaque else (wi.z != 0)
        return [dr.select(lit, at_least(value, 0), 0) for value in sums]

    # --- samples -----------------------------------------------------------------------------------------------

    def pdf(self, wi: Vector, wo: Vector) -> Array:
        """Density of `sample`, per solid angle, without the delta parts."""
        wi, wo = dr.detach(wi), dr.detach(wo)
        return self.proposal.pdf(self.proposal.mixture(wi, self.delta(wi), self._faces(wi)), wi, wo)

    def sample(self, wi: Vector, u: Vector) -> tuple[Vector, Array, Array, Any]:
        """(wo, density or probability, what a delta part carries in flux, mask of delta lanes)."""
        wi = dr.detach(wi)
        delta = self.delta(wi)
        mixture = self.proposal.mixture(wi, delta, self._faces(wi))
        wo, probability, carried, is_delta = self.proposal.sample(mixture, wi, u, delta)
        density = self.proposal.pdf(mixture, wi, wo)
        return wo, dr.select(is_delta, probability, density), carried, is_delta

    def delta(self, wi: Vector) -> Delta:
        """The delta parts for light from wi."""
        mirrored = type(wi)(-wi.x, -wi.y, wi.z)
        if not self.has_delta:
            return Delta(0 * wi.x, 0 * wi.x, mirrored, None)
        reflected, transmitted = smooth_energy(self.stack, wi)
        return Delta(
            reflected, transmitted, mirrored, None if self.stack.opaque else straight(self.stack, wi)
        )

    def _faces(self, wi: Vector) -> list[Lobe]:
        """The lobes of the outermost interfaces; their shares say on which side wi has to be."""
        if not self.closed.interface:
            return []
        axis = type(wi)(wi.x, wi.y, at_least(dr.abs(wi.z), 1e-6))
        found = []
        for above in (True,) if self.stack.opaque else (True, False):
            interface = self.stack.interfaces[0 if above else -1]
            if interface.delta is True:
                continue
            single = interface.single or interface
            facets, frame = getattr(single, "facets", None), getattr(single, "frame", None)
            found.append(Lobe((wi.z > 0) if above else (wi.z < 0), above, axis, facets, frame))
        return found

    # --- colours -----------------------------------------------------------------------------------------------

    def _colour(self, values: list[Array]) -> Array:
        """Channels as one value that closed forms can be added to."""
        if len(values) == 1:
            return values[0]
        return self.spectrum(*values)


def _flux(blocks: list[Block], colours: int, n_in: int) -> np.ndarray:
    """(n_in, C) what arrives anywhere of the light of each node."""
    found = np.zeros((n_in, colours))
    for block in blocks:
        if 0 in block.orders:
            found[block.first :] += block.values[:, block.orders.index(0)].sum(axis=1).T
    return found
