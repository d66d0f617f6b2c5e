"""Facets chosen in pairs: the mean they leave as it is, and that the promise is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lanes import DOUBLE, SINGLE, Lanes, back, direction, needs_llvm
from urushi.interfaces.base import Frame
from urushi.interfaces.conductor import BoundConductor
from urushi.interfaces.dielectric import BoundDielectric
from urushi.optics.microfacet import Microfacets
from urushi.solvers.walk import opposite

pytestmark = needs_llvm

N = 1 << 18
#: squared cosine below which index 1.5 reflects all light from inside
CAUGHT = 1 - 1.5**-2
Choose = Callable[[BoundDielectric, BoundConductor, Any, tuple[Any, ...]], tuple[Any, Any]]


def facets(
    lanes: Lanes, *alpha: float, distribution: str = "ggx", masking: str = "correlated"
) -> Microfacets:
    return Microfacets(lanes(alpha[0]), lanes(alpha[-1]), distribution, masking)


def pair(eta: float, lanes: Lanes = SINGLE, turned: float = 0.0) -> tuple[BoundDielectric, BoundConductor]:
    """A coat of roughness 0.05 by 0.15 and a metal of 0.2 by 0.3, by preference turned against each other."""
    coat = BoundDielectric(lanes(eta), facets(lanes, 0.05, 0.15), False, Frame(turned))
    return coat, BoundConductor(lanes(0.2), lanes(3.9), 1.0, facets(lanes, 0.2, 0.3), False, Frame(-turned))


def on_metal(coat: BoundDielectric, base: BoundConductor, w: Any, u: Any) -> tuple[Any, Any]:
    return opposite.metal_facet(base, coat, w, u)


def on_coat(coat: BoundDielectric, base: BoundConductor, w: Any, u: Any) -> tuple[Any, Any]:
    return opposite.coat_facet(coat, w, u)


def leaning(coat: BoundDielectric, base: BoundConductor, w: Any, u: Any) -> tuple[Any, Any]:
    return opposite.leaning_facet(coat, w, type(w)(3, -8, 0), u)


def draw(choose: Choose, eta: float, cos: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Chosen normals and weights, and normals sampled with the same numbers."""
    coat, base = pair(eta)
    w = SINGLE.vectors(np.broadcast_to(direction(cos, 0.7), (N, 3)))
    u = tuple(SINGLE(x) for x in rng.random((3, N)))
    m, weight = choose(coat, base, w, u)
    surface = base.facets if choose is on_metal else coat.facets
    assert surface is not None
    plain = surface.sample(w, u[0], u[1])
    return {"m": back(m), "weight": back(weight).ravel(), "plain": back(plain), "w": direction(cos, 0.7)}


@pytest.mark.parametrize("choose", [on_metal, on_coat, leaning])
@pytest.mark.parametrize("cos", [0.95, 0.6, 0.05])
def test_weighted_means_are_those_of_visible_normals(
    choose: Choose, cos: float, rng: np.random.Generator
) -> None:
    found = draw(choose, 1.5, cos, rng)
    m, weight, plain = found["m"], found["weight"], found["plain"]
    assert np.allclose(np.linalg.norm(m, axis=1), 1, atol=1e-5)
    assert weight.min() > 0 and weight.std() > 0.02

    def moments(m: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(N), m, m**2, m[:, 0] * m[:, 1], np.abs(m @ found["w"]) < 0.7])

    differences = weight[:, None] * moments(m) - moments(plain)
    away = differences.mean(axis=0) / (differences.std(axis=0) / np.sqrt(N) + 1e-9)
    assert np.all(np.abs(away) < 4.5), away


