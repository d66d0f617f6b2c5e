"""The directional basis: nodes that all media share, their weights, and what lies between the nodes."""

from __future__ import annotations

import numpy as np
import pytest

from urushi.errors import UrushiError
from urushi.solvers.adding.basis import Grid

STACKS = [(1.0,), (1.0, 1.5, 1.0), (1.0, 1.5, 1.33), (1.5, 1.0), (1.0, 1.0003, 2.4), (1.33, 1.33 + 1e-12)]


@pytest.mark.parametrize("indices", STACKS, ids=str)
def test_one_set_of_nodes_for_all_media(indices: tuple[float, ...]) -> None:
    grid = Grid.build(indices, 24)
    assert np.all(np.diff(grid.s) > 0) and grid.s[0] == 0
    for region, index in enumerate(indices):
        mu, weights = grid.mu[region], grid.weights[region]
        n = grid.count(region)
        assert len(mu) == len(weights) == n
        assert mu[0] == 1 and np.all(np.diff(mu) < 0) and mu[-1] > 0 and np.all(weights > 0)
        # Snell: node j here is node j there; what is not here is beyond total reflection.
        assert np.allclose(index * np.sqrt(1 - mu**2), grid.s[:n], rtol=1e-12, atol=1e-7)
        assert np.all(grid.s[n:] >= index) and np.all(grid.s[:n] < index * (1 + 1e-9))
        assert np.allclose(index**2 * mu * weights, grid.etendue[:n], rtol=1e-14, atol=1e-14)


def test_panels_end_at_every_index() -> None:
    grid = Grid.build([1.0, 1.5, 1.33], 16)
    assert [panel.index for panel in grid.panels] == [1.0, 1.33, 1.5]
    assert [grid.count(region) for region in range(3)] == [16, len(grid.s), 16 + grid.panels[1].count]
    for panel, low in zip(grid.panels, (0.0, 1.0, 1.33), strict=True):
        assert np.all((grid.s[panel.nodes] >= low) & (grid.s[panel.nodes] < panel.index))
        assert panel.high == pytest.approx(np.sqrt(1 - (low / panel.index) ** 2), rel=1e-14)
    assert len(Grid.build([1.33, 1.33 + 1e-12], 8).panels) == 1


@pytest.mark.parametrize(
    ("indices", "tolerance"), [((1.0,), 1e-14), ((1.0, 1.5), 1e-11), ((1.0, 1.0003, 2.4), 3e-8)]
)
def test_integrals_over_the_hemisphere(indices: tuple[float, ...], tolerance: float) -> None:
    """Powers of the cosine and a logarithm, in every region; nodes in the cosine itself would miss the last by 1e-4."""
    grid = Grid.build(indices, 24)
    for mu, weights in zip(grid.mu, grid.weights, strict=True):
        for power in range(8):
            assert weights @ mu**power == pytest.approx(1 / (power + 1), rel=tolerance)
        assert weights @ (mu * np.log(mu)) == pytest.approx(-1 / 4, rel=1e-6)


def test_nodes_per_panel() -> None:
    grid = Grid.build([1.0, 1.5], [5, 3])
    assert [panel.count for panel in grid.panels] == [5, 3]
    assert len(Grid.build([1.0, 1.001], 64).panels) == 2
    assert Grid.build([1.0, 1.001], 64).panels[1].count < 20
    for counts in ([5], [5, 1], [5, 5, 5]):
        with pytest.raises(UrushiError, match="allowed: 2 numbers, one for each different index"):
            Grid.build([1.0, 1.5], counts)


# --------------------------------------------------------------------------------- between nodes


def smooth(mu: np.ndarray, odd: bool) -> np.ndarray:
    """As an azimuthal order of light out of a slab: a power of sin(theta), and mu log mu."""
    sin = np.sqrt((1 - mu) * (1 + mu))
    return np.exp(mu) * (sin**3 if odd else sin**2) + 0.3 * mu * np.log(np.maximum(mu, 1e-300)) * (
        sin if odd else 1
    )


def error(grid: Grid, region: int, odd: bool, order: int = 8, low: float = 0.0) -> float:
    mu = np.linspace(low, 1, 2001)
    stencil = grid.stencil(region, mu, order)
    weights = stencil.odd if odd else stencil.even
    found = (weights * smooth(grid.mu[region], odd)[stencil.node]).sum(axis=1)
    return float(np.max(np.abs(found - smooth(mu, odd))))


@pytest.mark.parametrize("odd", [False, True])
def test_between_nodes(odd: bool) -> None:
    assert error(Grid.build([1.0], 24), 0, odd) < 5e-5  # of the logarithm, beyond the last node
    assert error(Grid.build([1.0], 24), 0, odd, low=0.02) < 1e-5
    assert error(Grid.build([1.0], 48), 0, odd, low=0.02) < 1e-7
    for region in (0, 1):
        assert error(Grid.build([1.0, 1.5], 24), region, odd) < 5e-5


