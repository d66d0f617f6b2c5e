"""The way out: where a path must be headed, at its last vertices, to leave along wo.

Light that leaves along wo crosses one last interface. Its direction before that is sampled backwards, from wo, with
the interface's own sampling (after Guo et al. 2018, section 5), and any vertex of the walk can then be connected to
it: theory (walk.7, walk.8). Behind a smooth interface nothing can be connected: where smooth interfaces lie inside
the stack the backward ray goes on through them, reflecting and refracting, until what it meets next may scatter. So a
path is cut at its first scattering vertex seen from wo, in one way only, and the estimate is exact for any number of
smooth interfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr

from ...media import inverse_cosine
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, at_least, mirror, negate, total
from ..bound import CALM, BoundStack
from .derivative import MOST_SWEEPS, relative, run

#: stands for the density of a delta distribution in MIS ratios; its square still fits single precision
DELTA = 1e18


@dataclass
class Exit:
    """The end of a path, sampled from wo.

    Attributes:
        c: propagation direction of the light before the exit, in region `region`.
        weight: flux density towards wo over sampling density; 0 on lanes without a way out.
        pdf: density of the direction next to the exit interface, as sampled; `DELTA` where that is smooth.
        jacobian: solid angle at `c` over solid angle next to the exit interface, for the same light.
        region: the region that `c` lies in: an int, or one per lane.
        places: all (region, upwards) that can occur.
        across: transmittance of the whole of each region along c (None: nothing in it).
        inv_cos: 1 / |cos| of c.
    """

    c: Vector
    weight: Array
    pdf: Array
    jacobian: Array
    region: Any
    places: set[tuple[int, bool]]
    inv_cos: Array | None = None
    across: dict[int, Array | None] = field(default_factory=dict)

    def meets(self, region: int, up: bool) -> Any:
        """Mask of the lanes whose exit ray travels in this region and sense; False if none can."""
        if (region, up) not in self.places:
            return False
        if len(self.places) == 1:
            return True
        here: Any = (self.c.z > 0) if up else (self.c.z < 0)
        if not isinstance(self.region, int) or len({place[0] for place in self.places}) > 1:
            here = here & (self.region == region)
        return here

    def carry(self, value: Array, region: int) -> Array:
        """What of a flux density that an interface sends along c, through all of `region`, leaves along wo."""
        across = self.across[region]
        return value * self.weight if across is None else value * (self.weight * across)

    def numbers(self) -> tuple[Any, ...]:
        """What differs from lane to lane, but for what follows from it."""
        return self.c, self.weight, self.pdf, self.jacobian, self.region

    def moved(
        self, stack: BoundStack, c: Vector, weight: Array, pdf: Array, jacobian: Array, region: Any
    ) -> Exit:
        """The same with other `numbers`."""
        end = Exit(c, weight, pdf, jacobian, region, self.places)
        end.inv_cos = inverse_cosine(end.c.z)
        for each in stack.regions:
            medium = stack.media[each]
            end.across[each] = None if medium is None else medium.transmittance(1.0, end.inv_cos)
        return end


def flux_back(stack: BoundStack, wo: Vector, inside: Vector, above: bool) -> Array:
    """The factor from the flux density wo -> inside to that of inside -> wo (Helmholtz reciprocity)."""
    near, far = (stack.indices[0], stack.indices[1]) if above else (stack.indices[-1], stack.indices[-2])
    return dr.square(near / far) * dr.abs(wo.z) * inverse_cosine(inside.z)


def sample_exit(stack: BoundStack, wo: Vector, rng: Generator, spectrum: Any) -> Exit:
    """Sample the end of a path that leaves along wo; serves every connection of one walk."""
    last = len(stack.interfaces) - 1
    found = _cross(stack, wo, rng, above=True)
    if not stack.opaque:
        below, up = _cross(stack, wo, rng, above=False), wo.z > 0
        region: Any = 1
        if last > 1:
            region = dr.select(up, 1, last) if isinstance(up, bool) else dr.select(up, _uint(wo)(1), last)
        found = Exit(
            dr.select(up, found.c, below.c),
            dr.select(up, found.weight, below.weight),
            dr.select(up, found.pdf, below.pdf),
            1.0,
            region,
            {(1, True), (last, False)},
        )
    # What the exit ray can run into, other than the interface it came through: smooth there means going on.
    ahead = stack.interfaces if not stack.opaque else stack.interfaces[1:]
    if any(interface.delta is not False for interface in ahead):
        found = _follow(stack, found, rng, spectrum)
    return found.moved(stack, *found.numbers())


def _uint(w: Vector) -> Any:
    return dr.uint32_array_t(dr.value_t(type(w)))


def _cross(stack: BoundStack, wo: Vector, rng: Generator, above: bool) -> Exit:
    interface: Any = stack.interfaces[0 if above else -1]
    # A direction on the other side stands for its mirror image here, and carries nothing.
    seen = type(wo)(wo.x, wo.y, dr.abs(wo.z))
    smooth = interface.delta is True
    u = (0.0, 0.0, 0.0) if smooth else (0.0, uniform(rng, wo), uniform(rng, wo))
    if interface.tilted:
        event = interface.towards(seen, u, above, "transmit", rng)
        found, back = event.w, 1.0
    else:
        event = interface.sample(seen, u, above, part="transmit", rng=rng)
        found, back = event.o, None
    inside = found if above else mirror(found)
    # Total reflection and facets seen from behind carry nothing.
    alive = ((wo.z > 0) if above else (wo.z < 0)) & (found.z < 0)
    back = flux_back(stack, wo, inside, above) if back is None else back
    weight = dr.select(alive, event.weight * back, 0)
    region = 1 if above else len(stack.interfaces) - 1
    pdf = dr.select(interface.delta, DELTA, event.pdf)
    return Exit(-inside, weight, pdf, 1.0, region, {(region, above)})


def _follow(stack: BoundStack, start: Exit, rng: Generator, spectrum: Any) -> Exit:
    """Carry the exit ray on through smooth interfaces, and stop it, at random, where it can be connected to.

    At a rough or diffuse interface it always stops; in a medium before a smooth interface, with the probability that
    light would collide there; outside the stack it is lost. Reflection and transmission are chosen by Fresnel, so the
    forward and the backward walk choose alike, and it cancels in the weights of multiple importance sampling.
    """
    uint = _uint(start.c)
    state = {
        "w": -start.c,  # as the ray travels, away from wo
        "weight": spectrum(start.weight),
        "jacobian": 1 + 0 * start.c.x,
        "region": uint(start.region),
        "going": uint(dr.select(total(dr.detach(start.weight)) > 0, uint(1), uint(0))),
        "turn": None if stack.still is None else uint(0),
        "rng": rng,
    }

    def body(stack: BoundStack, s: dict[str, Any]) -> dict[str, Any]:
        s["going"] = s["going"] > 0
        for down in (True, False):
            for region in stack.regions if down else reversed(stack.regions):
                _advance(stack, s, region, down)
        lost = s["going"] & (uniform(s["rng"], s["w"]) >= CALM)
        kept = dr.select(s["going"], s["weight"] * (1 / CALM), s["weight"])
        s["weight"] = spectrum(dr.select(lost, 0, kept))
        s["going"] = s["going"] & negate(lost)
        if s["turn"] is not None:
            s["turn"] = s["turn"] + 1
            s["going"] = s["going"] & (s["turn"] < MOST_SWEEPS)
        s["going"] = dr.select(s["going"], uint(1), uint(0))  # masks cannot be remembered in reverse mode
        return s

    out, rest = run(stack, state, lambda s: s["going"] > 0, body, "exit ray")
    if rest is not None:
        assert stack.still is not None
        carried = relative(out["weight"])
        out, _ = run(stack.still, rest, lambda s: s["going"] > 0, body, "exit ray on")
        out["weight"] = out["weight"] * carried
    rng.a, rng.b, rng.c, rng.count = out["rng"].a, out["rng"].b, out["rng"].c, out["rng"].count
    places = {(region, up) for region in stack.regions for up in (True, False)}
    return Exit(-out["w"], out["weight"], start.pdf, out["jacobian"], out["region"], places)


def _advance(stack: BoundStack, s: dict[str, Any], region: int, down: bool) -> None:
    """One region, and the interface ahead, for the exit rays that travel there."""
    k = region if down else region - 1
    interface: Any = stack.interfaces[k]
    medium, w = stack.media[region], s["w"]
    here = s["going"] & (s["region"] == region) & ((w.z < 0) if down else (w.z >= 0))
    if interface.delta is False:
        s["going"] = s["going"] & negate(here)
        return
    smooth = here if interface.delta is True else here & interface.delta
    s["going"] = s["going"] & (negate(here) | smooth)
    if medium is not None:
        passed = medium.transmittance(1.0, inverse_cosine(w.z))
        lit = dr.detach(total(s["weight"] * passed))
        hit = dr.detach(total(s["weight"] * (medium.albedo * (1 - passed))))
        p_pass = dr.select(hit > 0, lit / at_least(lit + hit, 1e-30), 1.0)
        stop = smooth & (uniform(s["rng"], w) >= p_pass)
        smooth = smooth & negate(stop)
        s["going"] = s["going"] & negate(stop)
        scaled = dr.select(stop, 1 / at_least(1 - p_pass, 1e-30), passed / at_least(p_pass, 1e-30))
        s["weight"] = dr.select(stop | smooth, s["weight"] * scaled, s["weight"])
    up_frame = -w if down else mirror(-w)
    u = (uniform(s["rng"], w), 0.5, 0.5)
    if interface.tilted:
        event = interface.towards(up_frame, u, down, "both", s["rng"])
        found = event.w
    else:
        event = interface.sample(up_frame, u, above=down, part="both", rng=s["rng"])
        found = event.o
    o = found if down else mirror(found)
    s["weight"] = dr.select(smooth, s["weight"] * event.weight, s["weight"])
    s["w"] = dr.select(smooth, o, w)
    if interface.opaque:
        return
    through = smooth & event.through
    if interface.tilted:
        bent = event.bent  # and in its weight already
    else:
        bent = dr.abs(w.z) / at_least(dr.abs(o.z) * dr.square(interface.ratio(down)), 1e-20)
        s["weight"] = dr.select(through, s["weight"] * bent, s["weight"])
    s["jacobian"] = dr.select(through, s["jacobian"] * bent, s["jacobian"])
    beyond = region + 1 if down else region - 1
    s["region"] = dr.select(through, type(s["region"])(beyond), s["region"])
    if beyond == 0 or beyond > stack.regions[-1]:
        s["going"] = s["going"] & negate(through)
        s["weight"] = dr.select(through, 0, s["weight"])
