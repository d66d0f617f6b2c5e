"""Continuous parameters: numbers, colours, roughness, normals, and the textures that may stand for them."""

from __future__ import annotations

import math
import numbers
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from urushi.description.base import Choice, Data, Description, Rule, shown
from urushi.errors import MaterialError


def plain(value: Any) -> Any:
    """numpy scalars and arrays (anything with ``dtype`` and ``tolist``) as Python numbers and lists."""
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        return value.tolist()
    return value


def is_number(value: object) -> bool:
    """Real numbers only; a truth value is not a number."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def finite(value: Any, rule: Rule, where: str | None = None) -> float:
    """The value as a finite float."""
    value = plain(value)
    if not is_number(value):
        raise rule.refuse(value, where=where)
    try:
        number = float(value)
    except OverflowError:
        raise rule.refuse(value, "which is too large", where=where) from None
    if not math.isfinite(number):
        raise rule.refuse(value, "which is not finite", where=where)
    return number


class Parameter(Rule):
    """A continuous parameter with closed bounds: one number, several (RGB), or a texture.

    Attributes:
        low: smallest value allowed.
        high: largest value allowed.
        size: how many numbers may stand in place of one (0: only one number will do).
        colour: True for colours, whose textures are sRGB-encoded unless they say ``raw: true``.
        texture: True if a `Texture` may stand in place of the numbers.
        unit: physical unit, empty for a plain ratio.
        meaning: what the parameter is.
        source: where the default comes from.
        why_one: why a list of numbers is refused.
    """

    def __init__(
        self,
        low: float,
        high: float,
        *,
        meaning: str,
        unit: str = "",
        source: str = "",
        size: int = 0,
        colour: bool = False,
        texture: bool = True,
        why_one: str = "",
    ) -> None:
        self.low, self.high = low, high
        self.meaning, self.unit, self.source_of_default = meaning, unit, source
        self.size, self.colour, self.texture, self.why_one = size, colour, texture, why_one

    def read(self, value: Any) -> float | tuple[float, ...] | Texture:
        """A float, a tuple of floats or a `Texture` that knows whether it is raw."""
        value = plain(value)
        if isinstance(value, Texture | Mapping):
            return self._texture(value)
        if isinstance(value, list | tuple):
            if not self.size or len(value) != self.size:
                raise self.refuse(value, self.why_one or f"which has {len(value)} values")
            return self.together(tuple(self.bounded(item, f"[{i}]") for i, item in enumerate(value)))
        return self.bounded(value)

    def bounded(self, value: Any, where: str | None = None) -> float:
        """One number within the bounds."""
        number = finite(value, self, where)
        if number < self.low:
            raise self.refuse(number, f"which is below {self.low:g}", where)
        if number > self.high:
            raise self.refuse(number, f"which is above {self.high:g}", where)
        return number

    def together(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Check several numbers against one another."""
        return values

    def _texture(self, value: Texture | Mapping[str, Any]) -> Texture:
        if not self.texture:
            raise self.refuse(value)
        if not isinstance(value, Texture):
            if "texture" not in value:
                raise self.refuse(value)
            if "file" in value:
                raise MaterialError("unknown key 'file' (text); allowed: texture, scale, raw", where="file")
            value = Texture.model_validate({"file" if key == "texture" else key: value[key] for key in value})
        if value.scale < 0 <= self.low:
            raise MaterialError(
                f"found {value.scale!r}, which makes the texture negative; allowed: a number of 0 or more",
                where="scale",
            )
        return value if value.raw is not None else value.model_copy(update={"raw": not self.colour})

    def allowed(self) -> str:
        """In words."""
        parts = [f"a number from {self.low:g} to {self.high:g}"]
        if self.size:
            parts.append(
                "a list of three such numbers (RGB)" if self.size == 3 else "a list of two such numbers"
            )
        if self.texture:
            parts.append("a texture")
        return " or ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)

    def schema(self) -> dict[str, Any]:
        """A number, an array or a texture."""
        return self._union({"type": "number", "minimum": self.low, "maximum": self.high})

    def _union(self, one: dict[str, Any]) -> dict[str, Any]:
        options = [one]
        if self.size:
            options.append({"type": "array", "items": one, "minItems": self.size, "maxItems": self.size})
        if self.texture:
            options.append({"$ref": "#/$defs/texture"})
        body: dict[str, Any] = one if len(options) == 1 else {"anyOf": options}
        return {**body, "unit": self.unit} if self.unit else dict(body)

    def source(self, value: Any) -> str:
        """Python source; a texture leaves out ``raw`` where it is the parameter's own default."""
        return value.source(not self.colour) if isinstance(value, Texture) else repr(value)

    def data(self, value: Any, folder: Path | None) -> Data:
        """A number, a list or ``{texture: ...}``."""
        if isinstance(value, Texture):
            return value.file_form(folder, not self.colour)
        return list(value) if isinstance(value, tuple) else value


