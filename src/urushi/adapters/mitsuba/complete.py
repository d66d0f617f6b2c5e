"""``complete_roughconductor`` and ``complete_roughdielectric``: Mitsuba's rough plugins, with the light they lose.

Single-scattering microfacets drop what meets a second facet: more than half of the light at a roughness of 1. These
take the parameters of the built-in `roughconductor` and `roughdielectric`, by the same names, and give it back:

    multiple_scattering   string    ``compensated`` (default; bounded cost, differentiable) or ``walk`` (the reference:
                                    a random walk between the facets, noisier)
    samples, seed         int       for ``walk``, as in `layered`

    {"type": "complete_roughconductor", "material": "Au", "alpha": 0.4, "distribution": "ggx"}

A white furnace stays white at every roughness, so long as `specular_reflectance` and `specular_transmittance` are 1.
Masking is height-correlated Smith (the built-in plugins have the separable form). A `layered` stack takes them as
layers, too.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from urushi.errors import MaterialError
from urushi.stack import Stack

from .nested import is_one, read_child
from .plugin import make_plugin
from .surface import traversed

#: our plugins, and the built-in ones whose parameters they take
BUILT_IN = {"complete_roughconductor": "roughconductor", "complete_roughdielectric": "roughdielectric"}
#: what may be said besides those parameters
OWN = ("multiple_scattering", "samples", "seed")
TINTS = ("specular_reflectance", "specular_transmittance")


def register(mi: Any) -> None:
    """Register the plugins in the current variant."""
    layered = make_plugin(mi)
    for name in BUILT_IN:
        plugin = _make(mi, layered, name)
        mi.register_bsdf(name, lambda props, plugin=plugin: plugin(props))


def _make(mi: Any, layered: Any, name: str) -> Any:
    class Complete(layered):
        outer_name = "layer_0."

        def _describe(self, props: Any) -> tuple[Any, dict[str, Any]]:
            where = props.id() or name
            how = props.get("multiple_scattering", "compensated")
            if how not in ("compensated", "walk"):
                raise MaterialError(
                    f"found {how!r}; allowed: compensated, walk (without: {BUILT_IN[name]})",
                    where=f"{where}.multiple_scattering",
                )
            given = {key: props[key] for key in props.keys() if key not in OWN}  # noqa: SIM118 (no mapping)
            built_in = mi.load_dict({"type": BUILT_IN[name], **given})
            layer, sources, _ = read_child(mi, built_in, 1.0, complete=how)
            found = traversed(mi, built_in)
            self.tints = {
                tint: found[tint] for tint in TINTS if tint in found and not is_one(mi, found[tint])
            }
            return Stack(name=where, layers=(layer,)), {f"layer_0.{key}": v for key, v in sources.items()}

        def _tint(self, si: Any, wo: Any, active: Any) -> Any:
            tint = mi.UnpolarizedSpectrum(1)
            for key, texture in self.tints.items():
                here = (si.wi.z * wo.z > 0) == (key == "specular_reflectance")
                tint = dr.select(here, texture.eval(si, active), tint)
            return tint

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return layered.eval(self, ctx, si, wo, active) * self._tint(si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            bs, weight = layered.sample(self, ctx, si, sample1, sample2, active)
            return bs, weight * self._tint(si, bs.wo, active)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return layered.eval_diffuse_reflectance(self, si, active) * self._tint(si, si.wi, active)

        def traverse(self, callback: Any) -> None:
            layered.traverse(self, callback)
            for tint, texture in self.tints.items():
                callback.put(tint, texture, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return layered.to_string(self).replace("Layered[", f"{name}[", 1)

        __repr__ = to_string

    return Complete
