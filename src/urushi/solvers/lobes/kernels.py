"""What interfaces and media do with light that is told by `nodes`: matrices of flux, from samples of facets.

Every node sends its light to facets that a lattice chooses among those visible from it; where their reflections and
refractions lie between nodes, these share them (`Nodes.shared`). What single scattering loses is given back where the
model says so, as `interfaces.compensated` does.
"""

from __future__ import annotations

import operator
import sys
from typing import Any

import drjit as dr
import numpy as np

from ...adding import Algebra, Slab, double
from ...interfaces import BoundConductor, BoundDielectric, BoundDiffuse, Interface, Null
from ...interfaces.base import Frame
from ...optics.fresnel import fresnel_conductor, fresnel_dielectric
from ...optics.microfacet import Microfacets
from ...optics.phase import HenyeyGreenstein, Isotropic
from ...optics.vectors import at_least, at_most, channels, reflect
from ..arrays import padded
from ..bound import BoundStack
from .azimuths import Azimuths
from .nodes import Nodes

#: facets for each direction, and for each of several azimuths: Fibonacci numbers
FACETS, FEWER = 1597, 610
#: the lowest cosine of a direction that light is sent from
LOWEST = 1e-4
#: moments of a phase function, and the depth of a slab in which light is scattered once
MOMENTS, THIN = 32, 2e-4
#: angles at which phase functions are asked
ANGLES = 256
#: of light that goes round for ever, what is lost at every turn
GONE = 1e-15


def _series(a: Any, b: Any, x: Any) -> Any:
    trip = a @ b
    return np.linalg.solve((1 + GONE) * np.eye(trip.shape[-1]) - trip, x)


#: the adding equations with matrices
ALGEBRA = Algebra(operator.matmul, _series)


#: what a number is ("index", "alpha", and "across" and "turn" of two roughnesses, "eta", "k", "reflectance", "depth",
#: "albedo", "g"), of which region or interface
Key = tuple[str, int]


def numbers(stack: BoundStack) -> dict[Key, Any]:
    """All numbers that matrices are made of."""
    last = len(stack.interfaces) + (not stack.opaque)
    found: dict[Key, Any] = {("index", r): stack.indices[r] for r in range(last)}
    for k, interface in enumerate(stack.interfaces):
        inner: Any = interface.single if interface.single is not None else interface
        if getattr(inner, "facets", None) is not None:
            found["alpha", k] = inner.facets.alpha_x
            if brushed(inner):
                found["across", k], found["turn", k] = inner.facets.alpha_y, _turn(inner.frame)
        if isinstance(inner, BoundConductor):
            found["eta", k], found["k", k] = inner.eta, inner.k
        if isinstance(inner, BoundDiffuse):
            found["reflectance", k] = inner.reflectance
    for r, medium in enumerate(stack.media):
        if medium is not None:
            found["depth", r] = medium.depth
            if medium.scatters:
                found["albedo", r], found["g", r] = medium.albedo, getattr(medium.phase, "g", 0.0)
    return found


def values(number: Any) -> np.ndarray:
    """(C,) a number or a colour that is the same for all lanes, C = 1 where it is a number."""
    parts = [number[c] for c in range(channels(number))] if channels(number) else [number]
    return np.array([float(np.ravel(np.array(dr.detach(part), dtype=np.float64))[0]) for part in parts])


def brushed(interface: Interface) -> bool:
    """Whether it has two roughnesses."""
    x, y = interface.roughness()
    return not (x is y or (isinstance(x, float) and x == y))


def still(interface: Interface) -> bool:
    """Whether it is smooth or invisible."""
    delta: Any = interface.delta
    return delta if isinstance(delta, bool) else bool(np.ravel(np.array(delta))[0])


