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

from urushi.errors import MaterialError, UnsupportedStack
from urushi.solvers import SOLVERS
from urushi.solvers.adding import reasons_against
from urushi.solvers.adding.build import bind_numbers
from urushi.solvers.adding.core import AddingCore, Prepared
from urushi.solvers.adding.corners import Corners, hats
from urushi.solvers.adding.whole import solution
from urushi.solvers.bound import bind
from urushi.solvers.numbers import replaced
from urushi.stack import Stack

from .methods import is_radiance, whole
from .surface import Surface

#: solutions that are kept, and corners that one material may have
KEPT, MOST_CORNERS = 64, 81

_solved: OrderedDict[tuple[Any, ...], Prepared] = OrderedDict()


class Adding:
    """Tables, evaluated with the closed forms of the place added; no derivatives.

    Besides the layers it takes `accuracy` (1e-3), `nodes` (as many as that needs), and `corners`, the values that a
    textured parameter is solved for (5).
    """

    OPTIONS = ("accuracy", "nodes", "corners")

    def __init__(self, mi: Any, stack: Stack, surface: Surface, props: Any) -> None:
        self.mi, self.stack, self.surface = mi, stack, surface
        where = props.id() or "layered"
        self.accuracy = props.get("accuracy", 1e-3)
        if not (isinstance(self.accuracy, (int, float)) and 1e-9 <= self.accuracy <= 0.5):
            raise MaterialError(
                f"found {self.accuracy!r}; allowed: a number from 1e-9 to 0.5", where=f"{where}.accuracy"
            )
        self.nodes = whole(props, "nodes", 0, 0, 1000)
        self.corners = whole(props, "corners", 5, 2, 33)
        self._solve()

    # --- solving -----------------------------------------------------------------------------------------------

    def _solve(self) -> None:
        mi = self.mi
        if "spectral" in mi.variant():
            raise UnsupportedStack(
                "adding",
                ["spectral variants of Mitsuba are not there yet: use an RGB or a monochrome one"],
                ["walk"],
            )
        self.samples = self._samples()
        values = self.surface.at(dr.zeros(mi.SurfaceInteraction3f), True)
        given = {
            name: _plain(value)
            for name, value in values.items()
            if name not in self.samples and name != "exterior"
        }
        module = importlib.import_module(mi.Float.__module__ if mi.Float is not float else "drjit.scalar")
        double = "double" in mi.variant()
        coloured = self.surface.coloured and "mono" not in mi.variant()
        spectrum = mi.UnpolarizedSpectrum if coloured else mi.Float
        self._cores: dict[bool, list[AddingCore]] = {True: [], False: []}
        for corner in itertools.product(*self.samples.values()):
            stack = replaced(self.stack, given | dict(zip(self.samples, corner, strict=True)))
            reasons = reasons_against(stack)
            if reasons:
                raise UnsupportedStack("adding", reasons, [name for name in SOLVERS if name != "adding"])
            prepared = self._prepared(stack)
            bound = bind(self.stack, values, self.surface.fixed())
            for radiance, cores in self._cores.items():
                cores.append(AddingCore(prepared, bound, spectrum, module, double, radiance))

    def _prepared(self, stack: Stack) -> Prepared:
        key = repr(stack.replace({"name": "", "description": ""})), self.accuracy, self.nodes
        if key not in _solved:
            bound, _ = bind_numbers(stack)
            _solved[key] = Prepared.build(solution(stack, self.accuracy, self.nodes or None), bound)
            while len(_solved) > KEPT:
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
        bound = bind(self.stack, values, self.surface.fixed())
        cores = self._cores[is_radiance(self.mi, ctx)]
        weights: list[Any] = [1.0]
        for name, samples in self.samples.items():
            each = hats(values[name], samples) if len(samples) > 1 else [1.0]
            weights = [w * h for w in weights for h in each]
        return Corners(cores, bound, weights)

    def said(self) -> dict[str, Any]:
        nodes = len(self._cores[True][0].solution.grid.s)
        said = {"method": "adding", "accuracy": self.accuracy, "nodes": nodes}
        return said | ({"corners": len(self._cores[True])} if self.samples else {})

    def changed(self) -> None:
        """Another material: solved anew, unless it was before."""
        self._solve()


def _plain(value: Any) -> Any:
    array = np.array(dr.detach(value), dtype=float).ravel()
    return float(array[0]) if array.size == 1 else tuple(float(v) for v in array)
