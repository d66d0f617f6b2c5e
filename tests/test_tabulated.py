"""Fourier tables in Dr.Jit: the values of numpy, and directions of exactly the density that is claimed."""

from __future__ import annotations

import drjit.scalar
import numpy as np
import pytest
from scipy import fft

from chi2 import SIGNIFICANCE, p_value, strata
from fourier_files import COATED, MU, SLAB, kernel, small
from lanes import DOUBLE, SINGLE, back, both_precisions, direction, needs_llvm
from quadrature import gauss
from urushi.adapters.fourier import blended, evaluate, fourier_table, read_fourier, reflectance
from urushi.adapters.fourier.prepared import prepared
from urushi.optics.series import prepare
from urushi.optics.tabulated import Tabulated

pytestmark = needs_llvm

TABLES = {
    "slab": read_fourier(SLAB),
    "coated": read_fourier(COATED),
    "rgb": small(3),
    "kernel": fourier_table(MU, r_top=kernel(), t_down=kernel(energy=(0.2,)), r_bottom=kernel(energy=(0.9,))),
    "sharp": fourier_table(MU, r_top=kernel(orders=80, ratio=0.93), t_up=kernel()),
}


def coarse():
    """Few nodes, as different from one another as can be."""
    rng, mu = np.random.default_rng(3), np.array([0.3, 0.65, 1.0])
    mean = rng.uniform(0.5, 1, (1, 1, 3, 3)) * np.where(np.indices((3, 3)).sum(axis=0) % 2, 0.02, 1)
    wave = mean * rng.uniform(-1, 1, (1, 1, 3, 3))
    return fourier_table(mu, tolerance=0, r_top=np.concatenate([mean, wave], axis=1))


TABLES["coarse"] = coarse()
SERIES = {name: prepared(table) for name, table in TABLES.items()}
every_table = pytest.mark.parametrize("name", TABLES)


def of(lanes, series):
    return Tabulated(series, lanes.number)


def spread(rng, n):
    """Directions of both sides, the horizon and the normal among them."""
    cos = np.concatenate([[1, -1, 1, 1e-3, -1e-3], rng.uniform(-1, 1, n)])
    return direction(cos, rng.uniform(0, 2 * np.pi, len(cos)))


@both_precisions
@every_table
def test_values_are_those_of_numpy(rng, name, lanes):
    table = TABLES[name]
    wi, wo = lanes.rounded(spread(rng, 500)), lanes.rounded(spread(rng, 500)[::-1])
    sums = of(lanes, SERIES[name]).eval(lanes.vectors(wi), lanes.vectors(wo))
    found = np.stack([back(s) for s in sums], axis=1)
    truth = evaluate(table, wi, wo)
    # Channels Y, R, B.
    found = found[:, :1] if table.channels == 1 else found[:, 1:]
    truth = truth[:, :1] if table.channels == 1 else truth[:, ::2]
    tolerance = (2e-5 if lanes is SINGLE else 1e-9) * truth.max()
    np.testing.assert_allclose(np.maximum(found, 0), truth, atol=tolerance)
    assert truth.max() > 0.05


@every_table
def test_plain_floats_give_the_same(rng, name):
    """What the scalar variants compute, by numpy's sums, against lanes in double precision."""
    lanes, vector = of(DOUBLE, SERIES[name]), drjit.scalar.Array3f64
    plain = Tabulated(SERIES[name], float)
    wi, wo, u = spread(rng, 40), spread(rng, 40)[::-1], rng.random((45, 3))
    wis, wos = DOUBLE.vectors(wi), DOUBLE.vectors(wo)
    us = tuple(DOUBLE(u[:, i]) for i in range(3))
    sampled, valid = lanes.sample(wis, us)
    up, down = lanes.flux(wis)
    truth = [
        np.stack([back(s) for s in lanes.eval(wis, wos)], axis=1),
        back(lanes.pdf(wis, wos)),
        np.where(np.array(valid)[:, None], back(sampled), 0),
        np.stack([back(s) for s in (*up, *down)], axis=1),
    ]
    found: list[list] = [[], [], [], []]
    for a, b, c in zip(wi, wo, u.tolist(), strict=True):
        w, o = vector(*a), vector(*b)
        found[0].append(plain.eval(w, o))
        found[1].append(plain.pdf(w, o))
        direction_, valid_ = plain.sample(w, tuple(c))
        found[2].append(list(direction_) if valid_ else [0.0] * 3)
        found[3].append([*plain.flux(w)[0], *plain.flux(w)[1]])
    for one, other in zip(found, truth, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max())


