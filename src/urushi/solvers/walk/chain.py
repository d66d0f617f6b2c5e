"""The exit ray goes on through smooth interfaces inside the stack (see `exit`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from ...optics.vectors import Array, mirror
from ..bound import BoundStack
from .exit import Exit


def follow(stack: BoundStack, start: Exit, draw: Callable[[], Array]) -> Exit:
    """Carry the exit ray on through smooth interfaces, and stop it, at random, where it can be connected to.

    In a medium it stops with the probability that light would collide there; at a rough or diffuse interface always;
    outside the stack it is lost. Choices between reflection and transmission follow Fresnel, so forward and backward
    walk make them alike and they cancel in the weights of multiple importance sampling.
    """
    last = len(stack.interfaces) - 1
    region_t = dr.uint32_array_t(type(start.weight)) if not isinstance(start.region, int) else None
    value = type(start.pdf)
    uint: Any = int if value is float else dr.uint32_array_t(value)
    state = {
        "w": -start.c,  # the ray as it travels, away from wo
        "weight": start.weight + 0 * start.c.x,
        "jacobian": 1.0 + 0 * start.c.x,
        "region": uint(start.region) if region_t is None else start.region,
        "going": start.pdf > 0,
    }

    def step(s: dict[str, Any]) -> dict[str, Any]:
        for sense_down in (True, False):
            order = range(1, last + 1) if sense_down else range(last, 0, -1)
            for r in order:
                here = s["going"] & (s["region"] == r) & ((s["w"].z < 0) if sense_down else (s["w"].z > 0))
                _cross(stack, s, here, r, sense_down, draw)
        return s

    def body(w: Any, weight: Any, jacobian: Any, region: Any, going: Any, rng: Any) -> tuple[Any, ...]:
        s = step({"w": w, "weight": weight, "jacobian": jacobian, "region": region, "going": going})
        return s["w"], s["weight"], s["jacobian"], s["region"], s["going"], rng

    rng = draw.rng  # type: ignore[attr-defined]
    out = dr.while_loop(
        (state["w"], state["weight"], state["jacobian"], state["region"], state["going"], rng),
        lambda w, weight, jacobian, region, going, rng: going,
        body,
        label="exit ray",
    )
    draw.rng = out[5]  # type: ignore[attr-defined]
    places = {(r, up) for r in stack.regions for up in (True, False)}
    return Exit(-out[0], out[1], start.pdf, out[2], out[3], places)


def _cross(stack: BoundStack, s: dict[str, Any], here: Any, r: int, down: bool, draw: Callable[[], Array]) -> None:
    """One region and the interface behind it."""
    medium = stack.media[r]
    k = r if down else r - 1
    interface = stack.interfaces[k]
    w = s["w"]
    if medium is not None:
        passed = medium.transmittance(1.0, w.z)
        from ...optics.vectors import total

        share = 1.0 if not medium.scatters else None
        if share is None:
            lit = total(s["weight"] * passed)
            hit = total(s["weight"] * medium.albedo * (1 - passed))
            p_pass = dr.select(lit + hit > 0, lit / dr.maximum(lit + hit, 1e-30), 1.0)
            if interface.delta is False:
                p_pass = 0.0 * p_pass  # it stops at the interface anyway: the whole way serves both
                stop = here
            else:
                blocked = interface.delta is not True
                p_pass = dr.select(interface.delta, p_pass, 0.0) if blocked else p_pass
                stop = here & (draw() >= p_pass)
                s["weight"] = dr.select(stop & (p_pass > 0), s["weight"] / dr.maximum(1 - p_pass, 1e-30), s["weight"])
            go = here & ~stop if value_is_array(here) else (here and not stop)
            s["weight"] = dr.select(go, s["weight"] * passed / dr.maximum(p_pass, 1e-30), s["weight"])
            s["going"] = s["going"] & ~stop if value_is_array(here) else (s["going"] and not stop)
            here = go
        elif interface.delta is not False:
            s["weight"] = dr.select(here & interface.delta, s["weight"] * passed, s["weight"])
    _ = k
