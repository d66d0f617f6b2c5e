"""The numbers of a stack: from the description and from what a caller puts in their place.

Every continuous parameter may be one value or one value per evaluation (per lane): a texture, a sweep, or the tensor of
an optimiser. Values stay variables of the compiled code, so changing one compiles nothing anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from urushi.description.parameter import Parameter
from urushi.errors import MaterialError, UnsupportedStack, UrushiError
from urushi.optics.ior import conductor_rgb
from urushi.stack import Stack, Texture

from .arrays import padded

#: parameters of three numbers that are no colours, and what they are where nothing is said
VECTORS = {"normal": (0.0, 0.0, 1.0), "slope_variance": (0.0, 0.0, 0.0)}


@dataclass
class Numbers:
    """Values for `bound.bind`.

    Attributes:
        values: name -> number, colour, or pair, as Dr.Jit arrays (or floats in scalar mode).
        fixed: those that are known in Python.
        lanes: how many evaluations the values are for; 1 if they serve any.
        coloured: whether any of them is a colour.
    """

    values: dict[str, Any]
    fixed: dict[str, Any]
    lanes: int
    coloured: bool


def described(stack: Stack) -> dict[str, Any]:
    """Every continuous parameter of a stack, metals looked up; textures stay what they are."""
    found: dict[str, Any] = dict(stack.parameters())
    for i, layer in enumerate(stack.layers):
        material = getattr(layer, "material", None)
        if material is not None:
            found[f"layer_{i}.eta"], found[f"layer_{i}.k"] = conductor_rgb(material)
    found["exterior"] = stack.exterior
    return found


def as_numbers(name: str, value: Any) -> np.ndarray:
    """What is given for a parameter as numbers in double precision, of any shape.

    Raises:
        MaterialError: these are none.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise MaterialError(f"found {value!r:.60}; allowed: numbers", where=name) from None
    if array.size == 0:
        raise MaterialError("found no values; allowed: at least one", where=name)
    return array


def is_vector(name: str) -> bool:
    """Whether a parameter is three numbers that are no colour."""
    return name.rsplit(".", 1)[-1] in VECTORS


def _unsaid(stack: Stack, given: Mapping[str, Any]) -> dict[str, Any]:
    """Normals and the like that are given although the description has none."""
    found = {}
    for i, layer in enumerate(stack.layers):
        for field, value in VECTORS.items():
            if hasattr(layer, field) and getattr(layer, field) is None and f"layer_{i}.{field}" in given:
                found[f"layer_{i}.{field}"] = value
    return found


def gather_numbers(
    stack: Stack, given: Mapping[str, Any] | None, module: Any, double: bool, method: str
) -> Numbers:
    """Resolve all parameters.

    Args:
        stack: the description.
        given: values in place of those of the description, by name (``layer_0.alpha``): a number, a colour (3,), one
            number per evaluation (N,) or (N, 1), one colour per evaluation (N, 3), for a roughness a pair or (N, 2);
            or a Dr.Jit array, whose gradients are kept.
        module: the Dr.Jit module to compute in.
        double: whether to compute in double precision.

    Raises:
        MaterialError: an unknown name, a wrong shape or a value out of range.
        UnsupportedStack: a texture that nothing was given for.
    """
    given = dict(given or {})
    stack = _spelt_out(stack, given)
    unsaid = _unsaid(stack, given)
    stack = stack.replace(unsaid) if unsaid else stack
    known = described(stack)
    for name in given:
        if name not in known:
            stack.replace({name: 0.5})  # raises with a suggestion where it is a misspelt name
            raise MaterialError(f"found {name!r}; allowed: {', '.join(known)}", where=name)
    textured = [name for name, value in known.items() if isinstance(value, Texture) and name not in given]
    if textured:
        raise UnsupportedStack(
            method,
            [
                f"{name} is a texture, which has values only at points of a surface: render it with the Mitsuba "
                f"plugin, or give values by parameters={{{name!r}: ...}}"
                for name in textured
            ],
        )
    values: dict[str, Any] = {}
    fixed: dict[str, Any] = {}
    lanes, coloured = 1, False
    for name, value in known.items():
        if name in given and not isinstance(given[name], (int, float, tuple)):
            values[name], width, colour = _lanes(stack, name, given[name], module, double)
            if width not in (1, lanes) and lanes != 1:
                raise MaterialError(
                    f"found values for {width} evaluations, others are for {lanes}", where=name
                )
            lanes = max(lanes, width)
        else:
            if name in given:
                value = (
                    stack.replace({name: given[name]}).parameters()[name]
                    if name != "exterior"
                    else given[name]
                )
            fixed[name] = value
            values[name] = _constant(value, module, double)
            colour = isinstance(value, tuple) and len(value) == 3
        colour = colour and not is_vector(name)
        coloured = coloured or colour
    return Numbers(values, fixed, lanes, coloured)


