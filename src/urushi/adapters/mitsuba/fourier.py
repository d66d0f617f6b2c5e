"""``fourier``: a BSDF from a Fourier ``.bsdf`` file (layerlab, pbrt-v3), as Mitsuba 0.6 had it.

    parameter      type      what
    filename       string    the file
    eta            float     index below over index above, in place of the file's (layerlab always writes 1)
    parameter_N    float     where in the grid of parameters, for a file that has one; linear between its corners

    {"type": "fourier", "filename": "coat.bsdf"}

    <bsdf type="fourier">
        <string name="filename" value="coat.bsdf"/>
    </bsdf>

The file says what either side does; nothing is mirrored. Values are pbrt-v3's, to the clamping of what is negative.
Directions are sampled with an exact density (`urushi.optics.series`), also where the file rings. In spectral variants a
colour becomes a mixture of three fixed spectra that add up to 1, in monochrome ones its luminance. Derivatives are not
followed through the tables.
"""

from __future__ import annotations

import math
import re
from typing import Any

import drjit as dr

from urushi.adapters.fourier import FourierTable, blended, read_fourier
from urushi.adapters.fourier.build import GREEN
from urushi.adapters.fourier.prepared import tabulated
from urushi.errors import MaterialError, close


def register(mi: Any) -> None:
    """Register the plugin in the current variant."""
    plugin = make_plugin(mi)
    mi.register_bsdf("fourier", lambda props: plugin(props))


