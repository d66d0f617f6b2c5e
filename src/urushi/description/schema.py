"""The JSON schema of a material file, made from the rules of the fields."""

from __future__ import annotations

from typing import Any

from urushi.description.base import Description
from urushi.description.layers import LAYERS
from urushi.description.parameter import Texture
from urushi.description.phases import PHASES

VERSION = 1
"""Version of the file format."""


def file_schema(stack: type[Description]) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a material file, for editors and other tools.

    It says what each value may be; what needs several values at once (a base comes last, ``depth`` or ``thickness``)
    is for `urushi.load` to check.

    Args:
        stack: the class at the top of the file.
    """
    top = _object(stack)
    version = {"const": VERSION, "description": "version of the file format"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Urushi material",
        **top,
        "properties": {"urushi": version, **top["properties"]},
        "required": ["urushi", *top["required"]],
        "$defs": {
            "layer": _choice(LAYERS),
            "phase_function": _choice(PHASES),
            "texture": _renamed(_object(Texture), "file", "texture"),
        },
    }


def _choice(registry: dict[str, type[Description]]) -> dict[str, Any]:
    """``name`` (where nothing is required) or ``{name: {...}}``, for every class of a registry."""
    bodies = {kind: _object(piece) for kind, piece in registry.items()}
    bare = [kind for kind, body in bodies.items() if "required" not in body and "oneOf" not in body]
    keyed = [
        {"type": "object", "properties": {kind: body}, "required": [kind], "additionalProperties": False}
        for kind, body in bodies.items()
    ]
    return {"anyOf": [{"enum": bare}, *keyed]}


def _object(piece: type[Description]) -> dict[str, Any]:
    fields, rules = piece.model_fields, piece.rules()
    properties = {}
    for name, rule in rules.items():
        default = fields[name].default
        entry = {**rule.schema(), "description": rule.meaning}
        if not fields[name].is_required() and default is not None:
            entry["default"] = rule.data(default, None)
        properties[name] = entry
    body: dict[str, Any] = {"type": "object"}
    if piece.__doc__:
        body["description"] = piece.__doc__.partition("\n")[0]
    body |= {"properties": properties, "additionalProperties": False}
    required = [name for name in rules if fields[name].is_required()]
    if required:
        body["required"] = required
    alternatives = [{"required": list(names)} for names in piece.alternatives]
    if alternatives:
        body["oneOf"] = alternatives
    return body


def _renamed(body: dict[str, Any], old: str, new: str) -> dict[str, Any]:
    properties = {new if name == old else name: entry for name, entry in body["properties"].items()}
    return {
        **body,
        "properties": properties,
        "required": [new if name == old else name for name in body["required"]],
    }
