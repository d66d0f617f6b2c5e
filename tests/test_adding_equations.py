"""The adding equations over numbers, matrices and operators: closed forms, the series itself, and one another."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from urushi.adding import MATRICES, NUMBERS, Algebra, Slab, add, double, pile
from urushi.errors import UrushiError
from urushi.solvers.adding.operator import OPERATORS, Operator, identity, zero

REFLECTANCES = np.array([0.02, 0.04, 0.3, 0.9])


def plate(r: Any, inside: Any) -> Slab:
    """Two surfaces that reflect r each, and what lets `inside` pass between them, by the adding equations."""
    surface, filling = Slab(r, 1 - r, r, 1 - r), Slab(0.0, inside, 0.0, inside)
    return add(add(surface, filling), surface)


def symmetric(r: Any, t: Any) -> Slab:
    return Slab(r, t, r, t)


# ------------------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("m", [1, 2, 3, 7, 64, 1000])
def test_stokes_pile_of_lossless_plates(m: int) -> None:
    """Stokes 1862: R = 2 m r / (1 + (2 m - 1) r), T = (1 - r) / (1 + (2 m - 1) r)."""
    r = REFLECTANCES
    found = pile(plate(r, 1.0), m)
    assert np.allclose(found.r_top, 2 * m * r / (1 + (2 * m - 1) * r), rtol=1e-11, atol=1e-14)
    assert np.allclose(found.t_down, (1 - r) / (1 + (2 * m - 1) * r), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("m", [1, 2, 5, 16, 33])
def test_stokes_pile_of_absorbing_plates(m: int) -> None:
    """R = sinh m b / sinh(a + m b), T = sinh a / sinh(a + m b), with a and b from one plate's own R and T."""
    r, inside = REFLECTANCES, 0.8
    series = 1 / (1 - r**2 * inside**2)
    r1, t1 = r + r * inside**2 * (1 - r) ** 2 * series, inside * (1 - r) ** 2 * series
    one = plate(r, inside)
    assert np.allclose(one.r_top, r1, rtol=1e-14, atol=1e-14) and np.allclose(
        one.t_up, t1, rtol=1e-14, atol=1e-14
    )
    a = np.arccosh((1 + r1**2 - t1**2) / (2 * r1))
    b = np.arccosh((1 - r1**2 + t1**2) / (2 * t1))
    for found in (pile(one, m), pile(symmetric(r1, t1), m)):
        assert np.allclose(found.r_top, np.sinh(m * b) / np.sinh(a + m * b), rtol=1e-10, atol=1e-14)
        assert np.allclose(found.t_down, np.sinh(a) / np.sinh(a + m * b), rtol=1e-10, atol=1e-14)


def kubelka_munk(k: float, s: float, d: Any) -> Slab:
    """Kubelka & Munk 1931: a layer of thickness d, alone."""
    a = 1 + k / s
    b = np.sqrt(a**2 - 1)
    below = a * np.sinh(b * s * d) + b * np.cosh(b * s * d)
    return symmetric(np.sinh(b * s * d) / below, b / below)


@pytest.mark.parametrize(("k", "s"), [(0.1, 1.0), (3.0, 0.2), (1e-4, 5.0)])
def test_kubelka_munk(k: float, s: float) -> None:
    d, base = np.array([0.01, 0.5, 2.0]), 0.6
    whole = kubelka_munk(k, s, d)
    for layers in (
        add(kubelka_munk(k, s, 0.3 * d), kubelka_munk(k, s, 0.7 * d)),
        pile(kubelka_munk(k, s, d / 5), 5),
    ):
        assert np.allclose(layers, np.array(whole), rtol=1e-12, atol=1e-14)
    thin = symmetric(s * d * 2.0**-30, 1 - (k + s) * d * 2.0**-30)  # where R and T are K and S by definition
    assert np.allclose(double(thin, 30), np.array(whole), rtol=1e-6, atol=1e-14)
    a = 1 + k / s
    b = np.sqrt(a**2 - 1)
    coth = 1 / np.tanh(b * s * d)
    over_base = add(whole, Slab(base, 0.0, 0.0, 0.0))
    assert np.allclose(
        over_base.r_top, (1 - base * (a - b * coth)) / (a - base + b * coth), rtol=1e-12, atol=1e-14
    )
    assert np.all(over_base.t_down == 0) and np.all(over_base.r_bottom == 0)


