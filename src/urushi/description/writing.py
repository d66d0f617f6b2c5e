"""Plain data into YAML and JSON text, in the style of the hand-written material files."""

from __future__ import annotations

import json
import re

from urushi.description.base import Data

_SAFE = re.compile(r"(\.\./)*[A-Za-z][A-Za-z0-9_./-]*( [A-Za-z0-9_./-]+)*")
_RESERVED = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}


def yaml_text(document: dict[str, Data]) -> str:
    """YAML: one key a line at the top, one layer a line, flow style inside a layer."""
    lines = []
    for key, value in document.items():
        if key == "layers":
            lines.append("layers:")
            lines += [
                f"  - {_key(kind)}: {_flow(fields)}" for layer in value for kind, fields in layer.items()
            ]
        else:
            lines.append(f"{_key(key)}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def json_text(document: dict[str, Data]) -> str:
    """JSON, indented by two."""
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _flow(value: Data) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, str):
        return _text(value)
    return str(value)


def _number(value: float) -> str:
    """The shortest decimal that reads back as the same float; with a point, which YAML 1.1 needs beside an exponent."""
    mantissa, exponent, power = repr(value).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + exponent + power


def _key(text: str) -> str:
    """A key; those of the format are words, and stay bare even where YAML 1.1 would read ``n`` or ``y`` otherwise."""
    return text if _SAFE.fullmatch(text) else _quoted(text)


def _text(text: str) -> str:
    """Bare where every YAML reader takes it for text, else in double quotes."""
    return text if _SAFE.fullmatch(text) and text.lower() not in _RESERVED else _quoted(text)


def _quoted(text: str) -> str:
    letters = []
    for letter in text:
        code = ord(letter)
        if letter in '"\\':
            letters.append("\\" + letter)
        elif letter == "\n":
            letters.append("\\n")
        elif letter.isprintable() and code <= 0xFFFF:
            letters.append(letter)
        else:
            letters.append(f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}")
    return '"' + "".join(letters) + '"'
