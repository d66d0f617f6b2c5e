"""What a check hands back, and what it is given to look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

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
        text: what was found, and where.
        closer: a line of Python that shows the worst of it, with the BSDF as `bsdf`.
        claimed: False where the BSDF says itself that it does not keep this law; it passes then, whatever was found.
    """

    name: str
    passed: bool
    number: float
    limit: float
    text: str
    closer: str = ""
    claimed: bool = True

    @classmethod
    def of(
        cls, name: str, number: float, limit: float, text: str, closer: str = "", claimed: bool = True
    ) -> Report:
        """A report that passes where the number is within the limit, and a number that is none never is."""
        return cls(
            name, not claimed or bool(number <= limit), float(number), float(limit), text, closer, claimed
        )


def row(w: np.ndarray) -> str:
    """One direction as Python reads it again, the same to single precision."""
    return f"[[{', '.join(f'{x:.9g}' for x in np.ravel(w))}]]"
