"""``layered``: a stack of layers as a Mitsuba BSDF.

    parameter      type              what
    filename       string            material file, or ``preset:NAME``; or nested children instead:
    layer_0, ...   BSDF or medium    layers from the top down: dielectric, roughdielectric, conductor, roughconductor,
                                     diffuse, homogeneous
    thickness_N    float             geometric thickness of the medium ``layer_N`` (1)
    method         string            ``walk`` (default), or ``auto``
    samples        int               paths per evaluation (1)
    seed           int               another seed is another noise (0)
    max_depth      int               most scattering events inside (-1: no limit)

    {"type": "layered", "filename": "enamel.yaml"}

    <bsdf type="layered">
        <string name="filename" value="enamel.yaml"/>
    </bsdf>

`mi.traverse` shows every continuous parameter (``layer_0.alpha``, ``layer_1.albedo``, ...); those of textures and
spectra lie below them (``layer_0.alpha.data``). A stack without an opaque base transmits and is seen from both sides;
wrap an opaque one in ``twosided`` to see it from below.

Mitsuba gives `eval` no random numbers: each evaluation makes its own from a hash of (wi, wo, uv, time, seed), so that a
replay of the same path sees the same values. Light is treated as unpolarised in every variant.
"""

from __future__ import annotations

import re
from typing import Any

import drjit as dr

from urushi.errors import MaterialError, UnsupportedStack
from urushi.io import load
from urushi.solvers import PLANNED, SOLVERS
from urushi.solvers.walk import reasons_against
from urushi.solvers.walk.core import WalkCore
from urushi.solvers.walk.derivative import bind_live
from urushi.solvers.walk.smooth import has_delta

from .nested import read_children
from .surface import Surface


def register(mi: Any) -> None:
    """Register the plugin in the current variant."""
    plugin = make_plugin(mi)
    mi.register_bsdf("layered", lambda props: plugin(props))


