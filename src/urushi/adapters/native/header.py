"""The header of a ``.urushi.npz`` file: text to be read by anyone, and checked value by value."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import Any

from urushi.errors import MaterialError
from urushi.solvers.adding.phase import MOST_TERMS

from .packing import LEAST, MIRRORED, MOST, PLANES, SIDES, UNDER

VERSION = 4
CLOSED_FORMS = ("interface", "single", "through", "single, through", None)
#: how close together nodes may be towards the normal
TIGHTEST = 0.05
#: nodes and orders, at most
MOST_NODES, MOST_ORDERS = 4096, 1 << 14
#: nodes that any file may have, and the square of how many each of its bytes allows
FREE_NODES, PER_BYTE = 1024, 256
#: channels, and how many parameters may have them
MOST_CHANNELS, MOST_VARIED = 4096, 4096


def text(header: dict[str, Any], description: str, diagnostics: dict[str, Any]) -> bytes:
    """A header as text: JSON, in UTF-8."""
    whole = {
        "urushi solved stack": VERSION,
        "stack": json.loads(description),
        "diagnostics": diagnostics,
        **header,
    }
    return json.dumps(whole, default=_plain, separators=(",", ":")).encode()


def parsed(content: bytes, size: int) -> tuple[dict[str, Any], str, dict[str, Any]]:
    """The header, the description as JSON, and the diagnostics.

    Args:
        content: the text.
        size: bytes of the whole file, which limit what the header may ask for.

    Raises:
        MaterialError: something that no solved stack has.
    """
    try:
        data = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as fault:
        raise _wrong("header", str(fault)[:80], "JSON") from None
    keys = {"urushi solved stack", "stack", "diagnostics", "indices", "panels", "colours", "closed_form"}
    keys |= {"forward", "terms", "error", "mirror", "once", "deltas", "parts", "planes"}
    if isinstance(data, dict) and data.get("urushi solved stack", VERSION) != VERSION:
        raise _wrong(
            "urushi solved stack",
            data["urushi solved stack"],
            f"version {VERSION} of the format; save the stack again",
        )
    if not isinstance(data, dict) or set(data) - {"channels"} != keys:
        found = sorted(data)[:20] if isinstance(data, dict) else type(data).__name__
        raise _wrong("header", found, f"a mapping with the keys {', '.join(sorted(keys))}")
    if "channels" in data:
        _check_channels(data)
    elif not _whole(data["colours"], 1, 4):
        raise _wrong("colours", data["colours"], "1 to 4")
    if not _whole(data["planes"], 0, PLANES):
        raise _wrong("planes", data["planes"], f"0 to {PLANES}")
    if type(data["mirror"]) is not bool:
        raise _wrong("mirror", data["mirror"], "true, false")
    if data["closed_form"] not in CLOSED_FORMS:
        raise _wrong("closed_form", data["closed_form"], ", ".join(form or "null" for form in CLOSED_FORMS))
    if not _number(data["error"], LEAST, MOST):
        raise _wrong("error", data["error"], f"{LEAST:g} to {MOST:g}")
    _check_grid(data, size)
    _check_parts(data)
    diagnostics = data["diagnostics"]
    if not isinstance(diagnostics, dict) or not isinstance(data["stack"], dict):
        raise _wrong("diagnostics, stack", type(diagnostics).__name__, "mappings")
    for name in ("estimated_error", "accuracy"):
        if name in diagnostics and not _number(diagnostics[name], 0, 1e9):
            raise _wrong(f"diagnostics.{name}", diagnostics[name], "a number")
    if "history" in diagnostics:
        if not isinstance(diagnostics["history"], list):
            raise _wrong("diagnostics.history", diagnostics["history"], "a list")
        diagnostics["history"] = [
            tuple(row) if isinstance(row, list) else row for row in diagnostics["history"]
        ]
    own = {"urushi solved stack", "stack", "diagnostics"}
    header = {name: value for name, value in data.items() if name not in own}
    return header, json.dumps(data["stack"]), diagnostics


def _check_channels(data: dict[str, Any]) -> None:
    """Parameters with as many values as there are channels, or one; their names are the description's to know."""
    given, count = data["channels"], data["colours"]
    if not _whole(count, 1, MOST_CHANNELS):
        raise _wrong("colours", count, f"1 to {MOST_CHANNELS}")
    if not isinstance(given, dict) or not 1 <= len(given) <= MOST_VARIED:
        raise _wrong("channels", given, f"1 to {MOST_VARIED} parameters")
    for name, value in given.items():
        values = value if isinstance(value, list) else [value]
        if len(values) > max(count, 2) or not all(_number(v, -1e300, 1e300) for v in values):
            raise _wrong(f"channels[{name[:60]}]", value, f"a number, or {count} of them")