def as_arrays(given: Mapping[str, Any]) -> dict[str, Any]:
    """The same values, those in Dr.Jit arrays as numpy arrays (N, 1), (N, 2) or (N, 3).

    Raises:
        UrushiError: derivatives are wanted in one, which a numpy array does not have.
    """
    found = dict(given)
    for name, value in given.items():
        if dr.is_array_v(value):
            if dr.grad_enabled(value):
                raise UrushiError(
                    f"{name}: found a Dr.Jit array with derivatives, which a copy would not have; allowed: "
                    "drjit.detach(...) of it"
                )
            array = np.array(value, dtype=np.float64)
            found[name] = array[:, None] if dr.size_v(value) == dr.Dynamic else np.atleast_2d(array.T)
    return found


def replaced(stack: Stack, given: Mapping[str, Any]) -> Stack:
    """The stack with other numbers, for methods that take one value per parameter.

    Args:
        given: numbers, or colours of three, by name.

    Raises:
        MaterialError: an unknown name, a wrong shape or a value out of range.
    """
    changes: dict[str, Any] = {}
    for name, value in given.items():
        array = as_numbers(name, value)
        if array.ndim > 1 or array.size > 3:
            raise MaterialError(
                f"found shape {array.shape}; allowed: one number or one colour (this method is solved once, not for "
                "every evaluation)",
                where=name,
            )
        changes[name] = float(array.item()) if array.size == 1 else tuple(float(v) for v in array)
    found = _spelt_out(stack, given).replace(changes)
    known = described(found)
    for name in given:
        if name not in known:  # of a graded medium, what it is at every height
            raise MaterialError(f"is no continuous parameter; allowed: {', '.join(known)}", where=name)
    return found


def _spelt_out(stack: Stack, given: Mapping[str, Any]) -> Stack:
    """The stack with numbers for the metals given by name whose index the caller sets."""
    changes: dict[str, Any] = {}
    for i, layer in enumerate(stack.layers):
        name = f"layer_{i}"
        if getattr(layer, "material", None) is not None and {f"{name}.eta", f"{name}.k"} & set(given):
            eta, k = conductor_rgb(layer.material)  # type: ignore[attr-defined]
            changes |= {f"{name}.material": None, f"{name}.eta": eta, f"{name}.k": k}
    return stack.replace(changes) if changes else stack


def _types(module: Any, double: bool) -> tuple[Any, Any]:
    if module.__name__ == "drjit.scalar":
        return float, module.Array3f64 if double else module.Array3f
    return (module.Float64, module.Array3f64) if double else (module.Float, module.Array3f)


def _constant(value: Any, module: Any, double: bool) -> Any:
    number, colour = _types(module, double)
    make = float if number is float else lambda x: dr.opaque(number, x)
    if not isinstance(value, tuple):
        return make(value)
    return colour(*(make(v) for v in value)) if len(value) == 3 else tuple(make(v) for v in value)


