"""What every parameter of a stack is worth at a surface point: constants, textures and spectra.

In an RGB variant constants are Dr.Jit numbers and colours that `mi.traverse` exposes and that can be differentiated; in
a monochrome or spectral one a colour becomes Mitsuba's own `rgb` spectrum, and a metal's index the measured spectrum
that Mitsuba has for it. Textures are Mitsuba's `bitmap` plugin, or whatever texture a nested child brought along.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import drjit.scalar
import numpy as np

from urushi.adapters.normal_map import Slopes
from urushi.errors import MaterialError, UrushiError
from urushi.solvers.numbers import VECTORS, described, replaced
from urushi.stack import Stack, Texture

#: parameters that may differ from channel to channel
COLOURS = ("albedo", "reflectance", "depth", "sigma_t", "eta", "k")
#: those of them that stay in [0, 1]
BOUNDED = ("albedo", "reflectance")
#: and those by which light fades
DEPTHS = ("depth", "sigma_t")
#: optical depth at which the colour of a medium becomes a spectrum, where it is deepest: down and up again
FADED = 2.0


@dataclass(frozen=True)
class Source:
    """A texture of Mitsuba's that stands for a parameter.

    Attributes:
        texture: it.
        factor: multiplies what it gives.
        lowest: smallest value; smaller ones count as this one.
        shape: the Python value by which the code takes its shape (`Parameter.fixed`), if that is certain.
    """

    texture: Any
    factor: float = 1.0
    lowest: float | None = None
    shape: float | None = None


class Parameter:
    """One continuous parameter in one variant of Mitsuba.

    Attributes:
        value: a Dr.Jit number or colour, or a Mitsuba texture.
        factor: multiplies what a texture gives.
        fading: what a texture gives is the transmittance exp(-fading * value) (0: the value itself).
        lowest: smallest value of a texture; smaller ones count as this one (None: any).
        fixed: the Python value behind it, if it is a constant (None for a texture that may be anything).
        colour: whether it differs from channel to channel.
    """

    def __init__(self, mi: Any, name: str, value: Any) -> None:
        self.mi = mi
        self.name = name
        self.factor: float = 1.0
        self.fading: float = 0.0
        self.lowest: float | None = None
        self.fixed: Any = None
        kind = name.rsplit(".", 1)[-1]
        self.colour = kind in COLOURS
        self.encoded = isinstance(value, Texture) and not value.raw
        if isinstance(value, Texture):
            self.factor = value.scale
            bitmap = {"type": "bitmap", "filename": str(value.path), "raw": bool(value.raw)}
            value = mi.load_dict(bitmap)
        elif isinstance(value, Source):
            self.factor, self.lowest, self.fixed = value.factor, value.lowest, value.shape
            value = value.texture
        elif isinstance(value, mi.Texture):
            pass
        elif kind in VECTORS:
            self.fixed = value
            value = mi.Vector3f(*(v if mi.Float is float else dr.opaque(mi.Float, v) for v in value))
        elif isinstance(value, tuple) and len(value) == 3:
            self.fixed = value
            value = self._constant_colour(value, kind)
        else:
            self.fixed, self.colour = value, False
            value = self._constant_number(value)
        if kind in BOUNDED and isinstance(value, mi.Texture):
            most = _extent(mi, value, self.encoded, self.colour)[1] * self.factor
            if most > 1 + 1e-4:
                # A walk between such a base and a coat gains light at every turn and never ends.
                raise MaterialError(f"found {most:g}; allowed: values from 0 to 1", where=name)
        self.value = value

    def _constant_number(self, value: float) -> Any:
        if self.mi.Float is float:
            # `mi.traverse` can set no plain float of a Python plugin; it can set an array of one.
            return drjit.scalar.Array1f(value)
        # Opaque: a variable of the compiled code, so that another number compiles nothing anew.
        return dr.opaque(self.mi.Float, value)

    def _constant_colour(self, value: tuple[float, ...], kind: str) -> Any:
        mi = self.mi
        if "rgb" in mi.variant():
            return mi.Color3f(*(dr.opaque(mi.Float, v) for v in value))
        if kind in DEPTHS and max(value) > 0:
            # Smooth spectra of saturated colours miss them; what is seen is how the light fades, so that is made one.
            self.fading = FADED / max(value)
            return mi.load_dict({"type": "rgb", "value": [math.exp(-self.fading * v) for v in value]})
        # Mitsuba makes spectra of colours up to 1: larger ones are scaled down, and their spectrum up again.
        self.factor = 1.0 if kind in BOUNDED else max(2 * max(value), 1e-20)
        return mi.load_dict({"type": "rgb", "value": [v / self.factor for v in value]})

    def changed(self) -> None:
        """Look again at a constant that was set from outside: its value shapes the code (smooth or rough, ...)."""
        if self.textured:
            # A spectrum may be another one now; that a rough plugin of Mitsuba's stays rough is certain (`lowest`).
            self.fixed = None if self.lowest is None else self.fixed
            return
        dr.make_opaque(self.value)
        numbers = [float(n) for n in np.array(dr.detach(self.value)).ravel()]
        self.fixed = numbers[0] if len(numbers) == 1 else tuple(numbers) if len(numbers) == 3 else None

    def source(self) -> Any:
        """What gives the value, to make another `Parameter` of."""
        return Source(self.value, self.factor, self.lowest, self.fixed) if self.textured else self.fixed

    def extent(self) -> tuple[float, float]:
        """The smallest and the largest value that a texture gives, in any channel.

        Raises:
            MaterialError: a texture that does not say.
        """
        spectrum = "spectral" in self.mi.variant() and self.name.rsplit(".", 1)[-1] in BOUNDED
        low, high = (0.0, 1.0) if spectrum else _extent(self.mi, self.value, self.encoded, self.colour)
        low, high = low * self.factor, high * self.factor
        if not high > 0:
            raise MaterialError(
                "found a texture whose largest value is unknown; allowed: an image, or textures made of numbers",
                where=self.name,
            )
        low, high = (
            sorted((low, high)) if self.lowest is None else (max(low, self.lowest), max(high, self.lowest))
        )
        return low, high

    def said(self) -> str:
        """The value now, in words."""
        if not self.textured:
            return ", ".join(f"{n:g}" for n in np.array(dr.detach(self.value), dtype=float).ravel())
        if self.fading:
            return f"-log / {self.fading:g} of {self.value}"
        return str(self.value) if self.factor == 1.0 else f"{self.factor:g} times {self.value}"

    @property
    def textured(self) -> bool:
        return isinstance(self.value, self.mi.Texture)

    @property
    def optimised(self) -> bool:
        """Whether a gradient is wanted where the value is at the edge of another shape of the code (an albedo of 0)."""
        edge = self.fixed is not None and np.max(self.fixed) == 0 and not self.name.endswith("alpha")
        return edge and not self.textured and bool(dr.grad_enabled(self.value))

    @property
    def varies(self) -> bool:
        """Whether it may differ from point to point."""
        return self.textured and self.value.is_spatially_varying()

    def at(self, si: Any, active: Any) -> Any:
        """The value at a surface interaction: a number, a vector, or a colour in the variant's channels."""
        mi = self.mi
        if not self.textured:
            return self.value[0] if isinstance(self.value, drjit.scalar.Array1f) else self.value
        kind = self.name.rsplit(".", 1)[-1]
        if kind in VECTORS:
            found = mi.Vector3f(self.value.eval_3(si, active))
            if kind == "slope_variance":
                return found * self.factor
            # As Mitsuba's `normalmap` reads it; the scale makes slopes steeper.
            found = 2 * found - 1
            return mi.Vector3f(found.x * self.factor, found.y * self.factor, found.z)
        if not self.colour:
            number = self.value.eval_1(si, active) * self.factor
            return number if self.lowest is None else dr.maximum(number, self.lowest)
        value = self.value.eval(si, active) * self.factor
        if self.fading:
            value = -dr.log(dr.maximum(value, 1e-9)) / self.fading
        return value[0] if "mono" in mi.variant() else value


