"""A slab of particles as an operator: what stays a beam, and what becomes diffuse.

A beam stays one while it is not scattered, and while it is scattered forwards: of a Henyey-Greenstein function of
mean cosine g > 0 the share g^1.5 is taken as a forward lobe, half as wide as

    f_g = ((1 - g) / g)^0.8 / (1 + g)        (Belcour 2018, section 4)

says. Share and half are fitted to the energies and widths of coated metals by adding (docs/method-lobes.md).
See theory (lobes.8). The rest is diffuse. What leaves the slab altogether, on either side, is tabulated from solutions
of the transfer equation, so the energies are those of the slab, whatever the split.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from ...media import BoundMedium, inverse_cosine
from ...optics.vectors import Array, at_least, at_most, channels, total
from .flow import Flow
from .grid import Grid
from .settled import settled
from .width import OURS, PUBLISHED

#: mean cosines of the phase functions in the table: the ends, and nodes along this and the other axes
MEAN_COSINES = (-0.9, 0.98)
GS, ALBEDOS, DEPTHS, COSINES = 11, 11, 15, 11


class Particles:
    """A bound medium as an operator.

    Args:
        medium: with its numbers.
        scatters: False for what is not scattered at all, and the rest taken as lost.
    """

    def __init__(self, medium: BoundMedium, scatters: bool = True) -> None:
        self.medium = medium
        self.scatters = scatters and medium.scatters
        g = getattr(medium.phase, "g", 0.0)
        self.g = g
        self.forward = dr.select(g > 0, dr.power(at_least(g, 1e-8), 1.5), 0.0)
        self.spread = 0.5 * OURS.additive(PUBLISHED.roughness(forward_width(g)))

    def passed(self, cos: Array) -> tuple[Array, Array]:
        """What stays a beam under the cosine, and the width that this adds in the mean."""
        inv = inverse_cosine(cos)
        unscattered = self.medium.transmittance(1.0, inv)
        if not self.scatters:
            return unscattered, 0.0
        depth = self.medium.depth * inv
        kept = dr.exp(-depth * (1 - self.medium.albedo * self.forward))
        bright, all_of = _mean(kept - unscattered), _mean(kept)
        share = at_least(bright, 0) / at_least(all_of, 1e-20)
        return kept, share * self.spread

    def layer(self, cos: Array) -> tuple[Flow, Flow]:
        """(reflection, transmission) for a beam of this cosine."""
        beam, _ = self.passed(cos)
        if not self.scatters:
            return Flow(0.0, 0.0, 0.0), Flow(beam, 0.0, even_decay(self.medium.depth + 0 * cos))
        up, down = self._table("slab", cos)
        unscattered = self.medium.transmittance(1.0, inverse_cosine(cos))
        even_up, even_down = self._table("even", None, like=cos)
        return (
            Flow(0.0, up, even_up),
            Flow(
                beam,
                at_least(down + unscattered - beam, 0),
                even_down + even_decay(self.medium.depth + 0 * cos),
            ),
        )

    def _table(self, name: str, cos: Array | None, like: Array | None = None) -> tuple[Array, Array]:
        """Reflectance, and the scattered part of the transmittance."""
        depth, albedo, g = self.medium.depth, self.medium.albedo, self.g
        lane = cos if cos is not None else like
        size = max(channels(depth), channels(albedo))
        found = [
            self._channel(name, _pick(depth, c), _pick(albedo, c), g, cos, lane) for c in range(max(size, 1))
        ]
        if not size:
            return found[0]
        colour: Any = type(depth) if channels(depth) else type(albedo)
        return colour(*(f[0] for f in found)), colour(*(f[1] for f in found))

    @staticmethod
    def _channel(
        name: str, depth: Array, albedo: Array, g: Array, cos: Array | None, like: Array
    ) -> tuple[Array, Array]:
        grid = _grid(name)
        last = [] if cos is None else [dr.sqrt(at_most(at_least(cos, 1e-8), 1.0))]
        number = type(like)
        plain = tuple(number(value) if isinstance(value, float) else value for value in (g, albedo, depth))
        leading = settled("slab", plain, lambda: _leading(*plain))
        if leading is not None and not last:
            r, t = settled((name, "even"), leading, lambda: grid(leading, number(0)))
            return r, t
        part = None if leading is None else grid.at(leading, name)
        if part is not None:
            r, t = part(last, like)
            return r, t
        r, t = grid([*_leading(*(value + 0 * like for value in plain)), *last], like)
        return r, t


def _leading(g: Array, albedo: Array, depth: Array) -> list[Array]:
    low, high = MEAN_COSINES
    g = at_most(at_least(g, low), high)
    return [(g - low) / (high - low), dr.sqrt(at_least(1 - albedo, 1e-12)), depth / (1 + depth)]


def forward_width(g: Array) -> Array:
    """The width, in the published scale, of the forward lobe of a Henyey-Greenstein function of mean cosine g > 0."""
    kept = at_least(g, 1e-3)
    return dr.power((1 - kept) / kept, 0.8) / (1 + kept)


@cache
def _grid(name: str) -> Grid:
    with np.load(Path(__file__).parent / "data" / "slabs.npz") as file:
        return Grid(file[name] * 2.0**-14)


def _pick(value: Array, c: int) -> Array:
    return value[c] if channels(value) else value


def _mean(value: Array) -> Array:
    return total(value) * (1 / max(channels(value), 1))


def even_decay(depth: Array) -> Array:
    """What passes a slab that only takes away, of light that comes evenly: 2 E_3(depth), by Gauss's rule to 1e-4."""
    passed: Array = 0.0
    for c, weight in _GAUSS:
        passed = passed + weight * dr.exp(-depth / c)
    return passed


def _gauss(count: int) -> tuple[tuple[float, float], ...]:
    x, weight = np.polynomial.legendre.leggauss(count)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    return tuple((float(a), float(b)) for a, b in zip(x, weight * 2 * x, strict=True))


_GAUSS = _gauss(8)