def grid(series):
    """Directions by which what is linear between nodes, and a cosine series in azimuth, is integrated exactly."""
    x, w = gauss(2, 0, 1)
    width = np.diff(series.nodes)
    mu = (series.nodes[:-1, None] + width[:, None] * x).ravel()
    weight = (width[:, None] * w).ravel()
    turns = 2 * int(series.counts.max()) + 5
    phi = 2 * np.pi * np.arange(turns) / turns
    wo = direction(np.repeat(-mu, turns), np.tile(phi, len(mu)))
    return wo, np.repeat(weight, turns) * 2 * np.pi / turns


@every_table
@pytest.mark.parametrize("cos", [1.0, 0.97, 0.61, 0.2, 0.004, -0.3, -1.0])
def test_the_density_adds_up_to_one(name, cos):
    """And is nowhere negative: to ten digits where light gets, 0 where none does."""
    series = SERIES[name]
    wo, weight = grid(series)
    wi = np.broadcast_to(direction(cos, 0.7), wo.shape)
    density = back(of(DOUBLE, series).pdf(DOUBLE.vectors(wi), DOUBLE.vectors(wo)))
    lit = reflectance(TABLES[name], direction(np.array([cos])))
    expected = 1.0 if max(part.max() for part in lit) > 0 else 0.0
    assert density @ weight == pytest.approx(expected, abs=1e-9)
    assert density.min() >= 0