class Surface:
    """All parameters of a stack in one variant.

    Args:
        mi: the mitsuba module, its variant set.
        stack: the description.
        sources: Mitsuba textures that stand in for values of the description, by name; a pair for an anisotropic
            roughness.
        footprint: side of the square of texture coordinates that a pixel sees; normal maps are averaged over it, and
            what they vary within adds to the roughness.
    """

    def __init__(
        self, mi: Any, stack: Stack, sources: dict[str, Any] | None = None, footprint: float = 0.0
    ) -> None:
        self.mi = mi
        self.stack = stack
        given = {**described(stack), **_spectral_metals(mi, stack), **(sources or {})}
        self.exterior = given.pop("exterior")
        if footprint > 0:
            given |= _seen_from_afar(mi, stack, given, footprint)
        self.parameters: dict[str, Any] = {}
        for name, value in given.items():
            if isinstance(value, tuple) and len(value) == 2:
                self.parameters[name] = tuple(Parameter(mi, name, v) for v in value)
            else:
                self.parameters[name] = Parameter(mi, name, value)

    def each(self) -> list[tuple[str, Parameter]]:
        """Every parameter by the name that `mi.traverse` shows: ``layer_0.alpha``, ``layer_0.alpha_u``, ..."""
        found = []
        for name, parameter in self.parameters.items():
            if isinstance(parameter, tuple):
                found += [(f"{name}_{axis}", p) for axis, p in zip("uv", parameter, strict=True)]
            else:
                found.append((name, parameter))
        return found

    @property
    def varies(self) -> bool:
        return any(parameter.varies for _, parameter in self.each())

    @property
    def coloured(self) -> bool:
        return any(parameter.colour for _, parameter in self.each())

    def changed(self) -> None:
        """Look again at values that were set from outside.

        Raises:
            MaterialError: one that the description would refuse.
        """
        before = self.fixed()
        for _, parameter in self.each():
            parameter.changed()
        new = {name: _shortest(value) for name, value in self.fixed().items() if value != before.get(name)}
        if new:
            replaced(self.stack, new)

    def fixed(self) -> dict[str, Any]:
        """The parameters whose Python value shapes the code (`solvers.bound.bind`)."""
        known: dict[str, Any] = {"exterior": self.exterior}
        for name, parameter in self.parameters.items():
            if isinstance(parameter, tuple):
                if all(p.fixed is not None for p in parameter):
                    known[name] = tuple(p.fixed for p in parameter)
            elif parameter.fixed is not None and not parameter.optimised:
                known[name] = parameter.fixed
        return known

    def at(self, si: Any, active: Any) -> dict[str, Any]:
        """The value of every parameter at a surface interaction."""
        values: dict[str, Any] = {"exterior": self.exterior}
        for name, parameter in self.parameters.items():
            if isinstance(parameter, tuple):
                values[name] = tuple(p.at(si, active) for p in parameter)
            else:
                values[name] = parameter.at(si, active)
        return values


