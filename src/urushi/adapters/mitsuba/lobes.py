"""Lobes in the plugin `layered`: a few microfacet lobes for each place, with its textures and their derivatives."""

from __future__ import annotations

from typing import Any

from urushi.errors import UnsupportedStack
from urushi.solvers import SOLVERS
from urushi.solvers.bound import bind
from urushi.solvers.lobes import reasons_against
from urushi.solvers.lobes.core import LobesCore
from urushi.stack import Stack

from .methods import is_radiance
from .surface import Surface


class Lobes:
    """See `urushi.solvers.lobes.result.LobesBSDF` for `published` and `symmetric`."""

    OPTIONS = ("published", "symmetric")

    def __init__(self, mi: Any, stack: Stack, surface: Surface, props: Any) -> None:
        self.mi, self.stack, self.surface = mi, stack, surface
        self.published = bool(props.get("published", False))
        self.symmetric = bool(props.get("symmetric", False))
        reasons = reasons_against(stack, self.published)
        if reasons:
            raise UnsupportedStack("lobes", reasons, [name for name in SOLVERS if name != "lobes"])

    def at(self, ctx: Any, si: Any, active: Any) -> LobesHere:
        mi = self.mi
        coloured = self.surface.coloured and "mono" not in mi.variant()
        spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
        bound = bind(self.stack, self.surface.at(si, active), self.surface.fixed())
        return LobesHere(LobesCore(bound, spectrum, is_radiance(mi, ctx), self.symmetric, self.published))

    def said(self) -> dict[str, Any]:
        return {"method": "lobes", "published": self.published, "symmetric": self.symmetric}

    def changed(self) -> None:
        """Nothing is kept that could be out of date."""


class LobesHere:
    """The lobes at a surface interaction."""

    def __init__(self, core: LobesCore) -> None:
        self.stack = core.stack
        self.eval, self.pdf, self.sample, self.scale = core.eval, core.pdf, core.sample, core.scale
        self.albedo = lambda wi: core.flux(wi, True)
