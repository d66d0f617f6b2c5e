"""Lobes in the plugin `layered`: a few microfacet lobes for each place, with its textures and their derivatives.

A stack without textures is tabulated over the angle when the scene is loaded (`urushi.solvers.lobes.angular`). Where a
derivative is wanted in one of its numbers, the recursion is asked instead.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from urushi.errors import UnsupportedStack
from urushi.optics.vectors import is_live
from urushi.solvers import SOLVERS
from urushi.solvers.bound import bind
from urushi.solvers.lobes import reasons_against
from urushi.solvers.lobes.angular import Side, tabulate
from urushi.solvers.lobes.core import LobesCore
from urushi.solvers.lobes.energies import Energies
from urushi.stack import Stack

from .methods import is_radiance, truth
from .surface import Surface


class Lobes:
    """See `urushi.solvers.lobes.result.LobesBSDF` for `published` and `symmetric`."""

    OPTIONS = ("published", "symmetric")

    def __init__(self, mi: Any, stack: Stack, surface: Surface, props: Any) -> None:
        self.mi, self.stack, self.surface = mi, stack, surface
        self.published, self.symmetric = truth(props, "published"), truth(props, "symmetric")
        reasons = reasons_against(stack, self.published)
        if reasons:
            raise UnsupportedStack("lobes", reasons, [name for name in SOLVERS if name != "lobes"])
        self.changed()

    def at(self, ctx: Any, si: Any, active: Any) -> LobesHere:
        values = self.surface.at(si, active)
        core = self._core(values, is_radiance(self.mi, ctx), {} if _live(values) else self._tables)
        if self._energies is not None and self._energies.knows(core.stack):
            core.energies = self._energies
        return LobesHere(core)

    def said(self) -> dict[str, Any]:
        return {"method": "lobes", "published": self.published, "symmetric": self.symmetric}

    def changed(self) -> None:
        """The numbers are others: the tables are made anew, here, since code that is recorded can only use them."""
        self._tables: dict[bool, Side] = {}
        self._energies: Energies | None = None
        mi, variant = self.mi, self.mi.variant()
        one_per_lane = self.surface.varies or ("spectral" in variant and self.surface.coloured)
        if one_per_lane:
            return
        values = self.surface.at(dr.zeros(mi.SurfaceInteraction3f), True)
        core = self._core(values, True, {}, uniform=True)
        core.energies = self._energies = Energies.of(core)
        if mi.Float is not float and "double" not in variant and not _live(values):
            self._tables = tabulate(core, mi.Vector3f)

    def _core(self, values: dict[str, Any], radiance: bool, tables: Any, uniform: bool = False) -> LobesCore:
        mi = self.mi
        coloured = self.surface.coloured and "mono" not in mi.variant()
        spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
        bound = bind(self.stack, values, self.surface.fixed())
        return LobesCore(bound, spectrum, radiance, self.symmetric, self.published, uniform, tables)


class LobesHere:
    """The lobes at a surface interaction; `tabulated` if they are looked up."""

    def __init__(self, core: LobesCore) -> None:
        self.stack, self.tabulated = core.stack, bool(core.tables)
        self.eval, self.pdf, self.sample, self.scale = core.eval, core.pdf, core.sample, core.scale
        self.albedo = lambda wi: core.flux(wi, True)


def _live(values: dict[str, Any]) -> bool:
    """Whether derivatives are wanted in a number, now or later: a path that is followed twice, with and without, must
    meet the same lobes."""
    return any(
        is_live(one) for value in values.values() for one in (value if isinstance(value, tuple) else (value,))
    )
