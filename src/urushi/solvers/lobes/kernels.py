"""What interfaces and clear media do with light that is told by `nodes`: matrices of flux, from samples of facets.

Every node sends its light to facets that a lattice chooses among those visible from it; where their reflections and
refractions lie between nodes, these share them (`Nodes.shared`). What single scattering loses is given back where the
model says so, as `interfaces.compensated` does.
"""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np

from ...adding import Slab
from ...interfaces import BoundConductor, BoundDielectric, Interface, Null
from ...interfaces.base import Frame
from ...media import BoundMedium
from ...optics.fresnel import fresnel_conductor, fresnel_dielectric
from ...optics.microfacet import Microfacets
from ...optics.vectors import at_least, at_most, channels, reflect
from ..arrays import padded
from .nodes import Nodes

#: facets for each direction: a Fibonacci number
FACETS = 1597
#: the lowest cosine of a direction that light is sent from
LOWEST = 1e-4


def values(number: Any) -> np.ndarray:
    """(C,) a number or a colour that is the same for all lanes, C = 1 where it is a number."""
    parts = [number[c] for c in range(channels(number))] if channels(number) else [number]
    return np.array([float(np.ravel(np.array(part, dtype=np.float64))[0]) for part in parts])


def one(number: Any) -> float:
    """A number that is the same for all lanes."""
    return float(values(number)[0])


def still(interface: Interface) -> bool:
    """Whether it is smooth or invisible."""
    delta: Any = interface.delta
    return delta if isinstance(delta, bool) else bool(np.ravel(np.array(delta))[0])