def test_promises_are_kept(rng: np.random.Generator) -> None:
    found = draw(on_metal, 1.5, 0.9, rng)
    caught = {}
    for name in ("m", "plain"):
        m = found[name]
        caught[name] = np.mean((2 * (m @ found["w"]) * m[:, 2] - found["w"][2]) ** 2 < CAUGHT)
    assert caught["m"] > 1.15 * caught["plain"] > 0.1
    found = draw(on_coat, 1.5, 0.8, rng)
    caught = {name: np.mean((found[name] @ found["w"]) ** 2 < CAUGHT) for name in ("m", "plain")}
    assert caught["m"] > 1.15 * caught["plain"] > 0.1
    found = draw(leaning, 1.5, 0.8, rng)
    lean = {name: np.mean(found[name] @ [3, -8, 0]) for name in ("m", "plain")}
    assert lean["m"] > lean["plain"] + 0.1


@pytest.mark.parametrize("choose", [on_metal, on_coat])
def test_where_nothing_is_caught_facets_weigh_the_same(choose: Choose, rng: np.random.Generator) -> None:
    assert np.allclose(draw(choose, 0.8, 0.7, rng)["weight"], 1, atol=1e-6)


def test_what_hardly_bends_promises_no_extremes(rng: np.random.Generator) -> None:
    assert draw(on_metal, 1.002, 0.9, rng)["weight"].max() < 0.5 * (1 + 1 + 2.0**4 * opposite.LOST)
    assert draw(on_coat, 1.002, 0.9, rng)["weight"].max() <= 0.5 * (1 + 1 / opposite.ESCAPED) + 1e-5


@pytest.mark.parametrize(("cos_a", "cos_b", "phi"), [(0.87, 0.87, 0.0), (0.5, 0.9, 2.0), (0.9, 0.6, 1.0)])
def test_leans_follow_what_the_metal_sends(cos_a: float, cos_b: float, phi: float) -> None:
    """Against differences of log D(half-way) when the facet that light crosses is tilted a little.

    `leans` leaves out that light also gets steeper by it, which is a fifth here at most.
    """
    coat, base = pair(1.5, DOUBLE, turned=25.0)
    a, b = direction(cos_a, 0.4), direction(cos_b, 0.4 + phi)

    def refracted(w: np.ndarray, slope: np.ndarray) -> np.ndarray:
        m = np.array([*slope, 1.0]) / np.sqrt(1 + slope @ slope)
        cos = w @ m
        return w / 1.5 + m * (np.sqrt(1 - (1 - cos**2) / 2.25) - cos / 1.5)

    def log_density(one: np.ndarray, other: np.ndarray) -> float:
        half = (one + other) / np.linalg.norm(one + other)
        assert base.facets is not None
        return float(np.log(back(base.facets.density(base.frame.enter(DOUBLE.vectors(half[None]))))).item())

    flat, step = np.zeros(2), 1e-5
    found = opposite.leans(coat, base, DOUBLE.vectors(a[None]), DOUBLE.vectors(b[None]))
    for lean, tilted, other in zip(found, (a, b), (b, a), strict=True):
        slopes = []
        for k in range(2):
            up, down = (
                log_density(refracted(tilted, sign * step * np.eye(2)[k]), refracted(other, flat))
                for sign in (1, -1)
            )
            slopes.append((up - down) / (2 * step))
        here = back(coat.frame.leave(lean))[0, :2] / opposite.LEAN
        assert np.linalg.norm(here - slopes) < 0.25 * np.linalg.norm(slopes), (here, slopes)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("masking", ["correlated", "separable"])
def test_short_cuts_of_microfacets(distribution: str, masking: str, rng: np.random.Generator) -> None:
    """Rarity is 1 / D, and `single` the product of what `weigh` returns."""
    surface = facets(DOUBLE, 0.2, 0.4, distribution=distribution, masking=masking)
    cos, phi = rng.uniform(0.85, 1, (3, 1000)), rng.uniform(0, 2 * np.pi, (3, 1000))
    w, o, m = (DOUBLE.vectors(direction(c, p)) for c, p in zip(cos, phi, strict=True))
    rarity, density = back(surface.rarity(m)).ravel(), back(surface.density(m)).ravel()
    assert np.allclose(rarity * density * np.pi * 0.2 * 0.4, 1, rtol=1e-9)
    visible, masked = surface.weigh(w, o, m)
    assert np.allclose(back(surface.single(w, o, m)), back(visible * masked), rtol=1e-12, atol=0)
