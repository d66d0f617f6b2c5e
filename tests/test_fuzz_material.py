"""Thousands of damaged material files: each is read as a valid stack or refused with its place, and nothing else."""

from __future__ import annotations

import json
import random
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import urushi as ur
from urushi.io import dumps

REFUSED = 2000
"""How many damaged files must have been refused before the test is content."""

SIGNS = "{ } [ ] , : - # ? | > & * ! % @ ` ' \" [] {} --- ... << ~ &a *a !!int"
WORDS = "ior alpha depth albedo g phase dielectric medium conductor diffuse texture layers urushi none Au"
VALUES = "null true false yes 0 -1 1e999 .nan .inf 1e-5 2.5 1e9"
LETTERS = "\n\t \r\u2028\u202e\ufeff\x85\x00\x1bé\U0001f600٣½"
TOKENS = [*SIGNS.split(), *WORDS.split(), *VALUES.split(), *LETTERS]

WRONG: list[Any] = [
    None, True, "", "x", "0.5", -1, 2, 1e308, -1e-9, 10**30, [], {}, [1, 2], [1, 2, 3, 4], [[1]],
    {"texture": "gone.png"}, {"texture": 3}, {"texture": "a", "scale": "x"}, {"isotropic": {}}, "henyey_greenstein",
    {"henyey_greenstein": {"g": 2}}, ["diffuse", "diffuse"], {"diffuse": {}}, "\ud83d", "\u0000", "a" * 6000,
]  # fmt: skip


def flip_bytes(rng: random.Random, text: bytes) -> bytes:
    damaged = bytearray(text)
    for _ in range(rng.randint(1, 6)):
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def truncate(rng: random.Random, text: bytes) -> bytes:
    return text[: rng.randrange(len(text))]


def delete_span(rng: random.Random, text: bytes) -> bytes:
    start = rng.randrange(len(text))
    return text[:start] + text[start + rng.randint(1, 20) :]


def repeat_span(rng: random.Random, text: bytes) -> bytes:
    start = rng.randrange(len(text))
    span = text[start : start + rng.randint(1, 80)]
    return text[:start] + span * rng.randint(2, 40) + text[start:]


def put_token(rng: random.Random, text: bytes) -> bytes:
    parts = re.split(r"(\s+|[{}\[\],:])", text.decode())
    for _ in range(rng.randint(1, 3)):
        parts[rng.randrange(len(parts))] = rng.choice(TOKENS)
    return "".join(parts).encode()


def swap_tokens(rng: random.Random, text: bytes) -> bytes:
    parts = re.split(r"([{}\[\],:\s]+)", text.decode())
    first, second = rng.randrange(len(parts)), rng.randrange(len(parts))
    parts[first], parts[second] = parts[second], parts[first]
    return "".join(parts).encode()


def misspell(rng: random.Random, text: bytes) -> bytes:
    words = list(re.finditer(rb"[a-z_]{2,}", text))
    word = rng.choice(words)
    letters = bytearray(word.group())
    at = rng.randrange(len(letters))
    letters[at : at + rng.randint(0, 1)] = rng.choice(
        [b"", b"x", b"_", letters[at : at + 1] * 2, b"\xc3\xa9"]
    )
    return text[: word.start()] + bytes(letters) + text[word.end() :]


def move_number(rng: random.Random, text: bytes) -> bytes:
    numbers = list(re.finditer(rb"-?\d+\.?\d*", text))
    number = rng.choice(numbers)
    new = rng.choice(
        [b"-3", b"7.5", b"1e12", b"-0.0", b".nan", b"-.inf", b"1e-6", b"9" * 400, b"0x1F", b"1_000", b"1,5"]
    )
    return text[: number.start()] + new + text[number.end() :]


def shuffle_lines(rng: random.Random, text: bytes) -> bytes:
    lines = text.splitlines(keepends=True)
    rng.shuffle(lines)
    return b"".join(lines)


def reencode(rng: random.Random, text: bytes) -> bytes:
    return text.decode().encode(rng.choice(["utf-16", "utf-32", "utf-8-sig", "cp037"]))


def change_structure(rng: random.Random, text: bytes) -> bytes:
    """A value somewhere in the tree replaced, removed, renamed or moved; the file stays well-formed."""
    data = json.loads(text)
    spots: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            spots.append((node, key))
            walk(node[key])

    walk(data)
    node, key = rng.choice(spots)
    action = rng.randrange(5)
    if action == 0:
        node[key] = rng.choice(WRONG)
    elif action == 1:
        del node[key]
    elif action == 2 and isinstance(node, dict):
        node[rng.choice(TOKENS)] = node.pop(key)
    elif action == 3:
        other, place = rng.choice(spots)
        node[key] = json.loads(json.dumps(other[place])) if other is not node else [node[key]]
    else:
        for _ in range(rng.randint(1, 60)):
            node[key] = rng.choice([[node[key]], {"diffuse": node[key]}])
    return json.dumps(data).encode()


TEXTUAL: list[Callable[[random.Random, bytes], bytes]] = [
    flip_bytes, truncate, delete_span, repeat_span, put_token, swap_tokens, misspell, move_number, shuffle_lines,
    reencode,
]  # fmt: skip


def test_damaged_files_are_read_or_refused_with_their_place(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    sources: list[tuple[str, bytes]] = []
    for name in ur.presets():
        stack = ur.load(f"preset:{name}")
        sources += [(form, dumps(stack, form).encode()) for form in ("yaml", "json")]
    outcome: Counter[str] = Counter()
    refused_by: Counter[str] = Counter()
    while outcome["refused"] < REFUSED:
        assert sum(outcome.values()) < 4 * REFUSED, f"too few of the damaged files are refused: {outcome}"
        form, text = rng.choice(sources)
        if form == "json" and rng.random() < 0.5:
            damage: Callable[[random.Random, bytes], bytes] = change_structure
            form = rng.choice(["yaml", "json"])  # JSON is YAML as well
        else:
            damage = rng.choice(TEXTUAL)
        damaged = damage(rng, text)
        if damaged == text:
            continue
        path = tmp_path / f"m.{form}"
        path.write_bytes(damaged)
        try:
            stack = ur.load(path)
        except ur.MaterialError as error:
            assert error.file == str(path), (damage.__name__, damaged)
            assert error.where, (damage.__name__, damaged)
            assert str(error).startswith(f"{error.file}: {error.where}: {error.problem}")
            assert len(str(error)) < 3000
            outcome["refused"] += 1
            refused_by[damage.__name__] += 1
        else:
            assert isinstance(stack, ur.Stack)
            assert stack == ur.Stack.model_validate(
                {name: getattr(stack, name) for name in ur.Stack.model_fields}
            )
            outcome["read"] += 1
    assert set(refused_by) == {damage.__name__ for damage in [*TEXTUAL, change_structure]}
