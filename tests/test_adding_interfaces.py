"""Rough interfaces as matrices: against quadrature of their own values, their albedos, and stacks known otherwise."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import DOUBLE, direction, needs_llvm
from outside import cases
from quadrature import gauss
from surface import evaluate
from urushi.adding import Slab, add
from urushi.errors import OutOfReach, UrushiError
from urushi.interfaces.energy import directional
from urushi.solvers.adding.angles import fan, ring
from urushi.solvers.adding.balance import all_reciprocal, scales
from urushi.solvers.adding.basis import Grid
from urushi.solvers.adding.columns import Side, columns
from urushi.solvers.adding.interfaces import RoughLayer
from urushi.solvers.adding.operator import OPERATORS, Operator
from urushi.solvers.adding.resolution import narrowest, plan
from urushi.solvers.arrays import padded
from urushi.solvers.bound import BoundStack, bind
from urushi.solvers.numbers import gather_numbers

pytestmark = needs_llvm

GLASS = dict(ior=1.5, alpha=0.3)


def bound(*layers: Any, exterior: float = 1.0) -> BoundStack:
    import drjit.llvm.ad as module

    numbers = gather_numbers(ur.Stack(layers=list(layers), exterior=exterior), None, module, True, "adding")
    return bind(ur.Stack(layers=list(layers), exterior=exterior), numbers.values, numbers.fixed)


def indices(stack: BoundStack) -> list[float]:
    found = [float(np.array(index).ravel()[0]) for index in stack.indices]
    return found[:-1] if stack.opaque else found


@functools.cache
def prepared(*layers: Any, counts: tuple[int, ...], exterior: float = 1.0) -> tuple[Grid, list[RoughLayer]]:
    stack = bound(*layers, exterior=exterior)
    grid = Grid.build(indices(stack), counts)
    return grid, [RoughLayer(interface, grid, k) for k, interface in enumerate(stack.interfaces)]


def rest(*layers: Any, counts: tuple[int, ...], orders: int) -> tuple[Grid, np.ndarray, np.ndarray]:
    """Of a coat on a base: the grid, (C, M, n, n) what enters the coat, and (C, n) all that is reflected."""
    grid, (coat, base) = prepared(*layers, counts=counts)
    upper, lower = coat.slab(range(orders)), base.slab(range(orders))
    entering = add(upper._replace(r_top=Operator(upper.r_top.shape)), lower, OPERATORS).r_top
    assert entering.dense is not None
    return grid, entering.dense, entering.albedo() + upper.r_top.albedo()


def between(grid: Grid, values: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """(C, n) albedos of the nodes of the first region at other cosines."""
    stencil = grid.stencil(0, mu)
    return np.einsum("cnk,nk->cn", values[:, stencil.node], stencil.even)


def read(grid: Grid, matrices: np.ndarray, mu_o: Any, mu_i: Any, phi: Any) -> np.ndarray:
    """(C, N) flux densities between the nodes of the first region; phi = 0 is the mirror direction."""
    mu = grid.mu[0]
    smooth = matrices / (grid.weights[0] * mu)[:, None] * (mu[:, None] + mu)
    out, into = grid.stencil(0, np.asarray(mu_o)), grid.stencil(0, np.asarray(mu_i))
    total = np.zeros((len(matrices), len(out.node)))
    for m in range(matrices.shape[1]):
        a, b = (out.odd, into.odd) if m % 2 else (out.even, into.even)
        k = smooth[:, m][:, out.node[:, :, None], into.node[:, None, :]]
        total += (1 if m == 0 else 2) * np.cos(m * np.asarray(phi)) * np.einsum("cnkl,nk,nl->cn", k, a, b)
    return total / (2 * np.pi) * mu_o / (np.asarray(mu_o) + mu_i)


def every(slab: Slab) -> list[np.ndarray]:
    return [operator.dense for operator in slab if operator.dense is not None]


def poisson(height: float, phi: np.ndarray) -> np.ndarray:
    peak: np.ndarray = (1 - height**2) / (1 + height**2 - 2 * height * np.cos(phi))
    return peak


def test_quadrature_of_angles() -> None:
    """The points of a fan integrate over all cosines of a region, those of a ring over the azimuth."""
    grid = Grid.build([1.0, 1.5], (12, 8))
    for region, centre in ((0, 0.0), (0, 1.2), (1, 0.3), (1, np.pi / 2)):
        points = fan(grid, region, centre, 1e-3, 0.02, [0.4, 1.1], 10)
        assert np.allclose(
            points.weight @ np.stack([points.cos**0, points.cos**3], axis=1), [1, 0.25], atol=1e-9
        )
        assert np.allclose(points.sin**2 + points.cos**2, 1)
    for level in (0, 4, 12):
        circle = ring(level, 3, 40, 8)
        # Poisson's kernel, whose order m is 2 pi h^m; panels that need not resolve the cosines must resolve it.
        height = 0.9 if level else 0.5
        peak, exact = poisson(height, circle.phi), 2 * np.pi * height ** np.arange(3, 40)
        assert circle.weight @ peak == pytest.approx(2 * np.pi, abs=1e-6)
        assert np.allclose(peak @ circle.project, exact, atol=3e-4)
        assert len(circle.phi) < 8 * (level + 5)
        finer = [circle.finer(panel, 3, 40, 8) for panel in range(len(circle.breaks) - 1)]
        both = sum(poisson(height, one.phi) @ one.project for one in finer)
        assert np.allclose(both, exact, atol=1e-6) and sum(len(one.phi) for one in finer) < 300


@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("ior", [1.5, 1 / 1.5])
def test_resolved_lobes_are_values_at_nodes(ior: float, above: bool) -> None:
    """Where the nodes resolve the lobe a matrix holds w_o times the cosine integrals of the flux density."""
    glass = ur.Dielectric(ior=1.0, alpha=0.5) if ior < 1 else ur.Dielectric(ior=1.5, alpha=0.5)
    exterior = 1.5 if ior < 1 else 1.0
    grid, (layer,) = prepared(glass, counts=(32, 16), exterior=exterior)
    (interface,) = bound(glass, exterior=exterior).interfaces
    slab = layer.slab(range(6))
    region, beyond = (0, 1) if above else (1, 0)
    phi, weight = gauss(200, 0, np.pi)
    for same, operator in ((True, slab[0 if above else 2]), (False, slab[1 if above else 3])):
        assert operator.dense is not None
        target = region if same else beyond
        off, height = [], []
        for i in (3, 9, 16):
            w = direction(grid.mu[region][i], np.pi)[None]
            for o in (2, 8, 14):
                to = direction(grid.mu[target][o], phi) * ([1, 1, 1] if same else [1, 1, -1])
                value = evaluate(DOUBLE, interface, w, to, above)[0]
                exact = 2 * (weight * value) @ np.cos(phi[:, None] * np.arange(6))
                found = operator.dense[0, :, o, i] / grid.weights[target][o]
                off.append(np.abs(found - exact).max())
                height.append(np.abs(exact).max())
        # GGX facets that stand upright end transmission with a jump, which no basis resolves quickly.
        assert max(off) < (4e-3 if same else 2e-3) * max(height)


@pytest.mark.parametrize(
    "layer",
    [
        ur.Dielectric(**GLASS),
        ur.Dielectric(ior=1.33, alpha=0.1, distribution="beckmann", masking="separable"),
        ur.Conductor(material="Au", alpha=0.3),
    ],
)
def test_albedos(layer: Any) -> None:
    """Columns add up to the albedo that samples find, from both sides, in every colour."""
    counts = (16,) if layer.kind == "conductor" else (16, 8)
    grid, (rough,) = prepared(layer, counts=counts)
    (interface,) = bound(layer).interfaces
    slab = rough.slab(range(2))
    totals = [slab.r_top.albedo() + slab.t_down.albedo(), slab.r_bottom.albedo() + slab.t_up.albedo()]
    for above, total in zip((True, False), totals, strict=True):
        if not above and interface.opaque:
            continue
        r, d, _ = directional(interface, grid.mu[0 if above else 1][[0, 5, 10]], above, accuracy=5e-5)
        assert np.allclose(total[:, [0, 5, 10]], (r + d).T, atol=2e-4)


def test_narrow_lobes_on_few_nodes() -> None:
    """At alpha 0.002 each column acts on smooth light like Fresnel's mirror and Snell's law do."""
    grid, (layer,) = prepared(ur.Dielectric(ior=1.5, alpha=0.002), counts=(12, 8))
    _, (smooth,) = prepared_smooth()
    slab = layer.slab(range(3))
    for name in ("r_top", "t_down", "r_bottom", "t_up"):
        operator, exact = getattr(slab, name), getattr(smooth, name)
        region_o = 0 if name in ("r_top", "t_up") else 1
        # How the next layer sees what comes: next to the normal order m goes like s^m.
        light = grid.s[: grid.count(region_o)] ** np.arange(3)[:, None] / (1 + grid.mu[region_o])
        found = np.einsum("mo,moi->mi", light, operator.dense[0])
        n = exact.delta.shape[1]
        expected = np.zeros((3, operator.shape[1]))
        expected[:, :n] = light[:, :n] * exact.delta[0]
        # Not near the horizon nor total reflection, where even little roughness tells.
        s = grid.s[: operator.shape[1]]
        assert np.abs(found - expected)[:, (s > 0) & (s < 0.9)].max() < 1e-3, name


def prepared_smooth() -> tuple[Grid, list[Slab]]:
    from urushi.solvers.adding.smooth import smooth

    stack = bound(ur.Dielectric(ior=1.5))
    grid = Grid.build(indices(stack), (12, 8))
    return grid, [smooth(stack.interfaces[0], grid, 0)]


@pytest.mark.parametrize("layer", [ur.Dielectric(**GLASS), ur.Dielectric(ior=1.5, alpha=0.02)])
def test_reciprocal_and_balanced(layer: Any) -> None:
    grid, (rough,) = prepared(layer, counts=(16, 8))
    for orders in (range(0, 3), range(5, 9)):
        first = rough.first(orders)
        slab = rough.slab(orders, first)
        a, b = grid.etendue[first : grid.count(0)], grid.etendue[first : grid.count(1)]
        for there, back, out, into in (
            (slab.r_top, slab.r_top, a, a),
            (slab.r_bottom, slab.r_bottom, b, b),
            (slab.t_down, slab.t_up, b, a),
        ):
            assert there.dense is not None and back.dense is not None
            given, returned = there.dense * into, np.swapaxes(back.dense * out, 2, 3)
            assert np.abs(given - returned).max() < 1e-14 * np.abs(given).max()
    # What any order holds does not depend on which others are asked for with it.
    few, many = rough.slab(range(2, 4)), rough.slab(range(0, 12))
    for one, other in zip(every(few), every(many), strict=True):
        assert np.abs(one - other[:, 2:4]).max() < 1e-4


def test_orders_end() -> None:
    """The bound on the orders holds: what lies beyond is small, and so is what lies before the first node."""
    layer = ur.Dielectric(ior=1.5, alpha=0.3)
    _, (rough,) = prepared(layer, counts=(16, 8))
    top = [np.abs(rough.slab(range(m, m + 1)).t_down.dense).max() for m in (0, 20)]
    assert top[1] < 0.1 * top[0]
    first = rough.first(range(20, 21))
    assert first > 0
    whole = rough.slab(range(20, 21)).r_top.dense
    assert whole is not None
    assert np.abs(whole[:, :, :first]).max() < 1e-3 * np.abs(rough.slab(range(1)).r_top.dense).max()
    assert rough.slab(range(rough.orders, rough.orders + 3)).r_top.dense is None


def test_coat_on_diffuse_closed_form() -> None:
    """Guo's case a: two closed forms, the coat's own reflection and all that a Lambert base gives back through it."""
    case = next(case for case in cases("guo") if case["name"] == "a")
    coat = ur.Dielectric(ior=1.5, alpha=0.1, masking="separable")
    grid, matrices, _ = rest(coat, ur.Diffuse(reflectance=0.5), counts=(32, 16), orders=1)
    (interface, _) = bound(coat, ur.Diffuse(reflectance=0.5)).interfaces
    theta_i, theta_o, phi = np.radians([value["triple"] for value in case["values"]]).T
    truth = np.array([value["f_cos"][0] for value in case["values"]])
    inner = read(grid, matrices, np.cos(theta_o), np.cos(theta_i), 0.0)[0]
    outer = evaluate(DOUBLE, interface, direction(np.cos(theta_i)), direction(np.cos(theta_o), phi))[0]
    assert np.abs(inner + outer - truth).max() < 2e-4


def test_layerlab_coated_diffuse() -> None:
    """Jakob 2014 on 196 nodes, single scattering between facets (its own errors are near 1e-3)."""
    case = next(case for case in cases("layerlab") if case["name"] == "coated diffuse")
    coat = ur.Dielectric(ior=1.5, alpha=0.1, distribution="beckmann", masking="separable")
    grid, _, total = rest(coat, ur.Diffuse(reflectance=0.5), counts=(24, 12), orders=1)
    mu, truth = np.array(case["mu"]), np.array(case["R"])
    assert np.abs(between(grid, total, mu)[0] - truth)[mu > 0.1].max() < 1.5e-3
    w = grid.etendue[: total.shape[1]]
    assert abs(total[0] @ w / w.sum() - case["bihemispherical_R"]) < 1e-3


def test_few_nodes_are_enough_for_a_sharp_coat() -> None:
    """A coat of alpha 0.01 on a wide base, with lobes far narrower than the nodes are apart."""
    coat, base = ur.Dielectric(ior=1.5, alpha=0.01), ur.Conductor(eta=0.2, k=3.0, alpha=0.3)
    mu = np.array([1.0, 0.8, 0.5, 0.2])
    found = []
    for counts in ((16, 8), (32, 16)):
        grid, matrices, total = rest(coat, base, counts=counts, orders=12)
        found.append((between(grid, total, mu), read(grid, matrices, mu, mu, 0.3)))
    (few, few_values), (many, many_values) = found
    assert np.abs(few - many).max() < 2e-3
    assert np.abs(few_values - many_values).max() < 6e-3 * np.abs(many_values).max()


def test_coat_on_gold_against_the_walk() -> None:
    layers = (ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(material="Au", alpha=0.2))
    grid, matrices, total = rest(*layers, counts=(24, 12), orders=1)
    assert matrices.shape[0] == 3
    mu = np.array([1.0, 0.8, 0.4])
    walk = ur.solve(ur.Stack(layers=list(layers)), "walk", samples=1 << 15)
    truth, error = walk.reflectance(direction(mu), with_error=True)
    assert (np.abs(between(grid, total, mu).T - truth) < 4 * error + 3e-4).all()
    assert error.max() < 4e-3


@pytest.mark.parametrize("kind", ["compensated", pytest.param("walk", marks=pytest.mark.slow)])
def test_complete_interfaces_lose_nothing(kind: str) -> None:
    """A rough coat on a rough ideal mirror gives back all light, and single scattering would not."""
    coat = ur.Dielectric(**GLASS, multiple_scattering=kind)
    mirror = ur.Conductor(material="none", alpha=0.3, multiple_scattering=kind)
    _, _, total = rest(coat, mirror, counts=(16, 8), orders=2)
    assert np.abs(total - 1).max() < 1e-11
    _, (one, other) = prepared(coat, mirror, counts=(16, 8))
    assert np.abs(one.scale - 1).max() < 0.05 and np.abs(other.scale - 1).max() < 0.05
    single = rest(ur.Dielectric(**GLASS), ur.Conductor(material="none", alpha=0.3), counts=(16, 8), orders=2)[
        2
    ]
    assert single.max() < 0.97


@pytest.mark.slow
def test_walked_coat_on_a_coloured_base_against_the_walk() -> None:
    layers = (
        ur.Dielectric(ior=1.5, alpha=0.4, multiple_scattering="walk"),
        ur.Diffuse(reflectance=(0.8, 0.5, 0.2), alpha=0.5, multiple_scattering="walk"),
    )
    grid, _, total = rest(*layers, counts=(16, 8), orders=2)
    mu = np.array([1.0, 0.7, 0.4])
    walk = ur.solve(ur.Stack(layers=list(layers)), "walk", samples=1 << 14)
    truth, error = walk.reflectance(direction(mu), with_error=True)
    assert (np.abs(between(grid, total, mu).T - truth) < 4 * error + 2e-3).all()


def test_scales_repair_a_matrix() -> None:
    rng = np.random.default_rng(3)
    w = rng.uniform(0.1, 1, 6)
    exchange = rng.random((1, 6, 6)) + 3 * np.eye(6)
    matrix = (exchange + np.swapaxes(exchange, 1, 2)) / w
    matrix /= matrix.sum(1).max()
    sums = matrix.sum(1) * rng.uniform(0.95, 1.05, (1, 6))
    d = scales(matrix, sums)
    assert np.allclose((d[:, :, None] * matrix * d[:, None]).sum(1), sums, atol=1e-12)
    with pytest.raises(UrushiError, match="6 nodes"):
        scales(matrix, sums * 9)
    slab = all_reciprocal(Slab(matrix, matrix, matrix, matrix * 1.1), w, w)
    assert np.allclose(slab.t_down * w, np.swapaxes(slab.t_up * w, 1, 2), rtol=1e-13)


def test_lobes_narrower_than_any_nodes_are_refused() -> None:
    """At once, where the accuracy asks for it: a rough interface that hardly refracts, in front of a mirror."""
    stack = ur.Stack(
        layers=[ur.Dielectric(ior=1.466), ur.Dielectric(ior=1.48, alpha=0.1), ur.Conductor(material="Au")]
    )
    with pytest.raises(
        OutOfReach, match=r"accuracy: found 0.001, but .* would take \d+ nodes; allowed: .*nodes="
    ) as said:
        ur.solve(stack, method="adding")
    assert "3894" in str(said.value)
    assert ur.solve(stack, method="adding", nodes=12).diagnostics["nodes"] == 36


def test_resolution() -> None:
    """What the lobes of a stack ask for: those of closed form do not count, those behind them do."""
    assert narrowest([0.01], [1.0, 1.5], False) is None
    assert narrowest([0.01, None], [1.0, 1.5], True) is None
    assert narrowest([0.0, 0.05], [1.0, 1.5], True) == pytest.approx(0.1)
    assert narrowest([0.3, 0.05], [1.0, 1.5], True) == pytest.approx(np.sqrt(0.01 + 2 * 0.1**2))
    assert narrowest([0.1, 0.1], [1.0, 1.5, 1.0], False) == pytest.approx(np.hypot(0.1 / 3, 0.05))
    assert plan([0.01, None], [1.0, 1.5], True, 1e-3)[0] == [18, 11]
    # Of stacks that transmit, whatever meets one rough interface has a closed form behind smooth ones, too.
    through = functools.partial(narrowest, opaque=False, through=True)
    assert through([0.1, 0.0], [1.0, 1.5, 1.5]) is None
    assert through([0.1, 0.1], [1.0, 1.5, 1.0]) == pytest.approx(np.hypot(0.1 / 3, 0.05))
    assert through([0.0, 0.1], [1.0, 1.5, 1.0]) == pytest.approx(np.sqrt(2) * 0.1 / 3)  # off the upper face
    sheet = [0.1, 0.1], [1.0, 1.5, 1.0], False, 1e-3
    assert plan(*sheet)[1] == plan([0.3, 0.3], *sheet[1:], True)[1] == 1 and plan(*sheet, True)[1] == 0.4
    assert plan(*sheet, True)[0][0] < 0.6 * plan(*sheet)[0][0]
    assert plan(*sheet, True)[0][1] < 0.3 * plan(*sheet)[0][1]
    # Before a mirror nobody outside sees the directions of total reflection.
    before = plan([0.1, 0.0], [1.0, 1.5], True, 1e-3, True)[0]
    assert before[1] < 0.3 * before[0]
    few, more = (plan([0.05, 0.1], [1.0, 1.5], True, a)[0][0] for a in (1e-2, 1e-4))
    assert more > 1.8 * few
    _, (layer,) = prepared(ur.Dielectric(ior=1.5, alpha=0.1), counts=(32, 16))
    assert layer.error < 1e-3 < prepared(ur.Dielectric(ior=1.5, alpha=0.1), counts=(8, 6))[1][0].error


@pytest.mark.parametrize("node", [3, 7, 11])
def test_moments_of_columns(node: int) -> None:
    """What a column sends, weighted by s^p of the order's own kind, is exact on the fewest nodes, kinks and all."""
    (interface,) = bound(ur.Dielectric(**GLASS)).interfaces
    grid = Grid.build([1.0, 1.5], (5, 10))
    found = columns(Side(interface, grid, 1, 1, False), range(6), 10)
    mu, weight = gauss(2500, 0, 1)
    phi, ring_weight = gauss(1000, 0, np.pi)
    to = direction(mu[:, None], phi[None]).reshape(-1, 3)
    value = evaluate(DOUBLE, interface, direction(grid.mu[1][node], np.pi)[None], to, False)[0]
    flux = value.reshape(len(mu), -1) * weight[:, None] * ring_weight * 2
    for m, power in enumerate((0, 1, 2, 1, 2, 1)):
        exact = (1.5 * np.sqrt(1 - mu**2)) ** power @ flux @ np.cos(m * phi)
        assert grid.s**power @ found[0, m, :, node] == pytest.approx(exact, abs=2e-5), m


@pytest.mark.parametrize("kind", [np.float64, np.uint32])
def test_arrays_may_be_read_beyond_their_end(kind: Any) -> None:
    """Dr.Jit reads whole packets of numpy's own memory, of 16 numbers and more: they have to be there."""
    given = np.arange(21).reshape(3, 7)
    found = padded(given, kind)
    assert found.dtype == kind and np.array_equal(found, given.ravel())
    assert found.base is not None and found.base.nbytes >= found.nbytes + 16 * found.itemsize