def test_lossless_kubelka_munk() -> None:
    """R = S d / (1 + S d), however many layers it is cut into."""
    sd = np.array([1e-3, 1.0, 1e4])
    found = pile(symmetric(sd / 100 / (1 + sd / 100), 1 / (1 + sd / 100)), 100)
    assert np.allclose(found.r_top, sd / (1 + sd), rtol=1e-12, atol=1e-14) and np.allclose(
        found.t_up, 1 / (1 + sd), rtol=1e-10
    )


# ------------------------------------------------------------------------------------- any algebra


def random_slab(rng: np.random.Generator, above: int, below: int) -> Slab:
    """Matrices of a layer between two regions; no column sums to more than 0.9."""

    def block(n_out: int, n_in: int) -> np.ndarray:
        return rng.uniform(0, 0.9 / (2 * max(above, below)), (2, 3, n_out, n_in))

    return Slab(block(above, above), block(below, above), block(below, below), block(above, below))


def by_bounces(upper: Slab, lower: Slab, bounces: int = 400) -> Slab:
    """The sum over all bounces, one after another."""

    def from_above(upper: Slab, lower: Slab) -> tuple[np.ndarray, np.ndarray]:
        down = upper.t_down
        r, t = upper.r_top, 0
        for _ in range(bounces):
            up = lower.r_top @ down
            r, t = r + upper.t_up @ up, t + lower.t_down @ down
            down = upper.r_bottom @ up
        return r, t

    return Slab(*from_above(upper, lower), *from_above(lower.turned_over(), upper.turned_over()))


