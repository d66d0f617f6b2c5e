"""The description of a layered material: a `Stack` of layers, from the top down, frozen and checked.

Nothing here computes anything; `urushi.solve` turns a stack into a BSDF.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from urushi.description.base import Data, Description, Registered, Rule, Text, close, inside, shown
from urushi.description.graded import GradedMedium
from urushi.description.layers import LAYERS, Conductor, Dielectric, Diffuse, Layer, Medium
from urushi.description.parameter import Parameter, Texture
from urushi.description.phases import PHASES, HenyeyGreenstein, Isotropic, Rayleigh, Tabulated
from urushi.errors import MaterialError

__all__ = [
    "LAYERS",
    "PHASES",
    "Conductor",
    "Dielectric",
    "Diffuse",
    "GradedMedium",
    "HenyeyGreenstein",
    "Isotropic",
    "Layer",
    "Medium",
    "Rayleigh",
    "Stack",
    "Tabulated",
    "Texture",
    "parameter_table",
]


class _Layers(Rule):
    """The layers, from the top down."""

    meaning = "the layers, from the top down"
    most = 1000
    one = Registered(LAYERS, "layer", meaning="an interface or a medium")

    def read(self, value: Any) -> tuple[Layer, ...]:
        """A tuple of layers; only the last may be opaque."""
        if not isinstance(value, list | tuple) or not 1 <= len(value) <= self.most:
            raise self.refuse(
                value, f"which has {len(value)} layers" if isinstance(value, list | tuple) else ""
            )
        layers = []
        for index, item in enumerate(value):
            try:
                layers.append(self.one.read(item))
            except MaterialError as error:
                raise inside(error, f"[{index}]") from None
        self._bases(layers)
        return tuple(layers)  # type: ignore[arg-type]

    def _bases(self, layers: list[Any]) -> None:
        opaque = [index for index, layer in enumerate(layers) if layer.opaque]
        if len(opaque) > 1:
            first, second = opaque[:2]
            raise MaterialError(
                f"{layers[second].called()} is opaque, and so is layers[{first}] ({layers[first].called()}) above it; "
                "allowed: one opaque base, at the bottom",
                where=f"[{second}]",
            )
        if opaque and opaque[0] != len(layers) - 1:
            base, below = opaque[0], layers[opaque[0] + 1 :]
            places = (
                f"layers[{base + 1}]"
                if len(below) == 1
                else f"layers[{base + 1}] to layers[{len(layers) - 1}]"
            )
            kinds = ", ".join(dict.fromkeys(layer.called() for layer in below))
            raise MaterialError(
                f"{layers[base].called()} is opaque, nothing can lie below it: remove {places} ({kinds})",
                where=f"[{base}]",
            )

    def allowed(self) -> str:
        """In words."""
        return f"a list of 1 to {self.most} layers, each one of {', '.join(LAYERS)}"

    def schema(self) -> dict[str, Any]:
        """An array of layers."""
        return {"type": "array", "items": self.one.schema(), "minItems": 1, "maxItems": self.most}

    def source(self, value: Any) -> str:
        """One layer a line."""
        return "[\n" + "".join(f"        {layer!r},\n" for layer in value) + "    ]"

    def data(self, value: Any, folder: Path | None) -> Data:
        """A list of one-key mappings."""
        return [{layer.kind: layer.data(folder)} for layer in value]


class Stack(Description):
    """A layered material: its layers from the top down, and the index of what lies above them.

    Args:
        name: what the material is called (may be empty).
        layers: at least one layer, from the top down: `Dielectric`, `Medium`, `GradedMedium`, and at the bottom
            perhaps an opaque base (`Conductor` or `Diffuse`). Without a base the stack transmits. It may begin or end
            with a medium.
        exterior: absolute index of the material above the first layer, 1 (air) to 5.
        description: a sentence or two about the material.

    Raises:
        MaterialError: a value is not allowed, or an opaque layer is not the last one.

    Example:
        >>> varnish, wood = Dielectric(ior=1.5, alpha=0.1), Diffuse(reflectance=(0.5, 0.3, 0.1))
        >>> Stack(name="varnish", layers=[varnish, wood])
        Stack(
            name='varnish',
            layers=[
                Dielectric(ior=1.5, alpha=0.1),
                Diffuse(reflectance=(0.5, 0.3, 0.1)),
            ],
        )
    """

    name: Annotated[str, Text("what the material is called", longest=200)] = ""
    layers: Annotated[tuple[Layer, ...], _Layers()]
    exterior: Annotated[
        float,
        Parameter(
            1.0,
            5.0,
            meaning="absolute index of refraction above the first layer",
            source="air",
            texture=False,
            why_one="one index serves every colour",
        ),
    ] = 1.0
    description: Annotated[str, Text("a sentence or two about the material", longest=5000, lines=True)] = ""

    def parameters(self) -> dict[str, float | tuple[float, ...] | Texture]:
        """The continuous parameters of the layers, in order: ``layer_0.alpha``, ``layer_1.phase.g``, ...

        A conductor given by ``material`` has neither ``eta`` nor ``k`` here: the solver looks them up. A medium has
        either ``depth``, or ``thickness`` and ``sigma_t``. ``normal`` appears only where there is one.

        Returns:
            Name to float, tuple (RGB, or alpha along x and y) or `Texture`.
        """
        return {
            f"layer_{index}.{name}": value
            for index, layer in enumerate(self.layers)
            for name, value in continuous(layer)
        }

    def replace(self, changes: Mapping[str, Any]) -> Stack:
        """A new stack with some values changed, checked again.

        Args:
            changes: new values by name: those of `parameters`, any other field of a layer (``layer_0.masking``,
                ``layer_2.material``, None to unset it), or ``name``, ``exterior``, ``description``.

        Raises:
            MaterialError: an unknown name, or a value that is not allowed.
        """
        if not isinstance(changes, Mapping):
            raise MaterialError(
                f"found {shown(changes)}; allowed: a mapping of names such as layer_0.alpha to values"
            )
        own = [name for name in type(self).model_fields if name != "layers"]
        known = {f"layer_{i}.{name}" for i, layer in enumerate(self.layers) for name in _names(layer)} | set(
            own
        )
        for name in changes:
            if name not in known:
                listed = ", ".join(dict.fromkeys([*self.parameters(), *own]))
                raise MaterialError(
                    f"unknown name {shown(name)}; {close(name, known)}allowed: {listed}", where=str(name)[:60]
                )
        layers = []
        for index, layer in enumerate(self.layers):
            head = f"layer_{index}."
            mine = {name[len(head) :]: value for name, value in changes.items() if name.startswith(head)}
            try:
                layers.append(_changed(layer, mine))
            except MaterialError as error:
                raise inside(error, f"layers[{index}]") from None
        return type(self)(
            layers=tuple(layers),
            **{name: changes.get(name, getattr(self, name)) for name in own},
        )

    def describe(self) -> str:
        """The cross-section in words, one layer a line, for a terminal."""
        above = "air" if self.exterior == 1.0 else f"index {self.exterior:g}"
        rows = [(above, "")]
        rows += [
            (f"{index}  {layer.kind.replace('_', ' ')}", in_words(layer))
            for index, layer in enumerate(self.layers)
        ]
        if not self.layers[-1].opaque:
            rows.append(("open", "transmits"))
        width = max(len(left) for left, _ in rows)
        lines = [f"  {left.ljust(width)}  {right}".rstrip() for left, right in rows]
        heading = [self.name or "unnamed stack"]
        if self.description:
            heading += [f"  {line}" for line in self.description.splitlines()]
        return "\n".join(heading + lines)

    def _repr_html_(self) -> str:
        """The cross-section as a picture, for a notebook."""
        from urushi.cross_section import as_html

        return as_html(self)

    def __repr__(self) -> str:
        rules = type(self).rules()
        said = {name: value for name, value in self.spoken().items() if name != "name" or value}
        return (
            "Stack(\n"
            + "".join(f"    {name}={rules[name].source(value)},\n" for name, value in said.items())
            + ")"
        )

    __str__ = __repr__


def continuous(piece: Description) -> Iterator[tuple[str, Any]]:
    """Names and values of the continuous parameters of a layer or a phase function."""
    for name, rule in type(piece).rules().items():
        value = getattr(piece, name)
        if isinstance(value, Description) and not isinstance(value, Texture):
            yield from ((f"{name}.{inner}", number) for inner, number in continuous(value))
        elif isinstance(rule, Parameter) and value is not None:
            yield name, value


def _names(piece: Description) -> Iterator[str]:
    """Every name of a layer that `Stack.replace` knows."""
    for name in type(piece).model_fields:
        yield name
        value = getattr(piece, name)
        if isinstance(value, Description) and not isinstance(value, Texture):
            yield from (f"{name}.{inner}" for inner in _names(value))


def _changed(piece: Any, changes: Mapping[str, Any]) -> Any:
    """The layer or phase function with some values changed; ``phase.g`` changes the phase function."""
    if not changes:
        return piece
    values = {name: value for name, value in changes.items() if "." not in name}
    for name in {name.partition(".")[0] for name in changes if "." in name}:
        inner = {key.partition(".")[2]: value for key, value in changes.items() if key.startswith(f"{name}.")}
        if name in values:
            raise MaterialError(
                f"found both {name} and {name}.{next(iter(inner))}; allowed: one of them", where=name
            )
        try:
            values[name] = _changed(getattr(piece, name), inner)
        except MaterialError as error:
            raise inside(error, name) from None
    return piece.model_copy(update=values)


def in_words(piece: Description) -> str:
    """The values of a layer or a phase function in words: ``ior 1.5, alpha 0.1``."""
    words = []
    for name, value in piece.spoken().items():
        if isinstance(value, Texture):
            scale = "" if value.scale == 1.0 else f" times {value.scale:g}"
            said = f"{name} from {value.path.name}{scale}"
        elif isinstance(value, Description):
            said = _kind_in_words(value)
        elif isinstance(value, tuple) and isinstance(value[0], Description):
            said = f"{name} {', '.join(_kind_in_words(one) for one in value)}"
        elif isinstance(value, tuple):
            said = f"{name} {' '.join(f'{number:g}' for number in value)}"
        elif isinstance(value, float):
            said = f"{name} {value:g}"
        else:
            said = str(value) if name in ("material", "distribution") else f"{name.replace('_', ' ')} {value}"
        words.append(said)
    return ", ".join(words)


def _kind_in_words(piece: Description) -> str:
    inner = in_words(piece)
    return piece.kind.replace("_", " ") + (f" ({inner})" if inner else "")


def parameter_table() -> list[dict[str, Any]]:
    """Every continuous parameter: the one source of documentation, schema and random test inputs.

    Returns:
        One row per parameter: ``name`` (``dielectric.alpha``), ``meaning``, ``unit`` (empty for a ratio), ``low``,
        ``high``, ``size`` (how many numbers may stand for one, 0 for none), ``default`` (None: there is none) and
        ``source`` of the default.
    """
    rows = []
    pieces: dict[str, type[Description]] = {"stack": Stack, **LAYERS, **PHASES, "texture": Texture}
    for kind, piece in pieces.items():
        for name, rule in piece.rules().items():
            if isinstance(rule, Parameter):
                field = piece.model_fields[name]
                rows.append(
                    {
                        "name": f"{kind}.{name}",
                        "meaning": rule.meaning,
                        "unit": rule.unit,
                        "low": rule.low,
                        "high": rule.high,
                        "size": rule.size,
                        "default": None if field.is_required() else field.default,
                        "source": rule.source_of_default,
                    }
                )
    return rows