def test_odd_orders_are_odd_beyond_the_normal() -> None:
    grid = Grid.build([1.0], 48)
    mu = np.linspace(0.99, 1, 101)
    stencil, values = grid.stencil(0, mu), smooth(grid.mu[0], True)
    for weights, good in ((stencil.odd, True), (stencil.even, False)):
        off = np.max(np.abs((weights * values[stencil.node]).sum(axis=1) - smooth(mu, True)))
        assert off < 1e-7 if good else off > 1e-5


@pytest.mark.parametrize("order", [2, 4, 6])
def test_the_order_is_the_order_stated(order: int) -> None:
    """Halving the distance of the nodes divides the error by 2^order, away from the logarithm at grazing."""
    errors = [error(Grid.build([1.0], n), 0, False, order, low=0.3) for n in (24, 48)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_a_node_is_itself() -> None:
    grid = Grid.build([1.0, 1.5], 12)
    for region in (0, 1):
        mu = grid.mu[region]
        stencil = grid.stencil(region, mu)
        matrix = np.zeros((len(mu), len(mu)))
        np.add.at(matrix, (np.arange(len(mu))[:, None], stencil.node), stencil.even)
        assert np.allclose(matrix, np.eye(len(mu)), atol=1e-6)
        assert np.allclose(stencil.even.sum(axis=1), 1, rtol=1e-10, atol=1e-14)
    with pytest.raises(UrushiError, match="allowed: 0 to 1"):
        grid.stencil(0, np.array([0.5, 1.1]))


@pytest.mark.parametrize("odd", [False, True])
def test_basis_functions(odd: bool) -> None:
    """They are 1 at their node and 0 at the others, add up to 1 (even), and stand for anything smooth."""
    grid = Grid.build([1.0, 1.5], [24, 16])
    for panel, region in zip(grid.panels, (0, 1), strict=True):
        own = grid.mu[region][panel.nodes]
        at_nodes = grid.functions(panel, own, odd)
        expected = np.eye(panel.count)
        if odd and panel.first == 0:
            expected[0, 0] = 0  # where every odd order is 0
        assert np.allclose(at_nodes, expected, atol=1e-12)
        mu = np.linspace(0.01, panel.high, 301)
        values = grid.functions(panel, mu, odd)
        sin = np.sqrt((1 - mu) * (1 + mu)) if odd else 1
        sin_own = np.sqrt((1 - own) * (1 + own)) if odd else 1
        assert np.allclose(values @ (np.exp(own) * sin_own), np.exp(mu) * sin, atol=1e-9)
        if not odd:
            assert np.allclose(values.sum(axis=1), 1, rtol=1e-12, atol=1e-14)


def test_hundreds_of_nodes() -> None:
    grid = Grid.build([1.0], 600)
    assert grid.weights[0].sum() == pytest.approx(1, rel=1e-12)
    values = grid.functions(grid.panels[0], np.linspace(0.01, 1, 50))
    assert np.allclose(values @ grid.mu[0], np.linspace(0.01, 1, 50), rtol=1e-10, atol=1e-14)


def test_nodes_closer_together_towards_the_normal() -> None:
    """By the factor asked for; they integrate as well as others, and know their own place."""
    plain, grid = Grid.build([1.0, 1.5], [40, 12]), Grid.build([1.0, 1.5], [40, 12], 0.4)
    assert [panel.squeeze for panel in grid.panels] == [0.4, 1.0]
    apart = [np.sqrt(2 - 2 * some.mu[0][1]) for some in (grid, plain)]  # from the normal, in radians
    assert apart[0] == pytest.approx(0.4 * apart[1], rel=1e-2)
    assert np.array_equal(grid.s[40:], plain.s[40:])
    for region, power in ((0, 0), (0, 3), (1, 0), (1, 3)):
        total = grid.weights[region] @ grid.mu[region] ** power
        assert total == pytest.approx(1 / (power + 1), rel=1e-11)
    y = np.linspace(0.01, 1, 50)
    for panel in grid.panels:
        mu = panel.cosine(y)
        assert np.allclose(panel.coordinate(mu), y, rtol=1e-12)
        slope = (panel.cosine(y + 1e-6) - panel.cosine(y - 1e-6)) / 4e-6 / y
        assert np.allclose(panel.density(y), slope, rtol=1e-6)
    at, cosines = grid.stencil(0, np.linspace(0.05, 1, 200)), np.linspace(0.05, 1, 200)
    lobe = 1 / (1 + (1 - grid.mu[0]) / 0.005) ** 2
    assert np.abs((at.even * lobe[at.node]).sum(axis=1) - 1 / (1 + (1 - cosines) / 0.005) ** 2).max() < 2e-3


@pytest.mark.parametrize("squeeze", [1.0, 0.4])
def test_odd_functions_from_even_ones(squeeze: float) -> None:
    """Two factors make one of the other, but in panels where both are the same."""
    grid = Grid.build([1.0, 1.5], [24, 16], squeeze)
    first, second = grid.panels
    mu = np.append(np.linspace(0.01, 1 - 1e-9, 300), 1.0)
    factors = grid.odd_factors(first, mu)
    assert factors is not None and grid.odd_factors(second, mu) is None
    made = factors[0][:, None] * grid.functions(first, mu) * factors[1]
    assert np.allclose(made, grid.functions(first, mu, odd=True), atol=1e-10)