class Roughness(Parameter):
    """``alpha``: 0 (smooth) or from `smallest` to 1, for both tangent directions or for each."""

    smallest: ClassVar[float] = 1e-4

    def bounded(self, value: Any, where: str | None = None) -> float:
        """One alpha; nothing between 0 and `smallest`."""
        number = super().bounded(value, where)
        if 0.0 < number < self.smallest:
            raise self.refuse(number, "which is too narrow a lobe for single precision", where)
        return number

    def together(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Both smooth or both rough."""
        if (values[0] == 0.0) != (values[1] == 0.0):
            raise self.refuse(values, "which is smooth along one axis only")
        return values

    def allowed(self) -> str:
        """In words."""
        return (
            f"0 (smooth) or a number from {self.smallest:g} to {self.high:g}, "
            "a list of two (both 0, or neither) or a texture"
        )

    def schema(self) -> dict[str, Any]:
        """0 or a range."""
        rough = {"type": "number", "minimum": self.smallest, "maximum": self.high}
        return self._union({"anyOf": [{"const": 0}, rough]})


class Normal(Parameter):
    """A shading normal: a vector in the tangent frame (any length, z up) or a normal map."""

    lowest: ClassVar[float] = 1e-3

    def together(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Upwards."""
        if values[2] < self.lowest:
            raise self.refuse(values, f"whose z is below {self.lowest:g}")
        return values

    def bounded(self, value: Any, where: str | None = None) -> float:
        """One component; a number on its own is no normal."""
        if where is None:
            raise self.refuse(value)
        return super().bounded(value, where)

    def allowed(self) -> str:
        """In words."""
        return (
            f"a list of three numbers from -1 to 1 whose z is at least {self.lowest:g} "
            "(the solver normalises it) or a texture"
        )

    def schema(self) -> dict[str, Any]:
        """Three numbers or a normal map."""
        sideways = {"type": "number", "minimum": -1, "maximum": 1}
        up = {"type": "number", "minimum": self.lowest, "maximum": 1}
        vector = {"type": "array", "prefixItems": [sideways, sideways, up], "minItems": 3, "maxItems": 3}
        return {"anyOf": [vector, {"$ref": "#/$defs/texture"}]}


class Covariance(Parameter):
    """Variances along x and y and the covariance of both: a symmetric matrix that is nowhere negative."""

    def together(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """A matrix that some slopes have."""
        xx, yy, xy = values
        if min(xx, yy) < 0:
            raise self.refuse(values, "of which a variance is negative")
        if xy * xy > xx * yy * (1 + 1e-6):
            raise self.refuse(values, "whose covariance is too large for its variances")
        return values

    def bounded(self, value: Any, where: str | None = None) -> float:
        """One entry; a number on its own is no matrix."""
        if where is None:
            raise self.refuse(value)
        return super().bounded(value, where)

    def allowed(self) -> str:
        """In words."""
        return f"a list of three numbers xx, yy, xy up to {self.high:g} with xy * xy <= xx * yy, or a texture"

    def schema(self) -> dict[str, Any]:
        """Three numbers or a texture."""
        variance = {"type": "number", "minimum": 0, "maximum": self.high}
        both = {"type": "number", "minimum": self.low, "maximum": self.high}
        entries = {"type": "array", "prefixItems": [variance, variance, both], "minItems": 3, "maxItems": 3}
        return {"anyOf": [entries, {"$ref": "#/$defs/texture"}]}


class _File(Rule):
    """A path, kept absolute, so that it means the same in every working directory."""

    meaning = "image file; in a material file, relative to that file's folder"

    def read(self, value: Any) -> str:
        """The absolute path."""
        if isinstance(value, os.PathLike):
            value = os.fspath(value)
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.refuse(value)
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise self.refuse(value, "which holds half a character (a lone surrogate)")
        return os.path.abspath(value)

    def allowed(self) -> str:
        """In words."""
        return "the path of an image file"

    def schema(self) -> dict[str, Any]:
        """A string."""
        return {"type": "string", "minLength": 1}

    def source(self, value: Any) -> str:
        """Relative to the working directory where the file lies below it."""
        path = Path(value)
        here = Path.cwd()
        return repr(path.relative_to(here).as_posix() if path.is_relative_to(here) else value)

    def data(self, value: Any, folder: Path | None) -> Data:
        """Relative to the folder of the material file."""
        if folder is None:
            return value
        try:
            return Path(os.path.relpath(value, folder)).as_posix()
        except ValueError:  # another drive
            return value


class Texture(Description):
    """An image in place of a continuous parameter: its value is ``scale`` times the image.

    Args:
        file: path of the image; relative to the working directory in Python and to the material's folder
            in a material file, and absolute from then on.
        scale: factor on the image's values.
        raw: True when the image holds the numbers themselves, False when it holds an sRGB-encoded colour;
            None leaves it to the parameter (False for reflectance and albedo, True for the rest).

    Raises:
        MaterialError: a value is not allowed. That the file exists is checked by `urushi.load`.
    """

    file: Annotated[str, _File()]
    scale: Annotated[
        float, Parameter(-1e6, 1e6, meaning="factor on the image's values", source="none", texture=False)
    ] = 1.0
    raw: Annotated[
        bool | None,
        Choice(
            None, False, True, meaning="the image holds the numbers themselves, not an sRGB-encoded colour"
        ),
    ] = None

    @property
    def path(self) -> Path:
        """The absolute path of the image."""
        return Path(self.file)

    def source(self, usual: bool | None) -> str:
        """Python source, without ``raw`` where it is the ``usual`` one."""
        parts = [f"file={_File().source(self.file)}"]
        if self.scale != 1.0:
            parts.append(f"scale={self.scale!r}")
        if self.raw != usual:
            parts.append(f"raw={self.raw!r}")
        return f"Texture({', '.join(parts)})"

    def file_form(self, folder: Path | None, usual: bool) -> dict[str, Data]:
        """``{texture: ..., scale: ..., raw: ...}`` without what goes without saying."""
        form: dict[str, Data] = {"texture": _File().data(self.file, folder)}
        if self.scale != 1.0:
            form["scale"] = self.scale
        if self.raw != usual:
            form["raw"] = self.raw
        return form


def scaled(texture: Texture, factor: float) -> Texture:
    """The texture times a number.

    Raises:
        MaterialError: the product is not allowed as a scale.
    """
    try:
        return texture.model_copy(update={"scale": texture.scale * factor})
    except MaterialError as error:
        raise MaterialError(f"scaling {shown(texture.file)}: {error.problem}", where=error.where) from None
