"""Urushi: layered materials for rendering.

Describe a stack of layers (`Stack` of `Dielectric`, `Medium`, `Conductor`, `Diffuse`), as Python or as a small YAML
file; `solve` turns it into a BSDF by one of three methods that check one another: ``adding`` (deterministic),
``lobes`` (fast) and ``walk`` (unbiased).

    import urushi as ur

    stack = ur.Stack(name="lacquer", layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Diffuse(reflectance=0.3)])
    bsdf = ur.solve(stack, method="walk")

Importing this package is light: Dr.Jit and Mitsuba are imported when something needs them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from urushi import llvm as _llvm
from urushi.errors import MaterialError, OutOfReach, UnsupportedStack, UrushiError
from urushi.io import load, presets, save, schema
from urushi.stack import (
    Conductor,
    Dielectric,
    Diffuse,
    GradedMedium,
    HenyeyGreenstein,
    Isotropic,
    Medium,
    Rayleigh,
    Stack,
    Tabulated,
    Texture,
)

_llvm.prepare()  # Dr.Jit takes the first LLVM it finds when it is imported, which may be one too old to work

if TYPE_CHECKING:
    from urushi import plot as plot
    from urushi.comparison import compare
    from urushi.solvers import add, solve

__version__ = "0.1.0"

# fmt: off
__all__ = [
    "Conductor", "Dielectric", "Diffuse", "GradedMedium", "HenyeyGreenstein", "Isotropic", "MaterialError", "Medium",
    "OutOfReach", "Rayleigh", "Stack", "Tabulated", "Texture", "UnsupportedStack", "UrushiError", "add", "compare",
    "load", "presets", "save", "schema", "solve",
]
# fmt: on


def __getattr__(name: str) -> Any:
    """Names that live in heavier modules, imported on first use."""
    if name in ("add", "solve"):
        from urushi import solvers

        return getattr(solvers, name)
    if name == "compare":
        from urushi import comparison

        return comparison.compare
    if name == "plot":  # needs matplotlib, which is an extra
        return importlib.import_module("urushi.plot")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), "add", "compare", "plot", "solve"])
