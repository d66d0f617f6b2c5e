"""Layers whose properties vary with depth: the limit of nothing varying, and that of thin slices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from urushi.adding import Slab, add
from urushi.errors import UrushiError
from urushi.solvers.adding import riccati
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.media import Scattering, slab
from urushi.solvers.adding.operator import OPERATORS
from urushi.solvers.adding.phase import HenyeyGreenstein


def constituents(*mixture: tuple[float, Any]) -> list[tuple[Scattering, Any]]:
    grid = Grid.build([1.0], 8)
    found = []
    for g, albedo in mixture:
        moments = HenyeyGreenstein(g).moments(6)
        found.append((Scattering.build(grid.mu[0], grid.weights[0], moments, range(6)), albedo))
    return found


@pytest.mark.parametrize(("depth", "albedo"), [(1.0, (0.9, 0.5)), (1e-3, (1.0, 1.0)), (5.0, (1.0, 0.0))])
def test_a_gradient_of_nothing_is_a_slab(depth: float, albedo: tuple[float, ...]) -> None:
    ((scattering, profile),) = constituents((0.5, lambda t: np.array(albedo)))
    found = riccati.solve(riccati.Gradient(depth, [(scattering, profile)]), 1e-9)
    for one, other in zip(found, slab(scattering, np.array([depth]), np.array(albedo)), strict=True):
        assert np.allclose(one.dense, other.dense, atol=3e-7)
        assert one.delta is other.delta is None or np.allclose(one.delta, other.delta)


def test_a_gradient_is_the_limit_of_slices() -> None:
    """Albedo and phase function that vary with depth; slices approach it with the square of their thickness.

    But for grazing light, which sees only the beginning of the first slice.
    """
    mixture = constituents(
        (0.6, lambda t: np.array([0.9 * t])), (-0.2, lambda t: np.array([0.8 * (1 - t) ** 2]))
    )
    found = riccati.solve(riccati.Gradient(2.0, mixture), 1e-9)
    errors = []
    for slices in (20, 40):
        whole: Slab | None = None
        for k in range(slices):
            t = (k + 0.5) / slices
            albedos = [profile(t)[0] for _, profile in mixture]
            mixed = Scattering(
                mixture[0][0].mu,
                mixture[0][0].weights,
                sum(a * s.even for a, (s, _) in zip(albedos, mixture, strict=True)) / sum(albedos),
                sum(a * s.odd for a, (s, _) in zip(albedos, mixture, strict=True)) / sum(albedos),
                0.0,
                0,
            )
            piece = slab(mixed, np.array([2.0 / slices]), np.array([sum(albedos)]))
            whole = piece if whole is None else add(whole, piece, OPERATORS)
        assert whole is not None
        errors.append(
            [np.max(np.abs((a.dense - b.dense)[..., :5, :5])) for a, b in zip(found, whole, strict=True)]
        )
    assert np.all(np.array(errors[1]) < 2e-4)
    assert np.allclose(np.array(errors[0]) / errors[1], 4, atol=0.5)
    # The two sides differ, so nothing was turned over.
    assert np.max(np.abs(found.r_top.dense - found.r_bottom.dense)) > 0.01


def test_gradients_out_of_range() -> None:
    for depth, albedo, message in ((0.0, 0.5, "depth"), (1.0, 1.1, "add up"), (1.0, -0.1, "albedo")):
        with pytest.raises(UrushiError, match=f"medium: found .*{message}"):
            riccati.solve(riccati.Gradient(depth, constituents((0.5, lambda t, a=albedo: np.array([a])))))
    with pytest.raises(UrushiError, match="no constituents"):
        riccati.solve(riccati.Gradient(1.0, []))
    with pytest.raises(UrushiError, match=r"found no step at depth .* use a larger tolerance"):
        riccati.solve(riccati.Gradient(1.0, constituents((0.5, lambda t: np.array([0.9])))), 1e-20)