def make_plugin(mi: Any) -> Any:
    """The class of the plugin in the current variant (its base class belongs to the variant)."""

    class Layered(mi.BSDF):  # type: ignore[misc, name-defined]
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.stack, sources = _described(mi, props)
            method = props.get("method", "walk")
            self.samples, self.seed = _whole(props, "samples", 1, 1), _whole(props, "seed", 0, 0)
            limit = _whole(props, "max_depth", -1, -1)
            self.max_depth = None if limit < 0 else limit
            _check_method(method, self.stack)
            self.surface = Surface(mi, self.stack, sources)
            self.m_components = _components(mi, self._bound(dr.zeros(mi.SurfaceInteraction3f), True), self.surface)
            self.m_flags = 0
            for component in self.m_components:
                self.m_flags |= component

        # --- evaluation ----------------------------------------------------------------------------------------

        def _bound(self, si: Any, active: Any) -> Any:
            return bind_live(self.stack, self.surface.at(si, active), self.surface.fixed())

        def _core(self, ctx: Any, si: Any, active: Any) -> WalkCore:
            coloured = self.surface.coloured and "mono" not in mi.variant()
            spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
            radiance = ctx is None or ctx.mode == mi.TransportMode.Radiance
            return WalkCore(self._bound(si, active), spectrum, radiance, self.max_depth)

        def _key(self, si: Any) -> tuple[Any, ...]:
            return si.uv.x, si.uv.y, si.time

        def _spectrum(self, value: Any) -> Any:
            value = mi.UnpolarizedSpectrum(value)
            return mi.depolarizer(value) if "polarized" in mi.variant() else value

        def _enabled(self, ctx: Any, reflected: Any) -> Any:
            """Mask of the lanes whose kind of scattering (not a delta part) the caller asks for."""
            flags = mi.BSDFFlags
            back = ctx.is_enabled(flags.GlossyReflection, 0) or ctx.is_enabled(flags.DiffuseReflection, 0)
            on = self._transmits and ctx.is_enabled(flags.GlossyTransmission, 1)
            return dr.select(reflected, back, on)

        @property
        def _transmits(self) -> bool:
            return not self.stack.layers[-1].opaque

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            core = self._core(ctx, si, active)
            value = core.eval(si.wi, wo, self._key(si), self.seed, 0, self.samples)
            active = active & self._enabled(ctx, si.wi.z * wo.z > 0)
            return self._spectrum(dr.select(active, value, 0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            density = self._core(ctx, si, active).pdf(si.wi, wo)
            return dr.select(active & self._enabled(ctx, si.wi.z * wo.z > 0), density, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            core, wi, flags = self._core(ctx, si, active), si.wi, mi.BSDFFlags
            wo, pdf, carried, delta = core.sample(wi, mi.Vector3f(sample1, sample2.x, sample2.y))
            value = core.eval(wi, wo, self._key(si), self.seed, 0, self.samples)
            reflected = wi.z * wo.z > 0
            wanted = self._enabled(ctx, reflected)
            if delta is not False:
                value = dr.select(delta, carried * core.scale(wi, wo), value)
                specular = ctx.is_enabled(flags.Delta)
                wanted = dr.select(delta, specular, wanted)
            active = active & (pdf > 0) & wanted
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf = wo, dr.select(active, pdf, 0)
            stack = core.stack
            ratio = stack.indices[-1] / stack.indices[0] if self._transmits else 1.0
            bs.eta = dr.select(reflected, 1.0, dr.select(wi.z > 0, ratio, 1 / ratio))
            kind = dr.select(reflected, +flags.GlossyReflection, +flags.GlossyTransmission)
            component = dr.select(reflected, 0, 1)
            if delta is not False:
                sharp = dr.select(reflected, +flags.DeltaReflection, +flags.DeltaTransmission)
                kind = dr.select(delta, sharp, kind)
                first = 2 if self._transmits else 1
                component = dr.select(delta, dr.select(reflected, first, first + 1), component)
            bs.sampled_type, bs.sampled_component = mi.UInt32(kind), mi.UInt32(component)
            weight = dr.select(active, value / dr.maximum(pdf, 1e-30), 0)
            return bs, self._spectrum(weight)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            """Directional-hemispherical reflectance for si.wi, as denoisers and albedo images want it."""
            core = self._core(None, si, active)
            up, down, *_ = core.flux(si.wi, self._key(si), self.seed, 0, max(self.samples, 4))
            return mi.UnpolarizedSpectrum(dr.select(active, dr.select(si.wi.z > 0, up, down), 0))

        # --- parameters ----------------------------------------------------------------------------------------

        def traverse(self, callback: Any) -> None:
            for name, parameter in self.surface.each():
                flags = mi.ParamFlags.Differentiable
                if name.endswith("rotation"):
                    flags = mi.ParamFlags.NonDifferentiable
                if not parameter.textured and parameter.fixed is not None and "alpha" in name:
                    flags |= mi.ParamFlags.Discontinuous
                callback.put(name, parameter.value, flags)

        def parameters_changed(self, keys: Any = ()) -> None:
            """What shapes the compiled code (smooth or rough, index-matched, without scattering) follows the values."""
            for _, parameter in self.surface.each():
                if not parameter.textured:
                    parameter.fixed = None

        def to_string(self) -> str:
            layers = ",\n".join(f"    {layer!r}" for layer in self.stack.layers)
            return (
                f"Layered[\n  name = {self.stack.name!r},\n  method = walk,\n  samples = {self.samples},\n"
                f"  seed = {self.seed},\n  layers = [\n{layers}\n  ]\n]"
            )

        __repr__ = to_string

    return Layered


def _described(mi: Any, props: Any) -> tuple[Any, dict[str, Any]]:
    """The stack, from a file or from nested children, and the textures that came with them."""
    children = {key: props[key] for key in props if isinstance(props[key], mi.Object)}
    thickness = {}
    for key in list(props.keys()):
        match = re.fullmatch(r"thickness_(\d+)", key)
        if match:
            thickness[int(match[1])] = float(props[key])
    if "filename" in props:
        if children or thickness:
            given = ", ".join([*children, *(f"thickness_{i}" for i in thickness)])
            raise MaterialError(f"found filename and {given}; allowed: a file, or nested layers", where="layered")
        name = props["filename"]
        if not name.startswith("preset:"):
            name = str(mi.file_resolver().resolve(name))
        return load(name), {}
    if not children:
        raise MaterialError("found no layers; allowed: filename, or layer_0, layer_1, ...", where="layered")
    return read_children(mi, children, thickness, props.id() or "layered")


def _whole(props: Any, name: str, default: int, low: int) -> int:
    value = props.get(name, default)
    if isinstance(value, bool) or int(value) != value or not low <= value < 2**31:
        raise MaterialError(f"found {value!r}; allowed: a whole number from {low}", where=f"layered.{name}")
    return int(value)


def _check_method(method: str, stack: Any) -> None:
    if method in PLANNED:
        raise UnsupportedStack(method, [f"this version of Urushi has no {method!r} yet"], list(SOLVERS))
    if method not in ("walk", "auto"):
        raise MaterialError(f"found {method!r}; allowed: walk, auto", where="layered.method")
    reasons = reasons_against(stack)
    if reasons:
        raise UnsupportedStack("walk", reasons)


def _components(mi: Any, stack: Any, surface: Surface) -> list[Any]:
    """Flags: scattering on both sides, then delta parts where a smooth interface lets light through unscattered."""
    flags = mi.BSDFFlags
    sides = flags.FrontSide if stack.opaque else flags.FrontSide | flags.BackSide
    extra = flags.SpatiallyVarying if surface.varies else 0
    if any(isinstance(parameter, tuple) for parameter in surface.parameters.values()):
        extra |= flags.Anisotropic
    wide = flags.DiffuseReflection if any(interface.flat for interface in stack.interfaces) else 0
    components = [flags.GlossyReflection | wide | sides | extra]
    asymmetric = flags.NonSymmetric if not stack.opaque else 0
    if not stack.opaque:
        components.append(flags.GlossyTransmission | sides | extra | asymmetric)
    if has_delta(stack):
        components.append(flags.DeltaReflection | sides | extra)
        if not stack.opaque:
            components.append(flags.DeltaTransmission | sides | extra | asymmetric)
    return components
