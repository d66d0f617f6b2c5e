"""Interfaces: what light does where one material meets the next. One model, one file.

An interface answers in its own frame: the incident direction `w` has w.z >= 0 whichever side it comes from (the caller
mirrors what comes from below, `above` says which), an outgoing `o` with o.z > 0 is reflected, with o.z < 0 transmitted.
Values are *flux densities*: f |cos o| without the eta^2 of radiance, so that an interface never gives back more than
it gets; the solver scales the radiance of a whole stack once.

Every interface offers (`Interface` spells it out):

    delta      True when smooth, False when rough, or a mask where it varies from lane to lane
    opaque     True when nothing is transmitted
    flat       True when sampling it never finds what a connection would miss (diffuse)
    reflect    (w, o, above)       -> (flux density, density of sampling o with the reflection chosen)
    transmit   (w, o, above)       -> likewise
    sample     (w, u, above, part) -> Scatter; part = "both" | "reflect" | "transmit"

A new interface is one file with such a class and one line in `INTERFACES`.
"""

from __future__ import annotations

from typing import Any

from .base import Interface, Scatter
from .conductor import BoundConductor
from .dielectric import BoundDielectric
from .diffuse import BoundDiffuse
from .null import Null

#: the class that binds the numbers of each described interface
INTERFACES: dict[str, Any] = {
    "dielectric": BoundDielectric,
    "conductor": BoundConductor,
    "diffuse": BoundDiffuse,
}

__all__ = ["INTERFACES", "BoundConductor", "BoundDielectric", "BoundDiffuse", "Interface", "Null", "Scatter"]
