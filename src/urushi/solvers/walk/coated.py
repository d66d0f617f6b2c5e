"""The walk between a coat and a rough metal, with nothing that scatters between them.

The same light as in `walk`, connected only, with what is special here: a path may begin at either end (`ends`), facets
are chosen in pairs (`opposite`), and paths hit the metal from above and the coat from below, in turn. Inside,
directions point away from the surface that they leave or meet.

Paths that end wait for those that go on, in a vector unit, and for two turns anyway (`stages`): so there is no roulette
after the first turn, and the second is where it begins.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...interfaces import Scatter
from ...interfaces.conductor import BoundConductor
from ...interfaces.dielectric import BoundDielectric
from ...media import inverse_cosine
from ...optics.random import Generator, uniform, uniform_three
from ...optics.vectors import Array, Vector, at_least, channels, halfway, peak
from ..bound import BoundStack
from .ends import begin, weight
from .opposite import coat_facet, leaning_facet, leans, metal_facet, paired
from .stages import in_stages

State = dict[str, Any]

#: throughput below which the roulette begins
ROULETTE = 0.35


def between(
    stack: BoundStack,
    wi: Vector,
    wo: Vector,
    rng: Generator,
    spectrum: Any,
    max_depth: int | None,
    staged: bool,
    seen: Array,
) -> Array:
    """`walk.estimate` where `ends.either_way` says so; `seen` is to be added to."""
    coat, base = stack.interfaces
    assert isinstance(coat, BoundDielectric) and isinstance(base, BoundConductor)
    metal = base.facets
    assert metal is not None
    lit, cos = (wi.z > 0) & (wo.z > 0), wo.z
    lean_i, lean_o = leans(coat, base, wi, wo) if paired(coat.facets, coat.delta) else (None, None)
    turned, odds = begin(wi, wo, rng)
    if lean_i is not None:
        lean_i, lean_o = dr.select(turned, lean_o, lean_i), dr.select(turned, lean_i, lean_o)
    wi, wo = dr.select(turned, wo, wi), dr.select(turned, wi, wo)
    leave, enter = _cross(coat, wo, lean_o, rng), _cross(coat, wi, lean_i, rng)
    c, w = -leave.o, -enter.o
    # Reciprocity, at the exit and for a path that began at wo: only the cosine of the wo that was asked for remains.
    back = dr.square(stack.indices[0] / stack.indices[1]) * cos * inverse_cosine(c.z)
    way_out = leave.weight * back * _across(stack, c)
    throughput = dr.select(lit, enter.weight * _across(stack, w), 0)
    value, _ = base.reflect(w, c, True)
    event, rarity = _first_hit(coat, base, w, rng)
    state: State = {
        "d": w,
        "throughput": spectrum(throughput),
        "light": spectrum(seen + throughput * value * way_out),
        "rng": rng,
        "first": odds * rarity,
        "depth": None if max_depth is None else dr.uint32_array_t(dr.value_t(type(w)))(0),
    }
    _back_to_metal(stack, state, event, spectrum, max_depth, True)

    def turn(s: State, fixed: tuple[Any, ...]) -> State:
        c, way_out = fixed
        w, throughput = s["d"], s["throughput"]
        value, _ = base.reflect(w, c, True)
        last = metal.rarity(halfway(base.frame.enter(w), base.frame.enter(c)))
        s["light"] = spectrum(s["light"] + throughput * (value * weight(s["first"], last)) * way_out)
        *u, u_roulette = uniform_three(s["rng"], w)
        _back_to_metal(stack, s, base.sample(w, (0.5, *u), True), spectrum, max_depth, False)
        s["throughput"] = spectrum(_roulette(s["throughput"], u_roulette))
        return s

    # `weight` leaves out the chance for this end.
    fixed = (c, spectrum(dr.fma(way_out, odds, way_out)))
    if staged:
        return in_stages(state, fixed, _carries, turn, done=1)
    (state,) = dr.while_loop((state,), _carries, lambda s: (turn(dict(s), fixed),), label="walk")
    return state["light"]


def _carries(s: State) -> Any:
    return peak(s["throughput"]) > 0


def _cross(coat: BoundDielectric, w: Vector, lean: Vector | None, rng: Generator) -> Scatter:
    """Through the coat, from w above it."""
    w = type(w)(w.x, w.y, dr.abs(w.z))  # what is below carries nothing, but must be a number
    if coat.delta is True:
        return coat.sample(w, (0.5, 0.5, 0.5), True, "transmit")
    u = uniform_three(rng, w)
    if lean is None:
        return coat.sample(w, (0.5, u[0], u[1]), True, "transmit")
    w = coat.frame.enter(w)
    m, weighs = leaning_facet(coat, w, lean, u)
    event = coat.at_facet(w, m, 0.5, True, "transmit")
    event.weight = event.weight * weighs
    return event


def _first_hit(
    coat: BoundDielectric, base: BoundConductor, w: Vector, rng: Generator
) -> tuple[Scatter, Array]:
    """Off the metal, and 1 / D of the facet."""
    u = uniform_three(rng, w)
    w = base.frame.enter(w)
    assert base.facets is not None
    if not paired(base.facets, base.delta):
        m = base.facets.sample(w, u[0], u[1])
        return base.at_facet(w, m), base.facets.rarity(m)
    m, weighs = metal_facet(base, coat, w, u)
    event = base.at_facet(w, m)
    event.weight = event.weight * weighs
    return event, base.facets.rarity(m)


def _back_to_metal(
    stack: BoundStack, s: State, event: Scatter, spectrum: Any, max_depth: int | None, first: bool
) -> None:
    """From the metal up to the coat and down again."""
    coat: Any = stack.interfaces[0]
    rng, up = s["rng"], event.o
    w = type(up)(-up.x, -up.y, up.z)
    if coat.delta is True:
        down = coat.sample(w, (0.5, 0.5, 0.5), False, "reflect")
    elif first and paired(coat.facets, coat.delta):
        u = uniform_three(rng, w)
        w = coat.frame.enter(w)
        m, weighs = coat_facet(coat, w, u)
        down = coat.at_facet(w, m, 0.5, False, "reflect")
        down.weight = down.weight * weighs
    else:
        down = coat.sample(w, (0.5, uniform(rng, w), uniform(rng, w)), False, "reflect")
    s["d"] = type(up)(-down.o.x, -down.o.y, down.o.z)
    kept = event.weight * _across(stack, up) * down.weight * _across(stack, s["d"])
    s["throughput"] = spectrum(s["throughput"] * kept)
    if max_depth is not None:
        s["depth"] = s["depth"] + 2
        s["throughput"] = spectrum(dr.select(s["depth"] < max_depth, s["throughput"], 0))


def _across(stack: BoundStack, w: Vector) -> Array:
    """Transmittance between the coat and the metal."""
    medium = stack.media[1]
    return 1.0 if medium is None else medium.transmittance(1.0, inverse_cosine(w.z))


def _roulette(throughput: Array, u: Array) -> Array:
    """End paths that carry less than the threshold, in proportion; the rest carry that much."""
    carried = peak(throughput)
    after = at_least(throughput, ROULETTE)
    if channels(throughput):
        after = throughput * at_least(ROULETTE * dr.rcp(at_least(carried, 1e-30)), 1)
    return dr.select(u * ROULETTE < carried, after, 0)
