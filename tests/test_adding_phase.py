"""Phase functions as series: moments, every azimuthal order between any two cosines, and where a series is cut."""

from __future__ import annotations

import numpy as np
import pytest

from urushi.errors import UrushiError
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.delta_m import FADES, Truncated
from urushi.solvers.adding.media import Scattering
from urushi.solvers.adding.phase import (
    PHASES,
    HenyeyGreenstein,
    Isotropic,
    Phase,
    Rayleigh,
    between,
    harmonics,
    resolved,
    terms,
)

AIR = Grid.build([1.0], 24)
ALL = [Isotropic(), Rayleigh(), *(HenyeyGreenstein(g) for g in (0.0, 0.5, -0.3, 0.99, -0.99))]


@pytest.mark.parametrize("phase", ALL, ids=lambda p: type(p).__name__)
def test_moments_are_the_moments(phase: Phase) -> None:
    """chi_l = 2 pi times the integral of p P_l, by a quadrature that follows the peak; chi_0 = 1."""
    x, w = np.polynomial.legendre.leggauss(20)
    u = np.linspace(0, 1, 41)
    edges = np.unique(np.concatenate([-1 + 2 * u**8, 1 - 2 * u**8]))
    length = np.diff(edges)[:, None]
    cos, weight = (edges[:-1, None] + length * (x + 1) / 2).ravel(), (length * w / 2).ravel()
    for l, chi in enumerate(phase.moments(12)):  # noqa: E741
        legendre = np.polynomial.legendre.Legendre.basis(l)(cos)
        assert 2 * np.pi * (weight * phase.eval(cos)) @ legendre == pytest.approx(chi, abs=1e-9)


def test_series_add_up_to_the_phase_function() -> None:
    mu, phi = np.array([0.05, 0.3, 0.9, 1.0]), np.linspace(0, np.pi, 7)
    sines = np.sqrt(1 - mu**2)
    for phase in (HenyeyGreenstein(0.9), HenyeyGreenstein(-0.7), Rayleigh(), Isotropic()):
        count = terms(phase, 1e-13)
        even, odd = between(mu, phase.moments(count), range(count))
        m = np.arange(count)
        series = (2 - (m == 0))[:, None] * np.cos(m[:, None] * phi) / (4 * np.pi)
        for sign, matrix in ((1, even + odd), (-1, even - odd)):
            cos = sign * mu[:, None] * mu
            truth = phase.eval(cos[..., None] + (sines[:, None] * sines)[..., None] * np.cos(phi))
            found = np.tensordot(matrix, series, (0, 0))
            assert np.allclose(found, truth, rtol=1e-10, atol=1e-12 * phase.eval(np.ones(1)))


def test_a_range_of_orders_is_part_of_all() -> None:
    mu, moments = np.array([0.1, 0.6, 1.0]), 0.8 ** np.arange(30)
    whole, part = between(mu, moments, range(30)), between(mu, moments, range(7, 12))
    for one, other in zip(whole, part, strict=True):
        assert np.allclose(one[7:12], other, rtol=1e-13, atol=1e-14)
    assert np.all(harmonics(mu, 5, range(6, 9)) == 0)


def test_how_many_terms() -> None:
    assert terms(Isotropic(), 1e-9) == 1 and terms(Rayleigh(), 1e-9) == 3
    assert terms(HenyeyGreenstein(0.5), 1e-3) == 14 and terms(HenyeyGreenstein(0.999), 1e-9) == 1800
    assert terms(HenyeyGreenstein(0.9), 1e-6, times=2) == terms(HenyeyGreenstein(0.81), 1e-6)
    for grid, region in ((AIR, 0), (Grid.build([1.0, 1.33, 1.5], 24), 2)):
        n = grid.count(region)
        count = resolved(grid.mu[region], grid.weights[region])
        assert 0.7 * n < count < 2 * n
        moments = 0.999 ** np.arange(count)
        assert Scattering.build(grid.mu[region], grid.weights[region], moments, range(1)).correction < 1e-3


def test_every_described_phase_function_has_its_series() -> None:
    from urushi.description.phases import PHASES as described

    assert set(PHASES) == set(described)


def test_what_is_not_allowed() -> None:
    for g in (1.0, -1.0, float("nan")):
        with pytest.raises(UrushiError, match="allowed: -1 < g < 1"):
            HenyeyGreenstein(g)
    with pytest.raises(UrushiError, match="found 2000 terms; allowed: at most 1800"):
        harmonics(np.array([0.5]), 2000, range(1))


# ----------------------------------------------------------------------------------------- delta-M


def test_a_series_that_is_cut_keeps_its_moments() -> None:
    """What the smooth part and the peaks scatter together has the moments of the phase function, till they fade."""
    for phase in ALL:
        truncated = Truncated.of(phase, 12)
        l = np.arange(12)  # noqa: E741
        whole = truncated.moments + truncated.backward * (-1.0) ** l
        whole = whole * (1 - truncated.forward) + truncated.forward
        kept = int(FADES * 12) + 1 if truncated.sharp else 12
        assert np.allclose(whole[:kept], phase.moments(12)[:kept], atol=1e-15)
        assert truncated.moments[0] + truncated.backward == pytest.approx(1, abs=1e-15)
    assert Truncated.of(HenyeyGreenstein(0.9), 10).forward == pytest.approx(0.9**9)
    assert Truncated.of(HenyeyGreenstein(0.9), 10).backward == 0
    assert Truncated.of(HenyeyGreenstein(-0.9), 10).backward == pytest.approx(0.9**9)
    assert Truncated.of(HenyeyGreenstein(-0.5), 10).backward == pytest.approx(0.5**10)
    for phase in (Rayleigh(), Isotropic()):
        assert Truncated.of(phase, 3).forward == Truncated.of(phase, 3).backward == 0


def test_a_peak_straight_on_is_no_scattering() -> None:
    """Of what is left, as much is scattered elsewhere and absorbed as before."""
    truncated = Truncated.of(HenyeyGreenstein(0.95), 16)
    depth, albedo = np.array([2.0, 3.0, 1.0]), np.array([0.5, 1.0, 0.0])
    scaled, albedo_scaled = truncated.scale(depth, albedo)
    assert np.allclose(scaled * (1 - albedo_scaled), depth * (1 - albedo), rtol=1e-13, atol=1e-15)
    assert np.allclose(
        scaled * albedo_scaled, depth * albedo * (1 - truncated.forward), rtol=1e-13, atol=1e-14
    )
