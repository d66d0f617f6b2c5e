"""The adding recursion: lobe after lobe, from the side that the light comes from.

Layer after layer is put below those before. What light there is above layer k, on its way down, is D_k, all bounces
among the layers above included; the layer sends part of it back, which makes the k-th lobe, bounces between the
layer and what lies above (U_k, from below), and gets out:

    down = (1 - U_k r)^-1 D_k        lobe k = t(U_k) r down        D_(k+1) = t down

These are the adding equations (`urushi.adding`) with the sum over layers left open; energies are flows of a beam and
of diffuse light (`flow`). U_k is itself the sum of the layers above for light that comes from below, with the
direction and the width of *this* lobe: a wide one is totally reflected where a narrow one gets out. Whatever U_k is,
as long as it loses nothing no light is lost. See theory (lobes.7).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...interfaces import BoundConductor, BoundDielectric, BoundDiffuse, RoughDiffuse
from ...optics.vectors import Array, Vector, at_least, at_most, mean
from ..bound import BoundStack
from . import matte
from .flow import BEAM, Flow, bounce, times
from .medium import Particles
from .moments import EVEN, Moments, is_zero, sum_of
from .operators import GRAZING, Boundary, leaning
from .returns import Step, from_below, meet
from .spread import Spread
from .through import leaving, wider
from .width import Width, mean_roughness, plus


@dataclass
class Beam:
    """One lobe.

    Attributes:
        energy: fraction of the incident flux, a colour or a number.
        width: see `width`.
        cos: cosine of its mean direction.
        sharp: mask of the lanes where it is one direction, not a lobe.
        layer: number of the interface that sent it.
        turn: angle by which its middle is farther from the normal than Snell's law says.
    """

    energy: Array
    width: Width
    cos: Array
    sharp: Any
    layer: int
    turn: Array = 0.0


@dataclass
class Answer:
    """What a stack does to light from one direction, on one side.

    Attributes:
        reflected: lobes on the side of the light, one for each interface that reflects.
        through: the lobe on the other side; None below an opaque base.
        delayed: what went to and fro before, as a lobe of its own; None if that is in `through`.
        diffuse, beyond: energy of the diffuse light on both sides; the float 0 where there is none.
        lit: the part of `diffuse` that a rough diffuse base sent out the first time, and what it hangs on, if any.
    """

    reflected: list[Beam]
    through: Beam | None
    diffuse: Array
    beyond: Array
    lit: matte.Lit | None = None
    delayed: Beam | None = None


def respond(stack: BoundStack, wi: Vector, above: bool, scatters: bool = True, tally: Any = None) -> Answer:
    """Everything that comes of light from wi.

    Args:
        stack: bound; of interfaces and media that have operators.
        wi: direction, |z| counts.
        above: the side it is on.
        scatters: False to see only what is never scattered by a medium.
        tally: told of every layer and the light around it (`ledger.Tally`), if any.
    """
    order = range(len(stack.interfaces)) if above else range(len(stack.interfaces) - 1, -1, -1)
    refracting = _refracting(stack, order)
    mixes = scatters and _mixes(stack)
    # Else what is no beam any more was but sent to and fro, and still belongs to its lobe.
    scattered = any(m is not None and m.scatters for m in stack.media) or not isinstance(
        stack.interfaces[-1].single or stack.interfaces[-1], BoundConductor
    )
    cos = at_least(dr.abs(wi.z), GRAZING)
    spread = Spread()
    steps: list[Step] = []
    arriving, sharp, width = BEAM, True, None
    spread_above: Width | None = None
    reflected: list[Beam] = []
    diffuse: Array = 0.0
    straight = beyond_cos = cos
    lobed: Array = 1.0
    direct: Array = 1.0
    left: tuple[Width, Array] = 0.0, 0.0
    delayed: tuple[Width, Array] | None = None
    for k in order:
        lean = leaning(stack.interfaces[k], k == order[0])
        boundary = Boundary(stack.interfaces[k], above, wi, mixes=mixes, lean=lean)
        # --- reflection: the lobe of this interface
        r, t = boundary.beam(cos, width)
        even_r, even_t = boundary.even(cos)
        step = Step(
            boundary, cos, spread_above, Flow(r, boundary.diffused(cos), even_r), Flow(t, 0.0, even_t)
        )
        lobe_width = plus(spread.down, boundary.reflected)
        back_width = lobe_width if not _known(sharp, boundary) else None
        met = meet(steps, step, boundary.back(cos, width, lobe_width), back_width, k == order[-1])
        (r, t), (later_r, later_t) = met.first, met.later
        up, later = met.above.whole, met.above_later.whole
        first = times(r, arriving)
        lit = None
        if boundary.matte is not None and matte.clear(stack):
            white = times(up.t_up, Flow(0.0, Moments(*EVEN) if mixes else 1.0, 0.0)).spread
            up = boundary.matte.leaves(up, straight, matte.rim(stack))
            lit = matte.Lit(times(up.t_up, first).spread, white * arriving.beam)
        more = bounce(later.r_bottom, later_r, times(up.r_bottom, first))
        again = times(later_r, more)
        sent = times(up.t_up, first) + times(later.t_up, again)
        sharp = _both(sharp, boundary.still())
        rest = sent.spread
        if not is_zero(sent.beam):
            # Light that goes back and forth before it gets out is what came under the steepest angles; it does not make
            # the middle of the lobe any wider, as the mean number of trips would have it.
            out = met.above.width
            out = spread.lobe(boundary.reflected, 0.0) if out is None else out
            beam, rest = _lobe(sent, dr.square(lobed)) if scattered else (sent.beam + sent.spread, 0.0)
            reflected.append(Beam(beam, out, cos, sharp, k))
        diffuse = sum_of(diffuse, rest)
        if tally is not None:
            passes = (met.first, arriving), (met.later, more)
            tally.met(k, step, passes, (met.above.slabs, first), (met.above_later.slabs, again))
            if boundary.opaque:
                tally.based(k, passes, boundary.unshadowed(cos, width))
        arriving = times(t, arriving) + times(later_t, more)
        if boundary.opaque:
            return Answer(reflected, None, diffuse, 0.0, lit)
        # --- refraction, and what it does to widths
        snell = boundary.refracted(cos)
        below = at_least(snell, GRAZING)
        straight, before = at_least(boundary.refracted(straight), GRAZING), straight
        if k in refracting and not _is_true(sharp):
            left = leaving(boundary, before, straight, *left, wi)
            if k == refracting[-1] and k != refracting[0] and matte.clear(stack):
                delayed = wider(left, at_most(before, straight), wi)
        direct = direct * t.beam
        inner = dr.square(mean(t.beam)) * mean(up.r_bottom.beam)
        spread.cross(
            boundary.reflected,
            boundary.transmitted(cos, below),
            boundary.turned.transmitted(below, cos),
            boundary.eta * below / cos,
            0.0,
            mean(r.beam),
            inner if steps else 0.0,
        )
        steps.append(step)
        cos = at_least(boundary.beyond(cos, width, spread.down), GRAZING)
        beyond_cos = snell
        # --- the medium beyond
        medium = stack.media[k + 1] if above else stack.media[k]
        if medium is not None:
            particles = Particles(medium, scatters, mixes)
            medium_r, medium_t = particles.layer(cos)
            over = from_below(steps, cos, None)
            down = bounce(over.whole.r_bottom, medium_r, arriving)
            sent = times(over.whole.t_up, times(medium_r, down))
            diffuse = sum_of(diffuse, sent.spread)
            step = Step(particles, cos, None, medium_r, medium_t)
            if tally is not None:
                passing = (((medium_r, medium_t), down),)
                tally.met(k + 1 if above else k, step, passing, (over.slabs, times(medium_r, down)))
            arriving = times(medium_t, down)
            direct = direct * medium_t.beam
            steps.append(step)
            if particles.scatters:
                more, spread_by = particles.widened(cos)
                lobed = lobed * more
                spread.cross(0.0, spread_by, spread_by, 1.0, 0.0, 0.0, 1.0)
                left = plus(left[0], spread_by), left[1]
                sharp = False if scatters else sharp
        spread_above = None if _is_true(sharp) else spread.down
        width = None if spread_above is None else mean_roughness(spread_above)
    beam, rest = _lobe(arriving, lobed)
    late: Beam | None = None
    if delayed is not None:
        energy = at_least(beam - direct, 0)
        late = Beam(energy, delayed[0], beyond_cos, sharp, len(stack.interfaces), delayed[1])
        beam = beam - energy
    through = Beam(beam, left[0], beyond_cos, sharp, len(stack.interfaces), left[1])
    return Answer(reflected, through, diffuse, rest, delayed=late)


def _lobe(light: Flow, factor: Array) -> tuple[Array, Array]:
    """Energy of what leaves as a lobe, and of what is diffuse.

    Light that was scattered forwards is followed as diffuse, but for a part (`medium`); more of it looks like a lobe.
    """
    if is_zero(light.scattered) or is_zero(light.beam):
        return light.beam, light.spread
    moved = at_most(light.beam * (factor - 1), at_least(light.spread, 0))
    return light.beam + moved, light.spread - moved


def _mixes(stack: BoundStack) -> bool:
    """Whether diffuse light is not nearly even everywhere, so that its moments are followed."""
    media = [medium for medium in stack.media if medium is not None]
    if any(medium.scatters for medium in media):
        return True
    through = sum(
        isinstance(interface.single or interface, BoundDielectric) for interface in stack.interfaces
    )
    base = stack.interfaces[-1].single or stack.interfaces[-1]
    diffuse = isinstance(base, (BoundDiffuse, RoughDiffuse))
    return (diffuse and bool(media)) or ((diffuse or isinstance(base, BoundConductor)) and through > 1)


def _refracting(stack: BoundStack, order: range) -> list[int]:
    """The interfaces that light refracts at on its way through; none above an opaque base."""
    if any(stack.interfaces[k].opaque for k in order):
        return []
    inner = {k: stack.interfaces[k].single or stack.interfaces[k] for k in order}
    return [k for k in order if isinstance(inner[k], BoundDielectric)]


def _known(sharp: Any, boundary: Boundary) -> bool:
    """Whether all light that the boundary sends back is certainly in one direction."""
    return _is_true(sharp) and boundary.smooth


def _is_true(mask: Any) -> bool:
    return isinstance(mask, bool) and mask


def _both(a: Any, b: Any) -> Any:
    if isinstance(a, bool):
        return b if a else False
    if isinstance(b, bool):
        return a if b else False
    return a & b
