"""Times: warm, in turn, so that whatever else the machine does meets them all."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from urushi.solvers import BSDF

#: evaluations of a run: from the first of these, four times as many until it takes `SECONDS`, up to the last
FEWEST, MOST = 1 << 12, 1 << 20
SECONDS = 0.02
ROUNDS = 7


def nanoseconds(
    bsdfs: dict[str, BSDF], seed: int = 0, advance: Callable[[float], object] = lambda share: None
) -> tuple[dict[str, float], dict[str, float]]:
    """Time of one `eval` and of one `sample`, by the name of each, on all threads of this machine.

    It is that of the compiled kernels, as Dr.Jit reports it: what a renderer pays. Of several rounds, in which all take
    their turn, the fastest counts; the others were disturbed.
    """
    runs: dict[tuple[str, str], Callable[[Any], Any]] = {}
    for name, bsdf in bsdfs.items():
        runs[name, "eval"], runs[name, "sample"] = partial(_evaluated, bsdf), partial(_sampled, bsdf)
    lanes: dict[int, Any] = {}
    sizes: dict[tuple[str, str], int] = {}
    for i, (key, run) in enumerate(runs.items()):
        size = FEWEST
        while True:
            lanes[size] = lanes[size] if size in lanes else _lanes(size, seed)
            _timed(run, lanes[size])  # compiles
            if size == MOST or min(_timed(run, lanes[size]) for _ in range(2)) > SECONDS:
                break
            size *= 4
        sizes[key] = size
        advance(0.5 * (i + 1) / len(runs))
    best = dict.fromkeys(runs, np.inf)
    for turn in range(ROUNDS):
        for key, run in runs.items():
            best[key] = min(best[key], _timed(run, lanes[sizes[key]]))
        advance(0.5 + 0.5 * (turn + 1) / ROUNDS)
    cost = {key: 1e9 * taken / sizes[key] for key, taken in best.items()}
    evals, samples = ({name: cost[name, what] for name in bsdfs} for what in ("eval", "sample"))
    return evals, samples


def _evaluated(bsdf: BSDF, lanes: Any) -> Any:
    return bsdf.eval(lanes[0], lanes[1])


def _sampled(bsdf: BSDF, lanes: Any) -> Any:
    sample = bsdf.sample(lanes[0], lanes[2])
    return sample.wo, sample.weight, sample.pdf


def _timed(run: Callable[[Any], Any], lanes: Any) -> float:
    """Seconds that the kernels of a run took."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(run(lanes))
        dr.sync_thread()
        return 1e-3 * sum(max(kernel.get("execution_time", 0.0), 0.0) for kernel in dr.kernel_history())


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
