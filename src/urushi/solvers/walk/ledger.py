"""The ledger of the walk: what a path loses at every event is counted where it is lost.

A path carries all light that is left. At each event its weight says what goes on, in the mean; the rest is what the
medium or the interface kept. A medium is charged the expected value of a whole flight, whether the path collides or
crosses: no chance decides. Roulette ends paths and makes the others heavier, so the sum is 1 in the mean only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from urushi.errors import UrushiError

from ...interfaces import BoundDiffuse, Scatter
from ...media import inverse_cosine
from ...media.homogeneous import Flight
from ...optics.vectors import Array, Vector
from ..arrays import LANES, NONE, fill
from ..bound import BoundStack
from ..ledger import Errors, Ledger, coloured, filed, owners
from .core import WalkCore

if TYPE_CHECKING:
    from .result import WalkBSDF


class Tally:
    """Where the losses of a path are counted, one place for each layer that may have any.

    Args:
        stack: bound, without derivatives.
        interfaces, media: which layer of the description each is (`urushi.solvers.ledger.owners`).
    """

    def __init__(self, stack: BoundStack, interfaces: list[int | None], media: list[int | None]) -> None:
        self.stack = stack
        self.media: dict[int, int] = {}
        self.absorbing: dict[int, int] = {}
        self.losing: dict[int, int] = {}
        #: (whether it is lost between facets, layer) of every place
        self.places: list[tuple[bool, int]] = []
        for k, layer in enumerate(interfaces):
            if layer is not None and stack.interfaces[k].opaque:
                self.absorbing[k] = self._place(False, layer)
            interface = stack.interfaces[k]
            if layer is not None and interface.delta is not True and not isinstance(interface, BoundDiffuse):
                self.losing[k] = self._place(True, layer)
        for region, layer in enumerate(media):
            if layer is not None:
                self.media[region] = self._place(False, layer)
        #: how many values a sample has: what leaves above and below, every place, and the sum of all
        self.size = len(self.places) + 3

    def _place(self, lost: bool, layer: int) -> int:
        self.places.append((lost, layer))
        return len(self.places) - 1

    def entered(self, spectrum: Any, k: int, w: Vector, back: Scatter, on: Scatter, here: Any) -> list[Array]:
        """Counts that begin with what interface k kept of the light from outside, seen in its own frame."""
        state: dict[str, Any] = {"counts": [spectrum(0) + 0 * w.x for _ in self.places], "throughput": 1.0}
        opaque = self.stack.interfaces[k].opaque
        event = replace(back, weight=dr.select(back.o.z > 0, back.weight, 0))
        self.met(state, k, w, event, None if opaque else on, here)
        return [spectrum(value) for value in state["counts"]]

    def flown(self, s: Any, region: int, here: Any, flight: Flight | None = None) -> None:
        """Charge the medium of a region for the whole flight ahead of the lanes `here`; None where none collides."""
        medium, d = self.stack.media[region], s["d"]
        assert medium is not None
        ahead = dr.select(d.z < 0, 1 - s["t"], s["t"])
        gone = 1 - medium.transmittance(ahead, inverse_cosine(d.z))
        kept = gone if flight is None else medium.absorbed(gone, flight)
        self._count(s, self.media[region], s["throughput"] * kept, here)

    def met(self, s: Any, k: int, w: Vector, event: Scatter, out: Scatter | None, here: Any) -> None:
        """Charge interface k for what it did not give back of the lanes `here`.

        Args:
            event: what goes on, by all that the interface does; or by reflection only, with `out`.
            out: what gets out of the stack.
        """
        missing = 1 - event.weight
        if out is not None:
            missing = missing - dr.select(out.o.z < 0, out.weight, 0)
        if k in self.absorbing:
            taken = self.stack.interfaces[k].absorbs(w, event)
            self._count(s, self.absorbing[k], s["throughput"] * (missing if taken is None else taken), here)
            missing = None if taken is None else missing - taken
        if k in self.losing and missing is not None:
            self._count(s, self.losing[k], s["throughput"] * missing, here)

    def _count(self, s: Any, place: int, value: Array, here: Any) -> None:
        s["counts"][place] = s["counts"][place] + dr.select(here, value, 0)


def counted(bsdf: WalkBSDF, wi: np.ndarray, with_error: bool) -> Ledger:
    """The ledger of a walk.

    Args:
        wi: (N, 3) directions, checked.
        with_error: whether to give standard errors.
    """
    if bsdf.max_depth is not None:
        raise UrushiError(
            f"max_depth: found {bsdf.max_depth}; allowed for a ledger: None, since light that is cut off ends nowhere"
        )
    interfaces, media = owners(bsdf.stack)
    mean, error, tally = _moments(bsdf, wi, interfaces, media)
    above = wi[:, 2:] > 0
    reflected, transmitted = np.where(above, mean[0], mean[1]), np.where(above, mean[1], mean[0])
    found = _filed(bsdf, wi, tally, mean, (reflected, transmitted))
    if not with_error:
        return found
    own = np.where(above, error[0], error[1]), np.where(above, error[1], error[0])
    spread = _filed(bsdf, wi, tally, error, own)
    errors = Errors(spread.reflected, spread.transmitted, spread.absorbed, spread.lost, error[-1])
    return replace(found, error=errors)


def _moments(
    bsdf: WalkBSDF, wi: np.ndarray, interfaces: list[int | None], media: list[int | None]
) -> tuple[list[np.ndarray], list[np.ndarray], Tally]:
    """Means and standard errors (N, C) of all that one sample counts, by the very paths of `reflectance`."""
    still = bsdf._core(bsdf._module)[0].stack
    tally = Tally(still.still or still, interfaces, media)

    def run(core: WalkCore, lanes: tuple[Any, ...], block: Any) -> tuple[Any, ...]:
        first, count = bsdf.block(block, blocks)
        stack = core.stack.still or core.stack
        own = Tally(stack, interfaces, media)  # of numbers that may be those of these lanes
        return replace(core, stack=stack).flux(lanes[0], (), bsdf._uint(bsdf.seed), first, count, own)

    blocks, share = bsdf.blocks()
    results: list[np.ndarray] = []
    rows, step = wi if len(wi) else NONE, max(LANES // blocks, 1)
    for start in range(0, len(rows), step):
        out = bsdf._launch(run, (rows,), start, min(start + step, len(rows)), blocks)
        moments = [np.einsum("rb...,b->r...", x, share, optimize=False) for x in out]
        mean, square = moments[: tally.size], moments[tally.size :]
        spread = [np.maximum(b - np.square(a), 0) for a, b in zip(mean, square, strict=True)]
        fill(results, [*mean, *(np.sqrt(x / max(bsdf.samples - 1, 1)) for x in spread)], len(rows), start)
    found = [coloured(x[: len(wi)]) for x in results]
    return found[: tally.size], found[tally.size :], tally


def _filed(
    bsdf: WalkBSDF,
    wi: np.ndarray,
    tally: Tally,
    values: list[np.ndarray],
    leaving: tuple[np.ndarray, np.ndarray],
) -> Ledger:
    """The values of all places, which come after the first two, by layer."""
    absorbed, lost = (
        {layer: values[2 + j] for j, (gone, layer) in enumerate(tally.places) if gone == wanted}
        for wanted in (False, True)
    )
    return filed(bsdf.stack, wi, leaving, absorbed, lost)
