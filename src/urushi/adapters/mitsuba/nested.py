"""Mitsuba's own plugins as layers: `layer_0`, `layer_1`, ... from the top down.

    dielectric, roughdielectric        -> Dielectric (relative index times that of what lies above; separable masking)
    conductor, roughconductor          -> Conductor (its index is absolute)
    complete_roughconductor, complete_roughdielectric -> the same with scattering between the facets
    diffuse                            -> Diffuse
    normalmap around any of these      -> the same with that normal (light in between is kept, see `interfaces.tilted`)
    homogeneous (a medium)             -> Medium of depth sigma_t * scale * thickness_N (thickness_N is 1 by default)

Their textures stay what they are. Anything else is refused. Indices are relative in Mitsuba: the stack is taken to lie
in air. Mitsuba's rough plugins are rough everywhere (alpha below 1e-4 counts as 1e-4), and so are these.
"""

from __future__ import annotations

import re
from typing import Any

from urushi.description.base import inside
from urushi.errors import MaterialError, UnsupportedStack
from urushi.stack import Conductor, Dielectric, Diffuse, HenyeyGreenstein, Isotropic, Medium, Rayleigh, Stack

from .surface import Source, traversed

#: stands in a description for a value that Mitsuba's texture gives; inside every range
_NOMINAL = 0.5
#: smallest roughness of Mitsuba's rough plugins
_NARROWEST = 1e-4
#: relative indices are rounded to single precision: a slab between two of them ends in air again
_ROUNDING = 1e-6

_PHASES = {
    "HGPhaseFunction": "hg",
    "IsotropicPhaseFunction": "isotropic",
    "RayleighPhaseFunction": "rayleigh",
}


def read_children(
    mi: Any, children: dict[str, Any], thickness: dict[int, float], name: str
) -> tuple[Stack, dict[str, Any]]:
    """The stack that nested plugins describe, and Mitsuba's objects behind its parameters.

    Args:
        children: plugin objects by name, ``layer_0`` and so on.
        thickness: geometric thickness of the media, by number of the layer.

    Returns:
        the stack, and parameter name -> texture (or number) that gives its value.

    Raises:
        UnsupportedStack: a child that cannot be read as a layer.
    """
    numbers = []
    for key in children:
        match = re.fullmatch(r"layer_(0|[1-9]\d*)", key)
        if not match:
            raise MaterialError(
                f"found a child {key!r}; allowed: layer_0, layer_1, ... from the top down", where=name
            )
        numbers.append(int(match[1]))
    if sorted(numbers) != list(range(len(numbers))):
        raise MaterialError(f"found layers {sorted(numbers)}; allowed: 0, 1, 2, ... without gaps", where=name)
    for number in thickness:
        if number >= len(numbers) or not isinstance(children[f"layer_{number}"], mi.Medium):
            raise MaterialError(f"thickness_{number} is given, but layer_{number} is no medium", where=name)
    layers: list[Any] = []
    sources: dict[str, Any] = {}
    reasons: list[str] = []
    index = 1.0
    for i in range(len(numbers)):
        child = children[f"layer_{i}"]
        try:
            layer, given, index = read_child(mi, child, index, thickness.get(i, 1.0))
        except Refused as refusal:
            reasons.append(f"layer_{i} ({child.class_name()}): {refusal}")
            continue
        except MaterialError as error:
            raise inside(error, f"{name}.layer_{i}") from None
        layers.append(layer)
        sources.update({f"layer_{i}.{key}": value for key, value in given.items()})
    if reasons:
        raise UnsupportedStack("walk", reasons)
    try:
        return Stack(name=name, layers=tuple(layers)), sources
    except MaterialError as error:
        raise inside(error, name) from None


class Refused(Exception):
    """A plugin that cannot be read as a layer, with the reason."""


