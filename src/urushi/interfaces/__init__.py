"""Interfaces: what light does where one material meets the next. One model, one file.

An interface answers in its own frame: the incident direction `w` has w.z >= 0 whichever side it comes from (the caller
mirrors what comes from below, `above` says which), an outgoing `o` with o.z > 0 is reflected, with o.z < 0 transmitted.
Values are *flux densities*: f |cos o| without the eta^2 of radiance, so that an interface never gives back more than
it gets; the solver scales the radiance of a whole stack once.

Every interface offers (`Interface` spells it out):

    delta      True when smooth, False when rough, or a mask where it varies from lane to lane
    opaque     True when nothing is transmitted
    flat       True when sampling it never finds what a connection would miss (diffuse)
    stochastic True when a flux density is itself an estimate, which needs a generator `rng`
    reflect    (w, o, above, part, rng)    -> (flux density, density of sampling o with the reflection chosen)
    transmit   (w, o, above, part, rng)    -> likewise
    sample     (w, u, above, part, rng)    -> Scatter; part = "both" | "reflect" | "transmit"

The density of a stochastic interface is a stand-in: positive wherever the flux density is, one where both are summed
over all directions, good for the weights of multiple importance sampling and for nothing else.

A new interface is one file with such a class and one line in `INTERFACES`.
"""

from __future__ import annotations

from typing import Any

from .base import Interface, Scatter
from .compensated import CompensatedConductor, CompensatedDielectric
from .conductor import BoundConductor
from .dielectric import BoundDielectric
from .diffuse import BoundDiffuse
from .null import Null
from .rough_diffuse import RoughDiffuse
from .walked import WalkedConductor, WalkedDielectric

#: the class that binds the numbers of each described interface, by its kind and its `multiple_scattering`
INTERFACES: dict[tuple[str, Any], Any] = {
    ("dielectric", False): BoundDielectric,
    ("conductor", False): BoundConductor,
    ("diffuse", False): RoughDiffuse,
    ("dielectric", "walk"): WalkedDielectric,
    ("conductor", "walk"): WalkedConductor,
    ("diffuse", "walk"): RoughDiffuse,
    ("dielectric", "compensated"): CompensatedDielectric,
    ("conductor", "compensated"): CompensatedConductor,
}


def key(layer: Any) -> tuple[str, Any]:
    """Where `INTERFACES` has the class of a described interface."""
    return layer.kind, getattr(layer, "multiple_scattering", False)


__all__ = [
    "INTERFACES",
    "BoundConductor",
    "BoundDielectric",
    "BoundDiffuse",
    "CompensatedConductor",
    "CompensatedDielectric",
    "Interface",
    "Null",
    "RoughDiffuse",
    "Scatter",
    "WalkedConductor",
    "WalkedDielectric",
    "key",
]
