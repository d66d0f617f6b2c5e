"""YAML and JSON text into plain data, strictly, and with the line of every value for error messages.

YAML is read event by event rather than by PyYAML's constructors: plain values follow the JSON-like core schema of
YAML 1.2 (``1e-4`` is a number, ``no`` and ``2020-01-01`` are text), a key may appear once, and tags, anchors, deep
nesting and floods of values are refused, so that no file can build anything but data or take long.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import yaml

from urushi.description.base import Data, shown
from urushi.errors import MaterialError

DEEPEST = 24
"""Levels of nesting that a file may have (a material needs 7)."""

MOST = 20_000
"""Values that a file may have."""

_INTEGER = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


@dataclass
class Node:
    """A value of a file and the line where it begins (0: unknown)."""

    data: Data
    line: int
    children: dict[str | int, Node]


def parse(text: str, form: str) -> Node:
    """Plain data from text.

    Args:
        text: the whole file.
        form: "yaml" or "json".

    Raises:
        MaterialError: a syntax error, a key given twice, or something that a material file has no use for.
    """
    return _parse_json(text) if form == "json" else _parse_yaml(text)


def line_of(root: Node, where: str) -> int:
    """The line of ``layers[1].phase.g`` in the file, or of the nearest thing around it.

    A place names no kinds of layer (``layers[1].albedo``), a file does (``layers: [.., {medium: {albedo: ..}}]``):
    a mapping of one key is stepped through.
    """
    node = root
    for step in re.findall(r"[^.\[\]]+", where):
        key: str | int = int(step) if step.isdigit() else step
        inner = node
        while key not in inner.children and isinstance(inner.data, dict) and len(inner.children) == 1:
            (inner,) = inner.children.values()
        if key not in inner.children:
            break
        node = inner.children[key]
    return node.line


def _parse_yaml(text: str) -> Node:
    try:
        return _Builder().build(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else "the file"
        problem = error.problem or error.context or "it cannot be read"
        raise MaterialError(f"not valid YAML: {problem}", where=place) from None
    except yaml.reader.ReaderError as error:
        position = error.position if isinstance(error.position, int) else 0
        line, column = text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)
        raise MaterialError(
            f"not valid YAML: the character U+{ord(text[position]):04X} is not allowed in a text file",
            where=f"line {line}, column {column}",
        ) from None
    except yaml.YAMLError as error:  # pragma: no cover - PyYAML has no third kind today
        raise MaterialError(f"not valid YAML: {error}", where="the file") from None
    except (RecursionError, ValueError, OverflowError) as error:
        # PyYAML lets a few of Python's own errors out, such as chr() of an escape beyond Unicode.
        raise MaterialError(f"not valid YAML: {error}", where="the file") from None


class _Builder:
    """Builds nodes from the stream of YAML events, on a stack of its own (no recursion)."""

    def __init__(self) -> None:
        self.open: list[Node] = []  # collections being filled
        self.key: list[str | None] = []  # the latest key in each
        self.wanting: list[bool] = []  # whether that key still waits for its value
        self.seen: list[dict[str, int]] = []  # the lines of every key in each
        self.root: Node | None = None
        self.count = 0

    def build(self, text: str) -> Node:
        documents = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._refusal("a second document begins here; allowed: one", line)
            elif isinstance(event, yaml.AliasEvent):
                raise self._refusal(f"found the alias *{event.anchor}; allowed: values written out", line)
            elif isinstance(event, yaml.ScalarEvent):
                self._refuse_extras(event, line)
                self._scalar(event, line)
            elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
                self._refuse_extras(event, line)
                self._begin(Node({} if isinstance(event, yaml.MappingStartEvent) else [], line, {}), line)
            elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
                for part in (self.open, self.key, self.wanting, self.seen):
                    part.pop()
        return self.root or Node(None, 1, {})

    def _refusal(self, problem: str, line: int) -> MaterialError:
        place = self._place()
        return MaterialError(f"{problem} (line {line})" if place else problem, where=place or f"line {line}")

    def _place(self) -> str:
        """The path of the value being read."""
        place = ""
        for node, key in zip(self.open, self.key, strict=True):
            last = node is self.open[-1]
            if isinstance(node.data, list):
                # A collection inside the list is placed when it begins, a scalar when it is complete.
                place += f"[{len(node.data) - (not last)}]"
            elif key is not None and (self.wanting[-1] or not last):
                place += f".{key}" if place else key
        return place[:200]

    def _refuse_extras(self, event: Any, line: int) -> None:
        if event.anchor is not None:
            raise self._refusal(f"found the anchor &{event.anchor}; allowed: values written out", line)
        if event.tag is not None and event.tag != "!":
            raise self._refusal(f"found the tag {shown(event.tag)}; allowed: no tags", line)

    def _begin(self, node: Node, line: int) -> None:
        if self._at_key():
            raise self._refusal("found a list or a mapping as a key; allowed: text", line)
        if len(self.open) >= DEEPEST:
            raise self._refusal(f"nested deeper than {DEEPEST} levels", line)
        self._place_in_parent(node, line)
        self.open.append(node)
        self.key.append(None)
        self.wanting.append(False)
        self.seen.append({})

    def _at_key(self) -> bool:
        return bool(self.open) and isinstance(self.open[-1].data, dict) and not self.wanting[-1]

    def _scalar(self, event: yaml.ScalarEvent, line: int) -> None:
        if self._at_key():
            key, seen = event.value, self.seen[-1]
            self.key[-1], self.wanting[-1] = key, True
            if key in seen:
                raise self._refusal(
                    f"found the key {shown(key)} again, first on line {seen[key]}; allowed: once", line
                )
            seen[key] = line
            return
        value = event.value if event.style is not None else self._plain(event.value, line)
        self._place_in_parent(Node(value, line, {}), line)

    def _plain(self, text: str, line: int) -> Data:
        if text in _WORDS:
            return _WORDS[text]
        if _NOT_FINITE.fullmatch(text):
            raise self._refusal(f"found {text}; allowed: finite numbers", line)
        if _INTEGER.fullmatch(text) and len(text) <= 300:
            return int(text)
        return float(text) if _NUMBER.fullmatch(text) else text

    def _place_in_parent(self, node: Node, line: int) -> None:
        self.count += 1
        if self.count > MOST:
            raise self._refusal(f"more than {MOST} values", line)
        if not self.open:
            self.root = node
            return
        parent, key = self.open[-1], self.key[-1]
        if isinstance(parent.data, list):
            parent.children[len(parent.data)] = node
            parent.data.append(node.data)
        else:
            assert key is not None
            parent.children[key] = node
            parent.data[key] = node.data
            self.wanting[-1] = False


class _Repeated(Exception):
    """A key that appears twice in one JSON object."""


def _parse_json(text: str) -> Node:
    def unique(pairs: list[tuple[str, Data]]) -> dict[str, Data]:
        found: dict[str, Data] = {}
        for key, value in pairs:
            if key in found:
                raise _Repeated(key)
            found[key] = value
        return found

    try:
        data = json.loads(text, object_pairs_hook=unique, parse_constant=_NotFinite, parse_int=_integer)
    except json.JSONDecodeError as error:
        raise MaterialError(
            f"not valid JSON: {error.msg}", where=f"line {error.lineno}, column {error.colno}"
        ) from None
    except _Repeated as error:
        key = str(error)
        raise MaterialError(
            f"found the key {shown(key)} twice; allowed: once", where=key[:60] or "the file"
        ) from None
    except RecursionError:
        raise MaterialError(f"nested deeper than {DEEPEST} levels", where="the file") from None
    return _node(data, "", 0, [0])


def _integer(text: str) -> int | float:
    """An integer; beyond 300 digits (where Python refuses to try) infinity, which every rule refuses."""
    return int(text) if len(text) <= 300 else float(text)


class _NotFinite:
    """NaN and Infinity, which Python's JSON reader knows and JSON does not."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __repr__(self) -> str:
        return self.name


def _node(data: Data, place: str, depth: int, count: list[int]) -> Node:
    """The nodes of data that came without line numbers; refuses what the YAML reader refuses."""
    count[0] += 1
    if count[0] > MOST:
        raise MaterialError(f"more than {MOST} values", where=place[:200] or "the file")
    if isinstance(data, _NotFinite):
        raise MaterialError(f"found {data!r}; allowed: finite numbers", where=place[:200] or "the file")
    if depth > DEEPEST:
        raise MaterialError(f"nested deeper than {DEEPEST} levels", where=place[:200] or "the file")
    node = Node(data, 0, {})
    if isinstance(data, dict):
        for key, value in data.items():
            node.children[key] = _node(value, f"{place}.{key}" if place else key, depth + 1, count)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            node.children[index] = _node(value, f"{place}[{index}]", depth + 1, count)
    return node