def _shortest(value: Any) -> Any:
    """The decimal number that single precision stands for: its own last digits may lie beyond a bound."""
    return tuple(map(_shortest, value)) if isinstance(value, tuple) else float(f"{value:.7g}")


def _seen_from_afar(mi: Any, stack: Stack, given: dict[str, Any], footprint: float) -> dict[str, Any]:
    """Normal maps averaged over a footprint, and the variance of slopes that this leaves out.

    Raises:
        MaterialError: a normal map that is no image, or that comes with a variance of its own.
    """
    found: dict[str, Any] = {}
    for i, layer in enumerate(stack.layers):
        source, name = given.get(f"layer_{i}.normal"), f"layer_{i}.normal"
        if source is None or isinstance(source, tuple):
            continue
        if f"layer_{i}.slope_variance" in given:
            raise MaterialError(
                "found a normal map and a slope_variance; allowed with a footprint: one of them", where=name
            )
        strength = source.scale if isinstance(source, Texture) else 1.0
        try:
            slopes = Slopes.of(_texels(mi, source, name), strength).seen(footprint)
        except UrushiError as error:
            raise (
                error if isinstance(error, MaterialError) else MaterialError(str(error), where=name)
            ) from None
        found[name] = _image(mi, 0.5 * slopes.normal() + 0.5)
        if hasattr(layer, "slope_variance"):
            found[f"layer_{i}.slope_variance"] = _image(mi, slopes.variance())
    return found


