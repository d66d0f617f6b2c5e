"""The position-free walk: one path through the stack, and what it says about f(wi, wo).

A path is a sequence of directions and of depths; where along the surface it wanders does not matter (Guo et al. 2018,
section 4), because the stack is the same everywhere under one shading point. The light starts along -wi, with flux 1,
and every event keeps or lowers its flux, so the eta^2 of radiance enters once, in `result`.

One turn of the loop sweeps the stack down and up again: each lane meets, in this order, the media and interfaces that
lie ahead of it. The stack is unrolled in Python; only the numbers are Dr.Jit's.

At every vertex next to the way out two strategies estimate the same light (power heuristic, Veach 1997):

    connect   go on along the exit ray that was sampled backwards from wo (`exit`);
    arrive    go on along a sampled direction and see how much of it the exit interface sends along wo.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces import Scatter
from ...optics.random import uniform
from ...optics.vectors import Array, Vector, channels, mirror, negate, peak
from ..bound import BoundStack
from .exit import DELTA, Exit, flux_back, sample_exit

State = dict[str, Any]


def direct(stack: BoundStack, wi: Vector, wo: Vector) -> Array:
    """Flux density of the light that meets one interface only: no randomness in it."""
    top, bottom = stack.interfaces[0], stack.interfaces[-1]
    value = dr.select((wi.z > 0) & (wo.z > 0), top.reflect(wi, wo, above=True)[0], 0)
    if stack.opaque:
        return value
    wi_low, wo_low = mirror(wi), mirror(wo)
    value = dr.select((wi.z < 0) & (wo.z < 0), bottom.reflect(wi_low, wo_low, above=False)[0], value)
    if len(stack.interfaces) == 1:
        value = dr.select((wi.z > 0) & (wo.z < 0), top.transmit(wi, wo, above=True)[0], value)
        value = dr.select((wi.z < 0) & (wo.z > 0), top.transmit(wi_low, wo_low, above=False)[0], value)
    return value


def estimate(stack: BoundStack, wi: Vector, wo: Vector, rng: Any, spectrum: Any, max_depth: int | None) -> Array:
    """One sample of the flux density f |cos wo| of all light that meets more than one interface or a medium.

    Args:
        stack: the stack with its numbers.
        wi, wo: directions away from the surface, on either side.
        rng: a generator per lane.
        spectrum: type of a colour, or of a number where nothing in the stack is coloured.
        max_depth: most scattering events after the entrance; None for no limit.
    """
    way_out = sample_exit(stack, wo, rng)
    state = _enter(stack, wi, way_out, rng, spectrum, max_depth)
    if max_depth is not None:
        state["alive"] = state["alive"] & (max_depth > 0)

    def body(s: State) -> tuple[State]:
        s = dict(s)
        for region in stack.regions:
            _advance(stack, s, wo, way_out, region, down=True)
        for region in reversed(stack.regions):
            _advance(stack, s, wo, way_out, region, down=False)
        _roulette(s, wi, max_depth)
        return (s,)

    (out,) = dr.while_loop((state,), lambda s: s["alive"], body, label="walk")
    return out["light"]


def _enter(stack: BoundStack, wi: Vector, way_out: Exit, rng: Any, spectrum: Any, max_depth: int | None) -> State:
    """Cross the first interface."""
    last = len(stack.interfaces) - 1
    u = (0.5, uniform(rng, wi), uniform(rng, wi))
    event = stack.interfaces[0].sample(wi, u, above=True, part="transmit")
    d, weight, pdf, delta = event.o, event.weight, event.pdf, stack.interfaces[0].delta
    alive = (wi.z > 0) & (d.z < 0)
    region: Any = 1
    light = 0 * spectrum(1) * wi.x
    if not stack.opaque:
        below = stack.interfaces[last].sample(mirror(wi), u, above=False, part="transmit")
        up = wi.z > 0
        alive = dr.select(up, alive, (wi.z < 0) & (below.o.z < 0))
        d = dr.select(up, d, mirror(below.o))
        weight, pdf = dr.select(up, weight, below.weight), dr.select(up, pdf, below.pdf)
        delta = dr.select(up, delta, stack.interfaces[last].delta)
        region = dr.select(up, 1, last)
    light = light + _connect_entrance(stack, wi, way_out)
    state: State = {
        "alive": alive & (peak(weight) > 0),
        "d": d,
        "throughput": spectrum(weight),
        "light": light,
        # density of the last sampled direction, in the current region; DELTA when no vertex could be connected
        "pdf": dr.select(delta, DELTA, pdf),
        "rng": rng,
        "depth": None if max_depth is None else _uint(wi)(0),
        "region": None,
        "t": None,
    }
    if last > 1:
        state["region"] = _uint(wi)(region)
    if any(medium is not None and medium.scatters for medium in stack.media):
        state["t"] = dr.select(d.z < 0, 0.0, 1.0)
    return state


def _uint(w: Vector) -> Any:
    return dr.uint32_array_t(dr.value_t(type(w)))


def _connect_entrance(stack: BoundStack, wi: Vector, way_out: Exit) -> Array:
    """Connect the entrance itself to the exit ray: wi refracts straight into its direction."""
    light = 0 * wi.x
    for above in (True,) if stack.opaque else (True, False):
        interface, region = (stack.interfaces[0], 1) if above else (stack.interfaces[-1], len(stack.interfaces) - 1)
        meets = way_out.meets(region, up=not above)
        if meets is False or interface.delta is True:
            continue
        w, c = (wi, way_out.c) if above else (mirror(wi), mirror(way_out.c))
        value, pdf = interface.transmit(w, c, above, part="transmit")
        value = value * _weight(pdf * way_out.jacobian, way_out.pdf)
        medium = stack.media[region]
        if medium is not None:
            value = value * medium.transmittance(1.0, c.z)
        light = light + dr.select((w.z > 0) & meets, value * way_out.weight, 0)
    return light


def _weight(other: Array, own: Array) -> Array:
    """Power heuristic: the weight of the strategy of density `own` against that of density `other`."""
    return dr.rcp(1 + dr.square(other / dr.maximum(own, 1e-18)))


def _advance(stack: BoundStack, s: State, wo: Vector, way_out: Exit, region: int, down: bool) -> None:
    """One region, and the interface ahead, for the lanes that travel there."""
    here = s["alive"] & ((s["d"].z < 0) if down else (s["d"].z > 0))
    if s["region"] is not None:
        here = here & (s["region"] == region)
    medium = stack.media[region]
    if medium is not None:
        here = _fly(stack, s, way_out, region, here)
    _meet(stack, s, wo, way_out, region, down, here)


def _fly(stack: BoundStack, s: State, way_out: Exit, region: int, here: Any) -> Any:
    """Cross the medium or collide in it; returns the lanes that arrive at the interface ahead."""
    medium = stack.media[region]
    assert medium is not None
    d, rng = s["d"], s["rng"]
    if not medium.scatters:
        passed = medium.transmittance(1.0, d.z)
        s["throughput"] = dr.select(here, s["throughput"] * passed, s["throughput"])
        return here
    channel = uniform(rng, d) if channels(medium.depth) else 0.0
    flight = medium.fly(s["t"], d, s["throughput"], uniform(rng, d), uniform(rng, d), channel)
    hit = here & flight.collided
    phase = medium.phase
    for up in (True, False):
        meets = way_out.meets(region, up)
        if meets is False:
            continue
        density = phase.eval(d, way_out.c)
        value = density * medium.transmittance(flight.t if up else 1 - flight.t, way_out.c.z)
        if not phase.flat:
            value = value * _weight(density * way_out.jacobian, way_out.pdf)
        s["light"] = s["light"] + dr.select(here & meets, s["throughput"] * flight.scattered * (value * way_out.weight), 0)
    s["throughput"] = dr.select(here, s["throughput"] * flight.weight, s["throughput"])
    after = phase.sample(d, uniform(rng, d), uniform(rng, d))
    s["pdf"] = dr.select(hit, 0.0 if phase.flat else phase.eval(d, after), s["pdf"])
    s["d"] = dr.select(hit, after, d)
    s["t"] = dr.select(hit, flight.t, s["t"])
    _count(s, hit)
    return here & negate(flight.collided)


def _meet(stack: BoundStack, s: State, wo: Vector, way_out: Exit, region: int, down: bool, here: Any) -> None:
    """Scatter at the interface ahead of the lanes `here`."""
    last = len(stack.interfaces) - 1
    k = region if down else region - 1
    beyond = region + 1 if down else region - 1
    interface = stack.interfaces[k]
    outer = k in (0, last) and not interface.opaque
    d = s["d"]
    w = -d if down else mirror(-d)
    if outer:
        _arrive(stack, s, wo, way_out, k, here)
    if interface.delta is not True:
        _connect(stack, s, way_out, k, down, w, here)
    # Beyond an outer interface lies no way to wo but the one just counted: the walk only goes on inside.
    u = (0.5 if outer else uniform(s["rng"], d), uniform(s["rng"], d), uniform(s["rng"], d))
    event = interface.sample(w, u, above=down, part="reflect" if outer else "both")
    o = event.o if down else mirror(event.o)
    s["throughput"] = dr.select(here, s["throughput"] * event.weight, s["throughput"])
    s["pdf"] = dr.select(here, _density(interface, event, s["pdf"], w, down, outer), s["pdf"])
    s["d"] = dr.select(here, o, d)
    _count(s, here)
    if s["t"] is not None:
        s["t"] = dr.select(here, dr.select(o.z < 0, 0.0, 1.0), s["t"])
    if s["region"] is not None and not outer and event.through is not False:
        s["region"] = dr.select(here & event.through, type(s["region"])(beyond), s["region"])


def _density(interface: Any, event: Scatter, before: Array, w: Vector, down: bool, outer: bool) -> Array:
    """Density of the sampled direction; a smooth event passes on the density of what came before it."""
    if interface.flat:
        return 0 * before
    if interface.delta is False:
        return event.pdf
    bent = dr.square(interface.ratio(down)) * dr.abs(event.o.z) / dr.maximum(w.z, 1e-20) if not interface.opaque else 1
    passed = before if outer or interface.opaque else before * dr.select(event.through, bent, 1.0)
    return passed if interface.delta is True else dr.select(interface.delta, passed, event.pdf)


def _connect(stack: BoundStack, s: State, way_out: Exit, k: int, down: bool, w: Vector, here: Any) -> None:
    """Strategy one: send the light from interface k along the exit ray."""
    interface = stack.interfaces[k]
    c = way_out.c if down else mirror(way_out.c)
    outer = k in (0, len(stack.interfaces) - 1)
    for through in (False,) if outer or interface.opaque else (False, True):
        region = (k + 1 if down else k) if through else (k if down else k + 1)
        up = down if not through else not down
        meets = way_out.meets(region, up)
        if meets is False:
            continue
        part = "reflect" if outer else "both"
        value, pdf = (interface.transmit if through else interface.reflect)(w, c, down, part)
        if not interface.flat:
            value = value * _weight(pdf * way_out.jacobian, way_out.pdf)
        medium = stack.media[region]
        if medium is not None:
            value = value * medium.transmittance(1.0, c.z)
        s["light"] = s["light"] + dr.select(here & meets, s["throughput"] * (value * way_out.weight), 0)


def _arrive(stack: BoundStack, s: State, wo: Vector, way_out: Exit, k: int, here: Any) -> None:
    """Strategy two: what the outer interface k sends along wo of the light that arrives along d."""
    interface, above = stack.interfaces[k], k == 0
    if interface.delta is True or not _ever_arrives(stack):
        return
    seen, inside = (wo, -s["d"]) if above else (mirror(wo), mirror(-s["d"]))
    value, pdf = interface.transmit(seen, inside, above, part="transmit")
    value = value * flux_back(stack, wo, inside, above)
    value = value * _weight(pdf, s["pdf"])
    s["light"] = s["light"] + dr.select(here & (seen.z > 0), s["throughput"] * value, 0)


def _ever_arrives(stack: BoundStack) -> bool:
    """False if every vertex inside is flat, so that connecting alone is as good as it gets."""
    inner = stack.interfaces[1:] if stack.opaque else stack.interfaces
    flat = all(interface.flat for interface in inner)
    return not (flat and all(medium is None or medium.phase.flat or not medium.scatters for medium in stack.media))


def _count(s: State, here: Any) -> None:
    if s["depth"] is not None:
        s["depth"] = dr.select(here, s["depth"] + 1, s["depth"])


def _roulette(s: State, like: Vector, max_depth: int | None) -> None:
    """End paths that carry little, in proportion; the rest carry more."""
    survival = dr.minimum(peak(s["throughput"]), 1)
    alive = s["alive"] & (uniform(s["rng"], like) < survival)
    s["throughput"] = s["throughput"] / dr.maximum(survival, 1e-30)
    s["alive"] = alive if max_depth is None else alive & (s["depth"] < max_depth)
