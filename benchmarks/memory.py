"""What evaluating four million pairs through numpy takes beyond its inputs, in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

TITLE = "Memory"
GOAL = 1000
PROGRAM = """
import json, resource, sys
import numpy as np
import urushi as ur

pairs = int(sys.argv[1])
bsdf = ur.solve("preset:enamel", method="walk", samples=1)
up = np.array([[0.0, 0.0, 1.0]])
bsdf.eval(up, up)

rng = np.random.default_rng(1)
def directions():
    w = rng.normal(size=(pairs, 3))
    w[:, 2] = np.abs(w[:, 2])
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    return w

wi, wo = directions(), directions()
bsdf.eval(wi[:100_000], wo[:100_000])
with open("/proc/self/clear_refs", "w") as file:  # the peak starts anew: what making the inputs took does not count
    file.write("5")
def status(name):
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(name)) * 1024 / 1e6

before = status("VmRSS")
value = bsdf.eval(wi, wo)
print(json.dumps({"before": before, "beyond": status("VmHWM") - before, "result": value.nbytes / 1e6}))
"""


def measure(quick: bool) -> dict[str, Any]:
    """Megabytes; none where the system does not say (it needs Linux)."""
    pairs = 1_000_000 if quick else 4_000_000
    if not Path("/proc/self/clear_refs").exists():
        return {"pairs": pairs, "beyond": None}
    command = [sys.executable, "-c", PROGRAM, str(pairs)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {"pairs": pairs, **json.loads(done.stdout)}


def table(found: dict[str, Any]) -> list[str]:
    """Markdown."""
    if found["beyond"] is None:
        return ["Not measured: this system does not tell the peak of a process."]
    met = "met" if found["beyond"] < GOAL else "missed"
    return [
        f"Evaluating {found['pairs']:,} pairs of the preset `enamel` through numpy, in RGB and double-precision "
        f"arrays, takes **{found['beyond']:.0f} MB** beyond the inputs at its peak, {found['result']:.0f} MB of "
        f"them the result (goal: under {GOAL} MB, {met}).",
    ]
