"""Cases of independent programs, and how to hold the walk against them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import urushi as ur

DATA = Path(__file__).parent / "data"
#: how many combined standard errors a case may be off
SIGMAS = 4.0


def cases(name: str) -> list[dict[str, Any]]:
    """The cases of one file."""
    found: list[dict[str, Any]] = json.loads((DATA / f"{name}.json").read_text("utf-8"))["cases"]
    return found


def stack(layers: list[dict[str, Any]], name: str = "") -> ur.Stack:
    """Layers as they are written in a material file."""
    kinds = {
        "dielectric": ur.Dielectric,
        "conductor": ur.Conductor,
        "diffuse": ur.Diffuse,
        "medium": ur.Medium,
    }
    built = []
    for layer in layers:
        ((kind, values),) = layer.items()
        values = dict(values)
        if "phase" in values:
            values["phase"] = ur.HenyeyGreenstein(**values["phase"]["henyey_greenstein"])
        built.append(kinds[kind](**values))
    return ur.Stack(name=name, layers=built)


def degrees(theta: Any, phi: Any = 0.0) -> np.ndarray:
    """Unit vectors from angles in degrees, (N, 3)."""
    theta, phi = np.broadcast_arrays(np.radians(np.atleast_1d(theta)), np.radians(phi))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


class Tally:
    """All comparisons with one source: none may be far off, and all together may not drift to one side."""

    def __init__(self) -> None:
        self.z: list[float] = []

    def add(
        self, what: str, found: Any, error: Any, truth: Any, truth_error: Any, rounding: float = 2e-5
    ) -> None:
        """Arrays of estimates with standard errors; `rounding` is relative, of single precision or a table."""
        found, truth = np.asarray(found, float), np.asarray(truth, float)
        spread = np.hypot(np.hypot(error, truth_error), rounding * np.abs(truth) + 1e-9)
        z = ((found - truth) / spread).ravel()
        assert np.isfinite(z).all(), what
        worst = int(np.argmax(np.abs(z)))
        assert abs(z[worst]) <= SIGMAS, (
            f"{what}[{worst}]: {found.flat[worst]} for {truth.flat[worst]}: {z[worst]:.1f} σ"
        )
        self.z.extend(z)

    def settle(self, independent: float = 1.0) -> None:
        """The mean of all deviations is that of chance; `independent` is the share of them that is."""
        n = len(self.z) * independent
        assert abs(np.mean(self.z)) * np.sqrt(n) <= SIGMAS, (
            f"mean deviation {np.mean(self.z):.2f} σ of {len(self.z)}"
        )