class Kernels:
    """Matrices of the layers of a stack.

    Args:
        stack: its structure.
        given: its numbers (C,), which may be others.
        nodes: of its regions.
        azimuths: of light.
        number: type of numbers: double precision, of a vectorised backend.
    """

    def __init__(
        self,
        stack: BoundStack,
        given: dict[Key, np.ndarray],
        nodes: Nodes,
        azimuths: Azimuths,
        number: Any,
    ) -> None:
        self.stack, self.given, self.nodes, self.number = stack, given, nodes, number
        self.azimuths = azimuths
        self.vector: Any = sys.modules[number.__module__].Array3f64
        small, size = 1, 1
        while size < (FACETS if azimuths.count == 1 else FEWER):
            small, size = size, small + size
        i = np.arange(size)
        self._lattice = (i + 0.5) / size, (i * small % size + 0.5) / size

    def slab(self, k: int) -> Slab:
        """All four matrices of an interface, (C, n_out, n_in); empty ones below an opaque base."""
        r, t = map(self.azimuths.told, self.sent(k, self.nodes.cosines(k), True))
        if self.stack.interfaces[k].opaque:
            return Slab(r, t, np.zeros((1, 0, 0)), np.swapaxes(t, 1, 2))
        below, up = map(self.azimuths.told, self.sent(k, self.nodes.cosines(k + 1), False))
        return Slab(r, t, below, up)

    def medium(self, region: int, scatters: bool) -> Slab:
        """A medium; all that meets particles is lost unless it `scatters`."""
        cos, depth = self.nodes.cosines(region), self.given["depth", region]
        if scatters:
            colours = np.broadcast_arrays(depth, self.given["albedo", region], self.given["g", region])
            slabs = [self._hazy(region, *map(float, colour)) for colour in zip(*colours, strict=True)]
            r, t = np.stack([slab.r_top for slab in slabs]), np.stack([slab.t_down for slab in slabs])
            if self.azimuths.count > 1:  # what is scattered has no azimuth any more
                r, t = self.azimuths.scattered(r, 0 * r), self.azimuths.scattered(t, self._clear(cos, depth))
            return Slab(r, t, r, t)
        through = self._clear(cos, depth)
        if self.azimuths.count > 1:
            through = self.azimuths.scattered(through, through)
        nothing = np.zeros((1, *through.shape[1:]))
        return Slab(nothing, through, nothing, through)

    @staticmethod
    def _clear(cos: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """(C, n, n) what goes through without meeting a particle."""
        return np.asarray(np.exp(-depth[:, None] / cos)[:, :, None] * np.eye(len(cos)))

    def _hazy(self, region: int, depth: float, albedo: float, g: float) -> Slab:
        """A slab of particles, by doubling of one so thin that light is scattered once in it.

        What of the peak polynomials cannot tell is taken as not scattered (delta-M, Wiscombe 1977).
        """
        cos = self.nodes.cosines(region)
        ends = np.concatenate([[1.0], 0.5 * (cos[1:] + cos[:-1]), [0.0]])
        told = self._phase(region, g)
        share = float(told[-1]) if told[-2] > 0 and told[-1] > 0 else 0.0
        moments = (told[:-1] - share) / (1 - share) * (2 * np.arange(MOMENTS) + 1)
        legendre = np.polynomial.legendre.legvander(cos, MOMENTS - 1).T
        signs = (-1.0) ** np.arange(MOMENTS)
        down, up = (
            np.maximum((legendre * factor).T @ legendre, 0) * (ends[:-1] - ends[1:])[:, None]
            for factor in (moments[:, None], (moments * signs)[:, None])
        )
        whole = (down + up).sum(axis=0)
        depth, albedo = depth * (1 - albedo * share), albedo * (1 - share) / (1 - albedo * share)
        times = max(int(np.ceil(np.log2(max(depth, 1e-12) / THIN))), 0)
        passed = np.exp(-depth / 2**times / cos)
        met = albedo * (1 - passed) / whole
        r, t = up * met, np.diag(passed) + down * met
        return double(Slab(r, t, r, t), times, ALGEBRA)

    def _phase(self, region: int, g: float) -> np.ndarray:
        """(MOMENTS + 1,) means of Legendre's polynomials of the scattering angle."""
        phase = self.stack.media[region].phase  # type: ignore[union-attr]
        if isinstance(phase, (HenyeyGreenstein, Isotropic)):
            return g ** np.arange(MOMENTS + 1)
        x, weight = np.polynomial.legendre.leggauss(ANGLES)
        c, s = (self.number(padded(v)) for v in (x, np.sqrt((1 - x) * (1 + x))))
        value = weight * np.array(phase.eval(self.vector(0, 0, 1), self.vector(s, 0 * s, c)))
        return np.asarray(value @ np.polynomial.legendre.legvander(x, MOMENTS) / value.sum())

    def sent(self, k: int, cos: np.ndarray, above: bool) -> tuple[np.ndarray, np.ndarray]:
        """Where light of some cosines goes.

        Args:
            k: number of the interface.
            cos: (N,) cosines on the side that the light comes from.
            above: whether that is the upper one.

        Returns:
            (C, M n, A N) what is reflected, (C, M n_beyond, A N) what is transmitted, on the nodes of either region and
            as harmonics of the azimuth, for light from all `Azimuths.angles`.
        """
        interface = self.stack.interfaces[k]
        inner: Any = interface.single if interface.single is not None else interface
        here, beyond = (k, k + 1) if above else (k + 1, k)
        cos = np.maximum(cos, LOWEST)
        full = interface.single is not None and not still(interface)
        if isinstance(inner, BoundConductor):
            r = self._metal(k, cos, self.given["eta", k], self.given["k", k])
            return r + self._returned(k, cos) if full else r, np.zeros((1, 0, r.shape[2]))
        if isinstance(inner, BoundDiffuse):
            even = self.given["reflectance", k][:, None] * self.nodes.weights(k)
            size = len(cos) * len(self.azimuths.angles)
            return self.azimuths.evened(np.repeat(even[:, :, None], size, axis=2)), np.zeros((1, 0, size))
        if isinstance(inner, Null) or self.nodes.index(beyond) == self.nodes.index(here):
            light = self.number(padded(cos))
            all_of = self.azimuths.kept(self.nodes.shared(here, light, [1 + 0 * light], 1))
            return 0 * all_of, all_of
        r, t = self._dielectric(k, cos, above)
        if full:
            lost = 1 - self.azimuths.energy(r) - self.azimuths.energy(t)
            passed = float(values(interface.missing.exchanged()[0 if above else 1])[0])  # type: ignore[attr-defined]
            for side, part in ((above, 1 - passed), (not above, passed)):
                more = self.azimuths.evened(self._lost_shape(k, side)[None, :, None] * (lost * part)[:, None])
                r, t = (r + more, t) if side is above else (r, t + more)
        return r, t

    def _lost_shape(self, k: int, above: bool) -> np.ndarray:
        """(n,) how what facets sent to one another leaves on a side, over all of it."""
        region = k if above else k + 1
        r, t = self._dielectric(k, np.maximum(self.nodes.cosines(region), LOWEST), above)
        lost = (1 - self.azimuths.energy(r) - self.azimuths.energy(t))[0]
        return _shape(self.azimuths.mean(lost), self.nodes.weights(region))

    def _dielectric(self, k: int, cos: np.ndarray, above: bool) -> tuple[np.ndarray, np.ndarray]:
        number, regions = self.number, (k, k + 1) if above else (k + 1, k)
        here, beyond_index = (float(self.given["index", region][0]) for region in regions)
        eta = dr.opaque(number, beyond_index / here)
        if still(self.stack.interfaces[k]):
            light = number(padded(cos))
            fresnel, beyond = fresnel_dielectric(light, eta, 1 / eta)
            r = self.nodes.shared(regions[0], light, [fresnel], 1)
            t = self.nodes.shared(regions[1], at_least(dr.abs(beyond), LOWEST), [1 - fresnel], 1)
            return self.azimuths.kept(r), self.azimuths.kept(t)
        w, facets, u = self._facets(k, cos)
        copy = BoundDielectric(eta, facets, False, Frame(0.0))
        up, down = (copy.sample(w, (0.5, *u), True, part) for part in ("reflect", "transmit"))
        weights = [dr.select(right, e.weight, 0) for e, right in ((up, up.o.z > 0), (down, down.o.z < 0))]
        r, t = (
            self._counted(region, k, sample.o, [weight])
            for region, sample, weight in zip(regions, (up, down), weights, strict=True)
        )
        return r, t

    def _metal(self, k: int, cos: np.ndarray, *index: np.ndarray) -> np.ndarray:
        """What a metal of some index (its real and its imaginary part, C of each) reflects by single scattering."""
        number = self.number
        colours = _pairs(number, *index)
        if still(self.stack.interfaces[k]):
            like = number(padded(cos))
            fresnel = [fresnel_conductor(like, *pair) for pair in colours]
            return self.azimuths.kept(self.nodes.shared(k, like, fresnel, 1))
        w, facets, u = self._facets(k, cos)
        m = facets.sample(w, *u)
        o = reflect(w, m)
        seen = at_most(at_least(dr.dot(w, m), 0), 1)
        kept = facets.masked(w, self.vector(o.x, o.y, dr.abs(o.z)), facets.sigma(w))
        kept = dr.select(o.z > 0, kept, 0)
        weights = [kept * fresnel_conductor(seen, *pair) for pair in colours]
        return self._counted(k, k, o, weights)

    def white(self, k: int, cos: np.ndarray) -> np.ndarray:
        """(A N,) what the facets of a metal would reflect if they absorbed nothing."""
        ideal = self._metal(k, np.maximum(cos, LOWEST), np.zeros(1), np.ones(1))
        return self.azimuths.energy(ideal)[0]

    def _returned(self, k: int, cos: np.ndarray) -> np.ndarray:
        """What a metal gives back of what its facets sent to one another (Kulla & Conty 2017)."""
        nodes, weights = np.maximum(self.nodes.cosines(k), LOWEST), self.nodes.weights(k)
        lost, all_lost = (1 - self.white(k, c) for c in (cos, nodes))
        all_lost = self.azimuths.mean(all_lost)
        mean = float(all_lost @ weights)
        like = self.number(padded(nodes))
        pairs = _pairs(self.number, self.given["eta", k], self.given["k", k])
        even = np.array([np.array(fresnel_conductor(like, *pair)) @ weights for pair in pairs])
        part = even**2 * (1 - mean) / (1 - even * mean)
        return self.azimuths.evened(part[:, None, None] * _shape(all_lost, weights)[None, :, None] * lost)

    def _facets(self, k: int, cos: np.ndarray) -> tuple[Any, Microfacets, tuple[Any, Any]]:
        """Directions, each for all facets of the lattice, the surface, and what chooses its facets."""
        interface: Any = self.stack.interfaces[k]
        number, given = self.number, (interface.single or interface).facets
        count = len(self._lattice[0])
        angles = self.azimuths.angles
        many = np.repeat(np.tile(cos, len(angles)), count)
        c, s = (number(padded(x)) for x in (many, np.sqrt((1 - many) * (1 + many))))
        u = tuple(number(padded(np.tile(x, len(cos) * len(angles)))) for x in self._lattice)
        alpha = dr.opaque(number, float(self.given["alpha", k][0]))
        names = "ggx" if given.ggx else "beckmann", "correlated" if given.correlated else "separable"
        if self.azimuths.count == 1:
            return self.vector(s, 0 * c, c), Microfacets(alpha, alpha, *names), (u[0], u[1])
        across = dr.opaque(number, float(self.given.get(("across", k), self.given["alpha", k])[0]))
        x, y = (
            number(padded(np.repeat(part, len(cos) * count))) for part in (np.cos(angles), np.sin(angles))
        )
        w = self._frame(k).enter(self.vector(s * x, s * y, c))
        return w, Microfacets(alpha, across, *names), (u[0], u[1])

    def _frame(self, k: int) -> Frame:
        turn = float(self.given["turn", k][0]) if ("turn", k) in self.given else 0.0
        return Frame(np.degrees(turn)) if turn == 0 else Frame(dr.opaque(self.number, np.degrees(turn)))

    def _counted(self, region: int, k: int, o: Any, weights: list[Any]) -> np.ndarray:
        """Samples that the interface k sent to o, on nodes and as harmonics (C, M n, A N)."""
        count = len(self._lattice[0])
        cos = at_most(at_least(dr.abs(o.z), LOWEST), 1)
        weights = [weight / count for weight in weights]
        if self.azimuths.count > 1:
            o = self._frame(k).leave(o)
            more = self.azimuths.at(o.x, o.y)
            weights = [part for weight in weights for part in (weight, *(weight * y for y in more))]
        found = self.nodes.shared(region, cos, weights, count)
        return found.reshape(-1, self.azimuths.count * found.shape[1], found.shape[2])


def _turn(frame: Frame) -> Any:
    """The angle of the x axis."""
    return dr.atan2(frame.sin, frame.cos) if frame.turned else 0.0


def _pairs(number: Any, *index: np.ndarray) -> list[tuple[Any, ...]]:
    """Complex indices, colour by colour."""
    colours = zip(*np.broadcast_arrays(*index), strict=True)
    return [tuple(dr.opaque(number, float(x)) for x in colour) for colour in colours]


def _shape(lost: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """What is lost, by direction, over all: that is how it leaves; evenly, where there is as good as nothing."""
    whole = float(lost @ weights)
    return np.asarray(lost * weights / whole if whole > 1e-6 else weights)
