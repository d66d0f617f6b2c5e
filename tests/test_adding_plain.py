"""Plain slabs, without interfaces: what is not there is not computed, and what is computed once is right everywhere."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import urushi as ur
from urushi.solvers.adding import build
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.cells import Cells
from urushi.solvers.adding.phase import HenyeyGreenstein, terms
from urushi.solvers.adding.refine import Seen
from urushi.solvers.adding.smooth import smooth
from urushi.solvers.adding.solver import solve_on
from urushi.solvers.adding.table import Series
from urushi.solvers.adding.whole import solution, unchecked

UP = np.array([[0.6, 0.0, 0.8], [0.0, 0.3, 0.954]])


def fog(depth: Any = 1.0, albedo: Any = 0.9, g: float = 0.5) -> ur.Medium:
    return ur.Medium(depth=depth, albedo=albedo, phase=ur.HenyeyGreenstein(g=g))


def test_a_slab_in_one_piece_is_the_slab_in_two() -> None:
    """In one piece it is its own mirror image, and one side stands for both; in two nothing is known of it."""
    whole = ur.solve(ur.Stack(layers=[fog(1.0)]), "adding", nodes=14)
    halves = ur.solve(ur.Stack(layers=[fog(0.5), fog(0.5)]), "adding", nodes=14)
    parts = whole.solution.parts
    assert parts[True, True].blocks is parts[False, False].blocks
    assert halves.solution.parts[True, True].blocks is not halves.solution.parts[False, False].blocks
    for order in range(min(whole.matrices.orders, halves.matrices.orders)):
        for above in (True, False):
            one, other = (bsdf.matrices.operator(order, above, True) for bsdf in (whole, halves))
            assert np.allclose(one, other, rtol=1e-9, atol=1e-10)


def test_a_mirror_image_is_looked_at_once() -> None:
    """What the check, the table and the sampling know of one side is what they would find on the other."""
    shared = solution(ur.Stack(layers=[fog(0.7, (0.9, 0.5, 1.0), 0.8)]), 1e-2)
    parts = {side: replace(part, blocks=list(part.blocks)) for side, part in shared.parts.items()}
    copied = replace(shared, parts=parts)
    assert shared.twin((False, False), [(True, False), (True, True)]) == (True, True)
    assert copied.twin((False, False), [(True, False), (True, True)]) is None
    one, other = Seen(shared), Seen(copied)
    for side in parts:
        for name in ("albedo", "values", "peak"):
            assert np.array_equal(getattr(one, name)[side], getattr(other, name)[side])
    a, b = Series(shared), Series(copied)
    assert all(np.allclose(x, y, atol=1e-12) for x, y in zip(a.values, b.values, strict=True))
    few, many = Cells.build(shared, a, None), Cells.build(copied, b, None)
    for name in ("mass", "width", "peak"):
        assert np.allclose(getattr(few, name), getattr(many, name), rtol=1e-9, atol=1e-12)


def test_a_slab_on_a_base_has_one_side() -> None:
    """A stack that is no mirror image of itself shares nothing."""
    parts = ur.solve(ur.Stack(layers=[fog(), ur.Dielectric(ior=1.5)]), "adding", nodes=12).solution.parts
    assert len({id(part.blocks) for part in parts.values()}) == 4


@pytest.mark.parametrize("g", [0.5, 0.8, -0.9])
@pytest.mark.parametrize("depth", [0.01, 100.0])
def test_no_order_that_counts_is_left_out(g: float, depth: float) -> None:
    """A lone medium is asked for the orders of light scattered twice; all orders together hold no more."""
    stack, accuracy = ur.Stack(layers=[fog(depth, 1.0, g)]), 1e-2
    few = unchecked(stack, accuracy, [48])
    bound, colours = build.solvable(stack)
    phases = build.phase_functions(stack)
    grid = Grid.build([1.0], [48])
    grid = Grid((1.0, 1.0), grid.s, grid.etendue, grid.x, grid.panels)
    layers = build.layers(bound, phases, grid, 0.1 * accuracy, complete=True)
    assert layers[1] is not None and layers[1].orders > terms(HenyeyGreenstein(g), 0.1 * accuracy, times=2)
    many = solve_on(bound, grid, layers, colours, 0.1 * accuracy)
    assert few.diagnostics["orders"] == many.diagnostics["orders"] > 3
    for side, part in few.parts.items():
        one, other = (np.concatenate([b.values for b in p.blocks], axis=1) for p in (part, many.parts[side]))
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)


def test_no_interface_is_the_identity() -> None:
    """What stands for no interface in `build.layers` changes as little as the operators of one that does nothing."""
    stack = ur.Stack(layers=[fog(g=0.3), fog(0.5, 0.8, -0.5)])
    bound, colours = build.bind_numbers(stack)
    grid = Grid.build([1.0], [10])
    grid = Grid((1.0, 1.0, 1.0, 1.0), grid.s, grid.etendue, grid.x, grid.panels)
    layers = build.layers(bound, build.phase_functions(stack), grid, 1e-4)
    assert [layer is None for layer in layers] == [True, False, True, False, True]

    class Identity:
        orders = 0

        def first(self, orders: range) -> int:
            return 0

        def slab(self, orders: range, first: int) -> Any:
            return smooth(bound.interfaces[0], grid, 0)

    explicit = [Identity() if layer is None else layer for layer in layers]
    one, other = (solve_on(bound, grid, some, colours, 1e-4) for some in (layers, explicit))
    for side, part in one.parts.items():
        for a, b in ((part.blocks, other.parts[side].blocks), (part.rest, other.parts[side].rest)):
            assert len(a) == len(b) > 0 or not b
            for x, y in zip(a, b, strict=True):
                assert np.allclose(x.values, y.values, rtol=0, atol=1e-14)


def test_nothing_at_all_lets_everything_through() -> None:
    bsdf = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.0)]), "adding", nodes=8)
    assert np.allclose(bsdf.transmittance(UP), 1) and np.allclose(bsdf.reflectance(UP), 0)
    assert np.allclose(bsdf.absorption(UP).transmitted, 1)
    assert np.array_equal(bsdf.matrices.operator(0, True, False)[0], np.eye(8))
    assert not bsdf.matrices.operator(0, True, True).any()
    ledger = ur.solve(ur.Stack(layers=[fog()]), "adding", nodes=12).absorption(UP)
    total = ledger.reflected + ledger.transmitted + ledger.absorbed.sum(axis=0)
    assert np.allclose(total, 1) and (ledger.transmitted > 0.3).all()


def test_a_thin_slab_is_decomposed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All orders of small matrices are solved together: calls are what takes the time."""
    seen = []
    svd = np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda a: seen.append(a.shape) or svd(a))
    unchecked(ur.Stack(layers=[fog()]), 1e-3, [10])
    assert len(seen) == 1 and seen[0][-1] == 10


def test_nothing_is_made_before_it_is_needed() -> None:
    bsdf = ur.solve(ur.Stack(layers=[fog()]), "adding", accuracy=1e-2)
    made = vars(bsdf.prepared)
    assert "estimated_error" in bsdf.diagnostics and not {"series", "cells"} & set(made)
    before = bsdf.eval(UP, UP[::-1])
    assert "series" in made and "cells" not in made and "sampling_bytes" not in bsdf.diagnostics
    bsdf.sample(UP, np.full((2, 3), 0.5))
    assert "cells" in made and np.array_equal(bsdf.eval(UP, UP[::-1]), before)
    assert bsdf.diagnostics["sampling_bytes"] == 4 * bsdf.prepared.cells.mass.size
    with pytest.raises(KeyError, match="size"):
        bsdf.diagnostics["size"]


def test_a_core_for_others_is_whole() -> None:
    """A renderer traces what it evaluates, and nothing can be made while it does."""
    import drjit.llvm.ad

    bsdf = ur.solve(ur.Stack(layers=[fog()]), "adding", accuracy=1e-2)
    assert {"proposal", "peaks"} <= set(vars(bsdf.core(drjit.llvm.ad, True)))
