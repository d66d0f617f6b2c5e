"""The adding recursion: lobe after lobe, from the side that the light comes from.

Layer after layer is put below those before. What light there is above layer k, on its way down, is D_k, all bounces
among the layers above included; the layer sends part of it back, which makes the k-th lobe, bounces between the
layer and what lies above (U_k, from below), and gets out:

    down = (1 - U_k r)^-1 D_k        lobe k = t(U_k) r down        D_(k+1) = t down

These are the adding equations (`urushi.adding`) with the sum over layers left open; energies are flows of a beam and
of diffuse light (`flow`). U_k is itself the sum of the layers above for light that comes from below, with the
direction and the width of *this* lobe: a wide one is totally reflected where a narrow one gets out. Whatever U_k is,
as long as it loses nothing no light is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...adding import Slab, add
from ...optics.vectors import Array, Vector, at_least, channels, total
from ..bound import BoundStack
from . import tables
from .flow import ALL, FLOWS, NONE, Flow, bounce, times
from .medium import Particles
from .operators import GRAZING, Boundary
from .spread import Spread
from .width import OURS, Width, mean_roughness, plus

#: the most that is reflected back and forth: single precision sees total reflection where there is none
MOST = 1 - 2e-7


@dataclass
class Beam:
    """One lobe.

    Attributes:
        energy: fraction of the incident flux, a colour or a number.
        width: see `width`.
        cos: cosine of its mean direction.
        sharp: mask of the lanes where it is one direction, not a lobe.
        layer: number of the interface that sent it.
    """

    energy: Array
    width: Width
    cos: Array
    sharp: Any
    layer: int


@dataclass
class Answer:
    """What a stack does to light from one direction, on one side.

    Attributes:
        reflected: lobes on the side of the light, one for each interface that reflects.
        through: the lobe on the other side; None below an opaque base.
        diffuse, beyond: energy of the diffuse light on both sides; the float 0 where there is none.
    """

    reflected: list[Beam]
    through: Beam | None
    diffuse: Array
    beyond: Array


@dataclass
class _Step:
    """A layer that the recursion has gone through: an interface, or the medium below one."""

    layer: Boundary | Particles
    cos: Array  # in the region above
    r: Flow
    t: Flow


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
    cos = at_least(dr.abs(wi.z), GRAZING)
    spread = Spread()
    steps: list[_Step] = []
    arriving, sharp, width = ALL, True, None
    reflected: list[Beam] = []
    diffuse: Array = 0.0
    beyond_cos = cos
    for k in order:
        boundary = Boundary(stack.interfaces[k], above, wi)
        # --- reflection: the lobe of this interface
        r, t = boundary.beam(cos, width)
        even_r, even_t = boundary.even(cos)
        base = boundary.inner.reflectance if boundary.scatters() else 0.0
        step = _Step(boundary, cos, Flow(r, base, even_r), Flow(t, 0.0, even_t))
        lobe_width = plus(spread.down, boundary.reflected)
        back_width = lobe_width if not _known(sharp, boundary) else None
        returning = boundary.back(cos, width, lobe_width)
        up, nearest, upper = _from_below(steps, returning, back_width)
        later, _, again = _from_below(steps, returning, back_width, nearest)
        first = times(step.r, arriving)
        more = bounce(later.r_bottom, step.r, times(up.r_bottom, first))
        sent = times(up.t_up, first) + times(later.t_up, times(step.r, more))
        down = arriving + more
        sharp = _both(sharp, boundary.still())
        if not _zero(sent.beam):
            # Light that goes back and forth before it gets out is what came under the steepest angles; it does not make
            # the middle of the lobe any wider, as the mean number of trips would have it.
            reflected.append(Beam(sent.beam, spread.lobe(boundary.reflected, 0.0), cos, sharp, k))
        diffuse = _sum(diffuse, sent.scattered)
        if tally is not None:
            tally.met(k, step, down, (upper, first), (again, times(step.r, more)))
            if boundary.opaque:
                tally.based(k, step.r, down, boundary.unshadowed(cos, width))
        arriving = times(step.t, down)
        if boundary.opaque:
            return Answer(reflected, None, diffuse, 0.0)
        # --- refraction, and what it does to widths
        snell = boundary.refracted(cos)
        below = at_least(snell, GRAZING)
        inner = dr.square(_mean(t)) * _mean(up.r_bottom.beam)
        spread.cross(
            boundary.reflected,
            boundary.transmitted(cos, below),
            boundary.turned.transmitted(below, cos),
            boundary.eta * below / cos,
            0.0,
            _mean(r),
            inner if steps else 0.0,
        )
        steps.append(step)
        cos = at_least(boundary.beyond(cos, width, spread.down), GRAZING)
        beyond_cos = snell
        # --- the medium beyond
        medium = stack.media[k + 1] if above else stack.media[k]
        if medium is not None:
            particles = Particles(medium, scatters)
            medium_r, medium_t = particles.layer(cos)
            up, _, upper = _from_below(steps, cos, None)
            down = bounce(up.r_bottom, medium_r, arriving)
            sent = times(up.t_up, times(medium_r, down))
            diffuse = _sum(diffuse, sent.scattered)
            step = _Step(particles, cos, medium_r, medium_t)
            if tally is not None:
                tally.met(k + 1 if above else k, step, down, (upper, times(medium_r, down)))
            arriving = times(medium_t, down)
            steps.append(step)
            _, spread_by = particles.passed(cos)
            if particles.scatters:
                spread.cross(0.0, spread_by, spread_by, 1.0, 0.0, 0.0, 1.0)
                sharp = False if scatters else sharp
        width = None if _is_true(sharp) else mean_roughness(spread.down)
    through = Beam(arriving.beam, spread.down, beyond_cos, sharp, len(stack.interfaces))
    return Answer(reflected, through, diffuse, arriving.scattered)


def _from_below(
    steps: list[_Step], cos: Array, width: Width | None, again: Array | None = None
) -> tuple[Slab, Array, list[Slab]]:
    """The layers gone through so far, for a lobe that comes from below.

    Args:
        cos, width: of the lobe; None for one direction.
        again: None, or for light that was reflected already and now comes back: how much of it by the nearest
            interface. It comes under angles at which that reflects more; what was reflected further up gets through
            the nearest as ever, and is reflected more up there.

    Returns:
        the layers as one; how much of what they reflect the nearest interface reflects, from below; and each of them,
        the nearest first.
    """
    slabs: list[Slab] = []
    first: Array | None = None
    whole_sent: Array = 0.0
    passing: Array = 1.0
    for step in reversed(steps):
        if isinstance(step.layer, Particles):
            r, t = step.layer.layer(cos if width is None else tables.mean(cos, mean_roughness(width)))
            slabs.append(Slab(step.r, step.t, r, t))
            passing = passing * _mean(t.beam)
            if width is not None:
                width = plus(width, step.layer.passed(cos)[1])
            continue
        turned = step.layer.turned
        alpha = None if width is None else mean_roughness(width)
        r, t = turned.beam(cos, alpha)
        if again is not None and width is not None:
            share, (later_r, later_t) = again if first is None else 1.0, turned.beam(cos, alpha, True)
            r, t = r + share * (later_r - r), t + share * (later_t - t)
        sent = passing * passing * r
        first = sent if first is None else first
        whole_sent, passing = whole_sent + sent, passing * t
        even_r, even_t = turned.even(cos)
        slabs.append(Slab(step.r, step.t, Flow(r, 0.0, even_r), Flow(t, 0.0, even_t)))
        snell = at_least(turned.refracted(cos), GRAZING)
        if width is not None:
            width = plus(width * OURS.factor(cos / (turned.eta * snell)), turned.transmitted(cos, snell))
            snell = at_least(turned.beyond(cos, alpha, width), GRAZING)
        cos = snell
    whole = Slab(NONE, ALL, NONE, ALL)
    for n, slab in enumerate(reversed(slabs)):
        whole = add(whole, slab, FLOWS) if n else slab
    return whole, 1.0 if first is None else first / at_least(whole_sent + 0 * cos, 1e-12), slabs


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


def _zero(value: Array) -> bool:
    return isinstance(value, float) and value == 0


def _sum(a: Array, b: Array) -> Array:
    return b if _zero(a) else a if _zero(b) else a + b


def _mean(value: Array) -> Array:
    return total(value) * (1 / max(channels(value), 1))
