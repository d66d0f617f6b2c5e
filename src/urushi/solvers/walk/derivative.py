"""Derivatives of the walk: sample with the numbers held still, weigh with the live ones.

The mean of f / p over directions drawn from p is right whatever p is, so p need not follow the parameters:
directions, distances and choices are sampled by a copy of the stack whose numbers are detached from the derivative,
and every event multiplies the path by its live flux density over that detached density ("detached sampling", theory
(walk.17), Zeltner et al. 2021, Monte Carlo Estimators for Differential Light Transport). No derivative of a choice is
lost, since none is taken. What a smooth interface does to a direction has no density; there the direction itself
carries the derivative.

The classes here stand in for the interfaces, media and phase functions of a stack when a parameter has its gradient
enabled, and cost nothing when none has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr

from urushi.errors import UnsupportedStack

from ...interfaces import Interface, Scatter
from ...interfaces.base import Part
from ...interfaces.given import Given
from ...interfaces.tilted import Came
from ...media import inverse_cosine
from ...media.homogeneous import Flight
from ...optics.random import Generator
from ...optics.vectors import Array, Vector
from ..bound import BoundStack, bind

#: sweeps after which a path ends when gradients are enabled: reverse mode has to know how much to remember
MOST_SWEEPS = 64
#: sweeps that are unrolled where reverse mode cannot remember a loop at all (inside a Mitsuba plugin)
UNROLLED = 8

State = dict[str, Any]


def bind_live(
    stack: Any, values: Mapping[str, Array], fixed: Mapping[str, Any], unrolled: bool = False
) -> BoundStack:
    """`bind`, with live and detached numbers side by side if any value has its gradient enabled.

    Args:
        unrolled: whether loops have to be unrolled to be differentiated (see `run`).
    """
    live = bind(stack, values, fixed)
    if not any(_live(value) for value in values.values()):
        return live
    if any(interface.stochastic for interface in live.interfaces):
        raise UnsupportedStack(
            "walk",
            [
                'an interface has multiple_scattering="walk", a walk within the walk, which Dr.Jit cannot '
                'differentiate: use "compensated" where derivatives are wanted'
            ],
        )
    still = bind(stack, {name: _detached(value) for name, value in values.items()}, fixed)
    return BoundStack(
        [LiveInterface(a, b) for a, b in zip(live.interfaces, still.interfaces, strict=True)],
        [None if a is None else LiveMedium(a, b) for a, b in zip(live.media, still.media, strict=True)],  # type: ignore[misc]
        live.indices,
        still=still,
        unrolled=unrolled,
    )


def run(stack: BoundStack, state: State, going: Any, body: Any, label: str) -> tuple[State, State | None]:
    """The loop `while going(state): state = body(stack, state)`, in a way that can be differentiated.

    Without live numbers it is a plain loop; with them, one that remembers at most `MOST_SWEEPS` turns. Where Dr.Jit
    cannot differentiate a loop in reverse (inside a virtual function call), the first `UNROLLED` turns are unrolled,
    and the caller runs the rest with still numbers: only the derivative of what a path already carries is then kept.

    Returns:
        the state after the loop, or after the unrolled turns; and in that case a detached copy of it to go on from.
    """

    def turn(s: State) -> tuple[State]:
        return (body(stack, dict(s)),)

    if stack.still is None:
        return dr.while_loop((state,), going, turn, label=label)[0], None
    if stack.unrolled:
        for _ in range(UNROLLED):
            (state,) = turn(state)
        return state, dr.detach(state)
    return dr.while_loop((state,), going, turn, label=label, max_iterations=MOST_SWEEPS)[0], None


def _live(value: Any) -> bool:
    if isinstance(value, tuple):
        return any(_live(v) for v in value)
    return bool(dr.grad_enabled(value)) if dr.is_array_v(value) else False


def _detached(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_detached(v) for v in value)
    return dr.detach(value) if dr.is_array_v(value) else value


def _follow(weight: Array, live: Array, density: Array) -> Array:
    """`weight`, with the derivative of `live` / `density`."""
    slope = (live - dr.detach(live)) / dr.maximum(dr.detach(density), 1e-20)
    return weight + dr.select(dr.detach(density) > 0, slope, 0)


class LiveInterface(Interface):
    """An interface whose values are live and whose sampling stands still."""

    def __init__(self, live: Any, still: Any) -> None:
        self.live, self.still = live, still
        self.opaque, self.flat, self.delta = live.opaque, live.flat, still.delta
        self.tilted = live.tilted

    @classmethod
    def bind(cls, given: Given) -> tuple[Interface, Array, float | None]:
        raise TypeError("a live interface is made of two bound ones: see bind_live")

    def reflect(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        value, pdf = self.live.reflect(w, o, above, part)
        return value, dr.detach(pdf)

    def transmit(
        self, w: Vector, o: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        value, pdf = self.live.transmit(w, o, above, part)
        return value, dr.detach(pdf)

    def sample(
        self,
        w: Vector,
        u: tuple[Array, Array, Array],
        above: bool,
        part: Part = "both",
        rng: Generator | None = None,
    ) -> Scatter:
        event = self.still.sample(dr.detach(w), u, above, part)
        smooth = self._smooth(w, u, above, part) if self.delta is not False else None
        if self.delta is True:
            assert smooth is not None
            return smooth
        reflected = self.live.reflect(w, event.o, above, part)[0] if part != "transmit" else 0 * event.pdf
        passed = (
            self.live.transmit(w, event.o, above, part)[0] if part != "reflect" and not self.opaque else 0
        )
        weight = _follow(event.weight, dr.select(event.through, passed, reflected), event.pdf)
        if smooth is None:
            return Scatter(event.o, weight, event.pdf, event.through)
        o = dr.select(self.delta, smooth.o, event.o)
        return Scatter(o, dr.select(self.delta, smooth.weight, weight), event.pdf, event.through)

    def _smooth(self, w: Vector, u: tuple[Array, Array, Array], above: bool, part: Part) -> Scatter:
        """A delta event: the direction follows the index, and so does the probability of what was chosen."""
        event = self.live.sample(w, u, above, part)
        if part != "both" or self.opaque:
            return event
        r, t = self.live.smooth_energy(w.z, above)
        energy = dr.select(event.through, t, r)
        return Scatter(event.o, _follow(event.weight, energy, energy), event.pdf, event.through)

    def back(
        self, o: Vector, w: Vector, above: bool, part: Part = "both", rng: Generator | None = None
    ) -> tuple[Array, Array]:
        value, pdf = self.live.back(o, w, above, part, rng)
        return value, dr.detach(pdf)

    def towards(
        self, o: Vector, u: tuple[Array, Array, Array], above: bool, part: Part, rng: Generator
    ) -> Came:
        """`Tilted.towards`: live where the normal itself turns the direction, else a live weight."""
        if self.delta is True:
            return self.live.towards(o, u, above, part, rng)
        came = self.still.towards(dr.detach(o), u, above, part, rng)
        weight = _follow(came.weight, self.live.back(o, came.w, above, part, rng)[0], came.pdf)
        return Came(came.w, weight, came.pdf, came.through, came.bent)

    def ratio(self, above: bool) -> Array:
        return self.live.ratio(above)

    def stretch(self, w: Vector, o: Vector, above: bool) -> Array:
        return self.live.stretch(w, o, above)

    def smooth_energy(self, cos: Array, above: bool) -> tuple[Array, Array]:
        return self.live.smooth_energy(cos, above)

    def lobe(self, cos: Array, above: bool) -> tuple[Array, Array, Array]:
        return self.still.lobe(cos, above)


class LivePhase:
    """A phase function whose value is live and whose sampling stands still."""

    def __init__(self, live: Any, still: Any) -> None:
        self._live, self._still = live, still
        self.flat = live.flat

    def eval(self, before: Vector, after: Vector) -> Array:
        return self._live.eval(before, after)

    def sample(self, before: Vector, u1: Array, u2: Array) -> Vector:
        return self._still.sample(dr.detach(before), u1, u2)


class LiveMedium:
    """A medium whose weights are live and whose sampling stands still."""

    def __init__(self, live: Any, still: Any) -> None:
        live.decay = lambda x: dr.exp(-x)
        self.live, self.still = live, still
        self.depth, self.albedo, self.scatters = live.depth, live.albedo, live.scatters
        self.phase = LivePhase(live.phase, still.phase)

    def phase_at(self, t: Array) -> LivePhase:
        return LivePhase(self.live.phase_at(t), self.still.phase_at(t))

    def transmittance(self, distance: Array, inv_cos: Array) -> Array:
        return self.live.transmittance(distance, inv_cos)

    def fly(self, t: Array, w: Vector, throughput: Array, u1: Array, u2: Array, u3: Array) -> Flight:
        flight = self.still.fly(dr.detach(t), dr.detach(w), dr.detach(throughput), u1, u2, u3)
        inv_cos = inverse_cosine(w.z)
        ahead = dr.select(w.z < 0, 1 - t, t)
        # Flux that passes, and flux that collides per distance; in ratio to themselves, times what was sampled.
        passed = relative(self.live.transmittance(ahead, inv_cos))
        density = self.live.albedo * self.live.depth * self.live.transmittance(dr.abs(flight.t - t), inv_cos)
        hit = relative(density * inv_cos)
        weight = flight.weight * dr.select(flight.collided, hit, passed)
        return Flight(flight.collided, flight.t, weight, flight.scattered * hit)


def relative(value: Array) -> Array:
    """1, with the logarithmic derivative of `value`."""
    still = dr.detach(value)
    return dr.select(still > 0, 1 + (value - still) / dr.maximum(still, 1e-30), 1)
