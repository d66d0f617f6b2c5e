"""A slab of particles as an operator: what stays a beam, and what becomes diffuse.

A beam stays one while it is not scattered, and while it is scattered forwards: of a Henyey-Greenstein function of
mean cosine g > 0 the share g^1.5 is taken as a forward lobe, half as wide as

    f_g = ((1 - g) / g)^0.8 / (1 + g)        (Belcour 2018, section 4)

says. Share and half are fitted to the energies and widths of coated metals by adding (docs/method-lobes.md).
See theory (lobes.8). The rest is diffuse. What leaves the slab altogether, on either side, is tabulated from solutions
of the transfer equation, so the energies are those of the slab, whatever the split.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from ...media import BoundMedium, inverse_cosine
from ...optics.vectors import Array, at_least, at_most, channels, mean
from .flow import Flow
from .grid import Grid
from .moments import COUNT, Mixing, Moments, of_powers, polynomials
from .quadrature import gauss
from .settled import settled
from .width import OURS, PUBLISHED

#: mean cosines of the phase functions in the table: the ends, and nodes along this and the other axes (`nodes`)
MEAN_COSINES = (-0.9, 0.98)
GS, ALBEDOS, DEPTHS, COSINES = 13, 12, 15, 11
#: powers of g: the share of scattered light whose energy is that of a beam, and the share that leaves as a lobe
STRAIGHT, FORWARD = 2.75, 1.5


class Particles:
    """A bound medium as an operator.

    Args:
        medium: with its numbers.
        scatters: False for what is not scattered at all, and the rest taken as lost.
        mixes: whether diffuse light is told by its moments; None where this medium scatters.
    """

    def __init__(self, medium: BoundMedium, scatters: bool = True, mixes: bool | None = None) -> None:
        self.medium = medium
        self.scatters = scatters and medium.scatters
        self.mixes = self.scatters if mixes is None else mixes
        g = getattr(medium.phase, "g", 0.0)
        self.g = g
        positive = at_least(g, 1e-8)
        self.straight = dr.select(g > 0, dr.power(positive, STRAIGHT), 0.0)
        self.forward = dr.select(g > 0, dr.power(positive, FORWARD), 0.0)
        self.spread = 0.5 * OURS.additive(PUBLISHED.roughness(forward_width(g)))

    def passed(self, cos: Array) -> Array:
        """What stays a beam under the cosine."""
        return self._kept(cos, self.straight) if self.scatters else self._unscattered(cos)

    def widened(self, cos: Array) -> tuple[Array, Array]:
        """How much more than that stays a lobe, as a factor, and the width that this adds in the mean."""
        if not self.scatters:
            return 1.0, 0.0
        kept, unscattered = self._kept(cos, self.forward), self._unscattered(cos)
        bright, all_of = mean(kept - unscattered), mean(kept)
        share = at_least(bright, 0) / at_least(all_of, 1e-20)
        return kept / at_least(self.passed(cos), 1e-20), share * self.spread

    def _unscattered(self, cos: Array) -> Array:
        return self.medium.transmittance(1.0, inverse_cosine(cos))

    def _kept(self, cos: Array, share: Array) -> Array:
        """What passes if this share of what is scattered goes on."""
        return dr.exp(-self.medium.depth * inverse_cosine(cos) * (1 - self.medium.albedo * share))

    def layer(self, cos: Array) -> tuple[Flow, Flow]:
        """(reflection, transmission) for a beam of this cosine."""
        beam = self.passed(cos)
        if not self.scatters:
            depth = self.medium.depth + 0 * cos
            passed = of_powers(_means(depth)) if self.mixes else even_decay(depth)
            return Flow(0.0, 0.0, 0.0), Flow(beam, 0.0, passed)
        unscattered, slab = self._unscattered(cos), self._table("slab", cos)
        up, down = (Moments(*some) * (1 - unscattered) for some in (slab[:COUNT], slab[COUNT:]))
        # What is counted as a beam although it was scattered.
        forward = at_most(beam - unscattered, down.parts[0])
        straight = Moments(*(-value for value in polynomials(cos)))
        shapes = self._table("shapes", None, like=cos)
        r, t = Mixing.told(shapes[: COUNT**2]), Mixing.told(shapes[COUNT**2 :])
        return Flow(0.0, up, r), Flow(beam, down + straight * forward, t)

    def _table(self, name: str, cos: Array | None, like: Array | None = None) -> list[Array]:
        """Moments of what is scattered up, and then down: of a beam, or of each polynomial."""
        depth, albedo, g = self.medium.depth, self.medium.albedo, self.g
        lane = cos if cos is not None else like
        size = max(channels(depth), channels(albedo))
        found = [
            self._channel(name, _pick(depth, c), _pick(albedo, c), g, cos, lane) for c in range(max(size, 1))
        ]
        if not size:
            return found[0]
        colour: Any = type(depth) if channels(depth) else type(albedo)
        return [colour(*parts) for parts in zip(*found, strict=True)]

    @staticmethod
    def _channel(
        name: str, depth: Array, albedo: Array, g: Array, cos: Array | None, like: Array
    ) -> list[Array]:
        grid = _grid(name)
        last = [] if cos is None else [dr.sqrt(at_most(at_least(cos, 1e-8), 1.0))]
        number = type(like)
        plain = tuple(number(value) if isinstance(value, float) else value for value in (g, albedo, depth))
        leading = settled("slab", plain, lambda: _leading(*plain))
        if leading is not None and not last:
            return settled((name, "all"), leading, lambda: grid(leading, number(0)))
        part = None if leading is None else grid.at(leading, name)
        if part is not None:
            return part(last, like)
        return grid([*_leading(*(value + 0 * like for value in plain)), *last], like)


def _leading(g: Array, albedo: Array, depth: Array) -> list[Array]:
    """Places along the axes: those whose nodes `nodes` lists."""
    low, high = (np.sqrt(1 - end) for end in MEAN_COSINES)
    root = dr.sqrt(1 - at_most(at_least(g, MEAN_COSINES[0]), MEAN_COSINES[1]))
    lost = at_most(at_least(1 - albedo, 1e-12), 1.0)
    return [(root - low) / (high - low), dr.cbrt(lost), depth / (1 + depth)]


def nodes() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean cosines, albedos, depths and cosines of the nodes."""
    low, high = (np.sqrt(1 - end) for end in MEAN_COSINES)
    u = np.linspace(0, 1, DEPTHS)
    return (
        1 - np.linspace(low, high, GS) ** 2,
        1 - np.linspace(0, 1, ALBEDOS) ** 3,
        np.minimum(u / np.maximum(1 - u, 1e-12), 1e5),
        np.maximum(np.linspace(0, 1, COSINES) ** 2, 1e-3),
    )


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


def even_decay(depth: Array) -> Array:
    """What passes a slab that only takes away, of light that comes evenly: 2 E_3(depth)."""
    return 2 * _means(depth, (1,))[0]


def _means(depth: Array, powers: Sequence[int] = range(2 * COUNT - 1)) -> list[Array]:
    """Integrals of exp(-depth / c) c^n dc over (0, 1), by Gauss's rule in the root of c: n = 1 to 1e-5."""
    found: list[Array] = [0.0 for _ in powers]
    for c, weight in _GAUSS:
        passed = dr.exp(-depth / c)
        found = [total + (weight * c**n) * passed for n, total in zip(powers, found, strict=True)]
    return found


_GAUSS = gauss(8, 2)