def make_plugin(mi: Any) -> Any:
    """The class of the plugin in the current variant (its base class belongs to the variant)."""

    class Fourier(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.filename, self.table, self.point = _described(mi, props)
            self.eta = float(props.get("eta", self.table.eta))
            if not 0 < self.eta < math.inf:
                where = f"{props.id() or 'fourier'}.eta"
                raise MaterialError(f"found {self.eta}; allowed: a positive number", where=where)
            self.tables = tabulated(self.table, mi.Float, luminance="mono" in mi.variant())
            flags = mi.BSDFFlags
            bent = flags.NonSymmetric if self.eta != 1 else 0
            self._parts: dict[bool, tuple[int, Any]] = {}
            components: list[Any] = []
            for reflects, kind, extra in (
                (True, flags.GlossyReflection, 0),
                (False, flags.GlossyTransmission, bent),
            ):
                sides = _sides(flags, self.tables.lit, reflects)
                if sides:
                    self._parts[reflects] = len(components), kind
                    components.append(kind | sides | extra)
            self.m_components = components
            self.m_flags = 0
            for component in components:
                self.m_flags |= component
            # The spectra of the primaries; colours are mixtures of them.
            self._primaries = []
            if "spectral" in mi.variant() and self.tables.channels == 3:
                unit = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
                self._primaries = [mi.load_dict({"type": "rgb", "value": value}) for value in unit]

        def _coloured(self, sums: list[Any], si: Any, active: Any) -> Any:
            """The value of the channels in a file, in the variant's colours; nothing is negative."""
            y = dr.maximum(sums[0], 0)
            if len(sums) == 1:
                return mi.UnpolarizedSpectrum(y)
            r, b = sums[1:]
            r, g, b = (dr.maximum(v, 0) for v in (r, GREEN[0] * y + GREEN[1] * r + GREEN[2] * b, b))
            if not self._primaries:
                return mi.UnpolarizedSpectrum(r, g, b)
            shares = [texture.eval(si, active) for texture in self._primaries]
            return (r * shares[0] + g * shares[1] + b * shares[2]) / (shares[0] + shares[1] + shares[2])

        def _spectrum(self, value: Any) -> Any:
            return mi.depolarizer(value) if "polarized" in mi.variant() else value

        def _enabled(self, ctx: Any, reflected: Any) -> Any:
            """Mask of the lanes whose kind of scattering the caller asks for."""
            asked = [
                reflects in self._parts and ctx.is_enabled(self._parts[reflects][1], self._parts[reflects][0])
                for reflects in (True, False)
            ]
            return dr.select(reflected, *asked)

        def _value(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            value = self._coloured(self.tables.eval(si.wi, wo, active), si, active)
            if ctx.mode == mi.TransportMode.Radiance and self.eta != 1:
                crossed = dr.select(si.wi.z > 0, self.eta**-2, self.eta**2)
                value *= dr.select(si.wi.z * wo.z < 0, crossed, 1)
            return dr.select(active, value, 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            active = active & self._enabled(ctx, si.wi.z * wo.z > 0)
            return self._spectrum(self._value(ctx, si, wo, active))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.tables.pdf(si.wi, wo, active & self._enabled(ctx, si.wi.z * wo.z > 0))

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wo, found = self.tables.sample(si.wi, (sample1, sample2.x, sample2.y), active)
            reflected = si.wi.z * wo.z > 0
            active = found & self._enabled(ctx, reflected)
            pdf = self.tables.pdf(si.wi, wo, active)
            active &= pdf > 0
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf = wo, dr.select(active, pdf, 0)
            bs.eta = dr.select(reflected, 1.0, dr.select(si.wi.z > 0, self.eta, 1 / self.eta))
            (a, one), (b, other) = (self._parts.get(reflects, (0, 0)) for reflects in (True, False))
            bs.sampled_type = dr.select(reflected, mi.UInt32(int(one)), mi.UInt32(int(other)))
            bs.sampled_component = dr.select(reflected, mi.UInt32(a), mi.UInt32(b))
            value = self._value(ctx, si, wo, active)
            return bs, self._spectrum(dr.select(active, value / dr.maximum(pdf, 1e-30), 0))

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            """Directional-hemispherical reflectance for si.wi, as denoisers and albedo images want it."""
            above, below = self.tables.flux(si.wi, active)
            sums = [dr.select(si.wi.z > 0, a, b) for a, b in zip(above, below, strict=True)]
            return dr.select(active, self._coloured(sums, si, active), 0)

        def to_string(self) -> str:
            said = {
                "filename": repr(self.filename),
                "nodes": len(self.table.nodes),
                "orders": self.table.max_order,
                "channels": self.table.channels,
                "eta": f"{self.eta:g}",
            }
            said |= {f"parameter_{i}": f"{value:g}" for i, value in enumerate(self.point)}
            return "Fourier[\n" + ",\n".join(f"  {name} = {value}" for name, value in said.items()) + "\n]"

        __repr__ = to_string

    return Fourier


def _described(mi: Any, props: Any) -> tuple[str, FourierTable, list[float]]:
    """The file, what it says at the point that was asked for, and that point."""
    where = props.id() or "fourier"
    given: dict[int, Any] = {}
    for key in list(props.keys()):
        match = re.fullmatch(r"parameter_(0|[1-9]\d*)", key)
        if match:
            given[int(match[1])] = props[key]
        elif key not in ("filename", "eta"):
            near = close(key, ["filename", "eta", "parameter_0"])
            raise MaterialError(f"found {key!r}; {near}allowed: filename, eta, parameter_N", where=where)
    name = props.get("filename", None)
    if not isinstance(name, str) or not name:
        raise MaterialError(f"found {name!r}; allowed: a Fourier .bsdf file", where=f"{where}.filename")
    table = read_fourier(str(mi.file_resolver().resolve(name)))
    if table.extrapolated:
        raise MaterialError(
            "found 3; allowed: 1, as extrapolated series cannot be evaluated", where="flags", file=name
        )
    if sorted(given) != list(range(len(table.positions))):
        ranges = ", ".join(f"parameter_{i} ({p[0]:g} to {p[-1]:g})" for i, p in enumerate(table.positions))
        found = ", ".join(f"parameter_{i}" for i in sorted(given)) or "no parameters"
        raise MaterialError(f"found {found}; allowed: {ranges or 'none, as the file has none'}", where=where)
    point = [given[i] for i in sorted(given)]
    return name, blended(table, point) if point else table, point


def _sides(flags: Any, lit: Any, reflects: bool) -> Any:
    """The sides from which light is reflected or transmitted at all."""
    found = 0
    for side, flag in ((1, flags.FrontSide), (0, flags.BackSide)):
        if lit[side, side if reflects else 1 - side]:
            found |= flag
    return found
