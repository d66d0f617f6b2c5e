"""Measure how fast adding converges, for its page: error against nodes and against processor time.

    python tools/make_convergence.py        write docs/images/convergence.png and docs/images/convergence.json

Errors are those of `refine.difference` from a solution with more nodes than any: the largest of all albedos, and of the
BSDF relative to its peak. Processor time is that of one solution, all threads together, kernels warm.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from urushi import llvm

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "images"
ACCURACY = 1e-5


def cases() -> dict[str, tuple[Any, list[int]]]:
    """Stack and nodes in the first panel."""
    import urushi as ur

    fog = ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.5))
    return {
        "smooth: glass slab, g 0.5": (
            ur.Stack(layers=[ur.Dielectric(ior=1.5), fog, ur.Dielectric(ior=1.0)]),
            [8, 12, 18, 27, 40],
        ),
        "rough: coat 0.1 over gold 0.2": (
            ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(material="Au", alpha=0.2)]),
            [8, 12, 18, 27, 40],
        ),
        "sharp: coat 0.02 over gold 0.05": (
            ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.02), ur.Conductor(material="Au", alpha=0.05)]),
            [18, 27, 40, 60, 90],
        ),
    }


def measure() -> dict[str, list[list[float]]]:
    """Case -> rows of nodes in the first panel, error, processor seconds."""
    from urushi.solvers.adding.refine import difference
    from urushi.solvers.adding.whole import unchecked

    found: dict[str, list[list[float]]] = {}
    for name, (stack, counts) in cases().items():
        unchecked(stack, 0.1, _panels(6))  # kernels
        best = unchecked(stack, ACCURACY, _panels(int(1.6 * counts[-1])))
        found[name] = []
        for count in counts:
            start = time.process_time()
            solved = unchecked(stack, ACCURACY, _panels(count))
            seconds = time.process_time() - start
            found[name].append([count, difference(solved, best), seconds])
            print(name, found[name][-1], flush=True)
    return found


def _panels(count: int) -> list[int]:
    """Nodes for the first panel and, beyond total reflection, fewer."""
    return [count, max(int(np.ceil(0.6 * count)), 6)]


def draw(found: dict[str, list[list[float]]]) -> None:
    """Both plots, side by side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.9), layout="constrained")
    for name, rows in found.items():
        count, error, seconds = np.array(rows).T
        axes[0].loglog(count, error, "o-", label=name)
        axes[1].loglog(seconds, error, "o-")
    axes[0].set_xlabel("nodes between normal and horizon")
    axes[0].set_ylabel("error: albedo, or part of the peak")
    axes[1].set_xlabel("processor seconds of one solution")
    figure.legend(loc="outside lower center", ncols=len(found), fontsize=8)
    for axis in axes:
        axis.grid(True, which="both", alpha=0.2)
    figure.savefig(FOLDER / "convergence.png", dpi=110)


def main() -> None:
    """Measure, draw, and keep the numbers."""
    llvm.ensure()
    found = measure()
    (FOLDER / "convergence.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    draw(found)
    for name, rows in found.items():
        x, y = np.log(np.array(rows)[:, :2]).T
        fitted = [-np.polyfit(x[k:], y[k:], 1)[0] for k in (0, -3)]
        between = -np.diff(y) / np.diff(x)
        print(
            f"{name}: orders {np.round(between, 1)}, fitted {fitted[0]:.1f}, of the last three {fitted[1]:.1f}"
        )


if __name__ == "__main__":
    main()
