"""What comes back: how a layer and those above it, through which the light came, treat what goes back and forth.

What has entered through a rough interface is no lobe near the critical angle: some of it is totally reflected, for
ever but for what roughness lets out. So the first return and all later ones have their own numbers, from tables of
light that entered through just such an interface (`tables.round_trip`, `tables.sheet`), not from those of lobes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr

from ...adding import Slab, add
from ...interfaces import BoundConductor, BoundDielectric, Null
from ...optics.vectors import Array, at_least, at_most, mean
from . import tables
from .flow import ALL, FLOWS, NONE, Flow
from .medium import Particles
from .operators import GRAZING, Boundary, Pair
from .width import OURS, Width, capped, mean_roughness, plus

#: what is left from one visit to the next of light trapped between clear interfaces
TRAPPED = 0.9
#: how much of the width that facets add to light which crosses them counts for what the next boundary reflects totally
CROSSED = 0.2


@dataclass
class Step:
    """A layer that the recursion goes through, an interface or the medium below one.

    Attributes:
        cos, width: mean cosine and width of the light above it; no width if that is one direction.
        r, t: reflection and transmission of that light.
    """

    layer: Boundary | Particles
    cos: Array
    width: Width | None
    r: Flow
    t: Flow


class Above(NamedTuple):
    """Layers, for light that one below sends up to them.

    Attributes:
        whole: as one.
        slabs: each, the nearest first.
        nearest: how much of what they reflect, from below, the nearest interface reflects.
        steep: mean cosine of what that sends back down; None if that is as it came.
        width: of what gets out, all that it went through on its way down included; None if that is in one direction.
    """

    whole: Slab
    slabs: list[Slab]
    nearest: Array
    steep: Array | None
    width: Width | None


class Meeting(NamedTuple):
    """A layer and those above it.

    Attributes:
        first, later: (reflection, transmission) of the layer for the light that arrives, and in the mean over all later
            times that it comes by.
        above, above_later: the layers above for what the layer sends back, likewise.
    """

    first: tuple[Flow, Flow]
    later: tuple[Flow, Flow]
    above: Above
    above_later: Above


def meet(steps: list[Step], step: Step, returning: Array, width: Width | None, last: bool) -> Meeting:
    """What an interface and the layers above it send to and fro.

    Args:
        steps: the layers above.
        step: the interface.
        returning: mean cosine of what it reflects.
        width: of that; None if all is in one direction.
        last: whether there is no other interface below.
    """
    boundary = step.layer
    assert isinstance(boundary, Boundary)
    first = later = step.r, step.t
    nearest = _nearest(steps)
    if width is None or nearest is None:
        above = from_below(steps, returning, None if width is None else boundary.reflected)
        return Meeting(first, later, above, above)
    if strays(steps, boundary):
        above = from_below(steps, returning, boundary.reflected, stray=True)
        return Meeting(first, later, above, above)
    upper, entered = nearest
    alpha = mean_roughness(width)
    clear = isinstance(boundary.inner, BoundDielectric)
    back: Pair | None = None
    back_later: tuple[Pair, Array] | None = None
    sheet: list[Pair] = []
    share: Array = 0.0
    if clear:  # it sends back no lobe of a mirror: much of it was reflected totally
        back = upper.turned.beam(returning, alpha)
        if last and all(s.layer is upper or isinstance(s.layer, Particles) for s in steps):
            sheet, share = upper.sheet(entered, boundary), _like_a_sheet(upper, boundary)
            first = _flows(step, _mixed(sheet[0], (step.r.beam, step.t.beam), share))
            back, back_later = _mixed(sheet[2], back, share), (sheet[3], share)
    kept = TRAPPED if clear else mean(step.r.beam)
    above = from_below(steps, returning, boundary.reflected, None, back and (back, 1.0))
    above_later = from_below(steps, returning, boundary.reflected, above.nearest, back_later, kept)
    assert above.steep is not None
    pair = boundary.beam(above.steep, alpha)
    if clear:
        beyond = at_least(boundary.refracted(step.cos), GRAZING)
        _, trapped, _, _ = boundary.turned.round_trip(beyond, mean_roughness(upper.reflected), TRAPPED)
        r, t = (dr.select(boundary.eta < 1, a, b) for a, b in zip(trapped, pair, strict=True))
        pair = _mixed(sheet[1], (r, t), share) if sheet else (r, t)
    return Meeting(first, _flows(step, pair), above, above_later)


def strays(steps: list[Step], boundary: Boundary) -> bool:
    """Whether light that comes back to a metal under several boundaries is followed by its moments.

    Between these it is totally reflected here or there, into all directions that do not get out: it is no lobe.
    """
    if not boundary.mixes or not isinstance(boundary.inner, BoundConductor):
        return False
    clear = not any(isinstance(s.layer, Particles) and s.layer.scatters for s in steps)
    return (
        clear
        and sum(isinstance(s.layer, Boundary) and not isinstance(s.layer.inner, Null) for s in steps) > 1
    )


def from_below(
    steps: list[Step],
    cos: Array,
    width: Width | None,
    again: Array | None = None,
    known: tuple[Pair, Array] | None = None,
    kept: Array = TRAPPED,
    stray: bool = False,
) -> Above:
    """The layers gone through so far, for the light that went through them and is sent back.

    Args:
        cos: mean cosine of what is sent back.
        width: what that has added to its width; None if all is in one direction.
        again: None, or for light that was reflected already and now comes back: how much of it by the nearest
            interface. What was reflected further up gets through the nearest as ever, and is reflected more up there.
        known: of the nearest interface, what is known better than here, and the share that this has.
        kept: what the layer below leaves of light that comes to it again.
        stray: whether what comes back down is no beam, but followed by its moments.
    """
    slabs: list[Slab] = []
    first: Array | None = None
    steep: Array | None = None
    lower: tuple[int, Step] | None = None
    out = broad = width
    whole_sent: Array = 0.0
    passing: Array = 1.0
    media: Array = 1.0
    slanted: list[tuple[int, Step, Array]] = []
    for step in reversed(steps):
        if isinstance(step.layer, Particles):
            r, t = step.layer.layer(cos)
            middle = cos if width is None else tables.mean(cos, mean_roughness(width))
            slanted.append((len(slabs), step, middle))
            slabs.append(Slab(step.r, step.t, r, t))
            through = mean(step.layer.passed(middle))
            passing, media = passing * through, media * through
            if width is not None:
                by = 2 * step.layer.widened(cos)[1]
                out = plus(out, by)
            continue
        boundary, turned = step.layer, step.layer.turned
        if isinstance(boundary.inner, Null):
            slabs.append(Slab(step.r, step.t, NONE, ALL))
            continue
        if width is None:
            r, t = turned.beam(cos, None)
        else:
            below = at_least(boundary.refracted(step.cos), GRAZING)
            factor = OURS.factor(boundary.eta * below / step.cos)
            wide = mean_roughness(width if step.width is None else plus(step.width * (1 / factor), width))
            (r, t), later, down, narrower = boundary.round_trip(step.cos, wide, kept * dr.square(media))
            down_by, up_by = boundary.transmitted(step.cos, below), turned.transmitted(below, step.cos)
            if broad is not width:  # of what gets out, all that crossings add counts
                all_of = mean_roughness(
                    broad if step.width is None else plus(step.width * (1 / factor), broad)
                )
                narrower = boundary.round_trip(step.cos, all_of, kept)[3]
            out = capped(plus(plus(out, down_by) * factor, up_by)) * OURS.factor(narrower)
            # What is totally reflected was the outside of the lobe: the rest is narrower, by medians of GGX.
            out_share = t / (r + t)
            left = OURS.factor(dr.sqrt(out_share / (2 - out_share)))
            inner, broad = width * left, plus(plus(broad * left, down_by) * factor, up_by)
            width = plus(plus(inner, down_by * CROSSED) * factor, up_by * CROSSED)
            if again is not None:
                r, t = _mixed(later, (r, t), again if first is None else 1.0)
            if first is None and known is not None:
                r, t = _mixed(known[0], (r, t), known[1])
            if lower is not None and not stray:
                k, under = lower
                slabs[k] = _steeper(slabs[k], under, down, wide)
            for k, under, middle in slanted:
                slabs[k] = _slanted(under, middle, down, r / (r + t))
            slanted = []
            lower, steep = (len(slabs), step), down if steep is None else steep
        sent = passing * passing * r
        first = sent if first is None else first
        whole_sent, passing = whole_sent + sent, passing * t
        even_r, even_t = turned.even(cos)
        back = Flow(r, 0.0, even_r)
        if stray:
            back = Flow(0.0, boundary.backs(step.cos, wide) * r, even_r)
        slabs.append(Slab(step.r, step.t, back, Flow(t, 0.0, even_t)))
        cos = at_least(turned.refracted(cos), GRAZING)
    whole = Slab(NONE, ALL, NONE, ALL)
    for n, slab in enumerate(reversed(slabs)):
        whole = add(whole, slab, FLOWS) if n else slab
    nearest = 1.0 if first is None else first / at_least(whole_sent + 0 * cos, 1e-12)
    return Above(whole, slabs, nearest, steep, out)


def _slanted(step: Step, middle: Array, down: Array, back: Array) -> Slab:
    """A medium below an interface, from below: what gets out went through it at less of a slant than what comes back.

    Args:
        middle: mean cosine of what is sent up.
        down: of what the interface sends back down, which went up at the same slant.
        back: how much of what comes to the interface that is.
    """
    particles = step.layer
    assert isinstance(particles, Particles)
    down = at_least(at_most(down, middle), GRAZING)
    out = at_most((middle - back * down) / at_least(1 - back, 0.05), 1.0)
    r_top, t_down = particles.layer(down)
    r_bottom, t_up = particles.layer(out)
    beam = dr.square(t_down.beam) / at_least(t_up.beam, 1e-12)
    more = (1 - beam) / at_least(1 - t_down.beam, 1e-6)
    if particles.scatters:
        r_top, t_down = (flow._replace(scattered=flow.scattered * more) for flow in (r_top, t_down))
    return Slab(r_top, t_down._replace(beam=beam), r_bottom, t_up)


def _steeper(slab: Slab, step: Step, cos: Array, alpha: Array) -> Slab:
    """An interface between others, for what one above sends down to it, under the mean cosine `cos`.

    What came up from a thinner side goes down there as it came.
    """
    assert isinstance(step.layer, Boundary)
    pair, denser = step.layer.beam(cos, alpha), step.layer.eta >= 1
    r, t = (dr.select(denser, a, b) for a, b in zip(pair, (step.r.beam, step.t.beam), strict=True))
    r_top, t_down = _flows(step, (r, t))
    return slab._replace(r_top=r_top, t_down=t_down)


def _nearest(steps: list[Step]) -> tuple[Boundary, Array] | None:
    """The nearest interface above that does anything, and the cosine under which light entered through it."""
    for step in reversed(steps):
        if isinstance(step.layer, Boundary) and not isinstance(step.layer.inner, Null):
            return step.layer, step.cos
    return None


def _like_a_sheet(upper: Boundary, lower: Boundary) -> Array:
    """1 where the same index is above the one and below the other, and that between them is higher; else less, or 0."""
    same = at_least(1 - 10 * dr.abs(upper.eta * lower.eta - 1), 0)
    return dr.select(upper.eta > 1, same, 0)


def _flows(step: Step, pair: Pair) -> tuple[Flow, Flow]:
    """With another reflectance and transmittance of a beam."""
    return step.r._replace(beam=pair[0]), step.t._replace(beam=pair[1])


def _mixed(known: Pair, other: Pair, share: Array) -> Pair:
    """A share of the first, the rest of the second."""
    r, t = (b + share * (a - b) for a, b in zip(known, other, strict=True))
    return r, t