def read_child(
    mi: Any, child: Any, index: float, thickness: float = 1.0, complete: str | None = None
) -> tuple[Any, dict[str, Any], float]:
    """One plugin as a layer.

    Args:
        child: the plugin.
        index: absolute index above it.
        thickness: geometric thickness of a medium.
        complete: `multiple_scattering` of a rough interface in place of none; its tints are then left to the caller.

    Returns:
        the layer, what gives its parameters their values, the index below.
    """
    if hasattr(child, "tints"):
        return _complete(child, index)
    kind = child.class_name()
    found = traversed(mi, child)
    if kind == "NormalMap":
        return _normal_map(mi, found, index, thickness, complete)
    if kind == "BumpMap":
        raise Refused(
            "a bump map has heights, not normals; allowed: normalmap around a BSDF that can be read"
        )
    if isinstance(child, mi.Medium):
        if kind != "HomogeneousMedium":
            raise Refused("only homogeneous media can be read")
        return (*_medium(mi, child, thickness), index)
    if kind == "SmoothDiffuse":
        return Diffuse(reflectance=_NOMINAL), {"reflectance": found["reflectance"]}, index
    for part in ("specular_reflectance", "specular_transmittance"):
        if complete is None and part in found and not is_one(mi, found[part]):
            raise Refused(f"{part} other than 1 is not physical and cannot be read")
    rough = kind.startswith("Rough")
    options: dict[str, Any] = {}
    given: dict[str, Any] = {}
    if rough:
        match = re.search(r"distribution = (\w+)", str(child))
        options = {"distribution": match[1] if match else "beckmann", "masking": "separable", "alpha": 0.5}
        if complete is not None:
            # Scattering between the facets is defined for facets whose heights are correlated.
            options |= {"masking": "correlated", "multiple_scattering": complete}
        if "alpha" in found:
            given["alpha"] = _rough(found["alpha"])
        else:
            options["alpha"] = (0.5, 0.5)
            given["alpha"] = (_rough(found["alpha_u"]), _rough(found["alpha_v"]))
    if kind in ("SmoothDielectric", "RoughDielectric"):
        eta = mi.traverse(child)["eta"]
        index *= _first(eta)
        if abs(index - 1) < _ROUNDING:
            index = 1.0
        return Dielectric(ior=index, **options), given, index
    if kind in ("SmoothConductor", "RoughConductor"):
        given |= {"eta": found["eta"], "k": found["k"]}
        return Conductor(eta=_NOMINAL, k=_NOMINAL, **options), given, index
    raise Refused(
        "cannot be read as a layer; allowed: dielectric, roughdielectric, conductor, roughconductor, diffuse, "
        "homogeneous, complete_roughconductor, complete_roughdielectric, normalmap around one of these"
    )


def _normal_map(
    mi: Any, found: dict[str, Any], index: float, thickness: float, complete: str | None
) -> tuple[Any, dict[str, Any], float]:
    """The interface inside a `normalmap`, with its normals."""
    layer, given, below = read_child(mi, found["nested_bsdf"], index, thickness, complete)
    if layer.normal is not None:
        raise Refused("a normal map around a normal map cannot be read")
    return (
        layer.model_copy(update={"normal": (0.0, 0.0, 1.0)}),
        {**given, "normal": found["normalmap"]},
        below,
    )


def _complete(child: Any, index: float) -> tuple[Any, dict[str, Any], float]:
    """The one layer of a plugin of `complete`, with what gives its parameters their values."""
    if child.tints:
        raise Refused(f"{', '.join(child.tints)} other than 1 is not physical and cannot be read")
    layer = child.stack.layers[0]
    below = index * layer.ior if layer.kind == "dielectric" else index
    given = {}
    for name, parameter in child.surface.parameters.items():
        several = parameter if isinstance(parameter, tuple) else (parameter,)
        sources = tuple(p.source() for p in several)
        given[name.removeprefix("layer_0.")] = sources if isinstance(parameter, tuple) else sources[0]
    if layer.kind == "dielectric":
        layer = layer.model_copy(update={"ior": below})
        given.pop("ior")
    return layer, given, below


def _medium(mi: Any, child: Any, thickness: float) -> tuple[Medium, dict[str, Any]]:
    parameters, found = mi.traverse(child), traversed(mi, child)
    scale = thickness * (_first(parameters["scale"]) if "scale" in parameters else 1.0)
    values: dict[str, Any] = {}
    spectra: dict[str, Any] = {}
    for name, ours, factor in (("albedo", "albedo", 1.0), ("sigma_t", "depth", scale)):
        texture = traversed(mi, found[name]).get("value")
        if not isinstance(texture, mi.Texture):
            raise Refused(f"{name} varies inside the medium; only homogeneous ones can be read")
        if "rgb" in mi.variant():
            values[ours] = _times(_colour(parameters[f"{name}.value.value"]), factor)
        else:
            # What stands in the parameters of a spectrum are no colours: the spectrum itself is the value.
            values[ours] = _NOMINAL
            spectra[ours] = Source(texture, factor)
    name = child.phase_function().class_name()
    kind = _PHASES.get(name)
    if kind is None:
        raise Refused(f"phase function {name} cannot be read; allowed: hg, isotropic, rayleigh")
    phase: Any = {"isotropic": Isotropic, "rayleigh": Rayleigh}.get(kind, Isotropic)()
    if kind == "hg":
        phase = HenyeyGreenstein(g=_first(parameters["phase_function.g"]))
    return Medium(phase=phase, **values), spectra


def _rough(texture: Any) -> Source:
    return Source(texture, lowest=_NARROWEST, shape=_NOMINAL)


def is_one(mi: Any, texture: Any) -> bool:
    if texture.is_spatially_varying():
        return False
    values = [v for k, v in mi.traverse(texture) if k.endswith("value")] or [1.0]
    return all(abs(c - 1) < 1e-6 for v in values for c in _flat(v))


def _flat(value: Any) -> list[float]:
    import numpy as np

    return [float(v) for v in np.array(value, dtype=float).ravel()]


def _first(value: Any) -> float:
    return _flat(value)[0]


def _colour(value: Any) -> Any:
    flat = _flat(value)
    return tuple(flat) if len(flat) == 3 and len(set(flat)) > 1 else flat[0]


def _times(value: Any, factor: float) -> Any:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor
