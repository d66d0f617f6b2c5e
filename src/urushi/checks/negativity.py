"""No answer is negative: there is no less than no light. What is not a number at all is for `finiteness`."""

from __future__ import annotations

import numpy as np

from .finiteness import hunt
from .report import Answers, Report


def check(answers: Answers, quick: bool) -> Report:
    """`eval`, `pdf`, `sample`, `reflectance` and `transmittance` at random and at extreme directions."""
    return hunt("not negative", lambda value: ~(np.nan_to_num(value) < 0), answers(1), quick)