def _texels(mi: Any, source: Any, name: str) -> np.ndarray:
    if isinstance(source, Texture):
        bitmap = mi.Bitmap(str(source.path))
        if source.raw:
            bitmap.set_srgb_gamma(False)  # bytes, too, are the numbers themselves
        return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))
    data = dict(mi.traverse(source)).get("data")
    if data is None:
        raise MaterialError(f"found a {source.class_name()}; allowed with a footprint: an image", where=name)
    array = np.array(data, dtype=np.float64)
    whole = np.array(data).dtype
    return array / np.iinfo(whole).max if np.issubdtype(whole, np.integer) else array


def _image(mi: Any, values: np.ndarray) -> Any:
    bitmap = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return mi.load_dict({"type": "bitmap", "bitmap": bitmap, "raw": True})


def _spectral_metals(mi: Any, stack: Stack) -> dict[str, Any]:
    """In variants without RGB, the measured spectra behind the names of metals."""
    if "rgb" in mi.variant():
        return {}
    found: dict[str, Any] = {}
    for i, layer in enumerate(stack.layers):
        material = getattr(layer, "material", None)
        if material is not None:
            metal = traversed(mi, mi.load_dict({"type": "conductor", "material": material}))
            found |= {f"layer_{i}.eta": metal["eta"], f"layer_{i}.k": metal["k"]}
    return found


def _extent(mi: Any, texture: Any, encoded: bool, colour: bool) -> tuple[float, float]:
    """The smallest and largest value of a texture, as far as known: of spectra the peak, of images the texels'.

    Texels of one byte are as they are in the file, sRGB-encoded perhaps.
    """
    try:
        return 0.0, float(texture.max())
    except RuntimeError:  # most textures cannot say
        pass
    if "spectral" in mi.variant() and colour:
        return 0.0, 0.0  # texels of a colour are coefficients there
    found: list[float] = []
    for key, value in mi.traverse(texture):
        if key.endswith((".value", "data")):
            array = np.array(value)
            for peak in (float(np.min(array)), float(np.max(array))):
                if np.issubdtype(array.dtype, np.integer):
                    peak /= np.iinfo(array.dtype).max
                    peak = ((peak + 0.055) / 1.055) ** 2.4 if encoded and peak > 0.04045 else peak
                found.append(peak)
    return (min(found), max(0.0, *found)) if found else (0.0, 0.0)


def traversed(mi: Any, plugin: Any) -> dict[str, Any]:
    """The objects and values right under a plugin, by name."""

    class Collect(mi.TraversalCallback):
        def __init__(self) -> None:
            super().__init__()
            self.found: dict[str, Any] = {}

        def put_object(self, name: str, value: Any, *_: Any) -> None:
            self.found[name] = value

        def put_value(self, name: str, value: Any, *_: Any) -> None:
            self.found[name] = value

        def put(self, name: str, value: Any, *_: Any) -> None:
            self.found[name] = value

    collect = Collect()
    plugin.traverse(collect)
    return collect.found
