"""Compensated interfaces lose nothing, whatever the roughness; and the tables that they take it from."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from conftest import Tool
from lanes import DOUBLE, SINGLE, back, direction, needs_llvm
from test_compensated import glass, mirror
from test_interface_energy import COSINES, REFLECTED
from urushi.interfaces import tables
from urushi.interfaces.compensated import MEAN_COSINES, MEAN_WEIGHTS
from urushi.interfaces.energy import directional, hemispherical

pytestmark = needs_llvm

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
each_model = pytest.mark.parametrize(("distribution", "masking"), MODELS)
GRAZING = (0.003, 0.03, 0.1, 0.25, 0.5, 0.75, 1.0)


def total(interface: Any, w: Any, above: bool = True, accuracy: float = 3e-4) -> np.ndarray:
    found = directional(interface, w, above, accuracy=accuracy)
    return found.reflectance + found.transmittance


@each_model
@pytest.mark.parametrize("alpha", [0.01, 0.06, pytest.param(0.23, marks=pytest.mark.slow), 0.6])
def test_a_white_metal_is_white(alpha: float, distribution: str, masking: str) -> None:
    interface = mirror(DOUBLE, alpha, None, distribution, masking)
    assert np.abs(total(interface, GRAZING) - 1).max() < 2e-3
    # The planted fault: without its lobe.
    if alpha > 0.2:
        assert np.abs(total(interface.single, GRAZING) - 1).max() > 0.01


def _glasses() -> list[Any]:
    """Every index and model, one of them quickly."""
    quick = (1.5, "ggx", "correlated")
    cases = [(eta, *model) for eta in (1.05, 1.5, 3.0) for model in MODELS]
    return [pytest.param(*case, marks=() if case == quick else pytest.mark.slow) for case in cases]


@pytest.mark.parametrize(("eta", "distribution", "masking"), _glasses())
def test_clear_glass_is_clear(eta: float, distribution: str, masking: str) -> None:
    """From both sides; Walter's fit gives Beckmann's separable masking 2e-3 too much by itself."""
    for alpha, above in itertools.product((0.01, 0.3, 1.0), (True, False)):
        interface = glass(DOUBLE, eta, alpha, None, distribution, masking)
        assert np.abs(total(interface, GRAZING, above, 6e-4) - 1).max() < 2e-3, (alpha, above)


@pytest.mark.slow
@each_model
def test_clear_glass_at_random(distribution: str, masking: str, rng: np.random.Generator) -> None:
    for _ in range(40):
        eta, alpha = np.exp(rng.uniform(np.log(1.05), np.log(3))), 10 ** rng.uniform(-2, 0)
        cos, above = rng.uniform(0.003, 1, 12) ** 1.5, bool(rng.integers(2))
        interface = glass(DOUBLE, eta, alpha, None, distribution, masking)
        assert np.abs(total(interface, cos, above, 6e-4) - 1).max() < 2.5e-3, (eta, alpha, above)


BRUSHED = [(1.0, 0.1), (0.5, 0.05), (0.1, 0.01), (0.2, 0.6), (0.3, 0.3)]


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alphas", BRUSHED)
def test_brushed_metal_is_white(alphas: tuple[float, float], distribution: str) -> None:
    w = direction(
        *(grid.ravel() for grid in np.meshgrid((0.02, 0.1, 0.4, 0.8, 1.0), np.radians([0, 25, 50, 75, 90])))
    )
    found = total(mirror(DOUBLE, *alphas, distribution), w, accuracy=2e-3)
    assert np.abs(found - 1).max() < 1e-2


@pytest.mark.parametrize("alphas", [(1.0, 1e-4), (1e-4, 0.1)])
def test_beyond_the_tables_errors_are_bounded(alphas: tuple[float, float]) -> None:
    """Brushing narrower than 16 to 1 counts as that: light is lost along the grooves near grazing."""
    w = direction(*(grid.ravel() for grid in np.meshgrid((0.02, 0.1, 0.4, 1.0), np.radians([0, 45, 90]))))
    for interface in (mirror(DOUBLE, *alphas), glass(DOUBLE, 1.5, *alphas)):
        found = total(interface, w, accuracy=4e-3)
        assert found.max() < 1.06 and found.min() > 0.7


@pytest.mark.parametrize(
    "eta", [1.5, *(pytest.param(eta, marks=pytest.mark.slow) for eta in (1.05, 1.2, 3.0))]
)
@pytest.mark.parametrize(
    "alphas", [(0.5, 0.05), pytest.param((1.0, 0.1), marks=pytest.mark.slow), (0.2, 0.6)]
)
def test_brushed_glass_is_clear(alphas: tuple[float, float], eta: float) -> None:
    """At corners that `test_compensated_scan` may miss."""
    w = direction(
        *(
            grid.ravel()
            for grid in np.meshgrid((0.003, 0.02, 0.1, 0.4, 0.8, 1.0), np.radians([0, 20, 25, 50, 75, 90]))
        )
    )
    for above in (True, False):
        found = total(glass(DOUBLE, eta, *alphas), w, above, accuracy=2e-3)
        assert np.abs(found - 1).max() < 1e-2


def test_glass_on_average() -> None:
    """Over the hemisphere nothing is lost but what the tables round, and n1^2 T12 = n2^2 T21."""
    for alpha in (0.1, 0.8):
        interface = glass(DOUBLE, 1.5, alpha)
        one, other = (hemispherical(interface, above, accuracy=5e-4) for above in (True, False))
        for found in (one, other):
            assert found.reflectance + found.transmittance == pytest.approx(1, abs=1e-3)
        assert other.transmittance * 1.5**2 == pytest.approx(one.transmittance, abs=1.5e-3)


# --- the tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("masking", "alpha"), REFLECTED)
def test_tables_against_printed_numbers(masking: str, alpha: float) -> None:
    interface = mirror(SINGLE, alpha, masking=masking)
    w = SINGLE.vectors(direction(np.array(COSINES)))
    expected = np.array(REFLECTED[masking, alpha])
    assert np.allclose(1 - back(interface.missing(w, True)), expected[:6], atol=1e-3)
    assert 1 - back(interface.missing.mean(True)) == pytest.approx(expected[6], abs=1e-3)


def test_nodes_lie_where_their_coordinates_say() -> None:
    for alpha in (1e-4, 0.03, 1.0):
        found = back(tables.of_cosine(DOUBLE(tables.cosines(alpha, 9)), alpha))
        assert np.allclose(found, np.linspace(0, 1, 9), atol=1e-6)
    assert np.allclose(back(tables.of_index(DOUBLE(tables.indices(9)))), np.linspace(0, 1, 9), atol=1e-6)
    assert np.allclose(
        back(tables.of_roughness(DOUBLE(tables.roughnesses(9)))), np.linspace(0, 1, 9), atol=1.1e-2
    )
    for alpha in (0.01, 0.2, 1.0):
        found = back(tables.of_bend(DOUBLE(tables.bends(alpha)), alpha))
        cells = tables.DENSE + tables.THIN
        middle = (np.arange(tables.HALVED) + 0.5) / cells
        assert np.allclose(found, np.sort(np.append(middle, np.linspace(0, 1, cells + 1))), atol=1e-5)
    found = back(tables.of_brushed_roughness(DOUBLE(tables.brushed_roughnesses(9))))
    assert np.allclose(found, np.linspace(0, 1, 9), atol=3e-3)
    ratios = DOUBLE(tables.ratios(9))
    assert np.allclose(back(tables.of_ratio(ratios, DOUBLE(1))), np.linspace(0, 1, 9), atol=1e-6)


def test_tables_are_what_their_tool_makes(tool: Tool, rng: np.random.Generator) -> None:
    """A few nodes of each, anew."""
    maker = tool("make_energy_tables")
    for kind, axes in maker.AXES.items():
        named = axes()
        arrays = np.broadcast_arrays(*named.values())
        at = tuple(rng.integers(0, n, 24) for n in arrays[0].shape)
        chosen = {name: array[at] for name, array in zip(named, arrays, strict=True)}
        for distribution in ("ggx", "beckmann"):
            found = maker.missing(distribution, 21, **chosen)
            for masking, lost in found.items():
                table = tables.energies(kind, f"{distribution}_{masking}")
                assert table.shape == arrays[0].shape
                # Half a step of the integers, and the error of the lattice.
                brushed = kind.startswith("brushed")
                assert np.allclose(table[at], np.maximum(lost, 0), atol=5e-3 if brushed else 8e-4)


#: every model, one of them quickly
SHIPPED = [pytest.param(*m, marks=() if m == MODELS[0] else pytest.mark.slow) for m in MODELS]


@pytest.mark.parametrize(("distribution", "masking"), SHIPPED)
def test_means_and_shares_are_what_their_tool_makes(
    distribution: str, masking: str, tool: Tool, rng: np.random.Generator
) -> None:
    """The same random numbers make them: what differs is the rounding of the file, 5e-4 of a mean, and of machines."""
    maker, model = tool("make_energy_tables"), (distribution, masking)
    with np.load(tables.DATA / "brushed_means.npz") as file:
        means = file["_".join(model)]
    roughness, ratio = tables.brushed_roughnesses(means.shape[2]), tables.ratios(means.shape[3])
    for j, k in zip(rng.integers(1, len(roughness), 4), rng.integers(0, len(ratio), 4), strict=True):
        found = maker.brushed_mean(model, float(roughness[j]), float(ratio[k]))
        assert np.allclose(means[..., j, k], found, rtol=1e-3, atol=1e-5)
    shares = tables.shares("_".join(model))
    indices = tables.indices(2 * tables.SHARE_INDICES - 1)[tables.SHARE_INDICES - 1 :]
    roughness = tables.roughnesses(tables.SHARE_ROUGHNESSES)
    for i, j in zip(rng.integers(1, len(indices), 4), rng.integers(1, len(roughness), 4), strict=True):
        share = maker.share(model, float(roughness[j]), float(indices[i]))
        assert shares[i, j] == pytest.approx(min(share, 1), abs=2e-3)


def test_the_mean_of_a_metal() -> None:
    """Four nodes, against many; for the metals that have names."""
    from test_fresnel import complex_fresnel
    from urushi.optics.ior import conductor_names, conductor_rgb

    nodes, weights = np.polynomial.legendre.leggauss(200)
    cos = 0.5 * (nodes + 1)
    for name in conductor_names():
        for eta, k in zip(*conductor_rgb(name), strict=True):
            if name == "none" or eta * eta + k * k < 1:
                continue
            exact = np.sum(weights * cos * complex_fresnel(cos, eta, k))
            found = np.dot(MEAN_WEIGHTS, complex_fresnel(np.array(MEAN_COSINES), eta, k))
            assert found == pytest.approx(exact, abs=1e-3), name
