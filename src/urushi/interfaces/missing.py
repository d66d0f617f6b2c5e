"""How much light single scattering between facets loses, from tables, for one bound interface."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from ..optics.microfacet import Microfacets
from ..optics.vectors import Array, Vector, at_least, at_most, channels, float_type
from .tables import (
    MOST_RATIO,
    WIDER,
    Table,
    of_azimuth,
    of_bend,
    of_brushed_roughness,
    of_cosine,
    of_index,
    of_ratio,
    of_roughness,
    table,
)


class Missing:
    """What a rough surface loses of the light from a direction, and on the average over all.

    Args:
        facets: the surface.
        eta: index below over index above; None for a perfect mirror.
        even: whether the surface is known to be isotropic: a finer table, and cheaper to look into.
        number: type of the numbers (a Dr.Jit float or `float`).
    """

    def __init__(self, facets: Microfacets, eta: Array | None, even: bool, number: Any) -> None:
        self.even = even
        self.number = number
        self.eta = None if eta is None else number(eta)
        self.model = "ggx" if facets.ggx else "beckmann"
        self.model += "_correlated" if facets.correlated else "_separable"
        self.kind = ("" if even else "brushed_") + ("metal" if eta is None else "glass")
        x, y = facets.alpha_x, facets.alpha_y
        self.larger = self.alpha = number(x) if even else number(at_least(x, y))
        self.index = None if self.eta is None else of_index(self.eta)
        self.bends = not even and eta is not None
        self.place: list[Array] = [(of_brushed_roughness if self.bends else of_roughness)(self.larger)]
        if not even:
            ratio = of_ratio(number(x), number(y))
            self.place.append(ratio)
            self.ratio = dr.exp(math.log(MOST_RATIO) * ratio)
            self.alpha = self.larger * dr.rsqrt(self.ratio)
            self.wide = x >= y
        self.table: Table = table(self.kind, self.model, number)

    def _index(self, above: Any) -> list[Array]:
        """Coordinate of the index that lies beyond, seen from a side: the axis is its own mirror image."""
        if self.index is None:
            return []
        if isinstance(above, bool):
            return [self.index if above else 1 - self.index]
        return [dr.select(above, self.index, 1 - self.index)]

    def __call__(self, w: Vector, above: Any) -> Array:
        """The part of the light from w that is lost.

        Args:
            w: in the frame of the roughness, z of either sign.
            above: whether w is on the upper side; True, False or a mask.
        """
        if self.even:
            return self.table(*self._index(above), *self.place, of_cosine(dr.abs(w.z), self.alpha))
        x, y = dr.abs(w.x), dr.abs(w.y)
        along, across = dr.select(self.wide, x, y), dr.select(self.wide, y, x)
        if self.bends:
            return self._bent(along, across, dr.abs(w.z), above)
        # Along the normal there is no azimuth, and none is needed.
        azimuth = dr.atan2(across, at_least(along, 1e-12)) * (2 / math.pi)
        return self.table(*self.place, azimuth, of_cosine(dr.abs(w.z), self.alpha))

    def _bent(self, along: Array, across: Array, cos: Array, above: Any) -> Array:
        """What brushed glass loses, of a direction given by its parts along the larger roughness and across."""
        # The roughness in the azimuth of the light; along the normal that of azimuth 0.
        first, second = dr.square(along) + 1e-12, dr.square(across / self.ratio)
        alpha = self.larger * dr.sqrt((first + second) * dr.rcp(first + dr.square(across)))
        eta = self.eta
        if above is False:
            eta = dr.rcp(eta)
        elif above is not True:
            eta = dr.select(above, eta, dr.rcp(eta))
        azimuth = of_azimuth(along, across, self.ratio)
        return self.table(of_bend(eta, alpha), *self.place, azimuth, of_cosine(cos, WIDER * alpha))

    def mean(self, above: bool) -> Array:
        """The same for light from the whole hemisphere, by cosine; above 0."""
        mean = self.larger * self._mean("mean", above)
        return mean if self.bends else mean * self.larger

    def cosine(self, above: bool) -> Array:
        """The mean cosine of the directions from which light is lost."""
        return self._mean("cosine", above)

    def _mean(self, what: str, above: bool) -> Array:
        means = table(f"{what}_{self.kind}", self.model, self.number)
        place = [*self._index(above), *self.place]
        if len(place) < len(means.shape):
            place = [0 * place[0], *place]
        return means(*place)

    def exchanged(self) -> tuple[Array, Array]:
        """How much of what is lost is transmitted, of light from above and from below.

        Reciprocity ties the two: t1 M1 n1^2 = t2 M2 n2^2, with M the mean losses. The one number that is left, that
        over the smaller of M1 n1^2 and M2 n2^2, is the one of a random walk among the facets.
        """
        assert self.index is not None and self.eta is not None
        shares = table("shares", self.model, self.number)
        share = shares(2 * dr.abs(self.index - 0.5), of_roughness(self.alpha))
        one, other = self.mean(True), dr.square(self.eta) * self.mean(False)
        exchanged = share * at_most(one, other)
        return exchanged / one, exchanged / other


def number_of(*values: Array) -> Any:
    """The type of a plain number made of these: the widest of theirs."""
    product: Any = 1.0
    for value in values:
        product = product * (dr.detach(value) if dr.is_array_v(value) else value)
    if not dr.is_array_v(product):
        return float
    return float_type(product) if channels(product) else type(product)
