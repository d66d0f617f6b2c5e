"""A stack solved by lobes, for Python: numpy or Dr.Jit in and out, and the lobes themselves as a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from urushi.errors import UnsupportedStack, UrushiError
from urushi.stack import Stack

from ...optics.vectors import channels, module_of
from ..arrays import backend_module, choice, mapped, number_type, vector_type
from ..bound import bind
from ..bsdf import BSDF, Sample, directions, random_numbers, same_count
from ..ledger import Ledger, lit
from ..numbers import as_arrays, gather_numbers
from ..smooth import has_delta, smooth_energy, straight
from .angular import tabulate
from .core import LobesCore
from .energies import Energies
from .operators import supports


@dataclass(frozen=True)
class LobeTable:
    """The lobes for light from one direction.

    Attributes:
        energy: (K, 3) fraction of the incident flux, delta parts and diffuse light included.
        direction: (K, 3) mean direction.
        alpha: (K, 2) roughness along two axes; 0 for a delta part, nan for diffuse light.
        axis: (K,) angle of the first of these axes, in degrees from x.
        kind: K words: "reflected", "forward", "transmitted", "delayed" (see `lobe.Lobe`), "diffuse", "delta".
        layer: (K,) number of the interface that sent it; -1 where there is none in particular.
    """

    energy: np.ndarray
    direction: np.ndarray
    alpha: np.ndarray
    axis: np.ndarray
    kind: tuple[str, ...]
    layer: np.ndarray

    def __len__(self) -> int:
        return len(self.kind)

    def __repr__(self) -> str:
        rows = ["kind         layer  energy (r g b)          direction              alpha           axis"]
        for k, kind in enumerate(self.kind):
            layer = str(self.layer[k]) if self.layer[k] >= 0 else "-"
            energy = " ".join(f"{e:.4f}" for e in self.energy[k])
            direction = " ".join(f"{d:+.3f}" for d in self.direction[k])
            x, y = self.alpha[k]
            alpha = "-" if np.isnan(x) else f"{x:.4f}" if np.isclose(x, y) else f"{x:.4f} {y:.4f}"
            axis = "-" if np.isnan(x) or np.isclose(x, y) else f"{self.axis[k]:.1f}"
            rows.append(f"{kind:12s} {layer:>5s}  {energy}  {direction}  {alpha:14s}  {axis}")
        return "\n".join(rows)


class LobesBSDF(BSDF):
    """A handful of lobes as a BSDF: an approximation in closed form.

    Args:
        stack: the description.
        published: as the paper of 2018 and its code have it, for comparison; no diffuse layers.
        symmetric: reflection in a form that is reciprocal, and whose energy is not exact any more.
        parameters: values in place of those of the description, one for all or one per evaluation, such as
            ``{"layer_0.alpha": alphas}`` (`urushi.solvers.numbers.gather_numbers`).
        backend: "llvm", "cuda", "scalar" (slow), or "auto": CUDA where there is one, else LLVM. Dr.Jit arrays as
            arguments are computed where they are, with derivatives.
        precision: "single" or "double".
        mode: "radiance" scales transmitted light by (n_wi / n_wo)^2, as Mitsuba does; "importance" does not.

    Raises:
        UrushiError: an option out of range.
        UnsupportedStack: an interface that has no operators.
    """

    def __init__(
        self,
        stack: Stack,
        *,
        published: bool = False,
        symmetric: bool = False,
        parameters: Mapping[str, Any] | None = None,
        backend: str = "auto",
        precision: str = "single",
        mode: str = "radiance",
    ) -> None:
        choice("published", published, (False, True))
        choice("symmetric", symmetric, (False, True))
        choice("backend", backend, ("auto", "llvm", "cuda", "scalar"))
        choice("precision", precision, ("single", "double"))
        choice("mode", mode, ("radiance", "importance"))
        self.stack, self.mode = stack, mode
        self.published, self.symmetric = published, symmetric
        self.parameters = dict(parameters or {})
        self.backend, self.double = backend, precision == "double"
        self._module = backend_module(backend)
        self._cores: dict[tuple[str, bool], tuple[LobesCore, int]] = {}
        self._untabulated: set[tuple[str, bool]] = set()
        self._energies: Energies | None = None
        core, self.lanes = self._core(self._module, self.double)
        self.diagnostics = {
            "method": "lobes",
            "reason": "closed form",
            "backend": self._module.__name__.removeprefix("drjit."),
            "precision": precision,
            "published": published,
            "symmetric": symmetric,
            "reciprocal": core.tilted is None and (core.alone or (symmetric and core.stack.opaque)),
            "consistent_to": 0.02,  # energies are from tables, and values from lobes of that energy
            "energies": "recursion" if core.energies is None else "direction by direction",
            "interfaces": len(core.stack.interfaces),
            "media": sum(medium is not None for medium in core.stack.media),
            "coloured": core.spectrum is not number_type(self._module, self.double),
            "delta_parts": has_delta(core.stack),
            "estimated_error": "an approximation whose error nothing here knows: compare with the walk or adding",
        }

    # --- the contract ------------------------------------------------------------------------------------------

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: (N, 3), (N, 3) -> (N, 3); with `with_error`, that and 0.

        There is no noise, so the standard error is 0. How far the approximation is off is not known here: compare it.
        """
        if dr.is_array_v(wi):
            return self._erred(self._colour(self._core_of(wi).eval(wi, wo), wi), with_error)
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (value,) = self._map(lambda core, a, b: (core.eval(a, b),), pair)
        return self._erred(self._shaped(value, wi, wo), with_error)

    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: (N, 3), (N, 3) -> (N,); delta parts are 0."""
        if dr.is_array_v(wi):
            return self._core_of(wi).pdf(wi, wo)
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (density,) = self._map(lambda core, a, b: (core.pdf(a, b),), pair)
        return density[0] if np.ndim(wi) == np.ndim(wo) == 1 else density

    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: wi (N, 3), u (N, 3) in [0, 1); u[:, 0] chooses a lobe, the others a direction of it."""

        def run(core: LobesCore, a: Any, b: Any) -> tuple[Any, ...]:
            wo, pdf, carried, delta = core.sample(a, b)
            value = dr.select(delta, carried * core.scale(a, wo), core.eval(a, wo))
            return wo, dr.select(pdf > 0, value / dr.maximum(pdf, 1e-30), 0), pdf, delta

        if dr.is_array_v(wi):
            wo, weight, pdf, delta = run(self._core_of(wi), wi, u)
            return Sample(wo, self._colour(weight, wi), pdf, delta)
        pair = same_count(directions(wi, "wi"), random_numbers(u), "wi and u")

        def plain(core: LobesCore, a: Any, b: Any) -> tuple[Any, ...]:
            wo, weight, pdf, delta = run(core, a, b)
            return wo, weight, pdf, dr.select(delta, 1.0, 0.0) + 0 * pdf

        wo, weight, pdf, delta = self._map(plain, pair)
        wo = wo / np.maximum(np.linalg.norm(wo, axis=1, keepdims=True), 1e-30)
        found = wo, self._shaped(weight, None, None), pdf, delta > 0.5
        return Sample(*((x[0] for x in found) if np.ndim(wi) == np.ndim(u) == 1 else found))

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance on the side of wi: (N, 3) -> (N, 3)."""
        return self._flux(wi, True, with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side (no factor of radiance): (N, 3) -> (N, 3)."""
        return self._flux(wi, False, with_error)

    def absorption(self, wi: Any, *, with_error: bool = False) -> Ledger:
        """Where the light from wi goes, as the recursion has it; errors are 0 (see `eval`), and the precision double.

        Raises:
            UrushiError: the published form, whose energies do not add up; a Dr.Jit array.
        """
        from .ledger import followed

        if self.published:
            raise UrushiError(
                "published: found True; allowed for a ledger: False, since its energies do not add up"
            )
        array = lit(wi, self._core(self._module, self.double)[0].stack.opaque)
        self._may_take(len(array))
        return followed(self, array, with_error)

    # --- the lobes ---------------------------------------------------------------------------------------------

    def lobes(self, wi: Any) -> LobeTable:
        """The lobes for light from one direction wi (3,), as a table that prints itself.

        Raises:
            UrushiError: more than one direction, or parameters that are one per evaluation.
        """
        array = directions(wi, "wi")
        if len(array) != 1 or self.lanes != 1:
            raise UrushiError(
                f"wi: found {len(array)} directions and {self.lanes} values of parameters; allowed: one"
            )
        module = self._module
        core = self._core(module, self.double)[0]
        w = vector_type(module, self.double)(*(float(x) for x in array[0]))
        above = bool(array[0, 2] > 0)
        if not above and core.stack.opaque:
            empty = np.zeros((0, 3))
            return LobeTable(empty, empty, np.zeros((0, 2)), np.zeros(0), (), np.zeros(0, int))
        found = core.find(w, above)
        rows: list[tuple[Any, ...]] = []
        if has_delta(core.stack):
            reflected, transmitted = smooth_energy(core.stack, w)
            rows.append((reflected, type(w)(-w.x, -w.y, w.z), 0.0, 0.0, 0.0, "delta", -1))
            if not core.stack.opaque:
                rows.append((transmitted, straight(core.stack, w), 0.0, 0.0, 0.0, "delta", -1))
        for lobe in found.all():
            o = lobe.direction()
            up = above == lobe.same
            turn = dr.atan2(lobe.frame.sin, lobe.frame.cos) * 180 / dr.pi if lobe.frame.turned else 0.0
            layer = lobe.layer if lobe.layer < len(core.stack.interfaces) else -1
            o = type(w)(o.x, o.y, o.z if up else -o.z)
            rows.append((lobe.energy, o, lobe.alpha_x, lobe.alpha_y, turn, lobe.kind, layer))
        for energy, up in ((found.diffuse, above), (found.beyond, not above)):
            if not (isinstance(energy, float) and energy == 0):
                axis = type(w)(0, 0, 1 if up else -1)
                rows.append((energy, axis, np.nan, np.nan, 0.0, "diffuse", -1))
        one = np.array
        return LobeTable(
            one([np.broadcast_to(np.ravel(one(row[0], float)), 3) for row in rows]),
            one([np.ravel(one(row[1], float)) for row in rows]),
            one([[float(np.ravel(one(a))[0]) for a in row[2:4]] for row in rows]),
            one([float(np.ravel(one(row[4]))[0]) for row in rows]),
            tuple(row[5] for row in rows),
            one([row[6] for row in rows]),
        )

    # --- how it runs -------------------------------------------------------------------------------------------

    def _flux(self, wi: Any, same: bool, with_error: bool) -> Any:
        if dr.is_array_v(wi):
            return self._erred(self._colour(self._core_of(wi, False).flux(wi, same), wi), with_error)
        (value,) = self._map(lambda core, a: (core.flux(a, same),), (directions(wi, "wi"),), False)
        return self._erred(self._shaped(value, wi, wi), with_error)

    def _made_of(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.stack,), {
            "published": self.published,
            "symmetric": self.symmetric,
            "parameters": as_arrays(self.parameters),
            "backend": self.backend,
            "precision": "double" if self.double else "single",
            "mode": self.mode,
        }

    def _map(self, run: Any, inputs: tuple[np.ndarray, ...], quick: bool = True) -> list[np.ndarray]:
        self._may_take(len(inputs[0]))
        get = self._quick_core if quick else lambda *key: self._core(*key)[0]
        core = get(self._module, self.double)
        return mapped(lambda *lanes: run(core, *lanes), inputs, self._module, self.double)

    def _may_take(self, rows: int) -> None:
        if self.lanes not in (1, rows):
            raise UrushiError(
                f"wi: found {rows} rows; allowed: {self.lanes}, as many as the parameters have values"
            )

    def _core(self, module: Any, double: bool) -> tuple[LobesCore, int]:
        key = module.__name__, double
        if key not in self._cores:
            numbers = gather_numbers(self.stack, self.parameters, module, double, "lobes")
            bound = bind(self.stack, numbers.values, numbers.fixed)
            unknown = [type(i).__name__ for i in bound.interfaces if not supports(getattr(i, "inner", i))]
            if unknown:
                raise UnsupportedStack("lobes", [f"there are no operators for {', '.join(unknown)}"])
            spectrum = vector_type(module, double) if numbers.coloured else number_type(module, double)
            radiance = self.mode == "radiance"
            uniform = numbers.lanes == 1 and module.__name__ != "drjit.scalar"
            if uniform:  # what is not computed yet may be given as many lanes as it is first used with
                dr.eval([getattr(interface, "inv_eta", None) for interface in bound.interfaces])
            core = LobesCore(bound, spectrum, radiance, self.symmetric, self.published, uniform)
            live = any(dr.grad_enabled(v) for v in numbers.values.values())
            if not self._cores and numbers.lanes == 1:  # all others are of the same numbers
                self._energies = Energies.of(core)
            core.energies = self._energies
            self._cores[key] = core, numbers.lanes
            if uniform and not double and not live:
                self._untabulated.add(key)
        return self._cores[key]

    def _quick_core(self, module: Any, double: bool) -> LobesCore:
        """The same with its tables, which are made when they are first asked for: not while code is recorded."""
        core, _ = self._core(module, double)
        key = module.__name__, double
        if key in self._untabulated and not dr.flag(dr.JitFlag.SymbolicScope):
            self._untabulated.remove(key)
            core.tables = tabulate(core, vector_type(module, double))
        return core

    def _core_of(self, w: Any, quick: bool = True) -> LobesCore:
        get = self._quick_core if quick else lambda *key: self._core(*key)[0]
        return get(module_of(w), dr.type_v(w) == dr.VarType.Float64)

    def _erred(self, value: Any, with_error: bool) -> Any:
        return (value, 0 * value) if with_error else value

    def _colour(self, value: Any, like: Any) -> Any:
        return value if channels(value) else type(like)(value)

    def _shaped(self, value: np.ndarray, *arguments: Any) -> np.ndarray:
        value = np.repeat(value[:, None], 3, axis=1) if value.ndim == 1 else value
        single = all(argument is not None and np.ndim(argument) == 1 for argument in arguments)
        return value[0] if single else value
