"""Adding in the plugin `layered`: solved when the scene is loaded, then looked up.

What is textured is solved at a few values over its range and interpolated (`urushi.solvers.adding.corners`). The
solutions of the last materials are kept, by what they are made of: a scene that is loaded again solves nothing.
"""

from __future__ import annotations

import importlib
import itertools
from collections import OrderedDict
from typing import Any

import drjit as dr
import numpy as np

from urushi.errors import MaterialError, UnsupportedStack, UrushiError
from urushi.optics.vectors import mean
from urushi.solvers import SOLVERS
from urushi.solvers.adding import MOST_ORDERS, media_method, reasons_against
from urushi.solvers.adding.build import bind_numbers
from urushi.solvers.adding.core import AddingCore, Prepared
from urushi.solvers.adding.corners import Corners, hats
from urushi.solvers.adding.whole import solution
from urushi.solvers.bound import bind
from urushi.solvers.numbers import is_vector, replaced
from urushi.stack import Stack

from .methods import is_radiance, whole
from .surface import Surface

#: solutions that are kept, as many as fit in so many bytes, and corners that one material may have
KEPT, BYTES, MOST_CORNERS = 256, 1 << 30, 81
#: wavelengths of spectral variants, a multiple of 3
WAVELENGTHS = 18

_solved: OrderedDict[tuple[Any, ...], Prepared] = OrderedDict()


