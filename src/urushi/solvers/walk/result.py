"""A stack solved by the walk, for Python: numpy or Dr.Jit in and out, with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np

from urushi.errors import UrushiError
from urushi.stack import Stack

from ...optics.vectors import channels, module_of
from ..arrays import LANES, NONE, backend_module, choice, fill, number_type, vector_type, whole
from ..bsdf import BSDF, Sample, directions, random_numbers, same_count
from ..ledger import Ledger, lit
from ..numbers import as_arrays, gather_numbers
from ..smooth import has_delta
from .core import WalkCore
from .derivative import bind_live

#: samples that one lane takes in a row; sums are then added in double precision, in an order that depends on the
#: number of samples alone, so that splitting a batch changes nothing
BLOCK = 32


class WalkBSDF(BSDF):
    """The walk as a BSDF.

    Args:
        stack: the description.
        samples: paths per evaluation.
        seed: integer below 2**32; results are a function of (wi, wo, seed) and of nothing else.
        max_depth: most scattering events inside; None (the default) for no limit and no bias.
        parameters: values in place of those of the description, one for all or one per evaluation, such as
            ``{"layer_0.alpha": alphas}`` (`urushi.solvers.numbers.gather_numbers`).
        backend: "llvm", "cuda", "scalar" (slow), or "auto": CUDA where there is one, else LLVM. Dr.Jit arrays as
            arguments are computed where they are.
        precision: "single" or "double".
        mode: "radiance" scales transmitted light by (n_wi / n_wo)^2, as Mitsuba does; "importance" does not.

    Raises:
        UrushiError: an option out of range.
    """

    def __init__(
        self,
        stack: Stack,
        *,
        samples: int = 64,
        seed: int = 0,
        max_depth: int | None = None,
        parameters: Mapping[str, Any] | None = None,
        backend: str = "auto",
        precision: str = "single",
        mode: str = "radiance",
    ) -> None:
        whole("samples", samples, 1, 2**31 - 1)
        whole("seed", seed, 0, 2**32 - 1)
        if max_depth is not None:
            whole("max_depth", max_depth, 0, 2**31 - 1)
        choice("backend", backend, ("auto", "llvm", "cuda", "scalar"))
        choice("precision", precision, ("single", "double"))
        choice("mode", mode, ("radiance", "importance"))
        self.stack = stack
        self.samples, self.seed, self.max_depth, self.mode = samples, seed, max_depth, mode
        self.parameters = dict(parameters or {})
        self.backend, self.double = backend, precision == "double"
        self._module = backend_module(backend)
        self._cores: dict[str, tuple[WalkCore, int]] = {}
        core, lanes = self._core(self._module)
        self.lanes = lanes
        self.diagnostics = {
            "method": "walk",
            "reason": "unbiased for any stack",
            "backend": self._module.__name__.removeprefix("drjit."),
            "precision": precision,
            "samples": samples,
            "seed": seed,
            "max_depth": max_depth,
            "interfaces": len(core.stack.interfaces),
            "media": sum(medium is not None for medium in core.stack.media),
            "coloured": core.spectrum is not number_type(self._module, self.double),
            "delta_parts": has_delta(core.stack),
            "reciprocal": not core.stack.tilted,
            "estimated_error": "none but noise: eval(..., with_error=True) gives the standard error",
        }

    # --- the contract ------------------------------------------------------------------------------------------

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: (N, 3), (N, 3) -> (N, 3), and its standard error with `with_error` (samples >= 2)."""
        self._may_err(with_error)
        if dr.is_array_v(wi):
            core, _ = self._core(module_of(wi))
            if self.samples == 1:
                return self._colour(core.once(wi, wo, self.seed), wi)
            mean, square = core.moments(wi, wo, (), self.seed, 0, self.samples)
            scale = core.scale(wi, wo)
            value = self._colour((mean + core.certain(wi, wo)) * scale, wi)
            error = dr.sqrt(dr.maximum(square - dr.square(mean), 0) / max(self.samples - 1, 1)) * scale
            return (value, self._colour(error, wi)) if with_error else value

        def launch(core: WalkCore, lanes: tuple[Any, ...], first: Any, count: Any) -> tuple[Any, ...]:
            a, b = lanes
            certain = core.spectrum(core.certain(a, b))
            scale = core.spectrum(core.scale(a, b))
            return (*core.moments(a, b, (), self._uint(self.seed), first, count), certain, scale)

        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        if self.samples == 1:
            seed = self._uint(self.seed)
            (value,) = self._map(lambda core, lanes: (core.once(*lanes, seed),), pair)
            return self._shaped((value,), wi, wo)
        mean, error, certain, scale = self._estimate(launch, pair, 2)
        value = (mean + certain) * scale
        return self._shaped((value, error * scale) if with_error else (value,), wi, wo)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance on the side of wi: (N, 3) -> (N, 3)."""
        return self._flux(wi, True, with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side (no factor of radiance): (N, 3) -> (N, 3)."""
        return self._flux(wi, False, with_error)

    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: (N, 3), (N, 3) -> (N,); delta parts are 0."""
        if dr.is_array_v(wi):
            return self._core(module_of(wi))[0].pdf(wi, wo)
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (density,) = self._map(lambda core, lanes: (core.pdf(*lanes),), pair)
        return density[0] if np.ndim(wi) == np.ndim(wo) == 1 else density

    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: wi (N, 3), u (N, 3) in [0, 1); u[:, 0] chooses a lobe, the others a direction of it."""
        if dr.is_array_v(wi):
            core, _ = self._core(module_of(wi))
            wo, pdf, carried, delta = core.sample(wi, u)
            value = core.eval(wi, wo, (), self.seed, 0, self.samples)
            weight = dr.select(delta, carried * core.scale(wi, wo), value) / dr.maximum(pdf, 1e-30)
            return Sample(wo, self._colour(dr.select(pdf > 0, weight, 0), wi), pdf, delta)
        pair = same_count(directions(wi, "wi"), random_numbers(u), "wi and u")

        def launch(core: WalkCore, lanes: tuple[Any, ...]) -> tuple[Any, ...]:
            o, pdf, carried, delta = core.sample(*lanes)
            carried = self._colour(carried * core.scale(lanes[0], o), lanes[0])
            return o, pdf, carried, dr.select(delta, 1.0, 0.0) + 0 * pdf

        wo, pdf, carried, delta = self._map(launch, pair)
        is_delta = delta > 0.5
        value = self.eval(pair[0], wo / np.linalg.norm(wo, axis=1, keepdims=True))
        weight = np.where(is_delta[:, None], carried, value) / np.maximum(pdf, 1e-30)[:, None]
        weight = np.where((pdf > 0)[:, None], weight, 0)
        single = np.ndim(wi) == np.ndim(u) == 1
        return Sample(
            *((x[0] for x in (wo, weight, pdf, is_delta)) if single else (wo, weight, pdf, is_delta))
        )

    def absorption(self, wi: Any, *, with_error: bool = False) -> Ledger:
        """Where the light from wi goes, counted event by event; `reflectance` and `transmittance` by the same paths.

        Raises:
            UrushiError: one sample and `with_error`, a `max_depth` (paths cut off end nowhere), a Dr.Jit array.
        """
        from .ledger import counted

        self._may_err(with_error)
        return counted(self, lit(wi, self._core(self._module)[0].stack.opaque), with_error)

    # --- how batches run ---------------------------------------------------------------------------------------

    def _flux(self, wi: Any, reflected: bool, with_error: bool) -> Any:
        self._may_err(with_error)
        if dr.is_array_v(wi):
            core, _ = self._core(module_of(wi))
            up, down, up2, down2 = core.flux(wi, (), self.seed, 0, self.samples)
            same = (wi.z > 0) if reflected else (wi.z < 0)
            mean, square = dr.select(same, up, down), dr.select(same, up2, down2)
            error = dr.sqrt(dr.maximum(square - dr.square(mean), 0) / max(self.samples - 1, 1))
            return (self._colour(mean, wi), self._colour(error, wi)) if with_error else self._colour(mean, wi)

        def launch(core: WalkCore, lanes: tuple[Any, ...], first: Any, count: Any) -> tuple[Any, ...]:
            up, down, up2, down2 = core.flux(lanes[0], (), self._uint(self.seed), first, count)
            same = (lanes[0].z > 0) if reflected else (lanes[0].z < 0)
            return dr.select(same, up, down), dr.select(same, up2, down2)

        mean, error = self._estimate(launch, (directions(wi, "wi"),), 2)
        return self._shaped((mean, error) if with_error else (mean,), wi, wi)

    def _estimate(self, launch: Any, inputs: tuple[np.ndarray, ...], moments: int) -> list[np.ndarray]:
        """Run `launch` on blocks of samples: the mean of them all, its standard error, and what else `launch` gives."""
        n, (blocks, share) = len(inputs[0]), self.blocks()
        if n == 0:
            self._may_take(n)
            return [x[:0] for x in self._estimate(launch, tuple(NONE for _ in inputs), moments)]
        results: list[np.ndarray] = []  # filled piece by piece: a large batch must not be there twice

        def run(core: WalkCore, lanes: tuple[Any, ...], block: Any) -> tuple[Any, ...]:
            return launch(core, lanes, *self.block(block, blocks))

        step = max(LANES // blocks, 1)
        for start in range(0, n, step):
            stop = min(start + step, n)
            out = self._launch(run, inputs, start, stop, blocks)
            mean, square = (_joined(x, share) for x in out[:2])
            error = np.sqrt(np.maximum(square - np.square(mean), 0) / max(self.samples - 1, 1))
            fill(results, [mean, error, *(x[:, 0] for x in out[moments:])], n, start)
        return results

    def blocks(self) -> tuple[int, np.ndarray]:
        """Into how many blocks the samples are split, and the share of each."""
        blocks = -(-self.samples // BLOCK)
        counts = np.full(blocks, BLOCK, dtype=np.float64)
        counts[-1] = self.samples - BLOCK * (blocks - 1)
        return blocks, counts / self.samples

    def block(self, number: Any, blocks: int) -> tuple[Any, Any]:
        """The number of the first sample of a block, and of how many."""
        first = number * BLOCK
        # One sample is a program of its own; any other number of them is a number in one program.
        count: Any = self.samples if self.samples == 1 else self._uint(self.samples)
        count = count if blocks == 1 else dr.minimum(count - first, BLOCK)
        if self._module.__name__ == "drjit.scalar" and blocks > 1:
            count = int(count)
        return first, count

    def _map(self, launch: Any, inputs: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        """Run `launch` once for every row."""
        n = len(inputs[0])
        if n == 0:
            self._may_take(n)
            return [x[:0] for x in self._map(launch, tuple(NONE for _ in inputs))]
        results: list[np.ndarray] = []
        for start in range(0, n, LANES):
            out = self._launch(
                lambda core, lanes, _: launch(core, lanes), inputs, start, min(start + LANES, n), 1
            )
            fill(results, [x[:, 0] for x in out], n, start)
        return results

    def _launch(
        self, run: Any, inputs: tuple[np.ndarray, ...], start: int, stop: int, blocks: int
    ) -> list[np.ndarray]:
        """Rows [start, stop) of the inputs, `blocks` lanes each; arrays of shape (rows, blocks[, channels])."""
        self._may_take(len(inputs[0]))
        if self._module.__name__ == "drjit.scalar":
            return self._launch_scalar(run, inputs, start, stop, blocks)
        vector, uint = vector_type(self._module, self.double), self._module.UInt
        lane = dr.arange(uint, (stop - start) * blocks)
        row, block = (lane, uint(0)) if blocks == 1 else (lane // blocks, lane % blocks)
        lanes = []
        for array in inputs:
            columns = vector(np.ascontiguousarray(array[start:stop].T))
            lanes.append(columns if blocks == 1 else dr.gather(vector, columns, row))
        core, width = self._core(self._module)
        if width > 1:
            core = self._core(self._module, row + start)[0]
        out = run(core, tuple(lanes), block)
        out = tuple(x + 0 * lanes[0].x for x in out)
        dr.eval(out)
        shape = (stop - start, blocks)
        return [
            np.moveaxis(np.array(x, dtype=np.float64).reshape(-1, *shape), 0, -1)
            if channels(x)
            else np.array(x, dtype=np.float64).reshape(shape)
            for x in out
        ]

    def _launch_scalar(
        self, run: Any, inputs: tuple[np.ndarray, ...], start: int, stop: int, blocks: int
    ) -> list[np.ndarray]:
        vector = vector_type(self._module, self.double)
        core, _ = self._core(self._module)
        rows = []
        for i in range(start, stop):
            lanes = tuple(vector(*(float(v) for v in array[i])) for array in inputs)
            rows.append([[np.array(x, dtype=np.float64) for x in run(core, lanes, b)] for b in range(blocks)])
        return [np.array([[block[j] for block in row] for row in rows]) for j in range(len(rows[0][0]))]

    def _core(self, module: Any, lanes: Any = None) -> tuple[WalkCore, int]:
        """The walk bound in a Dr.Jit module; with `lanes`, per-lane parameters gathered for these evaluations."""
        if module.__name__ in self._cores and lanes is None:
            return self._cores[module.__name__]
        numbers = gather_numbers(self.stack, self.parameters, module, self.double, "walk")
        if lanes is not None:
            numbers.values = {name: _gathered(value, lanes) for name, value in numbers.values.items()}
        spectrum = vector_type(module, self.double) if numbers.coloured else number_type(module, self.double)
        stack = bind_live(self.stack, numbers.values, numbers.fixed)
        alike = numbers.lanes == 1 and lanes is None
        core = WalkCore(stack, spectrum, self.mode == "radiance", self.max_depth, alike)
        if lanes is None:
            self._cores[module.__name__] = core, numbers.lanes
        return core, numbers.lanes

    def _uint(self, value: int) -> Any:
        return value if self._module.__name__ == "drjit.scalar" else dr.opaque(self._module.UInt, value)

    def _colour(self, value: Any, like: Any) -> Any:
        return value if channels(value) else type(like)(value)

    def _shaped(self, values: tuple[np.ndarray, ...], *arguments: Any) -> Any:
        values = tuple(np.repeat(v[:, None], 3, axis=1) if v.ndim == 1 else v for v in values)
        if all(np.ndim(argument) == 1 for argument in arguments):
            values = tuple(v[0] for v in values)
        return values if len(values) > 1 else values[0]

    def _made_of(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.stack,), {
            "samples": self.samples,
            "seed": self.seed,
            "max_depth": self.max_depth,
            "parameters": as_arrays(self.parameters),
            "backend": self.backend,
            "precision": "double" if self.double else "single",
            "mode": self.mode,
        }

    def _may_err(self, with_error: bool) -> None:
        if with_error and self.samples < 2:
            raise UrushiError("samples: found 1; allowed with with_error=True: at least 2")

    def _may_take(self, rows: int) -> None:
        if self.lanes not in (1, rows):
            raise UrushiError(
                f"wi: found {rows} rows; allowed: {self.lanes}, as many as the parameters have values"
            )


def _joined(blocks: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The mean over blocks of samples: (rows, blocks[, channels]) -> (rows[, channels])."""
    return np.einsum("rb...,b->r...", blocks, share, optimize=False)


def _gathered(value: Any, lanes: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_gathered(v, lanes) for v in value)
    return dr.gather(type(value), value, lanes) if dr.width(value) > 1 else value
