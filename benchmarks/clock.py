"""How time is taken: always against something else in the same process, in turn, and as a median.

A wall clock on a shared machine says little; the ratio of two things measured one after the other, many times, says
a good deal. The unit is the yardstick: one evaluation of Mitsuba's built-in `roughplastic` (alpha 0.1), which a
reader can measure on any machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np


def seconds(run: Callable[[], Any]) -> float:
    """Wall time of `run`, with what it returns evaluated and every kernel finished."""
    import drjit as dr

    dr.sync_thread()
    start = time.perf_counter()
    dr.eval(run())
    dr.sync_thread()
    return time.perf_counter() - start


def in_turn(runs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, np.ndarray]:
    """Seconds (rounds,) of each, warmed up, then measured one after the other, `rounds` times."""
    for run in runs.values():
        seconds(run)
    measured: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            measured[name].append(seconds(run))
    return {name: np.array(values) for name, values in measured.items()}


def spread(ratios: np.ndarray) -> tuple[float, float, float]:
    """Median and quartiles."""
    low, middle, high = np.percentile(ratios, [25, 50, 75])
    return float(middle), float(low), float(high)
