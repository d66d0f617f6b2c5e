"""A stack solved by adding, for Python: numpy or Dr.Jit in and out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from urushi.errors import UrushiError
from urushi.stack import Stack

from ...optics.vectors import channels, module_of
from ..arrays import backend_module, choice, mapped, number_type, vector_type
from ..bound import BoundStack, bind
from ..bsdf import BSDF, Sample, directions, random_numbers, same_count
from ..ledger import Ledger, alike, lit
from ..numbers import gather_numbers
from .build import phase_functions
from .core import AddingCore, Prepared
from .once import peaks
from .solution import Part, Solution
from .table import ORDER


@dataclass(frozen=True)
class Matrices:
    """The flux operators of a solved stack (see `solution` for their definition).

    Attributes:
        mu: cosines of the nodes above and below (one array for an opaque stack).
        weights: their quadrature weights in d mu.
        orders: number of azimuthal orders.
    """

    mu: tuple[np.ndarray, ...]
    weights: tuple[np.ndarray, ...]
    orders: int
    _parts: dict[tuple[bool, bool], Part]
    _colours: int

    @classmethod
    def of(cls, solution: Solution) -> Matrices:
        """Those of a solution."""
        grid, sides = solution.grid, (0,) if (True, False) not in solution.parts else (0, -1)
        blocks = [block for part in solution.parts.values() for block in part.whole()]
        return cls(
            tuple(grid.mu[k] for k in sides),
            tuple(grid.weights[k] for k in sides),
            max((block.orders.stop for block in blocks), default=1),
            solution.parts,
            solution.colours,
        )

    def operator(self, order: int, from_above: bool = True, to_above: bool = True) -> np.ndarray:
        """One azimuthal order of light that comes from one side and leaves on one side.

        Returns:
            (C, n_out, n_in): flux that arrives at each outgoing node of the flux of each incident one, the light that
            stays on its node (on the diagonal) included.

        Raises:
            UrushiError: the stack is opaque and a side is below, or the order is negative.
        """
        if (from_above, to_above) not in self._parts:
            raise UrushiError(
                "matrices: found a side below an opaque stack; allowed: from_above=True, to_above=True"
            )
        if order < 0:
            raise UrushiError(f"order: found {order}; allowed: at least 0")
        part = self._parts[from_above, to_above]
        n_in, n_out = len(self.mu[0 if from_above else -1]), len(self.mu[0 if to_above else -1])
        found = np.zeros((self._colours, n_out, n_in))
        for block in part.whole():
            if order in block.orders:
                found[:, block.first :, block.first :] += block.values[:, block.orders.index(order)]
        if part.delta is not None:
            k = np.arange(part.delta.shape[1])
            found[:, k, k] += part.delta
        return found


#: diagnostics of the tables, which are not made before they are needed
TABLES: dict[str, Callable[[Prepared], Any]] = {
    "azimuthal_terms": lambda made: made.series.terms,
    "azimuthal_error": lambda made: made.series.error,
    "table_bytes": lambda made: 4 * sum(values.size for values in made.series.values),
    "most_negative": lambda made: made.cells.negative,
    "sampling_bytes": lambda made: 4 * made.cells.mass.size,
}


class Diagnostics(dict[str, Any]):
    """What a solution says of itself; an entry of `TABLES` is there once ``diagnostics[...]`` has asked for it."""

    def __init__(self, known: dict[str, Any], prepared: Prepared) -> None:
        super().__init__(known)
        self._prepared = prepared

    def __missing__(self, key: str) -> Any:
        if key not in TABLES:
            raise KeyError(key)
        self[key] = TABLES[key](self._prepared)
        return self[key]


class AddingBSDF(BSDF):
    """A solution as a BSDF: deterministic, its error known to the solver.

    Values are interpolated between the nodes of the solution, what has a closed form is added in that form, and
    `sample` draws nearly in proportion to them. Dr.Jit arrays as arguments are computed where they are, without
    derivatives.

    Args:
        stack: the description that was solved.
        solution: its operators.
        backend: "llvm", "cuda", "scalar" (slow), or "auto": CUDA where there is one, else LLVM.
        precision: "double" or "single", for numpy; Dr.Jit arrays bring their own.
        mode: "radiance" scales transmitted light by (n_wi / n_wo)^2, as Mitsuba does; "importance" does not.
        order: nodes that a direction is interpolated from; 2, 4, 6 or 8.

    Raises:
        UrushiError: an option out of range, or a solution of another stack.
    """

    def __init__(
        self,
        stack: Stack,
        solution: Solution,
        *,
        backend: str = "auto",
        precision: str = "double",
        mode: str = "radiance",
        order: int = ORDER,
    ) -> None:
        choice("backend", backend, ("auto", "llvm", "cuda", "scalar"))
        choice("precision", precision, ("single", "double"))
        choice("mode", mode, ("radiance", "importance"))
        choice("order", order, (2, 4, 6, 8))
        self.stack, self.solution, self.mode = stack, solution, mode
        self.backend, self.double = backend, precision == "double"
        self._module = backend_module(backend)
        llvm = self._module if self._module.__name__ == "drjit.llvm.ad" else backend_module("llvm")
        bound = self._bind(llvm, True)
        if bound.opaque != ((True, False) not in solution.parts):
            raise UrushiError(
                "solution: found one of another stack; allowed: the operators of this very stack"
            )
        if not solution.peaks:  # solutions have them only where the error was measured with them
            solution.peaks.update(peaks(bound, phase_functions(stack), solution.terms))
        self.prepared = Prepared(solution, bound, order)
        self._cores: dict[tuple[str, bool], AddingCore] = {}
        self._interior: Any = None
        self.diagnostics = Diagnostics(
            solution.diagnostics
            | {
                "method": "adding",
                "backend": self._module.__name__.removeprefix("drjit."),
                "precision": precision,
                "channels": solution.colours,
                "closed_form": solution.closed_form,
            },
            self.prepared,
        )

    @property
    def matrices(self) -> Matrices:
        """The operators themselves."""
        return Matrices.of(self.solution)

    def core(
        self, module: Any, double: bool, spectrum: Any = None, radiance: bool | None = None
    ) -> AddingCore:
        """The solution in a Dr.Jit module and precision; made once for the same types.

        Args:
            module: such as `drjit.llvm.ad`.
            double: whether in double precision.
            spectrum: the type of a value; by default a colour of that module, or a number for one channel.
            radiance: as in `AddingCore`; by default the mode of this BSDF.
        """
        found = self._core(module, double, spectrum, radiance)
        found.make_sampling()
        return found

    def _core(
        self, module: Any, double: bool, spectrum: Any = None, radiance: bool | None = None
    ) -> AddingCore:
        """The same, ready for values alone; samples take longer to prepare, which the first of them then does."""
        if spectrum is None:
            spectrum = number_type(module, double)
            if self.solution.colours == 3:
                spectrum = vector_type(module, double)
            elif self.solution.colours > 1:
                spectrum = _channels_type(module, double, self.solution.colours)
        radiance = self.mode == "radiance" if radiance is None else radiance
        key = f"{module.__name__} {spectrum.__name__} {radiance}", double
        if key not in self._cores:
            stack = self._bind(module, double)
            self._cores[key] = AddingCore(
                self.prepared, stack, spectrum, module, double, radiance, sampling=False
            )
        return self._cores[key]

    # --- the contract ------------------------------------------------------------------------------------------

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: (N, 3), (N, 3) -> (N, C); with `with_error`, that and the error the solver expects.

        The error is that of the solver, relative to the largest f for this wi, times |cos theta_o|. One channel is
        given as three alike.
        """
        expected = self._expected() if with_error else 0.0

        def run(core: AddingCore, a: Any, b: Any) -> tuple[Any, ...]:
            value = core.eval(a, b)
            if not with_error:
                return (value,)
            return value, core.peak(a) * (expected * dr.abs(b.z) * core.scale(a, b))

        if dr.is_array_v(wi):
            found = tuple(self._colour(x, wi) for x in run(self._core_of(wi), wi, wo))
            return found if with_error else found[0]
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        return self._shaped(self._map(run, pair), wi, wo)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance on the side of wi: (N, 3) -> (N, C)."""
        return self._flux(wi, AddingCore.reflectance, with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side (no factor of radiance): (N, 3) -> (N, C)."""
        return self._flux(wi, AddingCore.transmittance, with_error)

    def absorption(self, wi: Any, *, with_error: bool = False) -> Ledger:
        """Where the light from wi goes, exactly; errors are what the solver expects (as for `reflectance`).

        The operators of a whole stack know nothing of its inside, so the layers are put together once more on the same
        nodes, for what has no azimuth; the first call takes part of the time of `solve`. That goes for results of
        `ur.add` and those read from a file as well.

        Raises:
            UrushiError: a Dr.Jit array, or a direction that no light comes from.
        """
        from .ledger import Interior

        array = lit(wi, (True, False) not in self.solution.parts)
        if self._interior is None:
            self._interior = Interior.solve(self.stack, self.solution, self.prepared.order)
        found = self._interior.ledger(array)
        return replace(found, error=alike(found, self._expected())) if with_error else found

    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: (N, 3), (N, 3) -> (N,); delta parts are 0."""
        if dr.is_array_v(wi):
            return self._core_of(wi).pdf(wi, wo)
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (density,) = self._map(lambda core, a, b: (core.pdf(a, b),), pair)
        return density[0] if np.ndim(wi) == np.ndim(wo) == 1 else density

    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: wi (N, 3), u (N, 3) in [0, 1); u[:, 0] chooses a part, the others a direction of it."""

        def run(core: AddingCore, a: Any, b: Any) -> tuple[Any, ...]:
            wo, pdf, carried, delta = core.sample(a, b)
            value = dr.select(delta, carried * core.scale(a, wo), core.eval(a, wo))
            weight = dr.select(pdf > 0, value / dr.maximum(pdf, 1e-30), 0)
            return wo, weight, pdf, delta

        if dr.is_array_v(wi):
            wo, weight, pdf, delta = run(self._core_of(wi), wi, u)
            return Sample(wo, self._colour(weight, wi), pdf, delta)
        pair = same_count(directions(wi, "wi"), random_numbers(u), "wi and u")

        def plain(core: AddingCore, a: Any, b: Any) -> tuple[Any, ...]:
            wo, weight, pdf, delta = run(core, a, b)
            return wo, weight, pdf, dr.select(delta, 1.0, 0.0) + 0 * pdf

        wo, weight, pdf, delta = self._map(plain, pair)
        wo = wo / np.maximum(np.linalg.norm(wo, axis=1, keepdims=True), 1e-30)
        found = wo, _repeated(weight), pdf, delta > 0.5
        return Sample(*((x[0] for x in found) if np.ndim(wi) == np.ndim(u) == 1 else found))

    def delta_parts(self, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """What `sample` knows of the delta parts.

        Args:
            wi: (N, 3) directions.

        Returns:
            probabilities of the mirror direction and of Snell's (N,), and what each carries, (N, 3), as `mode` has it.
        """

        def run(core: AddingCore, a: Any) -> tuple[Any, ...]:
            delta, (mirror, straight) = core.delta(a), core.delta_chances(a)
            passed = delta.transmitted * core.scale(a, -a)
            return mirror, straight, delta.reflected + 0 * a.x, passed + 0 * a.x

        mirror, straight, reflected, transmitted = self._map(run, (directions(wi, "wi"),))
        return mirror, straight, (_repeated(reflected), _repeated(transmitted))

    # --- how it runs -------------------------------------------------------------------------------------------

    def _made_of(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.stack, self.solution), {
            "backend": self.backend,
            "precision": "double" if self.double else "single",
            "mode": self.mode,
            "order": self.prepared.order,
        }

    def _expected(self) -> float:
        """The error that the solver expects."""
        if "estimated_error" not in self.solution.diagnostics:
            raise UrushiError(
                "with_error: this solution has no estimate of its error; allowed: solve(..., accuracy=...)"
            )
        return float(self.solution.diagnostics["estimated_error"])

    def _flux(self, wi: Any, question: Any, with_error: bool) -> Any:
        expected = self._expected() if with_error else 0.0
        if dr.is_array_v(wi):
            value = self._colour(question(self._core_of(wi), wi), wi)
            return (value, 0 * value + expected) if with_error else value
        (value,) = self._map(lambda core, a: (question(core, a),), (directions(wi, "wi"),))
        values = [value, np.full_like(value, expected)] if with_error else [value]
        return self._shaped(values, wi, wi)

    def _map(self, run: Any, inputs: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        core = self._core(self._module, self.double)
        return mapped(lambda *lanes: run(core, *lanes), inputs, self._module, self.double)

    def _core_of(self, w: Any) -> AddingCore:
        module = module_of(w)
        double = dr.type_v(w) == dr.VarType.Float64
        return self.core(module, double)

    def _bind(self, module: Any, double: bool) -> BoundStack:
        numbers = gather_numbers(self.stack, None, module, double, "adding")
        return bind(self.stack, numbers.values, numbers.fixed)

    def _colour(self, value: Any, like: Any) -> Any:
        return value if channels(value) else type(like)(value)

    def _shaped(self, values: list[np.ndarray], *arguments: Any) -> Any:
        found = tuple(_repeated(v) for v in values)
        if all(np.ndim(argument) == 1 for argument in arguments):
            found = tuple(v[0] for v in found)
        return found if len(found) > 1 else found[0]


def _repeated(value: np.ndarray) -> np.ndarray:
    return np.repeat(value[:, None], 3, axis=1) if value.ndim == 1 else value


def _channels_type(module: Any, double: bool, count: int) -> Any:
    name = f"Array{count}f" + ("64" if double else "")
    if not hasattr(module, name):
        raise UrushiError(f"channels: found {count}; allowed: 1 to 4")
    return getattr(module, name)