def _check_grid(data: dict[str, Any], size: int) -> None:
    indices, panels, forward = data["indices"], data["panels"], data["forward"]
    if not isinstance(indices, list) or not indices or not all(_number(n, 1, 5) for n in indices):
        raise _wrong("indices", indices, "numbers from 1 to 5")
    if not isinstance(panels, list) or not all(
        isinstance(p, list)
        and len(p) in ((2, 3) if k == 0 else (2,))
        and _number(p[0], 1, 5)
        and _whole(p[1], 2, MOST_NODES)
        and all(_number(squeeze, TIGHTEST, 1) for squeeze in p[2:])
        for k, p in enumerate(panels)
    ):
        said = f"pairs of an index and 2 to {MOST_NODES} nodes; in the first also {TIGHTEST} to 1"
        raise _wrong("panels", panels, said)
    breaks = [p[0] for p in panels]
    if any(b <= a * (1 + 1e-9) for a, b in pairwise(breaks)) or not all(
        any(abs(n - b) <= 1e-9 * n for b in breaks) for n in indices
    ):
        raise _wrong("panels", breaks, f"ascending indices, those of the regions among them: {indices[:9]}")
    nodes = sum(p[1] for p in panels)
    if nodes > MOST_NODES or nodes**2 > max(FREE_NODES**2, PER_BYTE * size):
        raise _wrong(
            "panels",
            f"{nodes} nodes in {size} bytes",
            f"at most {MOST_NODES}, and no more than such a file has",
        )
    if not isinstance(forward, dict) or not all(
        k.isdecimal() and len(k) < 9 and _number(v, 0, 1) for k, v in forward.items()
    ):
        raise _wrong("forward", forward, "regions and shares from 0 to 1")
    terms = data["terms"]
    if not isinstance(terms, dict) or not all(
        k.isdecimal() and len(k) < 9 and _whole(v, 1, min(MOST_TERMS, 4 * nodes)) for k, v in terms.items()
    ):
        raise _wrong("terms", terms, f"regions and numbers of terms, 1 to {MOST_TERMS}")


def _check_parts(data: dict[str, Any]) -> None:
    parts, deltas, opaque = data["parts"], data["deltas"], ["above to above"]
    stored = [name for name in SIDES if name != MIRRORED]
    allowed = [stored[: stored.index(UNDER)]] if data["mirror"] else [opaque, stored]
    if not isinstance(parts, dict) or list(parts) not in allowed:
        found = list(parts)[:9] if isinstance(parts, dict) else parts
        raise _wrong("parts", found, " or ".join(map(str, allowed)))
    if data["mirror"] and data["indices"][0] != data["indices"][-1]:
        raise _wrong("mirror", True, "false where the regions outside differ")
    if not isinstance(deltas, dict) or list(deltas) != [name for name in parts if name in deltas]:
        raise _wrong("deltas", deltas, f"some of {', '.join(parts)}, in this order")
    once = data["once"]
    if not isinstance(once, list) or once != [name for name in parts if name in once]:
        raise _wrong("once", once, f"some of {', '.join(parts)}, in this order")
    counts = [sum(p[1] for p in data["panels"] if p[0] <= data["indices"][k] * (1 + 1e-9)) for k in (0, -1)]
    for name, count in deltas.items():
        most = min(counts[0 if above else 1] for above in SIDES[name])
        if not _whole(count, 0, most):
            raise _wrong(f"deltas[{name}]", count, f"0 to {most}")
    for name, part in parts.items():
        if not isinstance(part, dict) or list(part) != ["blocks", "rest"]:
            raise _wrong(f"parts[{name}]", part, "blocks and rest")
        for kind, blocks in part.items():
            if not isinstance(blocks, list) or not all(isinstance(b, list) and len(b) == 3 for b in blocks):
                raise _wrong(f"parts[{name}].{kind}", blocks, "lists of three numbers")
            end = 0
            for start, stop, first in blocks:
                fine = _whole(start, end, MOST_ORDERS) and _whole(stop, start, MOST_ORDERS)
                if not fine or not _whole(first, 0, MOST_NODES) or (start == stop and start == 0):
                    raise _wrong(
                        f"parts[{name}].{kind}", [start, stop, first], "ascending orders, and a node"
                    )
                end = stop


def _whole(value: Any, low: int, high: int) -> bool:
    return type(value) is int and low <= value <= high


def _number(value: Any, low: float, high: float) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and low <= value <= high


def _plain(value: Any) -> Any:
    """Numbers of numpy as Python's."""
    if hasattr(value, "item"):
        return value.item()
    raise MaterialError(f"diagnostics hold a {type(value).__name__}; allowed: numbers and text")


def _wrong(where: str, found: Any, allowed: str) -> MaterialError:
    shown = str(found)
    return MaterialError(
        f"found {shown if len(shown) < 90 else shown[:87] + '...'}; allowed: {allowed}", where=where
    )
