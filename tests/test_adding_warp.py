"""Short series in the stretched azimuth: what they stand for, how few terms they take, and what they may lose."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from urushi.solvers.adding import warp
from urushi.solvers.adding.solution import Block


def series(f: np.ndarray) -> np.ndarray:
    """Cosine series of functions given in the middles of equal parts of [0, pi], along the last axis."""
    n = f.shape[-1]
    phi = np.pi * (np.arange(n) + 0.5) / n
    found = f @ np.cos(phi[:, None] * np.arange(n)) * (2 / n)
    found[..., 0] *= 0.5
    return found


def value(coefficients: np.ndarray, width: float, phi: np.ndarray) -> np.ndarray:
    cos, d2 = np.cos(phi), width**2
    x = (d2 * (1 + cos) - (1 - cos)) / (d2 * (1 + cos) + (1 - cos))
    found: np.ndarray = (
        np.cos(np.arccos(np.clip(x, -1, 1))[:, None] * np.arange(len(coefficients))) @ coefficients
    )
    return found


def blocks(coefficients: np.ndarray, size: int = 32) -> list[Block]:
    """(C, n_out, n_in, M) coefficients in blocks of a few orders."""
    found = coefficients.transpose(0, 3, 1, 2)
    ends = [*range(0, found.shape[1], size), found.shape[1]]
    return [Block(range(a, b), 0, found[:, a:b]) for a, b in itertools.pairwise(ends)]


def lobe(phi: np.ndarray, d: float) -> np.ndarray:
    """What GGX makes of the azimuth, 1 at its peak."""
    return (1 + np.tan(phi / 2) ** 2 / d**2) ** -2.0


PHI = np.pi * (np.arange(640) + 0.5) / 640
CHECKED = np.linspace(0, np.pi - 1e-6, 301)


def test_the_stretched_angle_and_its_slope() -> None:
    s = np.linspace(0, np.pi, 50)
    for d in (1.0, 0.3, 1e-3):
        phi = warp.azimuth(s, d)
        assert np.allclose(np.tan(phi / 2)[:-1], d * np.tan(s / 2)[:-1], rtol=1e-12)
        step = 1e-6
        middle = s[1:-1]
        numeric = (warp.azimuth(middle + step, d) - warp.azimuth(middle - step, d)) / (2 * step)
        assert np.allclose(warp.slope(middle, d), numeric, rtol=1e-6)


def test_few_orders_stay_what_they_are() -> None:
    given = np.random.default_rng(1).normal(size=(2, 3, 4, 10))
    found, width, error = warp.fit(blocks(given, 3), (2, 3, 4), 1e-9)
    assert np.array_equal(found, given.transpose(1, 2, 0, 3)) and (width == 1).all() and error == 0


def test_no_blocks_are_nothing() -> None:
    found, _, error = warp.fit([], (3, 2, 2), 1e-5)
    assert found.shape[:3] == (2, 2, 3) and not found.any() and error == 0


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_a_narrow_lobe_takes_a_few_terms(tolerance: float) -> None:
    """Lobes of three widths in one table, one of them upon a broad floor: 16 to 80 terms for 640 orders."""
    widths = (0.02, 0.1, 0.7)
    f = np.stack([lobe(PHI, d) for d in widths[:2]] + [lobe(PHI, widths[2]) + 0.1 * np.cos(PHI)])
    given = series(np.stack([f, 0.5 * f]))[:, :, None]
    found, width, error = warp.fit(blocks(given), (2, 3, 1), tolerance)
    assert error <= tolerance and found.shape[-1] <= (24 if tolerance > 1e-4 else 80)
    assert width[0, 0] < width[1, 0] < width[2, 0]
    for o, d in enumerate(widths):
        truth = lobe(CHECKED, d) + (0.1 * np.cos(CHECKED) if o == 2 else 0)
        for c, scale in enumerate((1, 0.5)):
            off = value(found[o, 0, c], width[o, 0], CHECKED) - scale * truth
            assert np.abs(off).max() <= 10 * tolerance, (o, c)


def test_orders_that_begin_at_a_later_node() -> None:
    """A block with `first` holds nothing of the nodes before."""
    given = series(lobe(PHI, 0.05)[None, None, None])
    inner = given.transpose(0, 3, 1, 2)
    split = [
        Block(range(0, 8), 0, np.pad(inner[:, :8], ((0, 0), (0, 0), (1, 0), (1, 0)))),
        Block(range(8, 400), 1, inner[:, 8:400]),
    ]
    found, width, _ = warp.fit(split, (1, 2, 2), 1e-6)
    assert not found[0].any() and not found[:, 0].any()
    assert np.allclose(value(found[1, 1, 0], width[1, 1], CHECKED), lobe(CHECKED, 0.05), atol=1e-5)


def test_no_better_than_what_it_is_made_from() -> None:
    """A plain series cut while it is still large: its ringing is not worth hundreds of terms."""
    cut = series(lobe(PHI, 0.01)[None, None, None])[..., :120]
    found, _, _ = warp.fit(blocks(cut), (1, 1, 1), 1e-9)
    assert found.shape[-1] <= 128
