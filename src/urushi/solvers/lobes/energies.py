"""Energies of clear stacks, exact but for the number of angles: for stacks that are the same for all lanes.

Light that was reflected totally at one of two interfaces and not at the other is no lobe, and what the recursion says
of it is off by some per cent. Energies need no azimuth, so where they are the same for all lanes, they are
followed direction by direction instead (`nodes`, `kernels`), by the adding equations with matrices. The lobe of an
interface is what the layers down to it reflect, less what those above do. What all this says is kept as
a table over the angle of the light, and takes the place of the recursion's energies; directions and widths stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ...adding import Slab, add, within
from ...interfaces import BoundConductor, BoundDielectric, BoundDiffuse, Null
from ...optics.vectors import Array, Vector, at_least, channels, is_live
from ..arrays import backend_module
from ..bound import BoundStack
from . import rows
from .azimuths import Azimuths
from .grid import Grid
from .kernels import ALGEBRA, Kernels, Key, brushed, numbers, still, values
from .moments import is_zero
from .nodes import Nodes

if TYPE_CHECKING:
    from .core import LobesCore
    from .ledger import Place
    from .recursion import Answer, Beam

#: cells of the table, and where azimuths count
CELLS, COARSE = 224, 96
#: relative step of derivatives, and where numbers end
STEP, STEPS = 5e-3, {"alpha": 5e-2, "across": 5e-2, "turn": 5e-2}
ROUGH = 1e-4, 1.0
LIMITS = {
    "alpha": ROUGH,
    "across": ROUGH,
    "turn": (-np.inf, np.inf),
    "albedo": (0.0, 1.0),
    "g": (-0.999, 0.999),
    "reflectance": (0.0, 1.0),
}
#: less than this that is scattered is not followed
FAINT = 1e-6


def follows(stack: BoundStack) -> bool:
    """Whether the energies of a stack are followed: two interfaces that light goes through, or particles, and something
    that widens it; no diffuse base of facets. One interface is enough if it is not alike in all azimuths."""
    inner = [interface.single or interface for interface in stack.interfaces]
    known = BoundConductor, BoundDielectric, BoundDiffuse, Null
    if stack.tilted or not all(isinstance(i, known) for i in inner):
        return False
    media = [m for m in stack.media if m is not None]
    hazy = any(m.scatters for m in media)
    rough = hazy or not all(i.flat or still(i) for i in stack.interfaces if not isinstance(i, BoundDiffuse))
    turned = any(brushed(i) for i in inner)
    return rough and (hazy or turned or sum(isinstance(i, BoundDielectric) for i in inner) > 1)


class Energies:
    """Tables over the cosine of the light, one for each side that it may come from.

    Args:
        sides: by whether the light comes from above.
        live: numbers that derivatives are known in.
    """

    def __init__(self, sides: dict[bool, Side], live: list[Key]) -> None:
        self._sides, self._live = sides, live

    @classmethod
    def of(cls, core: LobesCore) -> Energies | None:
        """Those of a stack of numbers that are the same for all lanes; None where the recursion is to be asked."""
        stack, number = core.stack, core.spectrum
        if core.published or core.tilted is not None or not follows(stack):
            return None
        if not dr.is_jit_v(number):
            number = backend_module("auto").Float
        while dr.depth_v(number) > 1:
            number = dr.value_t(number)
        all_of = numbers(stack)
        free = any(name == "turn" and is_live(value) for (name, _), value in all_of.items())
        given = {key: values(value) for key, value in all_of.items()}
        pile = Pile(stack, given, dr.float64_array_t(number), free=free)
        live = [key for key, value in all_of.items() if is_live(value) and pile.bends(key)]
        return cls({above: pile.side(above, live) for above in core.sides}, live)

    def knows(self, stack: BoundStack) -> bool:
        """Whether derivatives are known in all numbers that they are wanted in."""
        return all(key in self._live or not is_live(value) for key, value in numbers(stack).items())

    def put(
        self, answer: Answer, still: Answer, stack: BoundStack, wi: Vector, above: bool
    ) -> tuple[Answer, Answer]:
        """Answers of the recursion to light of some directions, with these energies.

        What particles scattered is shared out between lobes and diffuse light as the recursion has it.

        Args:
            answer: all of it; and
            still: what is never scattered by particles; the same if there are none.
            stack: whose they are.
            wi, above: where the light comes from.
        """
        side = self._sides[above]
        found = side.at(wi, [numbers(stack)[key] for key in self._live])
        exact = self._still(still, side, found)
        if not side.hazy:
            return exact, exact
        whole = exact
        for same, k in ((True, -2), (False, -1)):
            beams = list(zip(*(_beams(a, same) for a in (answer, still, exact)), strict=True))
            diffuse, alone, rest = ((a.diffuse if same else a.beyond) for a in (answer, still, exact))
            if not beams and is_zero(diffuse):
                continue
            diffuse = diffuse if is_zero(alone) else at_least(diffuse - alone, 0)
            more = [at_least(one.energy - other.energy, 0) for one, other, _ in beams]
            told = sum(more, diffuse)
            factor = side.picked(found, k, told) / at_least(told, FAINT)
            new = [
                replace(one, energy=known.energy + part * factor)
                for part, (one, _, known) in zip(more, beams, strict=True)
            ]
            diffuse = rest if is_zero(diffuse) else rest + diffuse * factor
            if same:
                whole = replace(whole, reflected=new, diffuse=diffuse)
            else:
                late = new[1] if len(new) > 1 else None
                whole = replace(whole, through=new[0], delayed=late, beyond=diffuse)
        return whole, exact

    def _still(self, answer: Answer, side: Side, found: list[Array]) -> Answer:
        """What is never scattered."""
        reflected = [
            replace(beam, energy=side.picked(found, beam.layer, beam.energy)) for beam in answer.reflected
        ]
        answer = replace(answer, reflected=reflected)
        if not is_zero(answer.diffuse):  # of a base
            k = len(found) // side.colours - 5
            answer = replace(answer, diffuse=side.picked(found, k, answer.diffuse))
        if answer.through is None:
            return answer
        whole, straight = (side.picked(found, k, answer.through.energy) for k in (-4, -3))
        if answer.delayed is None:
            return replace(answer, through=replace(answer.through, energy=whole))
        late = replace(answer.delayed, energy=at_least(whole - straight, 0))
        return replace(answer, through=replace(answer.through, energy=straight), delayed=late)

    def left(self, wi: Vector, above: bool, like: Array) -> tuple[dict[Place, Array], Array]:
        """What each layer keeps of light of some directions, and how much of that is lost between facets of the base.

        Args:
            like: a number or colour of the type that the answer has.
        """
        return self._sides[above].left(wi, like)


@dataclass
class Side:
    """What becomes of light from one side.

    Attributes:
        colours: C, 1 where nothing is coloured.
        critical: see `rows`.
        energies: C numbers for every interface, as a lobe; for all that is transmitted; for what was never reflected;
            all of what is not scattered; and for what is, on this side and beyond.
        slopes: their derivatives in live numbers.
        kept: C numbers for each of the `places`, and for what facets of the base lose.
        places: layers.
        hazy: whether anything scatters.
        azimuths: all numbers are so many, beside one another: what they have of every harmonic.
    """

    colours: int
    critical: float | None
    energies: Grid
    slopes: list[Grid]
    kept: Grid
    places: list[Place]
    hazy: bool
    azimuths: Azimuths

    def _read(self, tables: list[Grid], wi: Vector) -> list[list[Array]]:
        cos = dr.abs(wi.z)
        places = [rows.along(cos, self.critical)]
        harmonics = self.azimuths.at(wi.x, wi.y)
        found = []
        for table in tables:
            values = table(places, cos)
            size = len(values) // self.azimuths.count
            for j, harmonic in enumerate(harmonics, 1):
                more = values[j * size : (j + 1) * size]
                values[:size] = [dr.fma(harmonic, b, a) for a, b in zip(values[:size], more, strict=True)]
            found.append(values[:size])
        return found

    def at(self, wi: Vector, live: list[Array]) -> list[Array]:
        """All `energies`, with derivatives in these numbers."""
        found, *slopes = self._read([self.energies, *self.slopes], wi)
        for number, more in zip(live, slopes, strict=True):
            parts = [number[c] for c in range(channels(number))] if channels(number) else [number]
            parts = [part - dr.detach(part) for part in parts]
            found = [
                dr.fma(s, parts[n % self.colours % len(parts)], e)
                for n, (e, s) in enumerate(zip(found, more, strict=True))
            ]
        return found

    def picked(self, found: list[Array], k: int, like: Array) -> Array:
        """Those with number k, as a colour where `like` is one."""
        size = self.colours
        start = (k if k >= 0 else len(found) // size + k) * size
        if not channels(like):
            return found[start]
        return type(like)(*(found[start + (c if size > 1 else 0)] for c in range(channels(like))))

    def left(self, wi: Vector, like: Array) -> tuple[dict[Place, Array], Array]:
        """See `Energies.left`."""
        (found,) = self._read([self.kept], wi)
        parts = [self.picked(found, k, like) for k in range(len(self.places) + 1)]
        return dict(zip(self.places, parts, strict=False)), parts[-1]


class Pile:
    """The layers of a stack as matrices.

    Args:
        stack: its structure.
        given: its numbers (C,).
        number: double precision, of a vectorised backend.
        base: a pile to take layers from whose numbers are the same, and its nodes; None for none.
        free: whether axes of interfaces may turn.
    """

    def __init__(
        self,
        stack: BoundStack,
        given: dict[Key, np.ndarray],
        number: Any,
        base: Pile | None = None,
        free: bool = False,
    ) -> None:
        self.stack, self.given, self.number = stack, given, number
        regions = sum(name == "index" for name, _ in given)
        self.nodes: Nodes = (
            base.nodes if base else Nodes([float(given["index", r][0]) for r in range(regions)])
        )
        turns = [float(value[0]) for (name, _), value in given.items() if name == "turn"]
        self.azimuths: Azimuths = base.azimuths if base else Azimuths(turns, free)
        self.kernels = Kernels(stack, given, self.nodes, self.azimuths, number)
        self.hazy = any(medium is not None and medium.scatters for medium in stack.media)
        changed = {key for key in given if base is not None and given[key] is not base.given[key]}
        known: dict[Place, tuple[Slab, Slab]] = {}
        if base is not None:
            known = {place: (clear, hazy) for place, clear, hazy in base.layers}
        #: place, as it is to light that is never scattered, and to all
        self.layers: list[tuple[Place, Slab, Slab]] = []
        for k in range(len(stack.interfaces)):
            own = "alpha", "across", "turn", "eta", "k", "reflectance", "index"
            of = {(name, k) for name in own} | {("index", k + 1)}
            if base is None or changed & of:
                slab = self.kernels.slab(k)
                known[False, k] = slab, slab
            self.layers.append(((False, k), *known[False, k]))
            medium = stack.media[k + 1]
            if medium is None:
                continue
            if base is None or changed & {(name, k + 1) for name in ("depth", "albedo", "g")}:
                clear = self.kernels.medium(k + 1, False)
                known[True, k + 1] = clear, self.kernels.medium(k + 1, True) if medium.scatters else clear
            self.layers.append(((True, k + 1), *known[True, k + 1]))

    def bends(self, key: Key) -> bool:
        """Whether energies depend on a number: not on the roughness of what is smooth or invisible."""
        return key[0] not in ("alpha", "across", "turn") or not still(self.stack.interfaces[key[1]])

    def side(self, above: bool, live: list[Key]) -> Side:
        """What becomes of light from one side, with derivatives in some numbers."""
        regions = sum(name == "index" for name, _ in self.given)
        indices = [float(self.given["index", r][0]) for r in range(regions)]
        critical = rows.critical(indices, above)
        cos = rows.cosines((CELLS if self.azimuths.count == 1 else COARSE) + 1, critical)
        energies, kept = self._followed(cos, above)
        slopes = []
        for key in live:
            value = self.given[key]
            low, high = LIMITS.get(key[0], (0.0, np.inf))
            step = STEPS.get(key[0], STEP) * np.maximum(np.abs(value), 0.1)
            ends = np.maximum(value - step, low), np.minimum(value + step, high)
            less, more = (
                Pile(self.stack, {**self.given, key: end}, self.number, self)._followed(cos, above)[0]
                for end in ends
            )
            slopes.append((more - less) / (ends[1] - ends[0])[:, None])
        size = max(len(kept[0]), len(energies[0]))
        many = len(cos) * self.azimuths.count
        grids = []
        for x in (energies, *slopes, kept):
            parts = np.broadcast_to(x, (len(x), size, many)).reshape(len(x), size, -1, len(cos))
            grids.append(Grid(np.transpose(parts, (3, 2, 0, 1)).reshape(len(cos), -1)))
        places = [place for place, *_ in (self.layers if above else reversed(self.layers))]
        return Side(size, critical, grids[0], grids[1:-1], grids[-1], places, self.hazy, self.azimuths)

    def _followed(self, cos: np.ndarray, above: bool) -> tuple[np.ndarray, np.ndarray]:
        """(K + 4, C, H N), (L + 1, C, H N): `Side.energies` and `Side.kept`, for light of some cosines (N,), as
        harmonics of its azimuth."""
        count = len(self.stack.interfaces)
        first = 0 if above else count - 1
        total = self.azimuths.energy
        r, t = self.kernels.sent(first, cos, above)
        layers = self.layers
        if not above:
            layers = [(place, *(s.turned_over() for s in slabs)) for place, *slabs in reversed(layers)]
        entry = layers[0][1]._replace(r_top=r, t_down=t)
        whole, straight, before = entry, t, total(r)
        energies = {first: before}
        for (medium, number), slab, _ in layers[1:]:
            whole, straight = add(whole, slab, ALGEBRA), slab.t_down @ straight
            if not medium:
                after = total(whole.r_top)
                energies[number], before = after - before, after
        through = total(whole.t_down)
        pile = [entry, *(slab for _, _, slab in layers[1:])]
        lights = within(pile, np.eye(r.shape[2])[None], ALGEBRA)
        down, up = ([total(light) for light in some] for some in lights)
        down[0] = lights[0][0].sum(axis=1)
        up.append(0 * up[0])
        kept = [down[k] + up[k + 1] - up[k] - down[k + 1] for k in range(len(pile))]
        kept.append(self._shadowed(lights[0], pile[-1].r_top, cos))
        scattered = [np.maximum(up[0] - before, 0), np.maximum(down[-1] - through, 0)]
        every = [energies[k] for k in range(count)] + [through, total(straight), *scattered]
        size = max(len(e) for e in [*every, *kept])
        found = [np.stack([np.broadcast_to(e, (size, r.shape[2])) for e in some]) for some in (every, kept)]
        return self.azimuths.told(found[0]), self.azimuths.told(found[1])

    def _shadowed(self, down: list[np.ndarray], sent: np.ndarray, cos: np.ndarray) -> np.ndarray:
        """(C, M) what facets of the base reflect and others keep.

        Args:
            down: light above each layer, and below all.
            sent: what the base reflects.
            cos: (M,) of the light outside.
        """
        base = self.stack.interfaces[-1]
        if not isinstance(base, BoundConductor) or still(base):  # or nothing is lost
            return np.zeros((1, down[0].shape[-1]))
        k = len(self.stack.interfaces) - 1
        if len(self.layers) > 1:
            cos = self.nodes.cosines(k)
            sent = sent if self.azimuths.count == 1 else self.kernels.sent(k, cos, True)[0]
        lost = self.azimuths.energy(sent) * (1 / self.kernels.white(k, cos) - 1)
        lost = self.azimuths.told(lost) if len(self.layers) > 1 else lost
        return np.asarray((lost[:, None] @ down[-2])[:, 0])


def _beams(answer: Answer, same: bool) -> list[Beam]:
    """On the side of the light, or beyond."""
    beams = answer.reflected if same else [answer.through, answer.delayed]
    return [beam for beam in beams if beam is not None]
