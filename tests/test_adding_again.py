"""An interface that is met again, upright or upside down, is not integrated twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from urushi.solvers.adding import build
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.interfaces import RoughLayer
from urushi.solvers.adding.layers import Layer, TurnedOver


def made(monkeypatch: pytest.MonkeyPatch, *layers: Any) -> tuple[Grid, list[Layer | None], list[int]]:
    """The layers of a stack on a few nodes, and the regions above those that were integrated."""
    stack = ur.Stack(layers=list(layers))
    bound, _ = build.bind_numbers(stack)
    indices = build.indices(bound)
    grid = Grid.build(indices, [6] * len(set(indices)))
    seen: list[int] = []

    def counted(interface: Any, grid: Grid, region: int, *rest: Any, **more: Any) -> RoughLayer:
        seen.append(region)
        return RoughLayer(interface, grid, region, *rest, **more)

    monkeypatch.setattr(build, "RoughLayer", counted)
    return grid, build.layers(bound, build.phase_functions(stack), grid, 1e-3), seen


def glass(ior: float, alpha: float = 0.3, **more: Any) -> ur.Dielectric:
    return ur.Dielectric(ior=ior, alpha=alpha, **more)


def test_the_lower_face_of_a_sheet_is_the_upper_one(monkeypatch: pytest.MonkeyPatch) -> None:
    sheet = [glass(1.5), ur.Medium(depth=0.5, albedo=0.9), glass(1.0)]
    grid, (top, _, bottom), seen = made(monkeypatch, *sheet)
    assert seen == [1] and isinstance(top, TurnedOver) and isinstance(bottom, RoughLayer)
    bound, _ = build.bind_numbers(ur.Stack(layers=sheet))
    own = RoughLayer(bound.interfaces[0], grid, 0, 1e-3)
    assert top.orders == own.orders
    for orders in (range(2), range(2, 5)):
        first = own.first(orders)
        assert top.first(orders) == first
        for one, other in zip(top.slab(orders, first), own.slab(orders, first), strict=True):
            assert one.shape == other.shape and np.abs(other.dense).max() > 0
            assert np.allclose(one.dense, other.dense, rtol=1e-9, atol=1e-13)


def test_two_sheets_are_one_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    _, layers, seen = made(monkeypatch, glass(1.5), glass(1.0), glass(1.5), glass(1.0))
    assert seen == [3]
    assert layers[1] is layers[3] and isinstance(layers[0], TurnedOver) and isinstance(layers[2], TurnedOver)


@pytest.mark.parametrize(
    "other",
    [
        glass(1.0, 0.31),
        glass(1.0, 0.3, distribution="beckmann"),
        glass(1.0, 0.3, masking="separable"),
        glass(1.0, 0.3, multiple_scattering="compensated"),
        glass(1.1),
        ur.Conductor(material="Au", alpha=0.3),
    ],
    ids=["alpha", "distribution", "masking", "complete", "index", "metal"],
)
def test_others_are_others(monkeypatch: pytest.MonkeyPatch, other: Any) -> None:
    _, _, seen = made(monkeypatch, glass(1.5), other)
    assert seen == [1, 0]
