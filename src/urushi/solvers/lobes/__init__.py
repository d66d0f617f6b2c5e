"""Lobes: a stack as a handful of lobes, in closed form.

What a layer does to light is put into a few numbers: how much energy, around which direction, how wide. Each atomic
event (reflection, refraction, absorption, scattering, becoming diffuse) is an operator on these, and the adding
equations put layers together, lobe after lobe. The answer is an approximation that costs about as much as one layer,
for any number of lights, with derivatives in every parameter.

    width      alpha <-> a width that adds up           operators   what an interface does to energy, direction, width
    spread     widths through a stack                   medium      the same for a slab of particles
    flow       energies of a beam and of diffuse light  tables      energies of rough interfaces (grid, axes, settled)
    recursion  all of it, lobe after lobe               published   the same as the paper has it
    lobe       value and shape of one lobe              exit        how diffuse light leaves
    through    what leaves on the far side              core        all of it, as a BSDF on Dr.Jit arrays
    quadrature Gauss's rule over the cosine             matte       rough diffuse bases
    moments    diffuse light that is not even           mixing      what layers make of it
    slopes     interfaces with normals of their own     returns     what goes back and forth between layers
    angular    all of it by the angle alone, looked up  rows        the table for that
    energies   what is known better, angle by angle     nodes, kernels   angles, and what layers do with light of these
    azimuths   the same of light that is not alike in all

Sources: Belcour 2018; Weier & Belcour 2020 (anisotropy); de Dinechin & Belcour 2022 (diffuse bases).
"""

from __future__ import annotations

import sys
from typing import Any

from urushi import llvm
from urushi.errors import UnsupportedStack
from urushi.stack import Stack

#: what `solve` takes besides the stack
OPTIONS = ("published", "symmetric", "parameters", "backend", "precision", "mode")


def reasons_against(stack: Stack, published: bool = False) -> list[str]:
    """What of this stack the method cannot do; empty if it can."""
    reasons = []
    for i, layer in enumerate(stack.layers):
        if layer.kind == "graded":
            reasons.append(f"layers[{i}] is a graded medium, and lobes know homogeneous ones only")
        walks = layer.kind in ("dielectric", "conductor") and layer.multiple_scattering == "walk"  # type: ignore[attr-defined]
        if walks and layer.alpha != 0:  # type: ignore[attr-defined]
            reasons.append(
                f"layers[{i}].multiple_scattering is 'walk', and lobes know False and 'compensated' there only"
            )
        if published and getattr(layer, "normal", None) is not None:
            reasons.append(f"layers[{i}].normal is given, which the published method does not know")
        if published and layer.kind == "diffuse":
            reasons.append(f"layers[{i}] is diffuse, which the published method does not know")
    return reasons


def solve(stack: Stack, **options: Any) -> Any:
    """A `LobesBSDF`; see `urushi.solvers.lobes.result.LobesBSDF` for the options."""
    reasons = reasons_against(stack, bool(options.get("published", False)))
    if reasons:
        raise UnsupportedStack("lobes", reasons)
    if "drjit" not in sys.modules:
        llvm.prepare()  # before Dr.Jit takes the first LLVM it finds
    from .result import LobesBSDF

    return LobesBSDF(stack, **options)
