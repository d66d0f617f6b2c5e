"""Columns of an interface's matrices: where the light of each node goes, whatever the width of the lobe.

The matrix of a rough interface could hold its values at pairs of nodes, times a weight; then the nodes must resolve
the lobe, and a roughness of 0.01 needs hundreds of them. Here the light is collected instead: what leaves in the
direction mu is shared among the nodes around it by the basis functions L_o of the grid (the Lagrange polynomials of
its panels, whose sum is 1 everywhere):

    A_m[o, i] = integral of L_o(mu) k_m(mu <- mu_i) dmu,        k_m = integral of k cos(m phi) dphi

See theory (basis.14). So every column adds up to the true albedo, a lobe too narrow for the nodes acts on all that is
smooth as it should, the limit of a smooth interface is its diagonal, and where the nodes resolve the lobe A_m[o, i]
is w_o k_m(mu_o <- mu_i) again. phi is the azimuth between the ways light travels: 0 is straight on, and the mirror
direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np

from ...interfaces import Interface
from ...optics.random import generator
from ..arrays import padded
from .angles import Fan, Ring, fan, gauss, lagrange, ring
from .basis import Grid

#: values of the interface computed at a time
LANES = 1 << 21
SEED = 20_160_711
#: the narrowest lobe that gets panels of its own, in radians
NARROWEST = 1e-5
#: cosine up to which lobes become narrower in azimuth as both directions graze
GRAZING = 0.1
#: Gauss points per panel more than elsewhere where polynomials are integrated with cosines, which asks more of them
SMOOTH = 2
#: what a panel with a kink in it may hold, of all light of its node per unit of the cosine, to pass as smooth
DARK = 1e-4


@dataclass(frozen=True)
class Side:
    """One of the four operators of an interface.

    Attributes:
        interface: the boundary, in double precision.
        grid: the nodes.
        source, target: the regions that light comes from and goes to.
        above: whether it comes from above.
        draws: 0 for what needs no random numbers; or how many estimates to average of all the rest, which a
            stochastic interface sends in wide lobes.
    """

    interface: Interface
    grid: Grid
    source: int
    target: int
    above: bool
    draws: int = 0

    @property
    def reflects(self) -> bool:
        return self.source == self.target

    @cached_property
    def ratio(self) -> float:
        """Index beyond the boundary over that on the incident side."""
        return _number(self.interface.ratio(self.above))

    @cached_property
    def alpha(self) -> float:
        """Roughness; 1 for what has none but is no smooth interface either."""
        alpha = max(_number(a) for a in self.interface.roughness())
        return alpha if alpha > 0 and self.draws == 0 else 1.0

    def azimuth(self, node: int) -> float:
        """Width of the lobe about the direction of the smooth interface, in azimuth.

        At width x the facet between both directions has the slope alpha (at imaginary x, where GGX has its poles).
        Nearer to the horizon than `GRAZING` or alpha it counts as there.
        """
        if node >= min(self.grid.count(self.source), self.grid.count(self.target)):
            return np.inf
        sin = self.grid.s[node] / self.grid.indices[self.source]
        cos_i, cos_o = self.grid.mu[self.source][node], self.grid.mu[self.target][node]
        z = 2 * max(cos_i, min(self.alpha, GRAZING)) if self.reflects else abs(self.ratio * cos_o - cos_i)
        return float(2 * np.arcsinh(self.alpha * z / max(2 * sin, 1e-30)))


def _number(value: Any) -> float:
    return float(np.max(np.array(value)))


def columns(side: Side, orders: range, points: int, first: int = 0) -> np.ndarray:
    """(C, len(orders), n_out - first, n_in - first) what nodes receive, in each order, of the flux of each node.

    Args:
        side: which operator.
        orders: azimuthal orders.
        points: Gauss points per panel of every integral.
        first: nodes before this one neither send nor receive.
    """
    grid = side.grid
    sin_i = grid.s[: grid.count(side.source)] / grid.indices[side.source]
    cos_i = grid.mu[side.source]
    n_out = grid.count(side.target)
    fans = [_fan(side, sin, cos, points) for sin, cos in zip(sin_i[first:], cos_i[first:], strict=True)]
    found: np.ndarray | None = None
    for some in _chunks([len(f.cos) * len(orders) for f in fans]):
        chosen = fans[some.start : some.stop]
        lengths = [len(f.cos) for f in chosen]
        series = Pairs(
            np.repeat(sin_i[first:][some.start : some.stop], lengths),
            np.repeat(cos_i[first:][some.start : some.stop], lengths),
            np.concatenate([f.sin for f in chosen]),
            np.concatenate([f.cos for f in chosen]),
        ).series(side, orders, points)
        if found is None:
            found = np.zeros((len(series), len(orders), n_out, len(fans)))
        _share(side, chosen, series, orders, found[..., some.start : some.stop])
    assert found is not None
    if first == 0:  # light along the normal has no azimuth
        turning = np.asarray(orders) > 0
        found[:, turning, 0] = 0
        found[:, turning, :, 0] = 0
    return np.ascontiguousarray(found[:, :, first:])


def _share(side: Side, fans: list[Fan], series: np.ndarray, orders: range, found: np.ndarray) -> None:
    """Collect k_m at the points of fans (C, P, M) on the nodes (C, M, n_out, fans) by their basis functions."""
    ends = np.cumsum([0, *(len(f.cos) for f in fans)])
    flux = series.transpose(0, 2, 1) * np.concatenate([f.weight for f in fans])
    for p in range(len(fans[0].starts) - 1):
        panel = side.grid.panels[p]
        parts = [slice(f.starts[p], f.starts[p + 1]) for f in fans]
        at = np.concatenate([f.coordinate[part] for f, part in zip(fans, parts, strict=True)])
        even, odd = (slice((orders.start + k) % 2, None, 2) for k in (0, 1))
        functions, turned = side.grid.functions(panel, at), side.grid.odd_factors(panel, at)
        start = 0
        for k, part in enumerate(parts):
            stop = start + part.stop - part.start
            own = flux[..., ends[k] + part.start : ends[k] + part.stop]
            light = found[:, :, panel.nodes, k]
            if turned is None:
                light[:] = own @ functions[start:stop]
            else:
                light[:, even] = own[:, even] @ functions[start:stop]
                light[:, odd] = (own[:, odd] * turned[0][start:stop]) @ functions[start:stop] * turned[1]
            start = stop


def _chunks(sizes: list[int], limit: int = 4_000_000) -> Iterator[range]:
    """Consecutive columns that fit in memory together."""
    start, total = 0, 0
    for i, size in enumerate(sizes):
        if total + size > limit and i > start:
            yield range(start, i)
            start, total = i, 0
        total += size
    yield range(start, len(sizes))


def _fan(side: Side, sin_i: float, cos_i: float, points: int) -> Fan:
    grid, eta, alpha = side.grid, side.ratio, side.alpha
    n_in, n_out = grid.indices[side.source], grid.indices[side.target]
    theta_i = float(np.arctan2(sin_i, cos_i))
    sin_o = sin_i * n_in / n_out
    centre = float(np.arcsin(min(sin_o, 1.0)))
    kinks: list[float] = []
    if side.reflects:
        width = 2 * alpha
        if (
            eta < 1
        ):  # total reflection of a facet begins: the angle between both directions is twice the critical one
            critical = 2 * np.arcsin(eta)
            kinks = [critical - theta_i, theta_i - critical, theta_i + critical]
    else:
        cos_o = np.sqrt(max(1 - sin_o**2, 0.0))
        width = alpha * abs(1 - cos_i / (eta * cos_o)) if eta * cos_o > cos_i * 0.1 else alpha
        edge = np.arccos(min(eta, 1 / eta))  # no facet bends light by more
        kinks = [theta_i - edge, theta_i + edge, edge - theta_i]
        if cos_i < eta:  # the facet between them stands upright, and D of GGX does not end there
            kinks.append(float(np.arccos(cos_i / eta)))
    width = min(max(width, NARROWEST), 0.5)
    return fan(grid, side.target, centre, width, min(alpha, 0.5), kinks, points)


@dataclass(frozen=True)
class Pairs:
    """Pairs of directions, incident and outgoing, each with sine and cosine of its polar angle: (P,) all."""

    sin_i: np.ndarray
    cos_i: np.ndarray
    sin_o: np.ndarray
    cos_o: np.ndarray

    def series(self, side: Side, orders: range, points: int) -> np.ndarray:
        """(C, P, M) integrals of k cos(m phi) over the circle."""
        level = self._levels(side)
        kink = self._kinks(side)
        found: np.ndarray | None = None
        bent: list[tuple[Ring, int, np.ndarray]] = []
        circles = {int(one): ring(int(one), orders.start, orders.stop, points + SMOOTH) for one in set(level)}
        for some in _batches([(circles[one], np.flatnonzero(level == one)) for one in sorted(circles)]):
            every = self.values(
                side,
                np.concatenate([np.repeat(which, len(circle.phi)) for circle, which in some]),
                np.concatenate([np.tile(circle.phi, len(which)) for circle, which in some]),
            )
            if found is None:
                found = np.empty((len(every), len(level), len(orders)))
            start = 0
            for circle, which in some:
                stop = start + len(which) * len(circle.phi)
                values = every[:, start:stop].reshape(len(every), len(which), -1)
                found[:, which] = values @ circle.project
                curved = _bent(circle, kink[which], values)
                panel = np.searchsorted(circle.breaks, kink[which[curved]]) - 1
                for one in np.unique(
                    panel
                ):  # what the panel with the kink says is taken back, and found anew
                    there, places = curved[panel == one], circle.places(one)
                    found[:, which[there]] -= values[:, there, places] @ circle.project[places]
                    bent.append((circle, one, which[there]))
                start = stop
        assert found is not None
        fine = [
            (circle.finer(panel, orders.start, orders.stop, points), some) for circle, panel, some in bent
        ]
        for batch in _batches(fine):
            for circle, which in batch:
                found[:, which] += self._sources(side, circle, which, kink[which]) @ circle.project
        return found

    def _levels(self, side: Side) -> np.ndarray:
        """(P,) the width of each lobe in azimuth, as a power of 2 to divide by.

        The facet between both directions has a slope whose square is |eta o - w|^2 / Z^2 in the plane, Z what the
        directions have along the normal: it passes alpha^2 where phi passes this width.
        """
        eta = 1.0 if side.reflects else side.ratio
        z = self.cos_i + self.cos_o if side.reflects else np.abs(eta * self.cos_o - self.cos_i)
        sin_o = eta * self.sin_o
        across = np.maximum(sin_o * self.sin_i, 1e-30)
        width = np.sqrt(((side.alpha * z) ** 2 + 0.01 * (sin_o - self.sin_i) ** 2) / across)
        return np.clip(np.ceil(-np.log2(np.clip(width, 1e-9, 1.0))), 0, 20).astype(int)

    def _sources(self, side: Side, circle: Ring, which: np.ndarray, kink: np.ndarray) -> np.ndarray:
        """(C, P, Q) values at the points of a fine ring; in panels with a kink, those that give the integrals."""
        panel = np.searchsorted(circle.breaks, kink) - 1
        low, high = circle.breaks[panel], circle.breaks[panel + 1]
        # phi = kink -+ length y^2 makes a square root at the kink smooth.
        y, w = gauss(circle.points)
        before, after = (kink - low)[:, None], (high - kink)[:, None]
        phi = np.concatenate([kink[:, None] - before * y**2, kink[:, None] + after * y**2], axis=1)
        weight = 2 * np.concatenate([before * (2 * y * w), after * (2 * y * w)], axis=1)
        every = np.concatenate([np.tile(circle.phi, (len(which), 1)), phi], axis=1)
        values = self.values(side, np.repeat(which, every.shape[1]), every.ravel())
        values = values.reshape(-1, *every.shape)
        found = values[..., : len(circle.phi)]
        # The points' light goes to the panel's own points, whose polynomials resolve all that it is projected on.
        x = (phi - low[:, None]) / (high - low)[:, None]
        shares = lagrange(gauss(circle.points)[0], x)
        places = panel[:, None] * circle.points + np.arange(circle.points)
        light = np.einsum("cpq,pqj->cpj", values[..., len(circle.phi) :] * weight, shares, optimize=True)
        found[:, np.arange(len(kink))[:, None], places] = light / circle.weight[places]
        return found

    def _kinks(self, side: Side) -> np.ndarray:
        """(P,) azimuth at which a facet begins to reflect all, or can no longer refract; 0 where there is none."""
        eta = side.ratio
        if side.draws:
            return np.zeros(len(self.sin_i))
        across = np.maximum(self.sin_i * self.sin_o, 1e-30)
        along = self.cos_i * self.cos_o
        if side.reflects:
            cos = (along - 1 + 2 * eta**2) / across if eta < 1 else np.full_like(along, 2.0)
        else:
            cos = (min(eta, 1 / eta) - along) / across
        return np.where(np.abs(cos) < 1, np.arccos(np.clip(cos, -1, 1)), 0.0)

    def values(self, side: Side, pair: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """(C, L) flux densities of pairs (L,) at azimuths (L,)."""
        from drjit.llvm.ad import Array3f64, Float64, UInt32

        which = UInt32(padded(pair, np.uint32))
        given = (self.sin_i, self.cos_i, self.sin_o, self.cos_o)
        sin_i, cos_i, sin_o, cos_o = (dr.gather(Float64, Float64(padded(v)), which) for v in given)
        sin, cos = dr.sincos(Float64(padded(phi)))
        w = Array3f64(-sin_i, 0.0, cos_i)
        o = Array3f64(sin_o * cos, sin_o * sin, cos_o if side.reflects else -cos_o)
        through = not side.reflects
        certain = side.interface.certain(w, o, side.above, through)
        if side.draws == 0:
            found = np.array(certain)
        else:
            ask = side.interface.transmit if through else side.interface.reflect
            found = np.zeros(())
            for draw in range(side.draws):
                rng = generator(w, [sin_i, sin_o, cos_o, sin], UInt32(SEED), dr.opaque(UInt32, draw))
                value, _ = ask(w, o, side.above, rng=rng)
                found = found + np.array(value - certain) / side.draws
        if found.size % len(phi):  # one number for all
            found = np.repeat(np.atleast_2d(found).reshape(-1, 1), len(phi), axis=1)
        return found.reshape(-1, len(phi))


def _bent(circle: Ring, kink: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Which pairs have a kink (P,) in a panel of the ring whose values (C, P, Q) hold any light to speak of."""
    bent = np.flatnonzero((kink > 0) & (kink < np.pi))
    panel = np.searchsorted(circle.breaks, kink[bent]) - 1
    places = panel[:, None] * circle.points + np.arange(circle.points)
    light = (np.abs(values[:, bent[:, None], places]) * circle.weight[places]).sum(axis=2).max(axis=0)
    return bent[light > DARK]


def _batches(jobs: list[tuple[Ring, np.ndarray]]) -> Iterator[list[tuple[Ring, np.ndarray]]]:
    """Pairs (P,) of directions, each with the ring it is looked at on, so many at a time as fit in memory."""
    batch: list[tuple[Ring, np.ndarray]] = []
    lanes = 0
    for circle, which in jobs:
        step = max(LANES // len(circle.phi), 1)
        for start in range(0, len(which), step):
            part = which[start : start + step]
            if lanes + len(part) * len(circle.phi) > LANES and batch:
                yield batch
                batch, lanes = [], 0
            batch.append((circle, part))
            lanes += len(part) * len(circle.phi)
    if batch:
        yield batch