def test_matrices_against_the_sum_of_bounces(rng: np.random.Generator) -> None:
    upper, lower = random_slab(rng, 4, 6), random_slab(rng, 6, 5)
    for found, truth in zip(add(upper, lower, MATRICES), by_bounces(upper, lower), strict=True):
        assert found.shape == truth.shape and np.allclose(found, truth, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("algebra", [NUMBERS, MATRICES, OPERATORS], ids=["numbers", "matrices", "operators"])
def test_the_order_of_joining_does_not_matter(algebra: Algebra, rng: np.random.Generator) -> None:
    if algebra is NUMBERS:
        layers = [Slab(*rng.uniform(0, 0.5, (4, 3))) for _ in range(3)]
    elif algebra is MATRICES:
        layers = [random_slab(rng, *shape) for shape in ((3, 5), (5, 4), (4, 6))]
    else:
        layers = [random_operators(rng, *shape) for shape in ((3, 5), (5, 4), (4, 6))]
    a, b, c = layers
    first = add(add(a, b, algebra), c, algebra)
    second = add(a, add(b, c, algebra), algebra)
    for one, other in zip(first, second, strict=True):
        assert np.allclose(plain(one), plain(other), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("count", [1, 2, 3, 11, 16])
def test_a_pile_is_one_after_another(count: int, rng: np.random.Generator) -> None:
    slab = random_slab(rng, 4, 4)
    whole = slab
    for _ in range(count - 1):
        whole = add(whole, slab, MATRICES)
    for found, truth in zip(pile(slab, count, MATRICES), whole, strict=True):
        assert np.allclose(found, truth, rtol=1e-11, atol=1e-18)
    if count == 16:
        for found, truth in zip(double(slab, 4, MATRICES), whole, strict=True):
            assert np.allclose(found, truth, rtol=1e-11, atol=1e-18)


def test_half_the_work_for_layers_that_are_their_own_mirror_image(rng: np.random.Generator) -> None:
    slab = random_slab(rng, 4, 4)
    same = Slab(slab.r_top, slab.t_down, slab.r_top, slab.t_down)
    copies = Slab(same.r_top, same.t_down, same.r_top.copy(), same.t_down.copy())
    assert same.symmetric and not copies.symmetric
    bounces = []
    counting = MATRICES._replace(bounce=lambda *args: bounces.append(1) or MATRICES.bounce(*args))
    short = pile(same, 7, counting)
    assert short.symmetric and len(bounces) == 4
    long = pile(copies, 7, counting)
    assert len(bounces) == 4 + 8
    assert np.allclose(short, np.array(long), rtol=1e-12, atol=1e-14)


def test_no_layers() -> None:
    with pytest.raises(UrushiError, match="found 0 layers; allowed: at least 1"):
        pile(plate(0.1, 1.0), 0)


# ------------------------------------------------------------------------------- delta parts apart


def random_operators(rng: np.random.Generator, above: int, below: int, orders: int = 2) -> Slab:
    """A layer with diagonals and dense parts, the dense ones of different numbers of orders."""

    def block(n_out: int, n_in: int) -> Operator:
        dense = rng.uniform(0, 0.3 / max(above, below), (1, int(rng.integers(1, orders + 2)), n_out, n_in))
        return Operator((n_out, n_in), rng.uniform(0, 0.4, (2, min(n_out, n_in))), dense)

    return Slab(block(above, above), block(below, above), block(below, below), block(above, below))


def plain(x: Any, orders: int = 4) -> np.ndarray:
    """Anything as an array; of operators (C, M, out, in), more orders than they have."""
    return (
        np.stack([x.matrix(m) for m in range(orders)], axis=1) if isinstance(x, Operator) else np.asarray(x)
    )


def test_operators_are_matrices_with_a_diagonal(rng: np.random.Generator) -> None:
    for above, middle, below in ((3, 5, 4), (5, 3, 6), (4, 4, 4)):
        upper, lower = random_operators(rng, above, middle), random_operators(rng, middle, below)
        found = add(upper, lower, OPERATORS)
        truth = add(Slab(*(plain(x) for x in upper)), Slab(*(plain(x) for x in lower)), MATRICES)
        for one, other in zip(found, truth, strict=True):
            assert np.allclose(plain(one), other, rtol=1e-12, atol=1e-14)
        # The diagonal is that of the diagonals alone, and adds up like numbers.
        bare = add(
            *(Slab(*(Operator(x.shape, x.delta) for x in slab)) for slab in (upper, lower)), algebra=OPERATORS
        )
        for one, other in zip(found, bare, strict=True):
            assert other.dense is None and np.allclose(one.delta, other.delta, rtol=1e-14, atol=1e-14)


def test_smooth_layers_stay_diagonal_and_add_up_like_numbers() -> None:
    r = np.array([[0.04, 0.1, 0.5]])
    smooth = symmetric(Operator((3, 3), r), Operator((3, 3), 1 - r))
    found = pile(smooth, 6, OPERATORS)
    assert all(x.dense is None for x in found)
    assert np.allclose(found.r_top.delta, 6 * r / (1 + 5 * r), rtol=1e-13, atol=1e-14)


def test_nothing_below_and_nothing_between(rng: np.random.Generator) -> None:
    slab = random_operators(rng, 4, 4)
    nothing = symmetric(zero(4), identity(4))
    for found in (add(slab, nothing, OPERATORS), add(nothing, slab, OPERATORS)):
        for one, other in zip(found, slab, strict=True):
            assert np.array_equal(plain(one), plain(other))
    assert zero(3, 5).shape == (3, 5) and zero(4).delta is None
    assert np.allclose(slab.t_up.albedo(), slab.t_up.matrix(0).sum(axis=1)) and slab.t_up.orders >= 1


def test_light_that_is_trapped_is_not_there() -> None:
    """Total reflection on both sides of a film that nothing gets into at that angle."""
    total = Operator((2, 2), np.array([[0.1, 1.0]]))
    out, into = Operator((1, 2), np.array([[0.9]])), Operator((2, 1), np.array([[0.9]]))
    top = Slab(Operator((1, 1), np.array([[0.1]])), into, total, out)
    found = add(top, top.turned_over(), OPERATORS)
    assert np.allclose(found.r_top.delta, 2 * 0.1 / 1.1) and np.allclose(found.t_down.delta, 0.9 / 1.1)
    lit = top._replace(t_down=Operator((2, 1), None, np.full((1, 1, 2, 1), 0.4)))
    with pytest.raises(UrushiError, match="light of node 1 is let in"):
        add(lit, top.turned_over(), OPERATORS)
