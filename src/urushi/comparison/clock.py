"""Times: warm, in turn, so that whatever else the machine does meets them all."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from urushi.solvers import BSDF

#: evaluations of the short run; the difference to a long one is free of what a call costs once
SHORT, LONGEST = 1 << 10, 1 << 20
#: seconds that one long run takes at least, if the longest does
SECONDS = 0.03
ROUNDS = 7


def nanoseconds(
    bsdfs: dict[str, BSDF], seed: int = 0, advance: Callable[[float], object] = lambda share: None
) -> tuple[dict[str, float], dict[str, float]]:
    """Wall time of one `eval` and of one `sample`, by the name of each, on all threads of this machine."""
    import drjit as dr

    runs: dict[tuple[str, str], Callable[[Any], Any]] = {}
    for name, bsdf in bsdfs.items():
        runs[name, "eval"], runs[name, "sample"] = partial(_evaluated, bsdf), partial(_sampled, bsdf)
    short = _lanes(SHORT, seed)
    lanes: dict[int, Any] = {}
    longs: dict[tuple[str, str], Any] = {}
    for i, (key, run) in enumerate(runs.items()):
        _timed(dr, run, short)  # compiles
        size = SHORT
        while size < LONGEST:
            size *= 4
            longs[key] = lanes[size] = lanes[size] if size in lanes else _lanes(size, seed)
            if _timed(dr, run, longs[key]) - _timed(dr, run, short) > SECONDS:
                break
        advance(0.5 * (i + 1) / len(runs))
    taken: dict[tuple[str, str], list[tuple[float, float]]] = {key: [] for key in runs}
    for turn in range(ROUNDS):
        for key, run in runs.items():
            taken[key].append((_timed(dr, run, short), _timed(dr, run, longs[key])))
        advance(0.5 + 0.5 * (turn + 1) / ROUNDS)
    cost = {}
    for key, times in taken.items():
        size = len(longs[key][0].x)
        long = min(b for _, b in times)
        # The difference drowns where one evaluation costs next to nothing.
        spent = max(long - min(a for a, _ in times), 0.05 * long)
        cost[key] = 1e9 * spent / (size - SHORT)
    return tuple({name: cost[name, what] for name in bsdfs} for what in ("eval", "sample"))  # type: ignore[return-value]


def _evaluated(bsdf: BSDF, lanes: Any) -> Any:
    return bsdf.eval(lanes[0], lanes[1])


def _sampled(bsdf: BSDF, lanes: Any) -> Any:
    sample = bsdf.sample(lanes[0], lanes[2])
    return sample.wo, sample.weight, sample.pdf


def _timed(dr: Any, run: Callable[[Any], Any], lanes: Any) -> float:
    start = time.perf_counter()
    dr.eval(run(lanes))
    dr.sync_thread()
    return time.perf_counter() - start


def _lanes(n: int, seed: int) -> Any:
    """wi and wo from above, and random numbers."""
    import drjit as dr
    from drjit.llvm.ad import Array3f

    rng = np.random.default_rng((seed, n))
    found = []
    for _ in range(2):
        z, phi = rng.uniform(0.05, 1, n), rng.uniform(0, 2 * np.pi, n)
        sin = np.sqrt(1 - z**2)
        found.append(Array3f(np.stack([sin * np.cos(phi), sin * np.sin(phi), z]).astype(np.float32)))
    found.append(Array3f((rng.random((3, n)) * (1 - 2.0**-24)).astype(np.float32)))
    dr.eval(found)
    return found
