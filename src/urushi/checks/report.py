"""What a check hands back, and what it is given to look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from urushi.solvers import BSDF

#: gives the solved stack with this many samples an evaluation, where the method takes samples at all
Answers = Callable[[int], BSDF]


@dataclass(frozen=True)
class Report:
    """The outcome of one check.

    Attributes:
        name: of the check.
        passed: whether the law holds.
        number: the worst that was found.
        limit: the largest number that passes.
        text: what was found, where, and how to look closer.
    """

    name: str
    passed: bool
    number: float
    limit: float
    text: str

    @classmethod
    def of(cls, name: str, number: float, limit: float, text: str) -> Report:
        """A report that passes where the number is within the limit, and a number that is none never is."""
        return cls(name, bool(number <= limit), float(number), float(limit), text)
