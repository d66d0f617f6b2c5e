"""What Fourier tables say: against the kernels they were made of, and against what layerlab wrote and printed."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from fourier_files import COATED, DATA, MU, SLAB, kernel, small
from lanes import direction
from quadrature import gauss
from urushi.adapters.fourier import blended, evaluate, fourier_table, read_fourier, reflectance
from urushi.errors import MaterialError, UrushiError
from urushi.optics.spline import chords, running_integral, weights

LAYERLAB = {case["name"]: case for case in json.loads((DATA / "layerlab.json").read_text("utf-8"))["cases"]}


def lobe(mu_i, mu_o, phi, energy=0.6, ratio=0.5, g=0.3):
    """The kernel of `fourier_files` in closed form."""
    r = ratio * np.sqrt((1 - mu_i**2) * (1 - mu_o**2))
    poisson = (1 - r**2) / (1 - 2 * r * np.cos(phi) + r**2)
    return energy / np.pi * mu_o * (1 + g * mu_i * mu_o) * poisson


def pairs(rng, n, sides=(1, 1)):
    """Cosines, azimuths from the mirror direction, and the directions."""
    mu_i, mu_o, phi = rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n), rng.uniform(-np.pi, np.pi, n)
    turn = rng.uniform(0, 7, n)
    return mu_i, mu_o, phi, direction(mu_i * sides[0], turn), direction(mu_o * sides[1], turn + np.pi + phi)


SIDES = {"r_top": (1, 1), "t_down": (1, -1), "r_bottom": (-1, -1), "t_up": (-1, 1)}


@pytest.mark.parametrize("block", SIDES)
def test_a_kernel_comes_back(rng, block):
    """On the sides it was put on, dark on all others; phi = 0 is the mirror direction."""
    table = fourier_table(MU, tolerance=1e-6, **{block: kernel(orders=40)})
    for name, sides in SIDES.items():
        mu_i, mu_o, phi, wi, wo = pairs(rng, 400, sides)
        found = evaluate(table, wi, wo)
        truth = lobe(mu_i, mu_o, phi) if name == block else 0 * mu_i
        # Orders go to 0 at normal incidence like powers of a sine, which splines in the cosine follow worst.
        np.testing.assert_allclose(found[:, 0], truth, atol=3e-3)
        assert np.median(np.abs(found[:, 0] - truth)) < 1e-5


def test_radiance_is_scaled_where_light_crosses(rng):
    table = fourier_table(MU, r_top=kernel(), t_down=kernel(), r_bottom=kernel(), t_up=kernel(), eta=1.5)
    for sides, factor in (((1, 1), 1), ((1, -1), 1.5**-2), ((-1, -1), 1), ((-1, 1), 1.5**2)):
        *_, wi, wo = pairs(rng, 20, sides)
        ratio = evaluate(table, wi, wo) / evaluate(table, wi, wo, mode="importance")
        np.testing.assert_allclose(ratio, factor, rtol=1e-6)


def test_colours_pass_through_luminance(rng):
    energy = (0.7, 0.3, 0.1)
    table = fourier_table(MU, r_top=kernel(energy=energy))
    *_, wi, wo = pairs(rng, 50)
    grey = evaluate(fourier_table(MU, r_top=kernel(energy=(1,))), wi, wo)
    np.testing.assert_allclose(evaluate(table, wi, wo), grey * energy, rtol=1e-5)
    np.testing.assert_allclose(
        table.series(30, 10, 0)[0], table.series(30, 10, 1)[0] * 0.3706375 / 0.7, rtol=1e-5
    )
    up, down = reflectance(table, wi)
    np.testing.assert_allclose(
        up, reflectance(fourier_table(MU, r_top=kernel()), wi)[0] / 0.6 * energy, rtol=1e-5
    )
    assert not down.any()


@pytest.mark.parametrize("path", [SLAB, COATED], ids=["slab", "coated"])
def test_the_running_integral_of_layerlab(path):
    """The cdf in a real file follows from its coefficients, to the rounding of nodes that layerlab had in double."""
    table = read_fourier(path)
    n = len(table.nodes)
    mean = np.array([[table.series(i, o)[:1].sum() for o in range(n)] for i in range(n)])
    found = running_integral(table.nodes, mean)
    np.testing.assert_allclose(found, table.cdf[..., 0], atol=1e-6 * table.cdf.max())


@pytest.mark.parametrize("path", [SLAB, COATED], ids=["slab", "coated"])
def test_a_real_file_is_rebuilt_from_its_series(path):
    """Sizes, places, coefficients and integrals: what `fourier_table` makes of them is the same file."""
    table = read_fourier(path)
    n = len(table.nodes) // 2 - 1
    series = np.zeros((2, 2, 1, table.max_order, n, n))
    for i, side_i in ((i, s) for i in range(n) for s in (0, 1)):
        for o, side_o in ((o, s) for o in range(n) for s in (0, 1)):
            place = [n + 2 + j if side else n - 1 - j for j, side in ((i, side_i), (o, side_o))]
            a = table.series(*place)
            series[side_i, side_o, 0, : len(a), o, i] = a
    built = fourier_table(
        table.nodes[n + 2 :],
        r_top=series[1, 0],
        t_down=series[1, 1],
        r_bottom=series[0, 1],
        t_up=series[0, 0],
        tolerance=0,
    )
    np.testing.assert_array_equal(built.nodes, table.nodes)
    np.testing.assert_array_equal(built.counts, table.counts)
    np.testing.assert_array_equal(built.offsets, table.offsets)
    np.testing.assert_array_equal(built.coefficients, table.coefficients)
    np.testing.assert_allclose(built.cdf, table.cdf, atol=1e-6 * table.cdf.max())


def test_a_series_ends_where_the_rest_is_small():
    """By the sum of what follows against the mean: no kernel is off by more than that share of it."""
    exact, cut = (fourier_table(MU, r_top=kernel(orders=60, ratio=0.9), tolerance=t) for t in (0, 1e-3))
    assert len(cut.coefficients) < 0.5 * len(exact.coefficients)
    k = np.arange(60)[:, None] * np.linspace(0, np.pi, 50)
    for i, o in ((30, 10), (40, 15), (28, 3)):
        a, b = (t.series(i, o) for t in (exact, cut))
        assert len(b) < len(a)
        off = np.abs(a @ np.cos(k[: len(a)]) - b @ np.cos(k[: len(b)])).max()
        assert 0 < off <= 1e-3 * a[0] * (1 + 1e-6)


def test_the_coated_diffuse_base_of_layerlab():
    """The file has an energy correction, the table of numbers has not: they agree where little is corrected."""
    case, table = LAYERLAB["coated diffuse"], read_fourier(COATED)
    mu = np.array(case["mu"])
    up, down = reflectance(table, direction(mu))
    far = mu > 0.35
    np.testing.assert_allclose(up[far, 0], np.array(case["R"])[far], atol=4e-3)
    assert (up[~far, 0] > np.array(case["R"])[~far]).all() and not down.any()
    mu_i, mu_o, phi = np.meshgrid(case["f_mu_i"], case["f_mu_o"], case["f_phi"], indexing="ij")
    found = evaluate(table, direction(mu_i.ravel()), direction(mu_o.ravel(), np.pi + phi.ravel()))
    found = found[:, 0].reshape(mu_i.shape) / mu_o
    peak = np.max(case["f"], axis=(1, 2), keepdims=True)
    assert np.max(np.abs(found - case["f"])[1:] / peak[1:]) < 2e-2
    assert np.median(np.abs(found / case["f"] - 1)) < 6e-3


def test_the_slab_of_layerlab():
    """Albedo 0.9, g 0.5, depth 1 on 18 nodes: energies at its nodes as the finer table of numbers has them."""
    case, table = LAYERLAB["slab g=.5 albedo .9 depth 1"], read_fourier(SLAB)
    for mu in table.nodes[-5:].astype(float):
        up, down = reflectance(table, direction(np.array([mu])))
        assert up[0, 0] == pytest.approx(np.interp(mu, case["mu"], case["R"]), abs=2e-3)
        # Light that was not scattered is a spike at one node, whose integral by splines is not that of the quadrature.
        assert down[0, 0] == pytest.approx(np.interp(mu, case["mu"], case["T"]), abs=5e-2)
    below = [reflectance(table, direction(np.array([sign * 0.7]))) for sign in (1, -1)]
    np.testing.assert_allclose(below[0], below[1], rtol=1e-5)


def test_the_energy_is_the_integral_of_the_values():
    x, w = gauss(60, 0, 1)
    table = fourier_table(MU, r_top=kernel(), t_down=kernel(energy=(0.2,)))
    phi = (np.arange(64) + 0.5) * np.pi / 32
    for mu in (1.0, 0.55, 0.2):
        for sign, part in ((1, 0), (-1, 1)):
            wo = direction(sign * np.repeat(x, 64), np.tile(phi, 60))
            values = evaluate(table, direction(np.array([mu])), wo, mode="importance").reshape(60, 64)
            total = w @ values.mean(axis=1) * 2 * np.pi
            assert reflectance(table, direction(np.array([mu])))[part][0, 0] == pytest.approx(total, rel=2e-3)


def test_blending_is_linear_between_the_corners(rng):
    table = small(3, (2, 3))
    first, second = table.positions
    *_, wi, wo = pairs(rng, 30)
    corners = {
        (a, b): evaluate(blended(table, (first[a], second[b])), wi, wo) for a in range(2) for b in range(3)
    }
    x, y = 0.25, 0.6
    point = (first[0] + x * np.ptp(first), second[1] + y * (second[2] - second[1]))
    found = evaluate(blended(table, point), wi, wo)
    truth = sum(
        (x if a else 1 - x) * (y if b == 2 else 1 - y) * corners[a, b] for a in (0, 1) for b in (1, 2)
    )
    np.testing.assert_allclose(found, truth, rtol=1e-5)
    # The last parameter runs fastest, and each corner is the series that the file has there.
    np.testing.assert_array_equal(
        blended(table, (first[1], second[0])).series(6, 2, 1), table.series(6, 2, 1, 3)
    )
    assert np.ptp([c[0, 0] for c in corners.values()]) > 0.01


def test_the_corners_of_a_grid_are_the_blocks_that_were_given():
    """Channel by channel, basis by basis in it: each corner is the table that its block alone makes."""
    energies = [(0.1, 0.2, 0.3), (0.5, 0.1, 0.2)]
    blocks = np.stack([kernel(orders=4, energy=energy) for energy in energies])
    table = fourier_table(MU, r_top=blocks, positions=([0.0, 1.0],))
    for at, block in zip((0, 1), blocks, strict=True):
        alone, corner = fourier_table(MU, r_top=block), blended(table, (at,))
        np.testing.assert_array_equal(corner.coefficients, alone.coefficients)
        np.testing.assert_array_equal(corner.offsets, alone.offsets)
        np.testing.assert_allclose(corner.cdf, alone.cdf, rtol=1e-6)
    series = table.series(30, 10, 2, 1)
    np.testing.assert_array_equal(series, fourier_table(MU, r_top=blocks[1]).series(30, 10, 2))


def test_what_cannot_be_evaluated_or_built():
    table = small(1, (2,))
    wi = np.array([[0, 0, 1.0]])
    with pytest.raises(MaterialError, match="bases: found 2"):
        evaluate(table, wi, wi)
    with pytest.raises(MaterialError, match="parameters: found 0; allowed: 1"):
        blended(table, ())
    with pytest.raises(MaterialError, match=r"parameters\[0\]: found 2.0; allowed: 0 to 1"):
        blended(table, (2,))
    with pytest.raises(MaterialError, match="flags: found 3"):
        evaluate(replace(small(), flags=3), wi, wi)
    with pytest.raises(UrushiError, match="mode: found 'flux'"):
        evaluate(small(), wi, wi, mode="flux")
    good = kernel()
    for options, message in (
        ({"mu": MU[::-1], "r_top": good}, "mu: found others"),
        ({"mu": [0.0, 0.5], "r_top": good}, "mu: found others"),
        ({"mu": MU}, "at least one"),
        ({"mu": MU, "r_top": good[:, :, 1:]}, r"r_top: found the shape \(1, 12, 23, 24\)"),
        ({"mu": MU, "r_top": good * np.nan}, "r_top: found values that are not finite"),
        ({"mu": MU, "r_top": good, "t_up": kernel(energy=(1, 1, 1))}, "of the same bases and channels"),
        ({"mu": MU, "r_top": good, "tolerance": -1}, "tolerance: found -1"),
        ({"mu": MU, "r_top": good, "positions": ([0, 1],)}, "bases: found 1; allowed: 2"),
    ):
        with pytest.raises(MaterialError, match=message):
            fourier_table(**options)


def test_a_spline_has_the_slopes_of_the_chords(rng):
    """Quadratics are exact on even nodes; the ends are straight; two equal nodes of value 0 part both sides."""
    even = np.linspace(-1, 1, 9)
    h, left, right = chords(even)
    values = 1 + even - 2 * even**2
    for i in range(1, 7):
        t = rng.random()
        w = weights(t, left[i], right[i])
        assert np.dot(w, values[i - 1 : i + 3]) == pytest.approx(np.polyval([-2, 1, 1], even[i] + t * h[i]))
    parted = np.array([-1.0, -0.5, 0.0, 0.0, 0.25, 1.0])
    one, both = (running_integral(parted, np.array([0, 0, 0, 0, *v])) for v in ((0, 0), (1, 1)))
    assert not both[:4].any() and not one.any() and both[4] > 0
    assert weights(0.5, 1.0, 0.5) == pytest.approx((-0.125, 0.5625, 0.625, -0.0625))
