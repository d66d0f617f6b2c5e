"""What the solver hands to the BSDF: the four operators of a whole stack, as light outside sees them.

Light comes from above or from below and leaves above or below: four parts, of which those of an opaque stack are but
one. Each is a flux operator (see `operator`): on nodes i -> o and for azimuthal order m

    A_m[o, i] = w_o integral of k(o <- i, phi) cos(m phi) dphi,      k = f |cos theta_o| without the squared index ratio

See theory (basis.3). High orders are 0 towards normal incidence, and nodes are ordered from there: orders are kept in
blocks, each on the nodes from `first` on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .basis import Grid
from .peak import Peak
from .retro import Retro


@dataclass(frozen=True)
class Block:
    """Some azimuthal orders of a part.

    Attributes:
        orders: which.
        first: the nodes before this one have nothing of these orders, on either side.
        values: (C, len(orders), n_out - first, n_in - first).
    """

    orders: range
    first: int
    values: np.ndarray


@dataclass(frozen=True)
class Part:
    """Light that comes from one side and leaves on one side.

    Attributes:
        from_above, to_above: which sides.
        delta: (C, n) what stays on its node: the mirror direction or Snell's direction; None for nothing.
        blocks: everything else, less what the BSDF adds in closed form (`Solution.closed_form`), by ascending orders.
        rest: the blocks of that closed form on the nodes; with `blocks` they make the whole operator.
    """

    from_above: bool
    to_above: bool
    delta: np.ndarray | None
    blocks: list[Block]
    rest: list[Block] = field(default_factory=list)

    def whole(self) -> list[Block]:
        """The blocks with the closed form put back; orders may be split anew."""
        return [*self.blocks, *self.rest]


@dataclass(frozen=True)
class Solution:
    """A solved stack.

    Attributes:
        grid: the nodes; region 0 is the exterior above, the last one that below.
        parts: by (from_above, to_above).
        closed_form: what `eval` adds exactly: "interface" (one meeting with an outermost interface, where that needs no
            random numbers), "single" (that, and one collision wherever `once` covers it), or None.
        colours: number of channels C.
        diagnostics: sizes, time, estimated error, reasons.
        forward: by region, the share of the light scattered there that the solver counted as not scattered (delta-M);
            regions without such a share may be missing.
        terms: by region, the number of terms that the solver took of its phase function; {} where that is not known.
        peaks: by region, the peak that these leave out of light that passes, where `once` covers it; only evaluation
            needs it, and finds it where it is missing.
    """

    grid: Grid
    parts: dict[tuple[bool, bool], Part]
    closed_form: str | None
    colours: int
    diagnostics: dict[str, Any]
    forward: dict[int, float] = field(default_factory=dict)
    terms: dict[int, int] = field(default_factory=dict)
    peaks: dict[int, Peak | Retro] = field(default_factory=dict)

    def twin(self, side: tuple[bool, bool], among: Iterable[tuple[bool, bool]]) -> tuple[bool, bool] | None:
        """The first of some sides that is this one seen from the other end, in a stack that is its own mirror image."""
        one = self.parts[side]
        for other in among:
            if one.blocks is self.parts[other].blocks and one.rest is self.parts[other].rest:
                return other
        return None

    def some(self, channels: Sequence[int] | np.ndarray) -> Solution:
        """The same of some channels, in this order."""
        k = np.asarray(channels)
        seen: dict[int, list[Block]] = {}

        def those(blocks: list[Block]) -> list[Block]:
            # The same list stays the same list: see `twin`.
            if id(blocks) not in seen:
                seen[id(blocks)] = [replace(block, values=block.values[k]) for block in blocks]
            return seen[id(blocks)]

        parts = {
            side: replace(
                part,
                delta=None if part.delta is None else part.delta[k],
                blocks=those(part.blocks),
                rest=those(part.rest),
            )
            for side, part in self.parts.items()
        }
        return replace(self, parts=parts, colours=len(k))
