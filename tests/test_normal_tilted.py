"""A tilted interface by itself: densities are those of sampling, forwards and backwards, folded light included."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from lanes import SINGLE, back, direction, hemisphere, needs_llvm
from quadrature import sphere
from urushi.interfaces import BoundDielectric, BoundDiffuse
from urushi.interfaces.base import Frame
from urushi.interfaces.tilted import Tilted
from urushi.optics.microfacet import Microfacets
from urushi.optics.random import generator

pytestmark = needs_llvm

COUNT = 1 << 16
#: slopes of a normal tilted by 60 degrees, and by 17
NORMALS = {"steep": direction(0.5, 0.4), "gentle": np.array([0.3, 0.1, 1.0])}


def glass(normal: np.ndarray) -> Tilted:
    """Below a stack's outer side: light from above is folded by the plane, from below by the wall."""
    facets = Microfacets(SINGLE([0.3]), SINGLE([0.5]), "ggx", "correlated")
    inner = BoundDielectric(SINGLE([1.5]), facets, False, Frame(30.0))
    return Tilted(inner, [SINGLE([x]) for x in normal], (True, False))


def numbers(rng: np.random.Generator) -> tuple[Any, Any, Any]:
    return tuple(SINGLE(rng.random(COUNT)) for _ in range(3))  # type: ignore[return-value]


@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("name", NORMALS)
def test_the_density_of_a_sample_is_what_reflect_and_transmit_say(
    name: str, above: bool, rng: np.random.Generator
) -> None:
    interface, w = glass(NORMALS[name]), SINGLE.vectors(hemisphere(rng, COUNT, 0.02))
    event = interface.sample(w, numbers(rng), above)
    reflected, transmitted = interface.reflect(w, event.o, above)[1], interface.transmit(w, event.o, above)[1]
    truth = back(dr.select(event.through, transmitted, reflected))
    found, alive = back(event.pdf), back(event.weight) > 0
    assert np.all(np.abs(found - truth)[alive] <= 2e-2 * truth[alive] + 1e-4)
    # Every event lies on the side that it says.
    assert np.all((back(event.o)[:, 2] < 0) == back(event.through))


@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("name", NORMALS)
def test_values_and_densities_integrate_to_what_sampling_gives(
    name: str, above: bool, rng: np.random.Generator
) -> None:
    """From several directions, one of them behind the steep normal."""
    interface = glass(NORMALS[name])
    for cos, phi in ((0.9, 1.0), (0.3, 3.6), (0.5, 0.5)):
        w = SINGLE.vectors(np.broadcast_to(direction(cos, phi), (COUNT, 3)))
        event = interface.sample(w, numbers(rng), above)
        o, area = sphere(256, 256)
        wi, wo = SINGLE.vectors(np.broadcast_to(direction(cos, phi), o.shape)), SINGLE.vectors(o)
        for through in (False, True):
            value, pdf = interface.transmit(wi, wo, above) if through else interface.reflect(wi, wo, above)
            side = (o[:, 2] < 0) == through
            chosen = back(event.through) == through
            weight = back(event.weight)  # 0 where a facet would send light the wrong way
            for integrand, sampled in ((back(value), weight), (back(pdf), weight > 0)):
                truth, mean = np.sum((integrand * area)[side]), np.mean(sampled * chosen)
                assert abs(mean - truth) < 5 * np.std(sampled * chosen) / np.sqrt(COUNT) + 4e-3


