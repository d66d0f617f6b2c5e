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


def guo(case: dict[str, Any]) -> tuple[ur.Stack, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A case of Guo et al. 2018: the stack, wi and wo (N, 3), values f |cos| and their standard errors (N, 3)."""
    if isinstance(case["layers"], str):
        gold = ur.Conductor(
            eta=(0.143, 0.375, 1.442), k=(3.983, 2.386, 1.603), alpha=0.2, masking="separable"
        )
        layers = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1, masking="separable"), gold])
    else:
        layers = stack(case["layers"])
    theta_i, theta_o, phi = np.array([value["triple"] for value in case["values"]]).T
    truth, error = (np.array([value[key] for value in case["values"]]) for key in ("f_cos", "stderr"))
    return layers, degrees(theta_i), degrees(theta_o, phi), truth, error


def disort(case: dict[str, Any]) -> tuple[ur.Stack, np.ndarray, dict[str, np.ndarray]]:
    """A slab that DISORT solved: the stack, wi (1, 3), and wo (N, 3) of its tables of the BSDF, "brdf" and "btdf"."""
    phase = ur.HenyeyGreenstein(g=case["g"])
    slab = ur.Stack(layers=[ur.Medium(depth=case["tau"], albedo=case["omega"], phase=phase)])
    mu0 = case["mu0"]
    # What the table calls azimuth 0 goes on the way it came, on the other side of the normal from wi.
    grids = np.meshgrid(case["mus"], np.array(case["phis"]) + np.pi, indexing="ij")
    mus, phis = (grid.ravel() for grid in grids)
    sin = np.sqrt(1 - mus**2)
    wo = {
        table: np.stack([sin * np.cos(phis), sin * np.sin(phis), sign * mus], axis=1)
        for table, sign in (("brdf", 1), ("btdf", -1))
    }
    return slab, np.array([[np.sqrt(1 - mu0**2), 0.0, mu0]]), wo


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
