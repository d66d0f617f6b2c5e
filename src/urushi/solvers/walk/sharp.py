"""Light that meets nothing but smooth interfaces, where these are not parallel: one path of it at a time.

Between parallel smooth interfaces the mirror direction and Snell's are the only ones (`solvers.smooth`); tilted ones
send light into a new direction at every turn. So `sample` follows one path through them, chosen by Fresnel.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...media import inverse_cosine
from ...optics.random import Generator, uniform
from ...optics.vectors import Array, Vector, mirror, negate
from ..bound import CALM, BoundStack


def follow(stack: BoundStack, wi: Vector, rng: Generator, spectrum: Any) -> tuple[Vector, Array]:
    """(Where one path from wi leaves, its flux); the flux is 0 where it meets anything rough.

    Args:
        stack: with still numbers.
    """
    uint = dr.uint32_array_t(dr.value_t(type(wi)))
    last = len(stack.interfaces) - 1
    o, through, sharp = _meet(stack, 0, wi, True, rng)
    if not stack.opaque:
        low, low_through, low_sharp = _meet(stack, last, mirror(wi), False, rng)
        lit = wi.z > 0
        o = dr.select(lit, o, mirror(low))
        through, sharp = dr.select(lit, through, low_through), dr.select(lit, sharp, low_sharp)
    inside = through if last > 0 else False
    state = {
        "d": o,
        "weight": spectrum(dr.select(sharp, 1.0 + 0 * wi.x, 0.0)),
        "region": dr.select(wi.z > 0, uint(1), uint(max(last, 1))),
        "going": uint(dr.select(sharp & inside, uint(1), uint(0))),
        "rng": rng,
    }
    if last == 0 or stack.interfaces[0].opaque:
        return state["d"], state["weight"]

    def body(s: dict[str, Any]) -> tuple[dict[str, Any]]:
        s = dict(s)
        s["going"] = s["going"] > 0
        for down in (True, False):
            for region in stack.regions if down else reversed(stack.regions):
                _advance(stack, s, region, down)
        lost = s["going"] & (uniform(s["rng"], s["d"]) >= CALM)
        kept = dr.select(s["going"], s["weight"] * (1 / CALM), s["weight"])
        s["weight"] = spectrum(dr.select(lost, 0, kept))
        s["going"] = dr.select(s["going"] & negate(lost), uint(1), uint(0))
        return (s,)

    (state,) = dr.while_loop((state,), lambda s: s["going"] > 0, body, label="sharp")
    return state["d"], state["weight"]


def _meet(stack: BoundStack, k: int, w: Vector, above: bool, rng: Generator) -> tuple[Vector, Any, Any]:
    """(direction after, mask of what went through, mask of what is still one direction)."""
    interface = stack.interfaces[k]
    if interface.delta is False:
        return -w, False, False
    event = interface.sample(w, (uniform(rng, w), 0.5, 0.5), above, rng=rng)
    return event.o, event.through, interface.delta


def _advance(stack: BoundStack, s: dict[str, Any], region: int, down: bool) -> None:
    """One region, and the interface ahead, for the paths that travel there."""
    k = region if down else region - 1
    interface, medium, d = stack.interfaces[k], stack.media[region], s["d"]
    here = s["going"] & (s["region"] == region) & ((d.z < 0) if down else (d.z >= 0))
    rough = here if interface.delta is False else here & negate(interface.delta)
    s["going"] = s["going"] & negate(rough)
    s["weight"] = dr.select(rough, 0, s["weight"])
    here = here & negate(rough)
    if medium is not None:
        passed = medium.transmittance(1.0, inverse_cosine(d.z))
        s["weight"] = dr.select(here, s["weight"] * passed, s["weight"])
    if interface.delta is False:
        return
    w = -d if down else mirror(-d)
    event = interface.sample(w, (uniform(s["rng"], w), 0.5, 0.5), down, rng=s["rng"])
    s["d"] = dr.select(here, event.o if down else mirror(event.o), d)
    s["weight"] = dr.select(here, s["weight"] * event.weight, s["weight"])
    if event.through is False:
        return
    through = here & event.through
    beyond = region + 1 if down else region - 1
    s["region"] = dr.select(through, type(s["region"])(beyond), s["region"])
    if beyond == 0 or beyond > stack.regions[-1]:
        s["going"] = s["going"] & negate(through)
