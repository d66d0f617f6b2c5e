"""Stacks solved by adding in the Fourier format: a reader of the table finds what the solution says."""

from __future__ import annotations

import re

import numpy as np
import pytest

import urushi as ur
from outside import DATA, degrees
from urushi.adapters import fourier, native
from urushi.adapters.fourier import export
from urushi.adapters.fourier.export import difference, fourier_of
from urushi.errors import UrushiError

COATED = ur.Stack(
    name="coated",
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.1, distribution="beckmann", masking="separable"),
        ur.Diffuse(reflectance=0.5),
    ],
)
OPEN = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.3, alpha=0.5),
        ur.Medium(depth=0.5, albedo=[0.9, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.3)),
        ur.Dielectric(ior=1.2, alpha=0.5),
    ]
)


@pytest.fixture(scope="module")
def coated():
    return ur.solve(COATED, "adding", accuracy=1e-3)


@pytest.fixture(scope="module")
def table(coated):
    return fourier_of(coated, accuracy=2e-3)


def test_a_reader_finds_what_the_solution_says(coated, table, tmp_path, rng):
    found, error = table
    assert error <= 2e-3 and difference(coated, found) == error
    fourier.write_fourier(found, tmp_path / "coated.bsdf")
    read = fourier.read_fourier(tmp_path / "coated.bsdf")
    wi, wo = (
        degrees(*rng.uniform(0, [[80], [360]], (2, 500))),
        degrees(*rng.uniform(0, [[80], [360]], (2, 500))),
    )
    apart = np.abs(fourier.evaluate(read, wi, wo) - coated.eval(wi, wo)[:, :1])
    _, expected = coated.eval(wi, wo, with_error=True)
    peak = coated.eval(wi, wi * [-1, -1, 1])[:, :1] + expected[:, :1] / coated.diagnostics["estimated_error"]
    assert (apart <= 4e-3 * peak).all()
    up, _ = fourier.reflectance(read, degrees([5, 30, 60]))
    assert np.abs(up - coated.reflectance(degrees([5, 30, 60]))[:, :1]).max() < 5e-3


def test_the_native_file_is_five_times_smaller(coated, table, tmp_path):
    """In truth a hundred times; layerlab's own file of this stack has 1.42 MB."""
    fourier.write_fourier(table[0], tmp_path / "a.bsdf")
    size = native.save(coated, tmp_path / "a.urushi.npz")
    assert 50 * size < (tmp_path / "a.bsdf").stat().st_size < 1.42e6
    assert 50 * size < (DATA / "layerlab_coated_diffuse.bsdf").stat().st_size


def test_both_sides_and_colours():
    """Other indices above and below: radiance that passes is scaled by the reader as by the solution."""
    bsdf = ur.solve(OPEN, "adding", nodes=16)
    found, error = fourier_of(bsdf, nodes=40, accuracy=1e-2)
    assert found.channels == 3 and found.eta == pytest.approx(1.2)
    # What is left is between the nodes of the solution, which are few; a wrong index would be off by 0.3.
    assert error < 6e-2 < fourier_of(bsdf, nodes=8, accuracy=1e-2)[1]


def test_light_in_one_direction_is_refused_or_left_out_on_request(tmp_path):
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Diffuse(reflectance=0.5)])
    bsdf = ur.solve(stack, "adding", nodes=12)
    with pytest.raises(UrushiError, match="one direction"):
        fourier_of(bsdf, nodes=20)
    found, error = fourier_of(bsdf, nodes=48, accuracy=1e-2, delta="omit")
    assert error < 1e-2
    up, _ = fourier.reflectance(found, degrees([20]))
    fresnel = 0.04
    assert up[0, 0] == pytest.approx(bsdf.reflectance(degrees([20]))[0, 0] - fresnel, abs=5e-3)


def test_a_table_too_large_for_memory_is_refused(coated, monkeypatch):
    monkeypatch.setattr(export, "_ROOM", 1 << 16)
    with pytest.raises(UrushiError, match="allowed: 65536"):
        fourier_of(coated, nodes=60)


@pytest.mark.parametrize("options", [{"accuracy": 0}, {"nodes": 3}, {"delta": "drop"}])
def test_options_out_of_range_are_refused(coated, options):
    with pytest.raises(UrushiError, match=re.compile("allowed")):
        fourier_of(coated, **options)


def test_layerlab_finds_the_same(table):
    """Its own file of this stack; it scales energies of its columns up, by 0.4 %, and more at grazing angles."""
    theirs = fourier.read_fourier(DATA / "layerlab_coated_diffuse.bsdf")
    for theta in (10, 30, 60):
        wi, wo = degrees([theta] * 4), degrees([theta, 20, 50, 70], [180, 180, 90, 0])
        found, other = (fourier.evaluate(one, wi, wo) for one in (table[0], theirs))
        assert np.abs(found - other).max() < 1e-3 * other.max() + 5e-4
        assert fourier.reflectance(table[0], wi)[0] == pytest.approx(
            fourier.reflectance(theirs, wi)[0], rel=5e-3
        )
