"""The microsurface as a random medium: areas, flights and walks against quadrature and the paper's own walk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy import integrate, special, stats

from lanes import DOUBLE, SINGLE, Lanes, back, both_precisions, direction, needs_llvm
from microwalk import heitz, streams
from quadrature import all_normals
from surface import spread
from urushi.optics.bounces import begin, escape
from urushi.optics.facets import Event, Metal, Pane
from urushi.optics.microsurface import Microsurface, fly, other_depth, seen_next, seen_second, seen_through

pytestmark = needs_llvm

each_distribution = pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
ALPHAS = [(0.5, 0.5), (0.2, 1.0), (1.0, 0.3)]
SIGMAS = 4.5  # of dozens of comparisons each


def surface(lanes: Lanes, alpha: tuple[float, float], distribution: str = "ggx") -> Microsurface:
    return Microsurface(lanes(alpha[0]), lanes(alpha[1]), distribution)


@both_precisions
@each_distribution
def test_projected_area(lanes: Lanes, distribution: str) -> None:
    """Against its integral over the normals, from above and from below."""
    cos = np.array([1.0, 0.9, 0.5, 0.1, 0.01, -0.01, -0.1, -0.5, -0.8])
    w = lanes.rounded(direction(cos, 0.3 + np.arange(len(cos))))
    for alpha in ALPHAS:
        m, solid = all_normals(distribution, *alpha)
        density = back(surface(DOUBLE, alpha, distribution).density(DOUBLE.vectors(m)))
        expected = np.maximum(w @ m.T, 0) @ (density * solid)
        found = back(surface(lanes, alpha, distribution).area(lanes.vectors(w)))
        assert np.allclose(found, expected, rtol=2e-5, atol=2e-5)


@both_precisions
@each_distribution
def test_small_areas_keep_their_digits(lanes: Lanes, distribution: str) -> None:
    """sigma(w) - sigma(-w) = cos, and Smith's formula where it loses nothing: in double precision."""
    w = lanes.rounded(direction(np.array([0.95, 0.6, 0.2, 1e-3, 1e-6]), 0.7))
    for alpha in ((1e-2, 1e-2), (0.3, 0.1)):
        s = surface(lanes, alpha, distribution)
        up, down = back(s.area(lanes.vectors(w))), back(s.area(lanes.vectors(-w)))
        assert np.allclose(up - down, w[:, 2], rtol=1e-6)
        spread_ = np.hypot(alpha[0] * w[:, 0], alpha[1] * w[:, 1])
        a = w[:, 2] / spread_
        if distribution == "ggx":
            lam = 0.5 / a**2 / (1 + np.sqrt(1 + 1 / a**2))
        else:
            clear = a < 20
            lam = np.where(clear, np.exp(-(a**2)) / (2 * a * np.sqrt(np.pi)) - 0.5 * special.erfc(a), 0)
        far = a < (1e9 if distribution == "ggx" else 4)
        assert np.allclose((down / w[:, 2])[far], lam[far], rtol=2e-4)
        assert np.all(down >= 0)


@each_distribution
@pytest.mark.parametrize("cos", [0.3, 0.02, -0.05, -0.4, -0.7])
def test_normals_seen_from_anywhere(distribution: str, cos: float) -> None:
    """First and second moments of sampled normals against quadrature."""
    n = 1 << 17
    for alpha in ALPHAS:
        w = direction(cos, 0.6)
        m, solid = all_normals(distribution, *alpha)
        s = surface(DOUBLE, alpha, distribution)
        weight = np.maximum(m @ w, 0) * back(s.density(DOUBLE.vectors(m))) * solid
        one = SINGLE.vectors(spread(w[None], n))
        found = back(surface(SINGLE, alpha, distribution).normal(one, streams(one, 1)))
        assert np.allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5) and np.all(found[:, 2] > 0)
        moments = np.concatenate([found, found**2, found[:, [0]] * found[:, 1:2]], axis=1)
        truth = np.concatenate([m, m**2, m[:, [0]] * m[:, 1:2]], axis=1).T @ weight / weight.sum()
        error = moments.std(axis=0) / np.sqrt(n) + 2e-5
        assert np.all(np.abs(moments.mean(axis=0) - truth) < SIGMAS * error), (
            alpha,
            moments.mean(axis=0),
            truth,
        )


