"""The position-free walk: one path through the stack, and what it says about f(wi, wo).

A path is a sequence of directions and of depths; where along the surface it wanders does not matter (Guo et al. 2018,
section 4), because the stack is the same everywhere under one shading point. The light starts along -wi, with flux 1,
and every event keeps or lowers its flux, so the eta^2 of radiance enters once, in `result`.

One turn of the loop sweeps the stack down and up again: each lane meets, in this order, the media and interfaces that
lie ahead of it. The stack is unrolled in Python; only the numbers are Dr.Jit's.

At every vertex next to the way out two strategies estimate the same light, joined by the power heuristic (Veach
1997):

    connect   go on along the exit ray that was sampled backwards from wo (`exit`);
    arrive    go on along a sampled direction and see how much of it the exit interface sends along wo.

See theory (walk.5, walk.6, walk.9 to walk.12). Where every vertex is broad (diffuse, nearly isotropic scattering,
a base known to be no sharper than `BROAD` and its coat), connecting is as good as it gets and stands alone; `coated`
then does more for a coat over such a metal.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces import Interface, Scatter
from ...media import entry_height, inverse_cosine
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, at_least, at_most, channels, mirror, negate, peak
from ..bound import CALM, BoundStack
from ..direct import direct, direct_is_certain
from .coated import between
from .derivative import MOST_SWEEPS, relative, run
from .ends import either_way
from .exit import DELTA, Exit, flux_back, sample_exit
from .stages import in_stages

State = dict[str, Any]

#: throughput below which the roulette begins: a tail is short, and the lanes of a vector wait for one another anyway
ROULETTE = 0.37
#: the same where a medium scatters: there every flight counts all collisions on its way, so paths may end sooner
ROULETTE_SCATTERING = 0.7
#: roughness from which on connecting to a base is as good as it gets, and arriving only adds noise
BROAD = 0.15


def estimate(
    stack: BoundStack,
    wi: Vector,
    wo: Vector,
    rng: Generator,
    spectrum: Any,
    max_depth: int | None = None,
    staged: bool = False,
    certain: Array = 0,
) -> Array:
    """One sample of the flux density f |cos wo| of all light but what `direct` can tell for certain.

    Args:
        stack: the stack with its numbers.
        wi, wo: directions away from the surface, on either side.
        rng: a generator per lane.
        spectrum: type of a colour, or of a number where nothing in the stack is coloured.
        max_depth: most scattering events inside; None for no limit.
        staged: whether to pack paths on the way (`stages`); the numbers of the stack must be the same for all lanes.
        certain: what is known for certain, to be added to.
    """
    seen = spectrum(certain if direct_is_certain(stack) else certain + direct(stack, wi, wo, rng))
    if len(stack.interfaces) == 1:
        return seen + 0 * wi.x
    staged = staged and _lingers(stack)
    if _connects_only(stack) and either_way(stack):
        return between(stack, wi, wo, rng, spectrum, max_depth, staged, seen)
    way_out = sample_exit(stack, wo, rng, spectrum)
    state = _enter(stack, wi, way_out, rng, spectrum, max_depth)
    state["light"] = spectrum(state["light"] + seen)
    threshold = _roulette_threshold(stack)

    def body(stack: BoundStack, s: State, wo: Vector = wo, way_out: Exit = way_out) -> State:
        s["calm"] = True if stack.traps else None
        for region in stack.regions:
            _advance(stack, s, wo, way_out, region, down=True)
        for region in reversed(stack.regions):
            _advance(stack, s, wo, way_out, region, down=False)
        _roulette(s, s["d"], threshold, max_depth, stack.still is not None)
        if s["turn"] is not None:
            s["turn"] = s["turn"] + 1
            s["throughput"] = dr.select(s["turn"] < MOST_SWEEPS, s["throughput"], 0)
        # Mitsuba's spectra forget their name in arithmetic; a loop insists on the type it began with.
        s["throughput"], s["light"] = spectrum(s["throughput"]), spectrum(s["light"])
        return s

    if staged:
        fixed = (wo, *way_out.numbers())
        if state["pdf"] is None:  # nobody asks for wo, nor for densities
            fixed = (None, way_out.c, way_out.weight, None, None, way_out.region)
        return in_stages(
            state, fixed, _carries, lambda s, e: body(stack, s, e[0], way_out.moved(stack, *e[1:]))
        )
    state, rest = run(stack, state, _carries, body, "walk")
    if rest is None:
        return state["light"]
    assert stack.still is not None
    frozen = dr.detach(way_out)
    rest["light"] = 0 * rest["light"]
    rest, _ = run(stack.still, rest, _carries, lambda stack, s: body(stack, s, way_out=frozen), "walk on")
    return state["light"] + rest["light"] * relative(state["throughput"])


def _carries(s: State) -> Any:
    return peak(dr.detach(s["throughput"])) > 0


def _connects_only(stack: BoundStack) -> bool:
    """True if every vertex inside is broad: flat, or the rough base of a coat no rougher than itself."""
    vertices: list[Any] = stack.interfaces[1:] if stack.opaque else list(stack.interfaces)
    if stack.opaque and len(vertices) == 1:
        coat, base = (interface.known_alpha for interface in stack.interfaces)
        if coat is not None and base is not None and min(base) >= max(BROAD, *coat):
            vertices = []
    vertices += [medium.phase for medium in stack.media if medium is not None and medium.scatters]
    return all(vertex.flat for vertex in vertices)


def _lingers(stack: BoundStack) -> bool:
    """Whether paths differ in length by so much that packing them pays; not between a coat and a diffuse base."""
    media = any(medium is not None and medium.scatters for medium in stack.media)
    return media or not all(interface.flat for interface in stack.interfaces[1:])


def _weight(own: Array, other: Array) -> Array:
    """Power heuristic: the weight of the strategy of density `own` against `other` for the same path."""
    own, other = dr.square(dr.detach(own)), dr.square(dr.detach(other))
    return own / at_least(own + other, 1e-36)


def _uint(w: Vector) -> Any:
    return dr.uint32_array_t(dr.value_t(type(w)))


def _enter(
    stack: BoundStack,
    wi: Vector,
    way_out: Exit,
    rng: Generator,
    spectrum: Any,
    max_depth: int | None,
) -> State:
    """Cross the first interface, from either side."""
    last = len(stack.interfaces) - 1
    u = (0.5, uniform(rng, wi), uniform(rng, wi))
    event = stack.interfaces[0].sample(wi, u, above=True, part="transmit", rng=rng)
    d, weight, pdf, delta = event.o, event.weight, event.pdf, stack.interfaces[0].delta
    alive = (wi.z > 0) & (d.z < 0)
    region: Any = 1
    if not stack.opaque:
        below = stack.interfaces[last].sample(mirror(wi), u, above=False, part="transmit", rng=rng)
        up = wi.z > 0
        alive = dr.select(up, alive, (wi.z < 0) & (below.o.z < 0))
        d = dr.select(up, d, mirror(below.o))
        weight, pdf = dr.select(up, weight, below.weight), dr.select(up, pdf, below.pdf)
        delta = dr.select(up, delta, stack.interfaces[last].delta)
        region = dr.select(up, 1, last)
    light = spectrum(0 + _connect_entrance(stack, wi, way_out, rng))
    state: State = {
        "d": d,
        "throughput": spectrum(dr.select(alive, weight, 0)),  # a path that carries nothing has ended
        "light": light,
        "rng": rng,
        # density of the last sampled direction, in the current region; DELTA before any vertex that can be connected
        "pdf": None if _connects_only(stack) else dr.select(delta, DELTA, pdf),
        "depth": None if max_depth is None else _uint(wi)(0),
        "turn": None if stack.still is None else _uint(wi)(0),
        "region": None if last == 1 else _uint(wi)(region),
        "t": None,
        # lanes that met only smooth interfaces in this turn
        "calm": None,
    }
    if any(medium is not None and medium.scatters for medium in stack.media):
        state["t"] = entry_height(d)
    return state


def _connect_entrance(stack: BoundStack, wi: Vector, way_out: Exit, rng: Generator) -> Array:
    """Connect the entrance itself to the exit ray: wi refracts straight into its direction."""
    light = 0 * wi.x
    for above in (True,) if stack.opaque else (True, False):
        interface, region = (
            (stack.interfaces[0], 1) if above else (stack.interfaces[-1], len(stack.interfaces) - 1)
        )
        meets = way_out.meets(region, up=not above)
        if meets is False or interface.delta is True:
            continue
        w, c = (wi, way_out.c) if above else (mirror(wi), mirror(way_out.c))
        value, pdf = interface.transmit(w, c, above, part="transmit", rng=rng)
        value = value * _weight(way_out.pdf, pdf * way_out.jacobian)
        light = light + dr.select((w.z > 0) & meets, way_out.carry(value, region), 0)
    return light


def _advance(stack: BoundStack, s: State, wo: Vector, way_out: Exit, region: int, down: bool) -> None:
    """One region, and the interface ahead, for the lanes that travel there."""
    here = (s["d"].z < 0) if down else (s["d"].z >= 0)
    if s["region"] is not None:
        here = here & (s["region"] == region)
    interface = stack.interfaces[region if down else region - 1]
    # What scatters in the medium does not reach the interface: the same two numbers serve either.
    medium = stack.media[region]
    u = (0.5, 0.5)
    if interface.delta is not True or (medium is not None and medium.scatters):
        u = (uniform(s["rng"], s["d"]), uniform(s["rng"], s["d"]))
    if medium is not None:
        here = _fly(stack, s, way_out, region, here, u)
    _meet(stack, s, wo, way_out, region, down, here, u)


def _fly(stack: BoundStack, s: State, way_out: Exit, region: int, here: Any, u: tuple[Array, Array]) -> Any:
    """Cross the medium or collide in it; returns the lanes that arrive at the interface ahead."""
    medium = stack.media[region]
    assert medium is not None
    d, rng = s["d"], s["rng"]
    if not medium.scatters:
        passed = medium.transmittance(1.0, inverse_cosine(d.z))
        s["throughput"] = dr.select(here, s["throughput"] * passed, s["throughput"])
        return here
    channel = uniform(rng, d) if channels(medium.depth) else 0.0
    flight = medium.fly(s["t"], d, s["throughput"], uniform(rng, d), uniform(rng, d), channel)
    phase = medium.phase_at(flight.t)
    for up in (True, False):
        meets = way_out.meets(region, up)
        if meets is False:
            continue
        # All collisions on the way send light along the exit ray, whichever the walk then takes.
        density = phase.eval(d, way_out.c)
        value = (
            density * way_out.weight * medium.transmittance(flight.t if up else 1 - flight.t, way_out.inv_cos)
        )
        if not phase.flat:
            value = value * _weight(way_out.pdf, density * way_out.jacobian)
        s["light"] = s["light"] + dr.select(here & meets, s["throughput"] * (flight.scattered * value), 0)
    hit = here & flight.collided
    after = phase.sample(d, u[1], u[0])
    s["throughput"] = dr.select(here, s["throughput"] * flight.weight, s["throughput"])
    if stack.still is not None:
        s["throughput"] = dr.select(hit, s["throughput"] * relative(phase.eval(d, after)), s["throughput"])
    if s["pdf"] is not None:
        s["pdf"] = dr.select(hit, 0.0 if phase.flat else dr.detach(phase.eval(d, after)), s["pdf"])
    s["d"] = dr.select(hit, after, d)
    s["t"] = dr.select(hit, flight.t, s["t"])
    _count(s, hit)
    if s["calm"] is not None:
        s["calm"] = s["calm"] & negate(hit)
    return here & negate(flight.collided)


def _meet(
    stack: BoundStack,
    s: State,
    wo: Vector,
    way_out: Exit,
    region: int,
    down: bool,
    here: Any,
    u: tuple[Array, Array],
) -> None:
    """Scatter at the interface ahead of the lanes `here`."""
    k = region if down else region - 1
    interface, d = stack.interfaces[k], s["d"]
    outer = k in (0, len(stack.interfaces) - 1) and not interface.opaque
    w = -d if down else mirror(-d)
    if outer and s["pdf"] is not None:
        _arrive(stack, s, wo, k, here)
    if interface.delta is not True:
        _connect(s, interface, way_out, k, down, outer, w, here)
    # Beyond an outer interface lies no way to wo but the one just counted: the walk goes on inside only.
    choice = 0.5 if outer or interface.opaque else uniform(s["rng"], d)
    event = interface.sample(w, (choice, *u), above=down, part="reflect" if outer else "both", rng=s["rng"])
    o = event.o if down else mirror(event.o)
    s["throughput"] = dr.select(here, s["throughput"] * event.weight, s["throughput"])
    if s["pdf"] is not None:
        s["pdf"] = dr.select(here, _density(interface, event, s["pdf"], w, down), s["pdf"])
    s["d"] = dr.select(here, o, d)
    if s["t"] is not None:
        s["t"] = dr.select(here, entry_height(o), s["t"])
    if s["region"] is not None and not outer and event.through is not False:
        beyond = region + 1 if down else region - 1
        s["region"] = dr.select(here & event.through, type(s["region"])(beyond), s["region"])
    if s["calm"] is not None and interface.delta is not True and not stack.tilted:
        s["calm"] = s["calm"] & negate(here if interface.delta is False else here & negate(interface.delta))
    _count(s, here)


def _density(interface: Interface, event: Scatter, before: Array, w: Vector, down: bool) -> Array:
    """Density of the sampled direction; a smooth event passes on the density of what came before it."""
    if interface.flat:
        return 0 * before
    if interface.delta is False:
        return event.pdf
    passed = before
    if event.through is not False:
        bent = interface.stretch(w, event.o, down)
        passed = at_most(before * dr.select(event.through, bent, 1.0), DELTA)  # its square must stay finite
    return passed if interface.delta is True else dr.select(interface.delta, passed, event.pdf)


def _connect(
    s: State, interface: Interface, way_out: Exit, k: int, down: bool, outer: bool, w: Vector, here: Any
) -> None:
    """Strategy one: send the light from interface k along the exit ray."""
    c = way_out.c if down else mirror(way_out.c)
    for through in (False,) if outer or interface.opaque else (False, True):
        region = k + 1 if through == down else k
        meets = way_out.meets(region, up=down != through)
        if meets is False:
            continue
        value, pdf = (
            interface.transmit(w, c, down, rng=s["rng"])
            if through
            else interface.reflect(w, c, down, "reflect" if outer else "both", rng=s["rng"])
        )
        if s["pdf"] is not None and not interface.flat:
            value = value * _weight(way_out.pdf, pdf * way_out.jacobian)
        s["light"] = s["light"] + dr.select(here & meets, s["throughput"] * way_out.carry(value, region), 0)


def _arrive(stack: BoundStack, s: State, wo: Vector, k: int, here: Any) -> None:
    """Strategy two: what the outer interface k sends along wo of the light that arrives along d."""
    interface: Any = stack.interfaces[k]
    above = k == 0
    if interface.delta is True:
        return
    seen, inside = (wo, -s["d"]) if above else (mirror(wo), mirror(-s["d"]))
    if interface.tilted:
        value, pdf = interface.back(seen, inside, above, part="transmit", rng=s["rng"])
    else:
        value, pdf = interface.transmit(seen, inside, above, part="transmit", rng=s["rng"])
        value = value * flux_back(stack, wo, inside, above)
    value = value * _weight(s["pdf"], pdf)
    s["light"] = s["light"] + dr.select(here & (seen.z > 0), s["throughput"] * value, 0)


def _count(s: State, here: Any) -> None:
    if s["depth"] is not None:
        s["depth"] = dr.select(here, s["depth"] + 1, s["depth"])


def _roulette_threshold(stack: BoundStack) -> float:
    scatters = any(medium is not None and medium.scatters for medium in stack.media)
    return ROULETTE_SCATTERING if scatters else ROULETTE


def _roulette(s: State, like: Vector, threshold: float, max_depth: int | None, live: bool) -> None:
    """End paths that carry little, in proportion; the rest carry more."""
    u = uniform(s["rng"], like)
    carried = peak(dr.detach(s["throughput"]))
    if s["calm"] is None and not live and not channels(s["throughput"]):
        # survival = carried / threshold, without its division: who survives carries the threshold at least
        alive, after = u * threshold < carried, at_least(s["throughput"], threshold)
    else:
        survival = at_most(carried * (1 / threshold), 1)
        if s["calm"] is not None:
            survival = dr.select(s["calm"], at_most(survival, CALM), survival)
            s["calm"] = None
        alive, after = u < survival, s["throughput"] * dr.rcp(at_least(survival, 1e-30))
    if max_depth is not None:
        alive = alive & (s["depth"] < max_depth)
    s["throughput"] = dr.select(alive, after, 0)
