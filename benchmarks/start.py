"""How long it takes to begin: `import urushi`, `urushi render` on a machine that has never run it, and lobes.

What lobes have no closed form for is solved and tabulated as a stack is made or a number changed: `first_value` is from
`ur.solve` to the first value of a stack with another number, its code compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

TITLE = "Starting"
GOAL = 15.0
IMPORT = "import time; t = time.perf_counter(); import urushi; print(time.perf_counter() - t)"
RENDER = """
import sys
from contextlib import contextmanager
from urushi import cli
from urushi.cli import progress

@contextmanager
def bar(title):
    yield lambda done, total: print("pass", flush=True)

progress.bar = bar
sys.argv = ["urushi", "render", "preset:enamel-on-gold", "-o", sys.argv[1] + "/a.png"]
cli.main()
"""


def measure(quick: bool) -> dict[str, Any]:
    """Seconds; a new home folder each time, so that no kernel is in Dr.Jit's cache."""
    rounds = 1 if quick else 3
    imports = [float(_python(IMPORT).stdout) for _ in range(rounds + 4)]
    runs = [_first_pass() for _ in range(rounds)]
    return {
        "import": float(np.median(imports)),
        "first_pass_cold": float(np.median([cold for cold, _ in runs])),
        "first_pass_warm": float(np.median([warm for _, warm in runs])),
        "first_value": {name: _first_value(stack, rounds + 4) for name, stack in _stacks().items()},
    }


def _stacks() -> dict[str, Any]:
    """Those that `lobes` measures, and one whose interfaces are not alike in all azimuths."""
    import lobes
    import urushi as ur

    return {**lobes.stacks(), "brushed metal, lacquered": ur.load("preset:brushed-metal-lacquer")}


def _first_value(stack: Any, rounds: int) -> float:
    """Seconds from the description to a value by lobes, of stacks that differ in a number; the median."""
    import urushi as ur

    taken, index = [], stack.layers[0].ior
    for k in range(rounds + 1):
        other = stack.replace({"layer_0.ior": index + 1e-3 * k})
        start = time.perf_counter()
        ur.solve(other, method="lobes").eval([0.6, 0.0, 0.8], [-0.5, 0.0, 0.75**0.5])
        taken.append(time.perf_counter() - start)
    return float(np.median(taken[1:]))  # the first compiles


def _python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)


def _first_pass() -> tuple[float, float]:
    """Seconds from the command to the first pass of the picture, with Dr.Jit's cache empty and filled."""
    with tempfile.TemporaryDirectory() as home:
        environment = os.environ | {"HOME": home, "USERPROFILE": home}
        taken = []
        for _ in range(2):
            start = time.perf_counter()
            command = [sys.executable, "-c", RENDER, home]
            with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                line = process.stdout.readline()
                taken.append(time.perf_counter() - start)
                process.kill()
            if line != "pass\n":
                raise RuntimeError(f"the render ended before its first pass: {line!r}")
    return taken[0], taken[1]


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    met = "met" if found["first_pass_cold"] < GOAL else "missed"
    return [
        "| what | seconds |",
        "|---|---:|",
        f"| `import urushi` | {found['import']:.2f} |",
        f"| `urushi render preset:enamel-on-gold`, to the first pass, Dr.Jit's cache empty | "
        f"{found['first_pass_cold']:.1f} (goal {GOAL:g}, {met}) |",
        f"| the same once more | {found['first_pass_warm']:.1f} |",
        *(f"| lobes, to the first value: {name} | {x:.1g} |" for name, x in found["first_value"].items()),
    ]