class Kernels:
    """Matrices of the layers of a stack.

    Args:
        nodes: of its regions.
        number: type of numbers: double precision, of a vectorised backend.
    """

    def __init__(self, nodes: Nodes, number: Any) -> None:
        self.nodes, self.number = nodes, number
        self.vector: Any = sys.modules[number.__module__].Array3f64
        small, size = 1, 1
        while size < FACETS:
            small, size = size, small + size
        i = np.arange(size)
        self._lattice = (i + 0.5) / size, (i * small % size + 0.5) / size

    def slab(self, interface: Interface, region: int) -> Slab:
        """All four matrices of the interface below a region, (C, n_out, n_in); empty ones below an opaque base."""
        r, t = self.sent(interface, region, self.nodes.cosines(region), True)
        if interface.opaque:
            return Slab(r, t, np.zeros((1, 0, 0)), np.swapaxes(t, 1, 2))
        below, up = self.sent(interface, region, self.nodes.cosines(region + 1), False)
        return Slab(r, t, below, up)

    def medium(self, medium: BoundMedium, region: int) -> Slab:
        """A medium that does not scatter."""
        t = np.exp(-values(medium.depth)[:, None] / self.nodes.cosines(region))
        through = t[:, :, None] * np.eye(t.shape[1])
        nothing = np.zeros((1, *through.shape[1:]))
        return Slab(nothing, through, nothing, through)

    def sent(
        self, interface: Interface, region: int, cos: np.ndarray, above: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where light of some cosines goes.

        Args:
            interface: between a region and the next.
            region: the one above it.
            cos: (N,) cosines on the side that the light comes from.
            above: whether that is the upper one.

        Returns:
            (C, n, N) what is reflected, (C, n_beyond, N) what is transmitted, on the nodes of either region.
        """
        inner: Any = interface.single if interface.single is not None else interface
        here, beyond = (region, region + 1) if above else (region + 1, region)
        cos = np.maximum(cos, LOWEST)
        if isinstance(inner, BoundConductor):
            r = self._metal(inner, region, cos, inner.eta, inner.k)
            if interface.single is not None and not still(interface):
                r = r + self._returned(inner, region, cos)
            return r, np.zeros((1, 0, len(cos)))
        ratio = self.nodes.index(beyond) / self.nodes.index(here)
        if isinstance(inner, Null) or ratio == 1:
            light = self.number(padded(cos))
            all_of = self.nodes.shared(here, light, [1 + 0 * light], 1)
            return 0 * all_of, all_of
        r, t = self._dielectric(inner, (here, beyond), cos, ratio)
        if interface.single is not None and not still(interface):
            lost = 1 - r.sum(axis=1) - t.sum(axis=1)
            passed = one(interface.missing.exchanged()[0 if above else 1])  # type: ignore[attr-defined]
            shapes = [self._lost_shape(inner, region, side) for side in (above, not above)]
            r = r + shapes[0][None, :, None] * (lost * (1 - passed))[:, None]
            t = t + shapes[1][None, :, None] * (lost * passed)[:, None]
        return r, t

    def _lost_shape(self, inner: BoundDielectric, region: int, above: bool) -> np.ndarray:
        """(n,) how what facets sent to one another leaves on a side, over all of it."""
        here, beyond = (region, region + 1) if above else (region + 1, region)
        ratio = self.nodes.index(beyond) / self.nodes.index(here)
        cos = np.maximum(self.nodes.cosines(here), LOWEST)
        r, t = self._dielectric(inner, (here, beyond), cos, ratio)
        return _shape((1 - r.sum(axis=1) - t.sum(axis=1))[0], self.nodes.weights(here))

    def _dielectric(
        self, inner: BoundDielectric, regions: tuple[int, int], cos: np.ndarray, ratio: float
    ) -> tuple[np.ndarray, np.ndarray]:
        number = self.number
        eta = dr.opaque(number, ratio)
        if still(inner):
            light = number(padded(cos))
            fresnel, beyond = fresnel_dielectric(light, eta, 1 / eta)
            r = self.nodes.shared(regions[0], light, [fresnel], 1)
            return r, self.nodes.shared(regions[1], at_least(dr.abs(beyond), LOWEST), [1 - fresnel], 1)
        w, facets, u = self._facets(inner, cos)
        copy = BoundDielectric(eta, facets, False, Frame(0.0))
        up, down = (copy.sample(w, (0.5, *u), True, part) for part in ("reflect", "transmit"))
        weights = [dr.select(right, e.weight, 0) for e, right in ((up, up.o.z > 0), (down, down.o.z < 0))]
        r, t = (
            self._counted(region, sample.o.z, [weight])
            for region, sample, weight in zip(regions, (up, down), weights, strict=True)
        )
        return r, t

    def _metal(self, inner: BoundConductor, region: int, cos: np.ndarray, eta: Any, k: Any) -> np.ndarray:
        number = self.number
        pairs = np.broadcast_arrays(values(eta), values(k))
        colours = [tuple(dr.opaque(number, float(x)) for x in pair) for pair in zip(*pairs, strict=True)]
        if still(inner):
            like = number(padded(cos))
            return self.nodes.shared(region, like, [fresnel_conductor(like, *pair) for pair in colours], 1)
        w, facets, u = self._facets(inner, cos)
        m = facets.sample(w, *u)
        o = reflect(w, m)
        seen = at_most(at_least(dr.dot(w, m), 0), 1)
        kept = facets.masked(w, self.vector(o.x, o.y, dr.abs(o.z)), facets.sigma(w))
        kept = dr.select(o.z > 0, kept, 0)
        weights = [kept * fresnel_conductor(seen, *pair) for pair in colours]
        return self._counted(region, o.z, weights)

    def white(self, inner: BoundConductor, region: int, cos: np.ndarray) -> np.ndarray:
        """(N,) what the facets of a metal would reflect if they absorbed nothing."""
        found: np.ndarray = self._metal(inner, region, np.maximum(cos, LOWEST), 0.0, 1.0)[0].sum(axis=0)
        return found

    def _returned(self, inner: BoundConductor, region: int, cos: np.ndarray) -> np.ndarray:
        """What a metal gives back of what its facets sent to one another (Kulla & Conty 2017)."""
        nodes = np.maximum(self.nodes.cosines(region), LOWEST)
        weights = self.nodes.weights(region)
        lost, all_lost = (1 - self.white(inner, region, c) for c in (cos, nodes))
        mean = float(all_lost @ weights)
        like = self.number(padded(nodes))
        pairs = zip(*np.broadcast_arrays(values(inner.eta), values(inner.k)), strict=True)
        even = np.array(
            [
                np.array(fresnel_conductor(like, *map(self.number, map(float, pair)))) @ weights
                for pair in pairs
            ]
        )
        part = even**2 * (1 - mean) / (1 - even * mean)
        return np.asarray(part[:, None, None] * _shape(all_lost, weights)[None, :, None] * lost)

    def _facets(self, inner: Any, cos: np.ndarray) -> tuple[Any, Microfacets, tuple[Any, Any]]:
        """Directions, each for all facets of the lattice, the surface, and what chooses its facets."""
        given, number = inner.facets, self.number
        count = len(self._lattice[0])
        many = np.repeat(cos, count)
        c, s = (number(padded(x)) for x in (many, np.sqrt((1 - many) * (1 + many))))
        u = tuple(number(padded(np.tile(x, len(cos)))) for x in self._lattice)
        alpha = dr.opaque(number, one(given.alpha_x))
        names = "ggx" if given.ggx else "beckmann", "correlated" if given.correlated else "separable"
        return self.vector(s, 0 * c, c), Microfacets(alpha, alpha, *names), (u[0], u[1])

    def _counted(self, region: int, cos: Any, weights: list[Any]) -> np.ndarray:
        """Samples on nodes (C, n, N)."""
        count = len(self._lattice[0])
        cos = at_most(at_least(dr.abs(cos), LOWEST), 1)
        return self.nodes.shared(region, cos, [weight / count for weight in weights], count)


def _shape(lost: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """What is lost, by direction, over all: that is how it leaves; evenly, where there is as good as nothing."""
    whole = float(lost @ weights)
    return np.asarray(lost * weights / whole if whole > 1e-6 else weights)
