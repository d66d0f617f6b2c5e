"""Where to send samples: a mixture of simple lobes whose density is known exactly.

What a walk samples has no closed density, and a renderer that weighs it against light sampling needs one. So a
direction is drawn from lobes that cover whatever the stack can do (one reflection lobe an interface, one transmitted
lobe, a cosine lobe on each side, and the delta parts), and the walk then says what that direction is worth. The
guess behind the lobes (energies by a single pass through the stack, widths by adding variances of slope, after Belcour
2018) decides the noise only, never the mean. The mixture itself is `solvers.mixture`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...interfaces.base import Frame
from ...media import inverse_cosine
from ...optics.microfacet import Microfacets
from ...optics.vectors import Array, Vector, at_least, at_most, mean
from ..bound import BoundStack
from ..facet_lobe import Lobe
from ..mixture import Mixture
from ..smooth import cosines, has_delta, smooth_energy, snell, straight
from ..tilt import ways

#: share of the samples that every side light can leave on gets as a cosine lobe, whatever the guess
FLOOR = 0.1
#: more lobes than this are merged into the last
MOST = 4
#: narrowest and widest lobe
NARROW, WIDE = 1e-3, 1.0


def propose(stack: BoundStack, wi: Vector) -> Mixture:
    """The mixture for light that comes from wi, on either side."""
    guess = _guess(stack, wi, above=True)
    if not stack.opaque:
        guess = _merge(guess, _guess(stack, wi, above=False), wi.z > 0)
    axes, through = _tilted(stack, wi) if stack.tilted else ({}, guess.axis)
    rough = _few([(*lobe, axes.get(k)) for k, lobe in guess.rough.items()], stack.opaque)
    side_up = wi.z > 0
    parts: list[tuple[Array, Lobe]] = []
    # Kept off the horizon, so that no half-way vector vanishes.
    axis = type(wi)(wi.x, wi.y, at_least(dr.abs(wi.z), 1e-6))
    sides = (True,) if stack.opaque else (True, False)
    for up in sides:
        # On the side wi is on the reflected lobes lie, on the other the transmitted one.
        near = side_up if up else wi.z <= 0
        for energy, alpha_x, alpha_y, frame, own in rough:
            facets = Microfacets(alpha_x, alpha_y, "ggx", "separable")
            seen = axis if own is None else own
            parts.append((dr.select(near, energy, 0), Lobe(0.0, up, seen, facets, frame)))
        if not stack.opaque and through is not None:
            facets = Microfacets(guess.alpha_through, guess.alpha_through, "ggx", "separable")
            parts.append((dr.select(near, 0, guess.through), Lobe(0.0, up, through, facets, Frame(0.0))))
        parts.append((dr.select(near, guess.near, guess.far), Lobe(0.0, up)))
    if has_delta(stack):
        return Mixture.build(wi, parts, *smooth_energy(stack, wi), straight(stack, wi))
    return Mixture.build(wi, parts, None, None, None)


@dataclass
class _Guess:
    """Energies before normalisation: rough lobes (energy, alpha_x, alpha_y, frame) by interface, and cosine lobes."""

    rough: dict[int, tuple[Array, Array, Array, Frame]]
    near: Array
    far: Array
    through: Array
    alpha_through: Array
    axis: Vector | None


def _scatters(stack: BoundStack) -> bool:
    """False if there are delta parts only."""
    return any(interface.delta is not True for interface in stack.interfaces) or any(
        medium is not None and medium.scatters for medium in stack.media
    )


def _guess(stack: BoundStack, wi: Vector, above: bool) -> _Guess:
    """One pass through the stack: how much each interface sends back, and how wide."""
    cos = cosines(stack, wi, above)
    last = len(stack.interfaces) - 1
    order = range(last + 1) if above else range(last, -1, -1)
    outside = stack.indices[0 if above else -1]
    passing: Array = 1 + 0 * wi.x
    blur: Array = 0 * wi.x  # variance of slope that reaching this depth, and coming back, adds
    bend: Array = 0 * wi.x  # the same for going straight through, in the index of the region
    diffuse: Array = 0 * wi.x
    rough: dict[int, tuple[Array, Array, Array, Frame]] = {}
    blurred = False
    for k in order:
        interface = stack.interfaces[k]
        before, after = (k, k + 1) if above else (k + 1, k)
        reflected, transmitted, alpha = interface.lobe(cos[before], above)
        index = stack.indices[before]
        energy = passing * mean(reflected)
        if interface.flat:
            diffuse = diffuse + energy
        elif interface.delta is not True or blurred:
            x, y = interface.roughness()
            scale = dr.square(index / outside)
            lobe = [at_most(at_least(dr.sqrt(scale * dr.square(a) + blur), NARROW), WIDE) for a in (x, y)]
            certain = (
                interface.delta is False or blurred
            )  # else smooth lanes reflect a delta part, counted elsewhere
            keep = energy if certain else dr.select(interface.delta, 0, energy)
            keep = keep + 1e-3 * (1 if k in (0, last) else 0)
            rough[k] = (keep, lobe[0], lobe[1], getattr(interface, "frame", Frame(0.0)))
        if interface.opaque:
            break
        passing = passing * mean(transmitted)
        if interface.delta is not True:
            blurred = True
            step = dr.square((stack.indices[after] - index) * alpha)
            blur, bend = blur + 0.5 * step / dr.square(outside), bend + step
        medium = stack.media[after] if 0 < after <= last else None
        if medium is not None:
            left = mean(medium.transmittance(1.0, inverse_cosine(cos[after])))
            if medium.scatters:
                diffuse = diffuse + passing * (1 - left) * mean(medium.albedo)
            passing = passing * left
    beyond = stack.indices[-1 if above else 0]
    axis = None
    if not stack.opaque:
        ratio = outside / beyond
        z = snell(wi, ratio)
        tilt = at_most(ratio, dr.rcp(at_least(dr.sqrt(dr.square(wi.x) + dr.square(wi.y)), 1e-9)))
        axis = type(wi)(wi.x * tilt, wi.y * tilt, at_least(z, 1e-4))
    through = 0 * wi.x if stack.opaque else dr.select(cos[-1 if above else 0] > 0, passing, 0)
    through = through if any(interface.delta is not True for interface in stack.interfaces) else 0 * wi.x
    alpha_through = at_most(at_least(0.5 * dr.sqrt(bend) / beyond, NARROW), WIDE)
    floor = FLOOR if _scatters(stack) else 0.0
    far = 0 * wi.x if stack.opaque else floor + 0.5 * diffuse
    return _Guess(rough, floor + diffuse, far, through, alpha_through, axis)


def _merge(down: _Guess, up: _Guess, above: Any) -> _Guess:
    """The guess of the side that wi is on, lane by lane."""
    rough = {}
    for k in sorted(down.rough.keys() | up.rough.keys()):
        # What only one side sees as rough has no energy from the other.
        a, b = down.rough.get(k), up.rough.get(k)
        a, b = a or (0 * b[0], *b[1:]), b or (0 * a[0], *a[1:])  # type: ignore[index]
        rough[k] = (*(dr.select(above, p, q) for p, q in zip(a[:3], b[:3], strict=True)), a[3])
    return _Guess(
        rough,
        dr.select(above, down.near, up.near),
        dr.select(above, down.far, up.far),
        dr.select(above, down.through, up.through),
        dr.select(above, down.alpha_through, up.alpha_through),
        dr.select(above, down.axis, up.axis),
    )


def _tilted(stack: BoundStack, wi: Vector) -> tuple[dict[int, Vector], Vector | None]:
    """The axes of lobes that do not lie around the mirror direction, by interface, and of what is transmitted."""
    found = ways(stack, wi, True)
    axes, through = found.axes, found.through
    if not stack.opaque:
        other, near = ways(stack, wi, False), wi.z > 0
        axes = [dr.select(near, a, b) for a, b in zip(axes, other.axes, strict=True)]
        through = dr.select(near, through, other.through)
    return dict(enumerate(axes)), through


def _few(rough: list[Any], opaque: bool) -> list[Any]:
    """At most `MOST` lobes: those that are seen last, or from either side in the middle, are merged."""
    while len(rough) > MOST:
        i = len(rough) - 2 if opaque else len(rough) // 2 - 1
        (e1, x1, y1, _, axis), (e2, x2, y2, _, _) = rough[i : i + 2]
        rough[i : i + 2] = [(e1 + e2, at_least(x1, x2), at_least(y1, y2), Frame(0.0), axis)]
    return rough
