"""``layered``: a stack of layers as a Mitsuba BSDF.

    parameter      type              what
    filename       string            material file, or ``preset:NAME``; or nested children instead:
    layer_0, ...   BSDF or medium    layers from the top down: dielectric, roughdielectric, conductor, roughconductor,
                                     diffuse, homogeneous, complete_roughconductor, complete_roughdielectric
    footprint      float             side of the square of texture coordinates that a pixel sees, for normal maps (0)
    thickness_N    float             geometric thickness of the medium ``layer_N`` (1)
    method         string            ``walk`` (default), ``adding``, ``lobes``, or ``auto``
    samples        int               walk: paths per evaluation (1)
    seed           int               walk: another seed is another noise (0)
    max_depth      int               walk: most scattering events inside (-1: no limit)
    accuracy       float             adding: error allowed (1e-3)
    nodes          int               adding: nodes in each panel of directions (0: as many as that needs)
    orders         int               adding: azimuthal orders (0: as many as that needs)
    media          string            adding: how media are solved, ``ordinates``, ``doubling`` or ``riccati``
    corners        int               adding: values that a textured parameter is solved for (5)
    published      bool              lobes: as the paper of 2018 has them (false)
    symmetric      bool              lobes: the reciprocal form (false)

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

import math
import re
from typing import Any

import drjit as dr

from urushi.description.base import inside
from urushi.errors import MaterialError, close
from urushi.io import load
from urushi.solvers.smooth import has_delta

from .adding import Adding
from .lobes import Lobes
from .methods import Walk
from .nested import read_children
from .surface import Surface

METHODS: dict[str, Any] = {"walk": Walk, "adding": Adding, "lobes": Lobes}

#: what may be said besides the layers
OPTIONS = (
    "filename",
    "method",
    "footprint",
    *dict.fromkeys(o for method in METHODS.values() for o in method.OPTIONS),
)


def register(mi: Any) -> None:
    """Register the plugin in the current variant."""
    plugin = make_plugin(mi)
    mi.register_bsdf("layered", lambda props: plugin(props))


def make_plugin(mi: Any) -> Any:
    """The class of the plugin in the current variant (its base class belongs to the variant)."""

    class Layered(mi.BSDF):
        #: the part of a parameter's name that `mi.traverse` leaves out
        outer_name = ""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.stack, sources = self._describe(props)
            method = _method(props)
            try:
                self.surface = Surface(mi, self.stack, sources, _footprint(props))
            except MaterialError as error:
                raise inside(error, props.id() or "layered") from None
            self.method = method(mi, self.stack, self.surface, props)
            self._find_components()

        def _describe(self, props: Any) -> tuple[Any, dict[str, Any]]:
            return _described(mi, props)

        def _find_components(self) -> None:
            stack = self.method.at(None, dr.zeros(mi.SurfaceInteraction3f), True).stack
            found = _components(mi, stack, self.surface)
            self._parts = {part: (number, kinds) for number, (part, (kinds, _)) in enumerate(found.items())}
            self.m_components = [flags for _, flags in found.values()]
            self.m_flags = 0
            for component in self.m_components:
                self.m_flags |= component

        # --- evaluation ----------------------------------------------------------------------------------------

        def _spectrum(self, value: Any) -> Any:
            value = mi.UnpolarizedSpectrum(value)
            return mi.depolarizer(value) if "polarized" in mi.variant() else value

        def _asked(self, ctx: Any, part: str) -> bool:
            """Whether the caller asks for a part of the scattering (see `_components`)."""
            number, kinds = self._parts.get(part, (0, ()))
            return any(ctx.is_enabled(kind, number) for kind in kinds)

        def _said(self, reflected: Any, one: str, other: str) -> tuple[Any, Any]:
            """How `sample` calls a part: its flag and its number, by the side that wo is on."""
            (a, kinds_a), (b, kinds_b) = (self._parts.get(part, (0, (0,))) for part in (one, other))
            kind = dr.select(reflected, mi.UInt32(int(kinds_a[0])), mi.UInt32(int(kinds_b[0])))
            return kind, dr.select(reflected, mi.UInt32(a), mi.UInt32(b))

        def _enabled(self, ctx: Any, reflected: Any) -> Any:
            """Mask of the lanes whose kind of scattering (not a delta part) the caller asks for."""
            return dr.select(reflected, self._asked(ctx, "reflected"), self._asked(ctx, "transmitted"))

        @property
        def _transmits(self) -> bool:
            return not self.stack.layers[-1].opaque

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            value = self.method.at(ctx, si, active).eval(si.wi, wo)
            active = active & self._enabled(ctx, si.wi.z * wo.z > 0)
            return self._spectrum(dr.select(active, value, 0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            density = self.method.at(ctx, si, active).pdf(si.wi, wo)
            return dr.select(active & self._enabled(ctx, si.wi.z * wo.z > 0), density, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            here, wi = self.method.at(ctx, si, active), si.wi
            wo, pdf, carried, delta = here.sample(wi, mi.Vector3f(sample1, sample2.x, sample2.y))
            value = here.eval(wi, wo)
            reflected = wi.z * wo.z > 0
            wanted = self._enabled(ctx, reflected)
            if delta is not False:
                value = dr.select(delta, carried * here.scale(wi, wo), value)
                sharp = dr.select(reflected, self._asked(ctx, "mirrored"), self._asked(ctx, "straight"))
                wanted = dr.select(delta, sharp, wanted)
            active = active & (pdf > 0) & wanted
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf = wo, dr.select(active, pdf, 0)
            stack = here.stack
            ratio = stack.indices[-1] / stack.indices[0] if self._transmits else 1.0
            bs.eta = dr.select(reflected, 1.0, dr.select(wi.z > 0, ratio, 1 / ratio))
            kind, component = self._said(reflected, "reflected", "transmitted")
            if delta is not False:
                sharp_kind, sharp_component = self._said(reflected, "mirrored", "straight")
                kind = dr.select(delta, sharp_kind, kind)
                component = dr.select(delta, sharp_component, component)
            bs.sampled_type, bs.sampled_component = kind, component
            weight = dr.select(active, value / dr.maximum(pdf, 1e-30), 0)
            return bs, self._spectrum(weight)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            """Directional-hemispherical reflectance for si.wi, as denoisers and albedo images want it."""
            albedo = self.method.at(None, si, active).albedo(si.wi)
            return mi.UnpolarizedSpectrum(dr.select(active, albedo, 0))

        # --- parameters ----------------------------------------------------------------------------------------

        def traverse(self, callback: Any) -> None:
            for name, parameter in self.surface.each():
                flags = mi.ParamFlags.Differentiable
                if name.endswith("rotation"):
                    flags = mi.ParamFlags.NonDifferentiable
                if not parameter.textured and parameter.fixed is not None and "alpha" in name:
                    flags |= mi.ParamFlags.Discontinuous
                callback.put(name.removeprefix(self.outer_name), parameter.value, flags)

        def parameters_changed(self, keys: Any = ()) -> None:
            """What shapes the compiled code (smooth or rough, index-matched, without scattering) follows the values.

            Raises:
                MaterialError: a value that the description would refuse.
            """
            self.surface.changed()
            self.method.changed()
            self._find_components()

        def to_string(self) -> str:
            said = {"name": repr(self.stack.name), **self.method.said(), "exterior": self.stack.exterior}
            lines = [f"  {name} = {value}" for name, value in said.items()]
            lines += [_layer_said(i, layer, self.surface) for i, layer in enumerate(self.stack.layers)]
            return "Layered[\n" + ",\n".join(lines) + "\n]"

        __repr__ = to_string

    return Layered


def _layer_said(number: int, layer: Any, surface: Surface) -> str:
    """A layer as `to_string` shows it: what it is, and the values that its parameters have now."""
    words = [layer.kind]
    words += [getattr(layer, name) for name in ("distribution", "masking") if hasattr(layer, name)]
    if layer.is_medium:
        phases = layer.phase if isinstance(layer.phase, tuple) else (layer.phase,)
        words.append(" to ".join(phase.kind for phase in phases))
    head = f"layer_{number}."
    lines = [" ".join(words)]
    for name, parameter in surface.each():
        if name.startswith(head):
            lines.append(f"{name[len(head) :]} = {parameter.said()}")
    inside = ",\n".join(lines).replace("\n", "\n    ")
    return f"  layer_{number} = [\n    {inside}\n  ]"


def _described(mi: Any, props: Any) -> tuple[Any, dict[str, Any]]:
    """The stack, from a file or from nested children, and the textures that came with them."""
    where = props.id() or "layered"
    children: dict[str, Any] = {}
    thickness: dict[int, float] = {}
    for key in list(props.keys()):
        match = re.fullmatch(r"thickness_(0|[1-9]\d*)", key)
        if match:
            thickness[int(match[1])] = _length(props[key], f"{where}.{key}")
        elif isinstance(props[key], mi.Object):
            children[key] = props[key]
        elif key not in OPTIONS:
            near = close(key, [*OPTIONS, "thickness_0"])
            names = ", ".join((*OPTIONS, "layer_N", "thickness_N"))
            raise MaterialError(f"found {key!r}; {near}allowed: {names}", where=where)
    if "filename" in props:
        if children or thickness:
            given = ", ".join([*children, *(f"thickness_{i}" for i in thickness)])
            raise MaterialError(f"found filename and {given}; allowed: a file, or nested layers", where=where)
        name = props["filename"]
        if not isinstance(name, str) or not name:
            raise MaterialError(f"found {name!r}; allowed: a file, or preset:NAME", where=f"{where}.filename")
        if not name.startswith("preset:"):
            name = str(mi.file_resolver().resolve(name))
        return load(name), {}
    if not children:
        raise MaterialError("found no layers; allowed: filename, or layer_0, layer_1, ...", where=where)
    return read_children(mi, children, thickness, where)


def _footprint(props: Any) -> float:
    if "footprint" not in props:
        return 0.0
    return _length(props["footprint"], "footprint")


def _length(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
        raise MaterialError(f"found {value!r}; allowed: a number from 0", where=where)
    return float(value)


def _method(props: Any) -> Any:
    """The class of the method that was asked for."""
    name, names = props.get("method", "walk"), (*METHODS, "auto")
    if name not in names:
        raise MaterialError(
            f"found {name!r}; {close(name, names)}allowed: {', '.join(names)}",
            where=f"{props.id() or 'layered'}.method",
        )
    name = "walk" if name == "auto" else name
    others = {option for method in METHODS.values() for option in method.OPTIONS} - set(METHODS[name].OPTIONS)
    for option in sorted(others):
        if option in props:
            raise MaterialError(
                f"is no option of method {name!r}; allowed: {', '.join(METHODS[name].OPTIONS)}",
                where=f"{props.id() or 'layered'}.{option}",
            )
    return METHODS[name]


def _components(mi: Any, stack: Any, surface: Surface) -> dict[str, tuple[tuple[Any, ...], Any]]:
    """The parts of the scattering: what they are called (as `sample` says it first) and the flags of each component.

    ``reflected`` and ``transmitted`` are what `eval` knows; ``mirrored`` and ``straight`` are the delta parts, where
    smooth interfaces let light through unscattered. A diffuse base under a coat is part of ``reflected``.
    """
    flags = mi.BSDFFlags
    sides = flags.FrontSide if stack.opaque else flags.FrontSide | flags.BackSide
    extra = sides | (flags.SpatiallyVarying if surface.varies else 0)
    if any(isinstance(parameter, tuple) for parameter in surface.parameters.values()):
        extra |= flags.Anisotropic
    bent = extra | flags.NonSymmetric
    media = any(medium is not None and medium.scatters for medium in stack.media)
    glossy = media or any(
        not interface.flat and interface.delta is not True for interface in stack.interfaces
    )
    wide = any(interface.flat for interface in stack.interfaces)
    found: dict[str, tuple[tuple[Any, ...], Any]] = {}
    kinds = (flags.GlossyReflection,) * glossy + (flags.DiffuseReflection,) * wide
    if kinds:
        found["reflected"] = kinds, extra | kinds[0] | kinds[-1]
        if not stack.opaque:
            found["transmitted"] = (flags.GlossyTransmission,), flags.GlossyTransmission | bent
    if has_delta(stack):
        found["mirrored"] = (flags.DeltaReflection,), flags.DeltaReflection | extra
        if not stack.opaque:
            found["straight"] = (flags.DeltaTransmission,), flags.DeltaTransmission | bent
    return found
