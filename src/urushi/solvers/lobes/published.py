"""The recursion as the paper prints it and its code computes it (Belcour 2018), to reproduce its images.

What differs from `recursion`: reflectance from below is that from above (Stokes), the part of a lobe that is not
totally reflected comes from the lobe of the next interface, after the fact; media only absorb and scatter forwards
once; widths go down with the factor of going up, and refraction widens them as at normal incidence. There is no
diffuse light.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...interfaces import BoundConductor, BoundDielectric
from ...media import inverse_cosine
from ...optics.vectors import Array, Vector, at_least, at_most, mean
from ..bound import BoundStack
from .medium import Particles, forward_width
from .operators import GRAZING, Boundary
from .recursion import Answer, Beam
from .spread import Spread
from .width import PUBLISHED, Width, mean_roughness, plus


@dataclass
class Layer:
    """One entry of the published recursion.

    Attributes:
        reflectance: (cosine, width of the light) -> from above; what a transparent one does not reflect it transmits.
        eta: index below over index above.
        width: roughness -> width, for the roughness of the interface times a factor.
        opaque: whether nothing is transmitted.
        transmittance: cosine -> of a medium, which reflects nothing; None for an interface.
        scattered: width that crossing a medium adds.
        escape: (cosine, width) -> fraction of light from below that is not totally reflected; None to leave that out.
    """

    reflectance: Callable[[Array, Width], Array]
    eta: Array = 1.0
    width: Callable[[Array], Width] = lambda scale: 0.0
    opaque: bool = False
    transmittance: Callable[[Array], Array] | None = None
    scattered: Width = 0.0
    escape: Callable[[Array, Width], Array] | None = None


def add_up(
    layers: Sequence[Layer], cos: Array, published: bool = True, exact: bool = False
) -> tuple[list[tuple[Array, Width]], tuple[Array, Width]]:
    """Coefficients and widths of every lobe, and of what is transmitted.

    Args:
        layers: from the top down.
        cos: cosine of incidence on the first.
        published: with the printed Jacobians; False for the consistent ones.
        exact: refraction widens by the real cosines; False for those of normal incidence, as in the released code.
    """
    spread = Spread(PUBLISHED, published)
    down: Array = 1.0
    up: Array = 1.0
    back: Array = 0.0
    lobes: list[tuple[Array, Width]] = []
    before: Layer | None = None
    for layer in layers:
        reflected = layer.width(1.0)
        width = plus(spread.down, reflected)
        if layer.transmittance is None:
            r = layer.reflectance(cos, width)
            t = 0.0 * r if layer.opaque else 1 - r
            sin_sq = (1 - dr.square(cos)) / dr.square(layer.eta)
            below = dr.sqrt(at_least(1 - sin_sq, GRAZING**2))
            i, o = (cos, below) if exact else (1.0, 1.0)
            n = layer.eta
            widen = (
                layer.width(0.5 * dr.abs(n * o - i) / (n * o)),
                layer.width(0.5 * dr.abs(i / n - o) * n / i),
            )
            j = n * below / cos
        else:
            r, t = 0.0 * cos, layer.transmittance(cos)
            below, j, widen = cos, 1.0, (layer.scattered, layer.scattered)
        if before is not None and before.escape is not None and layer.transmittance is None:
            # light that comes from below and is totally reflected by the interface before
            share = before.escape(cos, width)
            back, up = at_most(back + (1 - share) * up, 1.0), share * up
        rest = at_least(1 - back * r, 1e-6)
        energy = down * r * up / rest
        rounds = mean(back * r / rest)
        lobes.append((energy, spread.lobe(reflected, rounds)))
        inner = t * back * t / rest
        spread.cross(reflected, *widen, j, rounds, mean(r), mean(inner))
        down, back, up = down * t / rest, r + inner, t * up / rest
        cos = below
        before = layer if layer.transmittance is None else before
        if layer.opaque:
            break
    return lobes, (down, spread.down)


def respond(stack: BoundStack, wi: Vector, above: bool) -> Answer:
    """Everything that comes of light from wi, in the form of `recursion.respond`."""
    order = range(len(stack.interfaces)) if above else range(len(stack.interfaces) - 1, -1, -1)
    layers: list[Layer] = []
    numbers: list[int | None] = []
    sharp: list[Any] = []
    still: Any = True
    for k in order:
        boundary = Boundary(stack.interfaces[k], above, wi, PUBLISHED)
        layers.append(_interface(boundary))
        numbers.append(k)
        still = still if boundary.smooth else False
        sharp.append(still)
        medium = stack.media[k + 1] if above else stack.media[k]
        if medium is not None and not boundary.opaque:
            layers.append(_medium(Particles(medium)))
            numbers.append(None)
            still = still and not medium.scatters
            sharp.append(still)
    cos = at_least(dr.abs(wi.z), GRAZING)
    lobes, (through, width) = add_up(layers, cos)
    reflected = [
        Beam(energy, spread, cos, hard, k)
        for (energy, spread), k, hard in zip(lobes, numbers, sharp, strict=True)
        if k is not None
    ]
    beyond = None
    if not stack.opaque:
        beyond = Beam(through, width, cos, still, len(stack.interfaces))
    return Answer(reflected, beyond, 0.0, 0.0)


def _interface(boundary: Boundary) -> Layer:
    def reflectance(cos: Array, width: Width) -> Array:
        return boundary.complete(cos, mean_roughness(width, PUBLISHED))

    def escape(cos: Array, width: Width) -> Array:
        return boundary.turned.escaping(cos, mean_roughness(width, PUBLISHED))

    inner = boundary.inner
    if not isinstance(inner, (BoundDielectric, BoundConductor)):
        return Layer(lambda cos, width: 0.0 * cos, eta=boundary.eta)
    return Layer(
        reflectance,
        eta=boundary.eta,
        width=boundary.width,
        opaque=boundary.opaque,
        escape=None if boundary.opaque else escape,
    )


def _medium(particles: Particles) -> Layer:
    medium = particles.medium

    def transmittance(cos: Array) -> Array:
        depth = medium.depth * inverse_cosine(cos)
        return (1 + medium.albedo * depth) * dr.exp(-depth)

    width = forward_width(particles.g) if particles.scatters else 0.0
    return Layer(lambda cos, _: 0.0 * cos, transmittance=transmittance, scattered=width)