@pytest.mark.parametrize(
    ("name", "cos"),
    [(name, cos) for name in ("slab", "coated", "kernel", "sharp") for cos in (1.0, 0.62, 0.15, -0.5)]
    + [("coarse", 0.45), ("coarse", 0.8)],
)
def test_directions_have_their_density(rng, name, cos):
    series = SERIES[name]
    tables, n = of(SINGLE, series), 1024 if name == "coarse" else 256
    u = np.concatenate([strata(rng, n), rng.random((n * n, 1))], axis=1)[:, [0, 2, 1]]
    u = np.minimum(u, 1 - 2.0**-24)
    wi = np.broadcast_to(direction(cos, 0.4), u.shape)
    wo, valid = tables.sample(SINGLE.vectors(wi), tuple(SINGLE(u[:, i]) for i in range(3)))
    valid, wo = np.array(valid), back(wo)
    if name == "coated" and cos < 0:
        assert valid.all() and (wo[:, 2] < 0).all()
    assert valid.all()
    np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1, atol=1e-5)
    phi = np.arctan2(wo[:, 1], wo[:, 0])
    # Cells that end at nodes, with as many points in each as integrate the longest series.
    edges = np.unique(series.nodes.astype(np.float32))[:: max(1, len(series.nodes) // 24)].astype(float)
    edges = np.unique(np.concatenate([edges, [1.0]]))
    x, weight = gauss(2, 0, 1)
    y, slice_weight = gauss(12 + int(series.counts.max()) // 4, 0, 1)
    width = np.diff(series.nodes)
    mu, weight = (series.nodes[:-1, None] + width[:, None] * x).ravel(), (width[:, None] * weight).ravel()
    sectors = np.linspace(-np.pi, np.pi, 13)
    phis = (sectors[:-1, None] + np.pi / 6 * y).ravel()
    o = direction(np.repeat(-mu, len(phis)), np.tile(phis, len(mu)))
    i = np.broadcast_to(direction(cos, 0.4), o.shape)
    density = back(of(DOUBLE, series).pdf(DOUBLE.vectors(i), DOUBLE.vectors(o))).reshape(len(mu), 12, -1)
    mass = weight[:, None] * (density @ (slice_weight * np.pi / 6))
    cells = np.clip(np.searchsorted(edges, mu) - 1, 0, len(edges) - 2)
    expected = np.zeros((len(edges) - 1, 12))
    np.add.at(expected, cells, mass * len(u))
    counts = np.histogram2d(-wo[:, 2], phi, bins=(edges, sectors))[0]
    assert p_value(counts, expected) > SIGNIFICANCE


def test_what_is_sampled_is_what_is_reflected(rng):
    """Value over density is the albedo, but for what linear and cubic interpolation differ by."""
    for name, most in (("coated", 0.01), ("kernel", 0.05)):
        tables = of(SINGLE, SERIES[name])
        wi = direction(rng.uniform(0.15, 1, 20000), rng.uniform(0, 6, 20000))
        wis = SINGLE.vectors(wi)
        wo, valid = tables.sample(wis, tuple(SINGLE(u) for u in rng.random((3, 20000))))
        weight = back(tables.eval(wis, wo)[0]) / back(tables.pdf(wis, wo))
        albedo = sum(reflectance(TABLES[name], wi))[:, 0]
        assert np.array(valid).all()
        assert np.std(weight / albedo) < most
        assert np.mean(weight / albedo) == pytest.approx(1, abs=4 * most / np.sqrt(20000) + 1e-3)


def test_there_is_density_wherever_splines_reach(rng):
    """A single lit pair of nodes: splines overshoot into intervals whose ends are dark."""
    block = np.zeros((1, 1, 6, 6))
    block[0, 0, 3, 2] = 1.0
    mu = np.linspace(0.1, 1, 6)
    tables = of(SINGLE, prepared(fourier_table(mu, r_top=block)))
    wi, wo = (SINGLE.vectors(direction(rng.uniform(0, 1, 5000), rng.uniform(0, 6, 5000))) for _ in range(2))
    value, density = back(tables.eval(wi, wo)[0]), back(tables.pdf(wi, wo))
    lit = value > 1e-5
    assert np.count_nonzero(lit) > 100 and (density[lit] > 0).all()
    # Each beam from where there is light at all finds what it reflects.
    assert np.max(value[lit] / density[lit]) < 60


def test_energies_are_those_of_numpy(rng):
    for name in ("slab", "coated", "rgb"):
        wi = spread(rng, 200)
        up, down = of(DOUBLE, SERIES[name]).flux(DOUBLE.vectors(wi))
        reflected, transmitted = reflectance(TABLES[name], wi)
        above = wi[:, 2] > 0
        found = back(up[0]), back(down[0])
        channel = 0
        if TABLES[name].channels == 3:
            found, channel = (back(up[1]), back(down[1])), 0
        np.testing.assert_allclose(np.where(above, *found), reflected[:, channel], atol=1e-9)
        np.testing.assert_allclose(np.where(above, *found[::-1]), transmitted[:, channel], atol=1e-9)


def test_lifted_series_are_positive():
    """The least value of each, on a grid eight times as fine as its highest order."""
    for name in ("slab", "coated", "sharp"):
        series = SERIES[name]
        ringing = 0
        rows = np.nonzero(series.counts.ravel() > 1)[0][:: 1 + series.counts.size // 4000]
        for pair in rows:
            start, count = series.offsets.ravel()[pair], series.counts.ravel()[pair]
            a = np.zeros(8 * count + 1)
            a[:count] = series.coefficients[start : start + count, 0]
            a[1:] /= 2
            values = fft.dct(a, type=1)
            ringing += values.min() < -1e-6 * values.max()
            assert values.min() + series.lift.ravel()[pair] >= -1e-3 * max(-values.min(), 1e-12)
        assert ringing > 0 or name != "slab"


def test_no_direction_where_there_is_nothing(rng):
    """From below an opaque table, beyond the last node, on the horizon: no density, no light, no direction."""
    mu = np.linspace(0.2, 0.9, 5)
    series = prepared(fourier_table(mu, r_top=kernel(mu)))
    tables = of(SINGLE, series)
    inside, u = direction(0.5, 0.3), tuple(SINGLE(v) for v in rng.random((3, 50)))
    for cos in (-0.5, 0.95, 0.0):
        nowhere = direction(cos, 1.0)
        wi, other = (SINGLE.vectors(np.broadcast_to(w, (50, 3))) for w in (nowhere, inside))
        assert not np.array(tables.sample(wi, u)[1]).any()
        for pair in ((wi, other), (other, wi)):
            assert not back(tables.pdf(*pair)).any()
            assert not back(tables.eval(*pair)[0]).any()
    assert back(tables.pdf(other, other)).all()


def test_a_table_of_two_nodes(rng):
    """The smallest there is: isotropic, from everywhere to everywhere."""
    nodes, ones = np.array([-1.0, 1.0]), np.ones((2, 2), int)
    series = prepare(nodes, np.zeros((2, 2), int), ones, np.array([[0.25]]))
    tables = of(SINGLE, series)
    wi = SINGLE.vectors(spread(rng, 50))
    np.testing.assert_allclose(back(tables.pdf(wi, wi)), 1 / (4 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(back(tables.eval(wi, wi)[0]), 0.25, rtol=1e-6)


def test_a_corner_of_a_grid_of_parameters(rng):
    """`blended` gives what can be prepared, and the whole grid is refused."""
    table = small(3, (2,))
    with pytest.raises(Exception, match="2 bases; allowed"):
        prepared(table)
    wi, wo = spread(rng, 20), spread(rng, 20)
    corner = blended(table, (1.0,))
    found = of(DOUBLE, prepared(corner)).eval(DOUBLE.vectors(wi), DOUBLE.vectors(wo))
    np.testing.assert_allclose(np.maximum(back(found[2]), 0), evaluate(corner, wi, wo)[:, 2], atol=1e-9)
