"""Fresnel's equations against printed values and against complex arithmetic in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanes import DOUBLE, SINGLE, Lanes, back, both_precisions, needs_llvm, one_by_one
from urushi.optics.fresnel import fresnel_conductor, fresnel_dielectric
from urushi.optics.ior import conductor_names, conductor_rgb

pytestmark = needs_llvm

COSINES = np.concatenate([np.linspace(0, 1, 101), 10.0 ** np.arange(-9, 0), 1 - 10.0 ** np.arange(-7, 0)])


def complex_fresnel(cos: Any, eta: Any, k: Any = 0.0) -> np.ndarray:
    """(|r_s|^2 + |r_p|^2) / 2 from the amplitudes (Born & Wolf, 1.5.2), the index being eta - i k."""
    cos, n = np.asarray(cos, np.complex128), np.asarray(eta) - 1j * np.asarray(k)
    n_cos = np.sqrt(n**2 - (1 - cos) * (1 + cos))
    n_cos = np.where(n_cos.imag > 0, -n_cos, n_cos)  # the wave that decays inwards
    with np.errstate(invalid="ignore"):  # an index of 0 - 0 i at normal incidence
        r_s = (cos - n_cos) / (cos + n_cos)
        r_p = (n**2 * cos - n_cos) / (n**2 * cos + n_cos)
    return np.asarray((np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2)


def dielectric(lanes: Lanes, cos: Any, eta: Any) -> tuple[np.ndarray, np.ndarray]:
    cos, eta = np.broadcast_arrays(cos, eta)
    eta = lanes(eta)
    reflectance, cos_t = fresnel_dielectric(lanes(cos), eta, 1 / eta)
    return back(reflectance), back(cos_t)


def conductor(lanes: Lanes, cos: Any, eta: Any, k: Any) -> np.ndarray:
    cos, eta, k = np.broadcast_arrays(cos, eta, k)
    return back(fresnel_conductor(lanes(cos), lanes(eta), lanes(k)))


@pytest.mark.parametrize(
    ("degrees", "eta", "r_s", "r_p"),
    [
        # Hecht, Optics, section 4.6: glass at normal incidence reflects 4 %; air to glass of 1.5 at 30 degrees has
        # r_s = -0.2404 and r_p = 0.1589.
        (0.0, 1.5, 0.2, 0.2),
        (0.0, 1 / 1.5, 0.2, 0.2),
        (30.0, 1.5, 0.2404, 0.1589),
        # The same text's Brewster angle of 56.3 degrees: no p light, and r_s = -(n^2 - 1) / (n^2 + 1).
        (np.degrees(np.arctan(1.5)), 1.5, 1.25 / 3.25, 0.0),
        (0.0, 1.333, 0.333 / 2.333, 0.333 / 2.333),
        (90.0, 1.5, 1.0, 1.0),
        (45.0, 1 / 1.5, 1.0, 1.0),
    ],
)
def test_printed_values(degrees: float, eta: float, r_s: float, r_p: float) -> None:
    cos = np.cos(np.radians(degrees)) if degrees < 90 else 0.0
    found, _ = dielectric(SINGLE, cos, eta)
    assert found[0] == pytest.approx((r_s**2 + r_p**2) / 2, abs=2e-5)


def test_gold_and_silver_look_as_printed() -> None:
    """Normal incidence, from the index by ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2) (Hecht, equation 4.82)."""
    for name, lowest in (("Ag", 0.9), ("Au", 0.3), ("Al", 0.9)):
        eta, k = map(np.array, conductor_rgb(name))
        found = conductor(SINGLE, 1.0, eta, k)
        assert np.allclose(found, ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2), atol=1e-6)
        assert found.min() > lowest


@both_precisions
def test_dielectric_against_complex_arithmetic(lanes: Lanes) -> None:
    etas = [0.2, 0.3, 1 / 1.5, 0.9, 0.999, 1.001, 1.1, 1.333, 1.5, 2.4, 3.0, 5.0]
    cos, eta = (lanes.rounded(x).ravel() for x in np.meshgrid(COSINES, etas))
    found, cos_t = dielectric(lanes, cos, eta)
    sin_t_sq = (1 - cos) * (1 + cos) / eta**2
    # Near the critical angle a rounding of the cosine moves the square root; elsewhere nothing cancels.
    near = 0.2 / np.maximum(np.abs(1 - sin_t_sq), 1e-3)
    room = lanes.exact * np.where(eta < 1, np.maximum(1, near), 1)
    assert np.all(np.abs(found - complex_fresnel(cos, eta)) <= room)
    assert np.all(np.abs(cos_t - np.sqrt(np.maximum(0, 1 - sin_t_sq))) <= room)
    assert found.min() >= 0 and found.max() <= 1
    total = sin_t_sq > 1 + 1e-6
    assert np.all(found[total] == 1) and np.all(cos_t[total] == 0)


def test_nearly_equal_indices_at_grazing_angles() -> None:
    """The index ratio differs from 1 by as little as single precision can say."""
    cos, step = (
        x.ravel() for x in np.meshgrid([0.0, 1e-7, 1e-4, 1e-3, 1e-2, 0.1, 1.0], 10.0 ** np.arange(-6, -1))
    )
    for eta in (SINGLE.rounded(1 + step), SINGLE.rounded(1 - step)):
        found, _ = dielectric(SINGLE, cos, eta)
        assert np.allclose(found, complex_fresnel(SINGLE.rounded(cos), eta), atol=3e-6)


@both_precisions
def test_equal_indices_reflect_nothing(lanes: Lanes) -> None:
    found, cos_t = dielectric(lanes, COSINES, 1.0)
    assert np.all(found == 0) and np.allclose(cos_t, lanes.rounded(COSINES), rtol=1e-6)


@both_precisions
def test_both_sides_reflect_alike(lanes: Lanes) -> None:
    """Stokes: the reflectance is the same for light that comes back along the refracted ray."""
    cos, eta = (lanes.rounded(x).ravel() for x in np.meshgrid(np.linspace(0.05, 1, 40), [1.1, 1.5, 3.0]))
    down, cos_t = dielectric(lanes, cos, eta)
    up, back_again = dielectric(lanes, cos_t, 1 / eta)
    assert np.allclose(down, up, atol=200 * lanes.exact)
    assert np.allclose(back_again, cos, atol=200 * lanes.exact)


@both_precisions
def test_conductor_against_complex_arithmetic(lanes: Lanes) -> None:
    names = [name for name in conductor_names() if name != "none"]
    index = np.array([np.stack(conductor_rgb(name), axis=-1) for name in names]).reshape(-1, 2)
    index = np.concatenate([index, index / 1.5, [[0.01, 0.04], [1e-3, 1e-2], [0.05, 30.0], [20.0, 30.0]]])
    cos = lanes.rounded(COSINES)[:, None]
    eta, k = (lanes.rounded(index[:, i])[None, :] for i in (0, 1))
    good = np.broadcast_to((eta > 0) & (k > 1e-4), (len(COSINES), len(index))).ravel()
    found = conductor(lanes, cos, eta, k)
    assert np.all(np.abs(found - complex_fresnel(cos, eta, k).ravel())[good] <= lanes.exact)
    # The channels that Mitsuba's conversion clamped to 0, too.
    assert found.min() >= 0 and found.max() <= 1


@both_precisions
def test_conductor_without_absorption_is_a_dielectric(lanes: Lanes) -> None:
    cos, eta = (lanes.rounded(x).ravel() for x in np.meshgrid(COSINES, [0.3, 0.9, 1.2, 1.5, 3.0]))
    expected = complex_fresnel(cos, eta)
    room = 3 * lanes.exact / np.sqrt(np.maximum(np.abs(eta**2 - (1 - cos) * (1 + cos)), 1e-3))
    # At the critical angle the floor of the modulus, 1e-10, shows in double precision.
    room = np.maximum(room, 1e-9 if lanes is DOUBLE else 0)
    found = conductor(lanes, cos, eta, 0.0)
    assert np.all(np.abs(found - expected) <= room)
    assert found.min() >= 0


@both_precisions
def test_perfect_mirror_and_empty_channel(lanes: Lanes) -> None:
    """Index 0 - i, as the material `none`; also 0 - 0 i, which Mitsuba's table has for the red of AlSb."""
    for eta, k in ((0.0, 1.0), (0.0, 3.0), (1e-12, 1.0), (0.0, 0.0), (0.0, 1e-6)):
        assert np.abs(conductor(lanes, COSINES, eta, k) - 1).max() <= 1e-6
    clamped = [name for name in conductor_names() if (0.0, 0.0) in zip(*conductor_rgb(name), strict=True)]
    assert "AlSb" in clamped