@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("name", NORMALS)
def test_backwards_is_the_same_light(name: str, above: bool, rng: np.random.Generator) -> None:
    """`back` is the flux density that `transmit` has from the other side; `towards` finds all of it."""
    interface = glass(NORMALS[name])
    w, o = hemisphere(rng, 4000, 0.05) * (1, 1, -1), hemisphere(rng, 4000, 0.05)
    found = back(interface.back(SINGLE.vectors(o), SINGLE.vectors(w), above, "transmit")[0])
    mirrored = SINGLE.vectors(w * (1, 1, -1)), SINGLE.vectors(o * (1, 1, -1))
    truth = back(interface.transmit(*mirrored, not above, "transmit")[0])
    assert np.allclose(found, truth, rtol=2e-2, atol=1e-3)
    for cos, phi in ((0.9, 1.0), (0.5, 0.5)):
        one = SINGLE.vectors(np.broadcast_to(direction(cos, phi), (COUNT, 3)))
        u = numbers(rng)
        rng_lanes = generator(one, [*u], 0, 0)
        came = interface.towards(one, u, above, "transmit", rng_lanes)
        grid, area = sphere(256, 256, -1, 0)
        there = SINGLE.vectors(np.broadcast_to(direction(cos, phi), grid.shape))
        value, pdf = (back(x) for x in interface.back(there, SINGLE.vectors(grid), above, "transmit"))
        weight, z = back(came.weight), back(came.w)[:, 2]
        alive = weight > 0
        assert np.all(z[alive] < 0)
        # Two moments of where light came from, and the share of samples that came from anywhere.
        for moment, of in ((z, grid[:, 2]), (np.ones(COUNT), np.ones(len(grid)))):
            sampled = np.where(alive, weight * moment, 0)
            spread = np.std(sampled) / np.sqrt(COUNT)
            assert abs(np.mean(sampled) - np.sum(value * area * of)) < 5 * spread + 1e-2
        assert abs(np.mean(alive) - np.sum((pdf * area)[value > 0])) < 0.02


def test_a_matte_surface_is_as_bright_as_it_is_tilted() -> None:
    """Lambert's cosine is that to the normal; all of it comes back."""
    normal = NORMALS["gentle"]
    interface = Tilted(BoundDiffuse(0.8), [SINGLE([x]) for x in normal])
    o, area = sphere(256, 128, 0, 1)
    w = SINGLE.vectors(np.broadcast_to(direction(0.9, 1.0), o.shape))
    value = back(interface.reflect(w, SINGLE.vectors(o), True)[0])
    cos = o @ (normal / np.linalg.norm(normal))
    steep = o[:, 2] > 0.5  # nothing is folded there
    assert np.allclose(value[steep], 0.8 * cos[steep] / np.pi, rtol=1e-4)
    assert np.sum(value * area) == pytest.approx(0.8, abs=2e-3)


def test_a_smooth_one_stretches_solid_angles_by_its_own_cosines(rng: np.random.Generator) -> None:
    normal = NORMALS["gentle"] / np.linalg.norm(NORMALS["gentle"])
    interface = Tilted(BoundDielectric(SINGLE([1.5]), None, True, Frame(0.0)), [SINGLE([x]) for x in normal])
    w = hemisphere(rng, 1000, 0.6)
    event = interface.sample(SINGLE.vectors(w), numbers(rng), True, "transmit")
    found = back(interface.stretch(SINGLE.vectors(w), event.o, True))
    assert np.allclose(found, 1.5**2 * np.abs(back(event.o) @ normal) / (w @ normal), rtol=1e-3)


def test_a_mirror_sends_light_from_behind_as_if_it_were_level(rng: np.random.Generator) -> None:
    """From outside; inside, the wall turns it around."""
    normal = NORMALS["gentle"] / np.linalg.norm(NORMALS["gentle"])
    w = hemisphere(rng, 4000, 0.02)
    w = w[w @ normal < -0.01]
    assert len(w) > 100
    for outside in (True, False):
        mirror = BoundDielectric(SINGLE([1.5]), None, True, Frame(0.0))
        interface = Tilted(mirror, [SINGLE([x]) for x in normal], (outside, True))
        u = tuple(SINGLE(np.full(len(w), x)) for x in (0.5, 0.5, 0.5))
        o = back(interface.sample(SINGLE.vectors(w), u, True, "reflect").o)
        assert np.allclose(o, w * (-1, -1, 1), atol=1e-5) == outside
