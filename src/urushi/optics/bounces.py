"""Walks among the facets of a microsurface: one that ends where it gets out, one that asks what leaves along o.

Heitz, Hanika, d'Eon & Dachsbacher 2016, Multiple-scattering microfacet BSDFs with the Smith model, in the depths of
`optics.microsurface`. What differs lowers the variance of the second (after Wang et al. 2022 and Bitterli & d'Eon
2022):

    - The depth of the last facet is integrated in closed form where light leaves on the side that it came from; for two
      reflections so is the first.
    - The last direction inside is sampled in two ways, onwards from a facet and backwards from o, weighed by the power
      heuristic: a sharp reflection is found from the side from which it looks broad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .exponential import decay
from .facets import Event
from .microsurface import Microsurface, exponential, fly, follow, other_depth, seen_next, seen_second
from .random import Generator, uniform
from .vectors import Array, Vector, at_least, at_most, negate, peak

State = dict[str, Any]

#: throughput below which the roulette begins
ROULETTE = 0.25


@dataclass
class Way:
    """Light after its first facet.

    Attributes:
        t, d: its depth and direction, in the frame of the side it is on.
        density: of `d`.
        weight: its throughput.
        inside: mask of the lanes on the other side than the first.
        going: mask of the lanes that have a way.
        w: where it came from.
        fallen: depth of the first facet, on the first side.
        first: rate of facets on the way down.
    """

    t: Array
    d: Vector
    density: Array
    weight: Array
    inside: Any
    going: Any
    w: Vector
    fallen: Array
    first: Array


def begin(surface: Microsurface, w: Vector, event: Event, weight: Array, going: Any, rng: Generator) -> Way:
    """The way after the first facet, which light from w met; `weight` has the factor of the event in it."""
    first = surface.rate(w, surface.area(w))
    t = exponential(rng, w) / first
    later, d = _cross(t, event.d, event.through)
    return Way(later, d, event.density, weight, event.through, going, w, t, first)


def _flip(d: Vector, through: Any) -> Vector:
    return d if through is False else type(d)(d.x, d.y, dr.select(through, -d.z, d.z))


def _cross(t: Array, d: Vector, through: Any) -> tuple[Array, Vector]:
    """Depth and direction as the other side has them, on the lanes that went through."""
    return (t, d) if through is False else (dr.select(through, other_depth(t), t), _flip(d, through))


def escape(surface: Microsurface, facet: Any, way: Way, rng: Generator) -> tuple[Vector, Array, Any]:
    """Follow light until it gets out.

    Returns:
        (direction in the frame of the first side, throughput, mask of what left on the other side).
    """

    def fly_on(s: State) -> None:
        w = -s["d"]
        rate = surface.rate(w, surface.area(w))
        s["t"], meets = fly(s["t"], s["d"], rate, exponential(s["rng"], w))
        s["going"] = s["going"] & meets

    def body(s: State) -> tuple[State]:
        _scatter(surface, facet, s, way)
        fly_on(s)
        return (s,)

    state = _state(way, facet, rng)
    fly_on(state)
    (out,) = dr.while_loop((state,), lambda s: s["going"], lambda s: body(dict(s)), label="escape")
    follow(rng, out["rng"])
    if not facet.sides:
        return out["d"], out["weight"], False
    return _flip(out["d"], out["inside"]), out["weight"], out["inside"]


@dataclass
class Last:
    """The last direction before light leaves along o, sampled backwards from o.

    Attributes:
        d: the direction, in the frame of the side it is on.
        inside: mask of the lanes where that is the other side than the first.
        across: mask of the lanes where o is on the other side than `d`.
        factor: density of scattering into o over that of the sampling, with what the facet leaves.
        density: of `d`, as sampled.
        rate: of facets along d.
    """

    d: Vector
    inside: Any
    across: Any
    factor: Array
    density: Array
    rate: Array


def _last(surface: Microsurface, facet: Any, o: Vector, rng: Generator) -> Last:
    beyond = o.z < 0 if facet.sides else False
    up = type(o)(o.x, o.y, dr.abs(o.z))
    area = surface.area(up)
    event = facet.scatter(surface, up, surface.normal(up, rng), area, beyond, rng)
    v = _flip(event.d, event.through)
    # Reciprocity: what a facet sends from v to o is what it sends from o to v, by projected areas and squared indices.
    reverse = area / surface.area(v)
    if facet.sides:
        reverse = reverse * dr.select(event.through, dr.square(facet.ratio(beyond)[1]), 1.0)
        inside = beyond ^ event.through
    else:
        inside = False
    return Last(
        -v,
        inside,
        event.through,
        event.factor * reverse,
        event.density,
        surface.rate(v, surface.area(v)),
    )


def _weight(own: Array, other: Array) -> Array:
    """Power heuristic."""
    return dr.rcp(1 + dr.square(other / at_least(own, 1e-30)))


def gather(surface: Microsurface, facet: Any, way: Way, o: Vector, rng: Generator) -> Array:
    """What leaves along o (in the frame of the first side, z on either) after one facet more or any number of them."""
    colour = type(way.weight)
    up = type(o)(o.x, o.y, dr.abs(o.z))
    area_o, masking = surface.area(up), surface.masking(up)
    two_way = not facet.estimated
    last = _last(surface, facet, o, rng) if two_way else None

    def leave(t: Array, d: Vector, rate: Array, across: Any, reach: Any) -> Array:
        """What of the light at depth t along d gets out along o; `reach` is where it meets a facet."""
        seen = seen_next(t, d, rate, masking)
        if not facet.sides:
            return seen
        later, meets = reach
        return dr.select(across, dr.select(meets, decay(masking * other_depth(later)), 0), seen)

    def connect(w: Vector, t: Array, area: Array, inside: Any, young: Any, rng: Generator) -> Array:
        """From a facet at depth t, by way of the last direction."""
        assert last is not None
        through = inside ^ last.inside if facet.sides else False
        density, factor = facet.toward(surface, w, _flip(last.d, through), area, through, inside)
        reach = None
        if facet.sides:
            t = dr.select(through, other_depth(t), t)
            reach = fly(t, last.d, last.rate, exponential(rng, w))
        out = leave(t, last.d, last.rate, last.across, reach)
        if young is not False:
            both = seen_second(way.first, last.d, last.rate, masking)
            out = dr.select(young & negate(through | last.across), both, out) if facet.sides else both
        return factor * last.factor * (density * out * _weight(last.density, density))

    def look(s: State, young: bool) -> None:
        """What leaves after the next facet, and on to that one."""
        w, rng = -s["d"], s["rng"]
        area = surface.area(w)
        rate = surface.rate(w, area)
        reach = fly(s["t"], s["d"], rate, exponential(rng, w))
        across, seen, reverse = False, o, area / area_o
        if facet.sides:
            across = s["inside"] ^ (o.z < 0)
            seen = _flip(o, s["inside"])
            reverse = reverse * dr.select(across, dr.square(facet.ratio(s["inside"])[1]), 1.0)
        out = leave(s["t"], s["d"], rate, across, reach)
        if young:
            both = seen_second(way.first, s["d"], rate, masking)
            out = dr.select(across | s["inside"], out, both) if facet.sides else both
        if facet.estimated:
            density, factor = facet.toward_one(surface.normal(w, rng), seen)
        else:
            density, factor = facet.toward(surface, w, seen, area, across, s["inside"])
            out = out * _weight(s["density"], density * reverse)
        found = s["weight"] * (factor * (density * out))
        s["light"] = colour(s["light"] + dr.select(s["going"], found, 0))
        s["t"], meets = reach
        s["going"] = s["going"] & meets

    def body(s: State) -> tuple[State]:
        if two_way:
            w = -s["d"]
            more = connect(w, s["t"], surface.area(w), s["inside"], False, s["rng"])
            s["light"] = colour(s["light"] + dr.select(s["going"], s["weight"] * more, 0))
        _scatter(surface, facet, s, way)
        look(s, False)
        return (s,)

    state = _state(way, facet, rng)
    light = 0 * way.weight
    if two_way:
        state["density"] = way.density
        start = connect(way.w, way.fallen, surface.area(way.w), False, True, rng)
        light = dr.select(way.going, light + start, 0)
    state["light"] = colour(light)
    look(state, True)
    (out,) = dr.while_loop((state,), lambda s: s["going"], lambda s: body(dict(s)), label="gather")
    follow(rng, out["rng"])
    return out["light"]


def _state(way: Way, facet: Any, rng: Generator) -> State:
    state = {"t": way.t, "d": way.d, "weight": way.weight, "going": way.going, "rng": rng}
    state["inside"] = way.inside if facet.sides else None
    return state


def _scatter(surface: Microsurface, facet: Any, s: State, way: Way) -> None:
    """Meet a facet, on the lanes that are going; light that carries little may end here."""
    going, w, rng = s["going"], -s["d"], s["rng"]
    event = facet.scatter(surface, w, surface.normal(w, rng), surface.area(w), s["inside"], rng)
    t, d = _cross(s["t"], event.d, event.through)
    if facet.sides:
        s["inside"] = s["inside"] ^ (going & event.through)
    s["t"], s["d"] = dr.select(going, t, s["t"]), dr.select(going, d, s["d"])
    if "density" in s:
        s["density"] = dr.select(going, event.density, s["density"])
    if facet.lossless:
        return
    weight = s["weight"] * event.factor
    survival = at_most(peak(weight) * (1 / ROULETTE), 1)
    alive = uniform(rng, w) < survival
    weight = dr.select(alive, weight * dr.rcp(at_least(survival, 1e-30)), 0)
    s["weight"] = type(way.weight)(dr.select(going, weight, s["weight"]))
    s["going"] = going & alive
