"""Energies of clear stacks, exact but for the number of angles: for stacks that are the same for all lanes.

Light that was reflected totally at one of two interfaces and not at the other is no lobe, and what the recursion says
of it is off by some per cent. Energies need no azimuth, so where they are the same for all lanes, they are
followed direction by direction instead (`nodes`, `kernels`), by the adding equations with matrices. The lobe of an
interface is what the layers down to it reflect, less what those above do. What all this says is kept as
a table over the angle of the light, and takes the place of the recursion's energies; directions and widths stay.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ...adding import Algebra, Slab, add, within
from ...interfaces import BoundConductor, BoundDielectric, Null
from ...optics.vectors import Array, at_least, channels
from ..bound import BoundStack
from . import rows
from .grid import Grid
from .kernels import Kernels, one, still
from .nodes import Nodes

if TYPE_CHECKING:
    from .core import LobesCore
    from .ledger import Place
    from .recursion import Answer

#: cells of the table
CELLS = 224
#: of light that goes round for ever, what is lost at every turn
GONE = 1e-15


def _series(a: Any, b: Any, x: Any) -> Any:
    trip = a @ b
    return np.linalg.solve((1 + GONE) * np.eye(trip.shape[-1]) - trip, x)


ALGEBRA = Algebra(operator.matmul, _series)


def follows(stack: BoundStack) -> bool:
    """Whether the energies of a stack are followed: two interfaces that light goes through, some of them rough, all
    alike in all azimuths, and nothing that scatters or is diffuse."""
    inner = [interface.single or interface for interface in stack.interfaces]
    known = all(isinstance(i, (BoundConductor, BoundDielectric, Null)) for i in inner)
    if not known or stack.tilted or any(m is not None and m.scatters for m in stack.media):
        return False
    if any(m is not None and hasattr(m, "albedos") for m in stack.media):
        return False
    pairs = [i.roughness() for i in inner]
    plain = all(x is y or (isinstance(x, float) and x == y) for x, y in pairs)
    rough = not all(i.flat or still(i) for i in stack.interfaces)
    return plain and rough and sum(isinstance(i, BoundDielectric) for i in inner) > 1


class Energies:
    """Tables over the cosine of the light, one for each side that it may come from."""

    def __init__(self, sides: dict[bool, Side]) -> None:
        self._sides = sides

    @classmethod
    def of(cls, core: LobesCore) -> Energies | None:
        """Those of a stack of numbers that are the same for all lanes; None where the recursion is to be asked."""
        stack = core.stack
        if not core.uniform or core.published or core.tilted is not None or not follows(stack):
            return None
        number = core.spectrum
        while dr.depth_v(number) > 1:
            number = dr.value_t(number)
        pile = Pile(stack, dr.float64_array_t(number))
        return cls({above: pile.side(above) for above in core.sides})

    def put(self, answer: Answer, cos: Array, above: bool) -> Answer:
        """The answer of the recursion to light of some cosines, with these energies."""
        side = self._sides[above]
        found = side.at(cos)
        reflected = [
            replace(beam, energy=side.picked(found, beam.layer, beam.energy)) for beam in answer.reflected
        ]
        answer = replace(answer, reflected=reflected)
        if answer.through is None:
            return answer
        whole, straight = (side.picked(found, k, answer.through.energy) for k in (-2, -1))
        if answer.delayed is None:
            return replace(answer, through=replace(answer.through, energy=whole))
        late = replace(answer.delayed, energy=at_least(whole - straight, 0))
        return replace(answer, through=replace(answer.through, energy=straight), delayed=late)

    def left(self, cos: Array, above: bool, like: Array) -> tuple[dict[Place, Array], Array]:
        """What each layer keeps of light of some cosines, and how much of that is lost between facets of the base.

        Args:
            like: a number or colour of the type that the answer has.
        """
        return self._sides[above].left(cos, like)


@dataclass
class Side:
    """What becomes of light from one side.

    Attributes:
        colours: C, 1 where nothing is coloured.
        critical: see `rows`.
        energies: C numbers for every interface, as a lobe; for all that is transmitted; for what was never reflected.
        kept: C numbers for each of the `places`, and for what facets of the base lose.
        places: layers.
    """

    colours: int
    critical: float | None
    energies: Grid
    kept: Grid
    places: list[Place]

    def at(self, cos: Array) -> list[Array]:
        """All `energies`."""
        return self.energies([rows.along(cos, self.critical)], cos)

    def picked(self, found: list[Array], k: int, like: Array) -> Array:
        """Those with number k, as a colour where `like` is one."""
        size = self.colours
        start = (k if k >= 0 else len(found) // size + k) * size
        if not channels(like):
            return found[start]
        return type(like)(*(found[start + (c if size > 1 else 0)] for c in range(channels(like))))

    def left(self, cos: Array, like: Array) -> tuple[dict[Place, Array], Array]:
        """See `Energies.left`."""
        found = self.kept([rows.along(cos, self.critical)], cos)
        parts = [self.picked(found, k, like) for k in range(len(self.places) + 1)]
        return dict(zip(self.places, parts, strict=False)), parts[-1]


class Pile:
    """The layers of a stack as matrices.

    Args:
        stack: of numbers that are the same for all lanes.
        number: double precision, of a vectorised backend.
    """

    def __init__(self, stack: BoundStack, number: Any) -> None:
        self.stack = stack
        self.nodes = Nodes(
            [one(index) for index in stack.indices[: len(stack.interfaces) + (not stack.opaque)]]
        )
        self.kernels = Kernels(self.nodes, number)
        self.layers: list[tuple[Place, Slab]] = []
        for k, interface in enumerate(stack.interfaces):
            self.layers.append(((False, k), self.kernels.slab(interface, k)))
            medium = stack.media[k + 1]
            if medium is not None:
                self.layers.append(((True, k + 1), self.kernels.medium(medium, k + 1)))

    def side(self, above: bool) -> Side:
        """What becomes of light from one side."""
        count = len(self.stack.interfaces)
        first = 0 if above else count - 1
        critical = rows.critical([one(n) for n in self.stack.indices], self.stack.opaque, above)
        cos = rows.cosines(CELLS + 1, critical)
        layers = self.layers if above else [(place, s.turned_over()) for place, s in reversed(self.layers)]
        r, t = self.kernels.sent(self.stack.interfaces[first], first, cos, above)
        whole = layers[0][1]._replace(r_top=r, t_down=t)
        pile = [whole, *(slab for _, slab in layers[1:])]
        before = whole.r_top.sum(axis=1)
        energies = {first: before}
        straight = t
        for (medium, number), slab in layers[1:]:
            whole, straight = add(whole, slab, ALGEBRA), slab.t_down @ straight
            if not medium:
                after = whole.r_top.sum(axis=1)
                energies[number], before = after - before, after
        through = [whole.t_down.sum(axis=1), straight.sum(axis=1)]
        source = np.eye(len(cos))[None]
        lights = within(pile, source, ALGEBRA)
        down, up = ([light.sum(axis=1) for light in some] for some in lights)
        up.append(0 * up[0])
        kept = [down[k] + up[k + 1] - up[k] - down[k + 1] for k in range(len(pile))]
        kept.append(self._shadowed(lights[0]))
        every = [energies[k] for k in range(count)] + through
        size = max(len(e) for e in [*every, *kept])
        tables = [
            Grid(np.concatenate([np.broadcast_to(e, (size, len(cos))) for e in some]).T)
            for some in (every, kept)
        ]
        return Side(size, critical, tables[0], tables[1], [place for place, _ in layers])

    def _shadowed(self, down: list[np.ndarray]) -> np.ndarray:
        """(C, M) what facets of the base reflect and others keep."""
        base: Any = self.stack.interfaces[-1]
        if not base.opaque or base.single is not None or still(base):
            return np.zeros((1, down[0].shape[-1]))
        region = len(self.stack.interfaces) - 1
        white = self.kernels.white(base, region, self.nodes.cosines(region))
        sent = self.layers[-1][1].r_top.sum(axis=1) * (1 / white - 1)
        return np.asarray((sent[:, None] @ down[-2])[:, 0])
