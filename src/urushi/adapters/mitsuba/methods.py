"""The methods as `layered` uses them: from a surface interaction to something that evaluates and samples there.

A method takes its own parameters from the plugin's, and gives `at(ctx, si, active)`, which has

    eval(wi, wo)    f |cos wo| without the delta parts      scale(wi, wo)   the factor of radiance
    pdf(wi, wo)     density of what `sample` draws          albedo(wi)      directional-hemispherical reflectance
    sample(wi, u)   wo, density or probability, what a delta part carries, mask of delta lanes
    stack           the bound stack
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr

from urushi.errors import MaterialError
from urushi.solvers.walk.core import WalkCore
from urushi.solvers.walk.derivative import bind_live

from .surface import Surface


class Method(Protocol):
    """See the module docstring."""

    def at(self, ctx: Any, si: Any, active: Any) -> Any:
        """What evaluates at a surface interaction; `ctx` None stands for radiance."""

    def said(self) -> dict[str, Any]:
        """Its settings, as `to_string` shows them."""

    def changed(self) -> None:
        """A parameter was set from outside."""


def is_radiance(mi: Any, ctx: Any) -> bool:
    return ctx is None or bool(ctx.mode == mi.TransportMode.Radiance)


def whole(props: Any, name: str, default: int, low: int, high: int) -> int:
    """A whole number among the plugin's parameters.

    Raises:
        MaterialError: something else, or a number out of range.
    """
    value = props.get(name, default)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high or int(value) != value:
        where = f"{props.id() or 'layered'}.{name}"
        raise MaterialError(f"found {value!r}; allowed: a whole number from {low} to {high}", where=where)
    return int(value)


def truth(props: Any, name: str) -> bool:
    """A truth value among the plugin's parameters, false where it is not given.

    Raises:
        MaterialError: something else.
    """
    value = props.get(name, False)
    if not isinstance(value, bool):
        where = f"{props.id() or 'layered'}.{name}"
        raise MaterialError(f"found {value!r}; allowed: true or false", where=where)
    return value


class Walk:
    """Random walks: a hash of (wi, wo, uv, time, seed) makes their random numbers, since Mitsuba gives `eval` none."""

    OPTIONS = ("samples", "seed", "max_depth")

    def __init__(self, mi: Any, stack: Any, surface: Surface, props: Any) -> None:
        self.mi, self.stack, self.surface = mi, stack, surface
        self.samples = whole(props, "samples", 1, 1, 2**31 - 1)
        self.seed = whole(props, "seed", 0, 0, 2**32 - 1)
        limit = whole(props, "max_depth", -1, -1, 2**31 - 1)
        self.max_depth = None if limit < 0 else limit
        # Opaque, as the parameters are: another seed compiles nothing anew.
        self._noise = dr.opaque(mi.UInt32, self.seed)

    def at(self, ctx: Any, si: Any, active: Any) -> WalkHere:
        mi = self.mi
        coloured = self.surface.coloured and "mono" not in mi.variant()
        spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
        bound = bind_live(self.stack, self.surface.at(si, active), self.surface.fixed(), unrolled=True)
        core = WalkCore(bound, spectrum, is_radiance(mi, ctx), self.max_depth)
        return WalkHere(core, (si.uv.x, si.uv.y, si.time), self._noise, self.samples)

    def said(self) -> dict[str, Any]:
        depth = -1 if self.max_depth is None else self.max_depth
        return {"method": "walk", "samples": self.samples, "seed": self.seed, "max_depth": depth}

    def changed(self) -> None:
        """Nothing is kept that could be out of date."""


class WalkHere:
    """The walk at a surface interaction.

    Args:
        core: the bound walk.
        key: what identifies the evaluation besides its directions.
        noise, samples: as the plugin was told.
    """

    def __init__(self, core: WalkCore, key: tuple[Any, ...], noise: Any, samples: int) -> None:
        self.core, self.key, self.noise, self.samples = core, key, noise, samples
        self.stack = core.stack
        self.pdf, self.sample, self.scale = core.pdf, core.sample, core.scale

    def eval(self, wi: Any, wo: Any) -> Any:
        return self.core.eval(wi, wo, self.key, self.noise, 0, self.samples)

    def albedo(self, wi: Any) -> Any:
        up, down, *_ = self.core.flux(wi, self.key, self.noise, 0, max(self.samples, 4))
        return dr.select(wi.z > 0, up, down)
