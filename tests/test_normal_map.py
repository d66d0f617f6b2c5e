"""Moments of slopes: what filtering a normal map has to keep."""

from __future__ import annotations

import numpy as np
import pytest

from urushi.adapters.normal_map import Slopes
from urushi.errors import UrushiError


def waves(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """A normal map with random slopes."""
    normal = np.concatenate([rng.normal(0, 0.2, (*shape, 2)), np.ones((*shape, 1))], axis=-1)
    return 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def test_slopes_are_those_of_the_image(rng: np.random.Generator) -> None:
    image = waves(rng, (4, 6))
    normal = 2 * image - 1
    found = Slopes.of(image, strength=2.0)
    assert np.allclose(found.mean, 2 * normal[..., :2] / normal[..., 2:])
    assert np.allclose(found.variance(), 0, atol=1e-12)
    assert np.allclose(Slopes.of(image).normal(), normal)


@pytest.mark.parametrize("shape", [(8, 8), (5, 7), (1, 6)])
def test_a_mip_map_ends_in_the_moments_of_the_whole(shape: tuple[int, int], rng: np.random.Generator) -> None:
    slopes = Slopes.of(waves(rng, shape))
    top = slopes.levels()[-1]
    assert top.mean.shape == (1, 1, 2)
    if shape == (8, 8):
        flat = slopes.mean.reshape(-1, 2)
        covariance = np.cov(flat.T, bias=True)
        assert np.allclose(top.mean[0, 0], flat.mean(axis=0))
        assert np.allclose(top.variance()[0, 0], [covariance[0, 0], covariance[1, 1], covariance[0, 1]])


def test_a_footprint_keeps_the_mean_and_moves_variance_into_the_texel(rng: np.random.Generator) -> None:
    slopes = Slopes.of(waves(rng, (32, 16)))
    for footprint in (0.0, 0.1, 5.0):
        seen = slopes.seen(footprint)
        assert np.allclose(seen.mean.mean(axis=(0, 1)), slopes.mean.mean(axis=(0, 1)))
        assert np.allclose(seen.second.mean(axis=(0, 1)), slopes.second.mean(axis=(0, 1)))
    assert np.allclose(slopes.seen(0.0).mean, slopes.mean)
    assert np.allclose(slopes.seen(5.0).mean, slopes.mean.mean(axis=(0, 1)), atol=1e-9)
    # One wave keeps what a Gaussian of the variance of a square of that side passes on.
    x = np.arange(32) / 32
    wave = Slopes(np.stack([np.cos(2 * np.pi * x), 0 * x], axis=-1)[None], np.zeros((1, 32, 3)))
    assert np.max(wave.seen(0.3).mean) == pytest.approx(np.exp(-2 * np.pi**2 * 0.3**2 / 12))


def test_wrong_images_are_named() -> None:
    with pytest.raises(UrushiError, match=r"shape \(4, 4\)"):
        Slopes.of(np.zeros((4, 4)))
    image = np.full((2, 3, 3), 1.0)
    image[1, 2] = 0.2
    with pytest.raises(UrushiError, match=r"normal map\[1, 2\]"):
        Slopes.of(image)