@both_precisions
def test_conductor_of_equal_index(lanes: Lanes) -> None:
    cos = COSINES[COSINES > 1e-3]
    found = conductor(lanes, cos, 1.0, 0.0)
    assert found.min() >= 0 and found.max() <= 1e-6


def test_plain_floats() -> None:
    cos, eta, k = (x.ravel() for x in np.meshgrid(COSINES[::7], [0.3, 0.9, 1.5], [0.0, 2.0]))
    found = one_by_one(lambda c, e: fresnel_dielectric(c, e, 1 / e)[0], cos, eta)
    assert np.allclose(found, complex_fresnel(cos, eta), atol=1e-9)
    assert fresnel_dielectric(0.0, 1.0, 1.0)[0] == 0
    found = one_by_one(fresnel_conductor, cos, eta, k)
    assert np.allclose(found, complex_fresnel(cos, eta, k), atol=1e-9)


def test_colours() -> None:
    """A colour gives what its channels give."""
    cos = np.linspace(0, 1, 11)
    eta, k = conductor_rgb("Au")
    found = back(fresnel_conductor(SINGLE(cos), SINGLE.vector(*eta), SINGLE.vector(*k)))
    for c in range(3):
        assert np.array_equal(found[:, c], conductor(SINGLE, cos, eta[c], k[c]))
