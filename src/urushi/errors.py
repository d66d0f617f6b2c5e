"""The errors Urushi raises; `UrushiError` is the root of them all.

An error names the value, the place and what is allowed, so that its reader can mend the material
without opening the source.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


class UrushiError(Exception):
    """Root of every error that Urushi raises on purpose."""


class MaterialError(UrushiError):
    """A description of a material is wrong: which file, where in it, what was found, what is allowed.

    Attributes:
        problem: what is wrong and what is allowed, in words.
        where: path inside the description, such as ``layers[1].albedo`` (or None).
        file: the material file (or None when the description was built in Python).
    """

    def __init__(self, problem: str, *, where: str | None = None, file: str | None = None) -> None:
        self.problem = problem
        self.where = where
        self.file = file
        super().__init__(": ".join(part for part in (file, where, problem) if part))


class UnsupportedStack(UrushiError):
    """A method cannot do this stack; says why, and which methods can.

    Attributes:
        method: the method that was asked for.
        reasons: one sentence for each thing that it cannot do.
        alternatives: names of the methods that can.
    """

    def __init__(self, method: str, reasons: Sequence[str], alternatives: Sequence[str] = ()) -> None:
        self.method = method
        self.reasons = tuple(reasons)
        self.alternatives = tuple(alternatives)
        able = f"; methods that can: {', '.join(self.alternatives)}" if self.alternatives else ""
        super().__init__(f"method {method!r} cannot do this stack: {'; '.join(self.reasons)}{able}")

    def __reduce__(self) -> tuple[object, ...]:
        # The arguments of an exception are its message alone, of which a worker process could not make it again.
        return type(self), (self.method, self.reasons, self.alternatives)


class OutOfReach(UrushiError):
    """An accuracy that adding does not get to with as many nodes as it may take."""


def close(found: object, names: Iterable[str]) -> str:
    """``did you mean 'alpha'? `` for a near miss, else nothing: for a message, before what is allowed."""
    known = {name.lower(): name for name in names}
    near = difflib.get_close_matches(str(found).lower(), known, n=3, cutoff=0.6)
    if not near:
        return ""
    return f"did you mean {' or '.join(repr(known[name]) for name in near)}? "
