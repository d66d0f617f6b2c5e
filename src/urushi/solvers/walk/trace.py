"""Where light from wi ends up: the walk without a wo, for reflectance and transmittance.

At an outermost interface the walk does both at once, with the same facet: what gets out is counted, what is reflected
inside goes on. So every path counts something, and no chance decides between the two.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from ...interfaces import Scatter
from ...media import entry_height, inverse_cosine
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, at_least, at_most, channels, mirror, negate, peak
from ..bound import CALM, BoundStack
from .derivative import MOST_SWEEPS, relative, run

State = dict[str, Any]

#: throughput below which the roulette begins
ROULETTE = 0.25


def trace(
    stack: BoundStack,
    wi: Vector,
    rng: Generator,
    spectrum: Any,
    max_depth: int | None = None,
    tally: Any = None,
) -> tuple[Array, ...]:
    """One sample of the flux that leaves upwards and downwards, for light of flux 1 from wi (delta parts included).

    With a `tally` (`ledger.Tally`), what it counted follows.
    """
    last = len(stack.interfaces) - 1
    uint = dr.uint32_array_t(dr.value_t(type(wi)))
    u = (0.5, uniform(rng, wi), uniform(rng, wi))
    top = stack.interfaces[0]
    back = top.sample(wi, u, above=True, part="reflect", rng=rng)
    on = top.sample(wi, u, above=True, part="transmit", rng=rng)
    if last == 0 and top.stochastic and not top.opaque:
        on = _rest(on, back)
    lit = wi.z > 0
    counts = None if tally is None else tally.entered(spectrum, 0, wi, back, on, lit)
    up_flux = spectrum(0) + dr.select(lit & (back.o.z > 0), back.weight, 0)
    down_flux = spectrum(0) + 0 * wi.x
    if top.opaque:
        return up_flux, down_flux, *(counts or ())
    d, weight, region = on.o, dr.select(lit & (on.o.z < 0), on.weight, 0), uint(1)
    if not stack.opaque:
        bottom = stack.interfaces[last]
        below = wi.z < 0
        back_low = bottom.sample(mirror(wi), u, above=False, part="reflect", rng=rng)
        on_low = bottom.sample(mirror(wi), u, above=False, part="transmit", rng=rng)
        if last == 0 and bottom.stochastic:
            on_low = _rest(on_low, back_low)
        if counts is not None:
            more = tally.entered(spectrum, last, mirror(wi), back_low, on_low, below)
            counts = [spectrum(a + b) for a, b in zip(counts, more, strict=True)]
        down_flux = down_flux + dr.select(below & (back_low.o.z > 0), back_low.weight, 0)
        d = dr.select(below, mirror(on_low.o), d)
        weight = dr.select(below & (on_low.o.z < 0), on_low.weight, weight)
        region = dr.select(below, uint(last), region)
    if last == 0:
        low = down_flux + dr.select(lit, weight, 0)
        return up_flux + dr.select(wi.z < 0, weight, 0), low, *(counts or ())
    state: State = {
        "d": d,
        "throughput": spectrum(weight),
        "up": spectrum(up_flux),
        "down": spectrum(down_flux),
        "region": region,
        "t": entry_height(d),
        "turn": None if stack.still is None else uint(0),
        "depth": uint(0) + 0 * region,
        "rng": rng,
        "calm": None,  # lanes that met only smooth interfaces in this turn
        "counts": counts,
    }

    def body(stack: BoundStack, s: State) -> State:
        s["calm"] = True if stack.traps else None
        for down in (True, False):
            for r in stack.regions if down else reversed(stack.regions):
                _advance(stack, s, r, down, tally)
        survival = at_most(peak(dr.detach(s["throughput"])) * (1 / ROULETTE), 1)
        if s["calm"] is not None:
            survival = dr.select(s["calm"], at_most(survival, CALM), survival)
            s["calm"] = None
        alive = uniform(s["rng"], s["d"]) < survival
        if max_depth is not None:
            alive = alive & (s["depth"] < max_depth)
        if stack.still is not None:
            s["turn"] = s["turn"] + 1
            alive = alive & (s["turn"] < MOST_SWEEPS)
        s["throughput"] = dr.select(alive, s["throughput"] / at_least(survival, 1e-30), 0)
        # Mitsuba's spectra forget their name in arithmetic; a loop insists on the type it began with.
        s.update({name: spectrum(s[name]) for name in ("throughput", "up", "down")})
        if s["counts"] is not None:
            s["counts"] = [spectrum(value) for value in s["counts"]]
        return s

    if max_depth == 0:
        return state["up"], state["down"], *(counts or ())
    state, rest = run(stack, state, _carries, body, "trace")
    if rest is None:
        return state["up"], state["down"], *(state["counts"] or ())
    assert stack.still is not None
    rest.update(up=0 * rest["up"], down=0 * rest["down"])
    rest, _ = run(stack.still, rest, _carries, body, "trace on")
    share = relative(state["throughput"])
    return state["up"] + rest["up"] * share, state["down"] + rest["down"] * share


def _rest(on: Scatter, back: Scatter) -> Scatter:
    """What a walk between facets does not reflect, it transmits: a walk for each would add up to 1 in the mean only."""
    below = type(on.o)(on.o.x, on.o.y, -dr.abs(on.o.z))
    return replace(on, o=below, weight=1 - dr.select(back.o.z > 0, back.weight, 0))


def _carries(s: State) -> Any:
    return peak(dr.detach(s["throughput"])) > 0


def _advance(stack: BoundStack, s: State, region: int, down: bool, tally: Any = None) -> None:
    """One region, and the interface ahead."""
    d, rng, medium = s["d"], s["rng"], stack.media[region]
    here = (s["region"] == region) & ((d.z < 0) if down else (d.z >= 0))
    if medium is not None and medium.scatters:
        channel = uniform(rng, d) if channels(medium.depth) else 0.0
        flight = medium.fly(s["t"], d, s["throughput"], uniform(rng, d), uniform(rng, d), channel)
        if tally is not None:
            tally.flown(s, region, here, flight)
        phase = medium.phase_at(flight.t)
        after = phase.sample(d, uniform(rng, d), uniform(rng, d))
        hit = here & flight.collided
        s["throughput"] = dr.select(here, s["throughput"] * flight.weight, s["throughput"])
        if stack.still is not None:
            s["throughput"] = dr.select(
                hit, s["throughput"] * relative(phase.eval(d, after)), s["throughput"]
            )
        s["d"] = d = dr.select(hit, after, d)
        s["t"] = dr.select(hit, flight.t, s["t"])
        s["depth"] = dr.select(hit, s["depth"] + 1, s["depth"])
        if s["calm"] is not None:
            s["calm"] = s["calm"] & negate(hit)
        here = here & negate(flight.collided)
    elif medium is not None:
        if tally is not None:
            tally.flown(s, region, here)
        passed = medium.transmittance(1.0, inverse_cosine(d.z))
        s["throughput"] = dr.select(here, s["throughput"] * passed, s["throughput"])
    k = region if down else region - 1
    interface = stack.interfaces[k]
    outer = k in (0, len(stack.interfaces) - 1) and not interface.opaque
    w = -d if down else mirror(-d)
    u = (uniform(rng, d), uniform(rng, d), uniform(rng, d))
    if outer:
        out = interface.sample(w, u, above=down, part="transmit", rng=rng)
        side = "down" if down else "up"
        s[side] = s[side] + dr.select(here & (out.o.z < 0), s["throughput"] * out.weight, 0)
    event = interface.sample(w, u, above=down, part="reflect" if outer else "both", rng=rng)
    if tally is not None:
        tally.met(s, k, w, event, out if outer else None, here)
    o = event.o if down else mirror(event.o)
    s["throughput"] = dr.select(here, s["throughput"] * event.weight, s["throughput"])
    s["d"] = dr.select(here, o, d)
    s["t"] = dr.select(here, entry_height(o), s["t"])
    s["depth"] = dr.select(here, s["depth"] + 1, s["depth"])
    if s["calm"] is not None and interface.delta is not True and not stack.tilted:
        s["calm"] = s["calm"] & negate(here if interface.delta is False else here & negate(interface.delta))
    if event.through is not False and not outer:
        beyond = region + 1 if down else region - 1
        s["region"] = dr.select(here & event.through, type(s["region"])(beyond), s["region"])