def _lanes(stack: Stack, name: str, value: Any, module: Any, double: bool) -> tuple[Any, int, bool]:
    """A value per lane, its number of lanes, and whether it is a colour."""
    number, colour = _types(module, double)
    if dr.is_array_v(value):
        if number is float and dr.is_jit_v(value):
            raise MaterialError("found a Dr.Jit array; allowed with backend 'scalar': numbers", where=name)
        if dr.depth_v(value) == 1 and dr.size_v(value) == dr.Dynamic:
            return number(value), dr.width(value), False
        if dr.size_v(value) == 3:
            return colour(value), dr.width(value), True
        if dr.size_v(value) == 2 and name.endswith(".alpha"):
            return (number(value.x), number(value.y)), dr.width(value), False
        raise MaterialError(
            f"found a Dr.Jit array of shape {dr.shape(value)}; allowed: numbers or colours", where=name
        )
    array = as_numbers(name, value)
    vector = is_vector(name)
    allows_colour = vector or _is_colour(stack, name)
    pair = name.endswith(".alpha")
    check_range(stack, name, array)
    if (array.ndim == 0 and not vector) or (array.ndim == 1 and array.shape[0] == 3 and allows_colour):
        plain = float(array) if array.ndim == 0 else tuple(float(v) for v in array)
        return _constant(plain, module, double), 1, array.ndim == 1
    if not vector and (array.ndim == 1 or (array.ndim == 2 and array.shape[1] == 1)):
        return _column(name, array, number), array.shape[0], False
    columns = [_column(name, column, number) for column in array.T] if array.ndim == 2 else []
    if len(columns) == 3 and allows_colour:
        return colour(*columns), array.shape[0], True
    if len(columns) == 2 and pair:
        return tuple(columns), array.shape[0], False
    numbers = "(3,)" if vector else "a number, (N,)"
    raise MaterialError(
        f"found shape {array.shape}; allowed: {numbers}" + (" or (N, 3)" if allows_colour else ""), where=name
    )


def _column(name: str, values: np.ndarray, number: Any) -> Any:
    """One value per evaluation; scalar code has one evaluation at a time."""
    if number is not float:
        return number(padded(values))
    if values.size != 1:
        raise MaterialError(
            f"found values for {values.size} evaluations; allowed with backend 'scalar': one", where=name
        )
    return float(values.item())


def _is_colour(stack: Stack, name: str) -> bool:
    """Whether three numbers for a parameter are one for each channel."""
    layer, _, field = name.partition(".")
    if not layer.startswith("layer_"):
        return False
    rule = type(stack.layers[int(layer.removeprefix("layer_"))]).rules().get(field)
    return isinstance(rule, Parameter) and rule.size == 3


def check_range(stack: Stack, name: str, array: np.ndarray) -> None:
    """Refuse values that the description would refuse."""
    if not np.isfinite(array).all():
        raise MaterialError("found a value that is not finite; allowed: numbers", where=name)
    if is_vector(name):
        if array.shape[-1:] == (3,) and array.ndim <= 2:
            _check_vectors(stack, name, np.atleast_2d(array))
        return
    for extreme in {float(array.min()), float(array.max())}:
        if name == "exterior":
            stack.replace({"exterior": extreme})
        else:
            stack.replace({name: extreme})


def _check_vectors(stack: Stack, name: str, rows: np.ndarray) -> None:
    """The description checks the rows that stand out; all others lie between them."""
    x, y, z = rows.T
    if name.endswith(".normal"):
        found = {int(np.argmin(z)), *(int(i) for c in rows.T for i in (np.argmin(c), np.argmax(c)))}
    else:
        found = {
            int(np.argmin(x * y - z * z)),
            *(int(i) for c in rows.T for i in (np.argmin(c), np.argmax(c))),
        }
    for i in sorted(found):
        stack.replace({name: tuple(float(v) for v in rows[i])})