class Adding:
    """Tables, evaluated with the closed forms of the place added; no derivatives.

    Besides the layers it takes `accuracy` (1e-3), `nodes` and `orders` (as many as that needs), `media` ("ordinates"),
    and `corners`, the values that a textured parameter is solved for (5).
    """

    OPTIONS = ("accuracy", "nodes", "orders", "media", "corners")

    def __init__(self, mi: Any, stack: Stack, surface: Surface, props: Any) -> None:
        self.mi, self.stack, self.surface = mi, stack, surface
        where = props.id() or "layered"
        self.accuracy = props.get("accuracy", 1e-3)
        if not (isinstance(self.accuracy, (int, float)) and 1e-9 <= self.accuracy <= 0.5):
            raise MaterialError(
                f"found {self.accuracy!r}; allowed: a number from 1e-9 to 0.5", where=f"{where}.accuracy"
            )
        self.nodes = whole(props, "nodes", 0, 0, 1000)
        self.orders = whole(props, "orders", 0, 0, MOST_ORDERS)
        try:
            self.media = media_method(props.get("media", None))
        except UrushiError as error:
            raise MaterialError(str(error).removeprefix("media: "), where=f"{where}.media") from None
        self.corners = whole(props, "corners", 5, 2, 33)
        tilted = [name for name in surface.parameters if is_vector(name)]
        if tilted:
            reasons = [f"{name} is given, and tilted interfaces mix azimuthal orders" for name in tilted]
            raise UnsupportedStack("adding", reasons, [name for name in SOLVERS if name != "adding"])
        self._solve()

    # --- solving -----------------------------------------------------------------------------------------------

    def _solve(self) -> None:
        mi = self.mi
        self.samples = self._samples()
        self.channels = _wavelengths(mi) if "spectral" in mi.variant() and self.surface.coloured else None
        fixed, values = self.surface.fixed(), self._values()
        bound = bind(self.stack, self.surface.at(dr.zeros(mi.SurfaceInteraction3f), True), fixed)
        module = importlib.import_module("drjit.scalar" if mi.Float is float else mi.Float.__module__)
        coloured = self.surface.coloured and "mono" not in mi.variant()
        spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
        self._cores: dict[bool, list[AddingCore]] = {True: [], False: []}
        for corner in itertools.product(*self.samples.values()):
            given = dict(zip(self.samples, corner, strict=True))
            for some in values:
                stack = replaced(self.stack, some | given)
                reasons = reasons_against(stack)
                if reasons:
                    raise UnsupportedStack("adding", reasons, [name for name in SOLVERS if name != "adding"])
                prepared = self._prepared(stack)
                for radiance, cores in self._cores.items():
                    cores.append(
                        AddingCore(prepared, bound, spectrum, module, "double" in mi.variant(), radiance)
                    )

    def _values(self) -> list[dict[str, Any]]:
        """The constant parameters: of all channels, or of three wavelengths after another."""
        mi = self.mi
        si = dr.zeros(mi.SurfaceInteraction3f)
        names = [name for name in self.surface.parameters if name not in self.samples]
        if self.channels is None:
            here = self.surface.at(si, True)
            return [{name: _plain(here[name]) for name in names}]
        found: dict[str, list[float]] = {name: [] for name in names}
        wavelength = type(si.wavelengths)
        size = dr.size_v(wavelength)
        for start in range(0, len(self.channels), size):
            some = np.resize(self.channels[start : start + size], size)
            si.wavelengths = wavelength(*map(float, some))
            here = self.surface.at(si, True)
            for name in names:
                value = _plain(here[name])
                found[name] += value if isinstance(value, tuple) else [value] * size
        return [
            {name: tuple(all_[k : k + 3]) if len(set(all_)) > 1 else all_[0] for name, all_ in found.items()}
            for k in range(0, len(self.channels), 3)
        ]

    def _prepared(self, stack: Stack) -> Prepared:
        nameless = stack.replace({"name": "", "description": ""})
        key = repr(nameless), self.accuracy, self.nodes, self.orders, self.media
        if key not in _solved:
            bound, _ = bind_numbers(stack)
            orders = self.orders or None
            found = solution(stack, self.accuracy, self.nodes or None, orders=orders, media=self.media)
            _solved[key] = Prepared(found, bound)
            while len(_solved) > KEPT or (len(_solved) > 1 and sum(map(_bytes, _solved.values())) > BYTES):
                _solved.popitem(last=False)
        _solved.move_to_end(key)
        return _solved[key]

    def _samples(self) -> dict[str, list[float]]:
        """The values that each textured parameter is solved for."""
        found: dict[str, list[float]] = {}
        for name, parameter in self.surface.parameters.items():
            if isinstance(parameter, tuple):
                if any(p.varies for p in parameter):
                    raise UnsupportedStack("adding", [f"{name} is anisotropic"], ["walk"])
            elif parameter.varies:
                if name.endswith(".ior"):
                    raise UnsupportedStack(
                        "adding",
                        [f"{name} is a texture, and the nodes are for one index: use one number"],
                        ["walk"],
                    )
                low, high = parameter.extent()
                found[name] = (
                    [low]
                    if high - low < 1e-6 * max(high, 1e-6)
                    else np.linspace(low, high, self.corners).tolist()
                )
        if self.corners ** len(found) > MOST_CORNERS:
            raise UnsupportedStack(
                "adding",
                [
                    f"{', '.join(found)} are textures: {self.corners} values of each make {self.corners ** len(found)} "
                    f"stacks to solve, and allowed are {MOST_CORNERS}: ask for fewer corners"
                ],
                ["walk"],
            )
        return found

    # --- the method --------------------------------------------------------------------------------------------

    def at(self, ctx: Any, si: Any, active: Any) -> Any:
        values = self.surface.at(si, active)
        cores = self._cores[is_radiance(self.mi, ctx)]
        shares: list[Any] = [1.0]
        for name, samples in self.samples.items():
            each = hats(values[name], samples) if len(samples) > 1 else [1.0]
            shares = [w * h for w in shares for h in each]
        weights, chances = [], []
        if self.channels is None:
            for core, share in zip(cores, shares, strict=True):
                weights.append(self._unit(core, share))
                chances.append(mean(share))
        else:
            spectra = [
                hats(si.wavelengths, self.channels)[k : k + 3] for k in range(0, len(self.channels), 3)
            ]
            for core, (share, spectrum) in zip(cores, itertools.product(shares, spectra), strict=True):
                own = [share * self.mi.UnpolarizedSpectrum(hat) for hat in spectrum]
                weights.append(own if core.colours == 3 else [own[0] + own[1] + own[2]])
                chances.append(mean(own[0] + own[1] + own[2]))
        return Corners(cores, bind(self.stack, values, self.surface.fixed()), weights, chances)

    def _unit(self, core: AddingCore, share: Any) -> list[Any]:
        """Each channel of a core goes to the same channel of the result."""
        if core.colours == 1:
            return [share]
        colour = self.mi.UnpolarizedSpectrum
        return [share * colour(*(float(k == c) for k in range(3))) for c in range(3)]

    def said(self) -> dict[str, Any]:
        nodes = len(self._cores[True][0].solution.grid.s)
        said = {"method": "adding", "accuracy": self.accuracy, "nodes": nodes}
        return said | ({"corners": len(self._cores[True])} if self.samples else {})

    def changed(self) -> None:
        """Another material: solved anew, unless it was before."""
        self._solve()


def _bytes(prepared: Prepared) -> int:
    """What the operators of a solution take; tables made of them are of the same order."""
    parts = prepared.solution.parts.values()
    blocks = {id(block): block for part in parts for block in (*part.blocks, *part.rest)}
    return sum(block.values.nbytes for block in blocks.values())


def _wavelengths(mi: Any) -> list[float]:
    """What a spectral variant is solved for: three at a time, 28 nm apart."""
    return np.linspace(float(mi.MI_CIE_MIN), float(mi.MI_CIE_MAX), WAVELENGTHS).tolist()


def _plain(value: Any) -> Any:
    array = np.array(dr.detach(value), dtype=float).ravel()
    return float(array[0]) if array.size == 1 else tuple(float(v) for v in array)