@both_precisions
def test_depths(lanes: Lanes) -> None:
    """The depth seen from the other side, there and back, and a flight that ends outside or at a facet."""
    t = lanes.rounded(np.concatenate([10.0 ** np.linspace(-7, 1.5, 100), [0.099, 0.101]]))
    other = back(other_depth(lanes(t)))
    assert np.allclose(other, -np.log(-np.expm1(-t)), rtol=3e-5, atol=3e-7)
    assert np.allclose(back(other_depth(other_depth(lanes(t[t < 10])))), t[t < 10], rtol=3e-3)
    d = lanes.vectors(direction(np.array([0.5, 0.5, -0.5, 1.0, 0.5])))
    depth, meets = fly(
        lanes(np.full(5, 2.0)), d, lanes([0.5, 0.5, 0.5, 0.0, np.nan]), lanes([0.4, 1.1, 3.0, 0.1, 1])
    )
    assert np.array(meets).tolist() == [True, False, True, False, False]
    assert np.allclose(back(depth)[[0, 2]], [1.2, 8.0])


@both_precisions
def test_integrated_depths(lanes: Lanes, rng: np.random.Generator) -> None:
    """What is seen from the next facet, and from the second, against integrals over the depth."""
    rate, masking, t, first = (10 ** rng.uniform(-2, 1.5, 40) for _ in range(4))
    masking[:5], masking[5:8] = rate[:5], rate[5:8] * 1.001
    cos = np.where(np.arange(40) % 2, 0.4, -0.4)
    rate, masking, t, first = (lanes.rounded(x) for x in (rate, masking, t, first))

    def seen(t: float, rate: float, masking: float, up: bool) -> float:
        def one(x: float) -> float:
            return float(rate * np.exp(-rate * x - masking * (t - x if up else t + x)))

        end = t if up else 40 / (rate + masking)
        knots = [p for p in (1 / (rate + masking), t - 1 / masking, 1 / rate) if 0 < p < end]
        return float(integrate.quad(one, 0, end, points=knots, limit=200)[0])

    d = lanes.vectors(direction(cos))
    found = back(seen_next(lanes(t), d, lanes(rate), lanes(masking)))
    expected = [seen(*x) for x in zip(t, rate, masking, cos > 0, strict=True)]
    assert np.allclose(found, expected, rtol=2e-4, atol=1e-7)
    found = back(seen_second(lanes(first), d, lanes(rate), lanes(masking)))
    depths = -np.log(np.arange(0.5, 20_000) / 20_000)  # the middles of as many equal chances
    for i in range(40):
        of_each = back(
            seen_next(
                DOUBLE(depths / first[i]),
                DOUBLE.vectors(spread(direction(cos[i])[None], len(depths))),
                DOUBLE(rate[i]),
                DOUBLE(masking[i]),
            )
        )
        assert found[i] == pytest.approx(of_each.mean(), rel=2e-3)


@both_precisions
def test_refracted_once(lanes: Lanes) -> None:
    """Beta(1 + a, 1 + b), up to grazing angles."""
    a, b = (lanes.rounded(x.ravel()) for x in np.meshgrid(*[np.r_[0, 10.0 ** np.linspace(-4, 5, 19)]] * 2))
    found, expected = back(seen_through(lanes(a), lanes(b))), special.beta(1 + a, 1 + b)
    near = expected > 1e-25
    exact = 4e-6 if lanes is DOUBLE else np.where(expected > 1e-4, 2e-5, 1e-3)[near]
    assert near.sum() > 150 and np.all(np.abs(found[near] / expected[near] - 1) < exact)
    assert np.all(found[~near] < 1e-20) and np.all(found >= 0)


@both_precisions
@each_distribution
def test_density_of_facets(lanes: Lanes, distribution: str, rng: np.random.Generator) -> None:
    """`toward` says of a scattered direction what `scatter` does, on every side and from any direction."""
    n = 4000
    w = lanes.vectors(direction(rng.uniform(-0.8, 1, n), rng.uniform(0, 6, n)))
    s, stream = surface(lanes, (0.3, 0.6), distribution), streams(w, 4)
    inside = lanes(rng.random(n)) < 0.5
    area, m = s.area(w), s.normal(w, stream)
    for facet in (Metal(0.2, 3.0), Pane(lanes(1.5), lanes(1 / 1.5))):
        event = facet.scatter(s, w, m, area, inside, stream)
        density, factor = facet.toward(s, w, event.d, area, event.through, inside)
        assert np.allclose(back(factor + 0 * w.x), back(event.factor + 0 * w.x), rtol=1e-3)
        ratio = back(density / event.density)[back(dr.abs(dr.dot(w, m))) > 0.05]
        assert np.quantile(np.abs(ratio - 1), 0.99) < (2e-3 if lanes is SINGLE else 1e-9)
    assert 0.2 < np.mean(np.array(event.through)) < 0.9


@dataclass
class Tally(Metal):
    """Mirrors that leave the light a thousandth less each, so that its weight counts them."""

    def scatter(self, *args: Any) -> Event:
        event = super().scatter(*args)
        return Event(event.d, 0.999 + 0 * event.factor, False, event.density)


def counted(
    alpha: tuple[float, float], w: np.ndarray, n: int, distribution: str = "ggx"
) -> tuple[np.ndarray, np.ndarray]:
    """Directions out and numbers of facets, of n walks."""
    s, facet = surface(DOUBLE, alpha, distribution), Tally(0.0, 1.0)
    one = DOUBLE.vectors(spread(w[None], n))
    stream = streams(one, 7)
    event = facet.scatter(s, one, s.normal(one, stream), s.area(one), False, stream)
    going = one.z > 0
    o, weight, _ = escape(s, facet, begin(s, one, event, event.factor, going, stream), stream)
    return back(o), np.rint(np.log(back(weight)) / np.log(0.999)).astype(int)


def test_numbers_of_facets() -> None:
    """Mean numbers, and the part that meets one, for GGX: three digits that an independent program printed."""
    n = 1 << 18
    means = {0.5: (1.151, 1.375, 1.411), 1.0: (1.281, 1.857, 2.225)}
    once = {0.5: (0.8601, 0.6983, 0.6840), 1.0: (0.7602, 0.4507, 0.3275)}
    for alpha in (0.5, 1.0):
        for cos, mean, part in zip((0.1, 0.5, 0.9), means[alpha], once[alpha], strict=True):
            o, met = counted((alpha, alpha), direction(cos), n)
            assert np.all(o[:, 2] > 0) and met.min() == 1
            assert abs(met.mean() - mean) < 4 * met.std() / np.sqrt(n) + 1e-3
            assert abs(np.mean(met == 1) - part) < 4 * np.sqrt(part * (1 - part) / n) + 1e-4


@pytest.mark.parametrize("alpha", [(0.7, 0.7), (0.2, 1.0)])
def test_against_the_walk_of_the_paper(alpha: tuple[float, float], rng: np.random.Generator) -> None:
    """Directions after one, two and more facets, as frequent as in Heitz's walk on heights of normal distribution."""
    n, w = 200_000, direction(0.6, 0.5)
    o, met = counted(alpha, w, n)
    theirs, order = heitz(alpha, w, n, rng)
    for facets in (1, 2, 3):
        tables = []
        for d, k in ((o, met), (theirs, order)):
            d = d[np.minimum(k, 3) == facets]
            tables.append(
                np.histogram2d(d[:, 2], np.arctan2(d[:, 1], d[:, 0]), (8, 8), ((0, 1), (-np.pi, np.pi)))[0]
            )
        mine, other = (table.ravel() for table in tables)
        some = mine + other > 10
        assert some.sum() > 30
        chi2 = np.sum((mine - other)[some] ** 2 / (mine + other)[some])
        assert stats.chi2.sf(chi2, some.sum()) > 1e-5, facets
