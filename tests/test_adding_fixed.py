"""What the user of adding may fix: the number of azimuthal orders, and how media are solved."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from mitsuba_plugin import Asked, layered
from outside import degrees
from urushi.errors import UrushiError

pytestmark = needs_llvm

COLOURED = ur.Medium(depth=(0.5, 3.0, 0.0), albedo=(0.9, 1.0, 0.5), phase=ur.HenyeyGreenstein(g=0.4))
METAL = ur.Stack(layers=[ur.Dielectric(ior=1.5), COLOURED, ur.Conductor(material="Au", alpha=0.4)])
SLAB = ur.Stack(layers=[ur.Dielectric(ior=1.5), COLOURED, ur.Dielectric(ior=1.0)])
BASE = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Conductor(material="Au", alpha=0.4)])
WI = degrees(40)
AROUND = np.arange(64) * (360 / 64)


def round_the_normal(bsdf, theta: float = 60.0) -> np.ndarray:
    """(64, C) values at equal steps of the azimuth: their mean is that of the first 64 orders."""
    wo = np.concatenate([degrees(theta, phi) for phi in AROUND])
    return bsdf.eval(np.repeat(WI, len(wo), axis=0), wo)


@pytest.fixture(scope="module")
def whole():
    return ur.solve(BASE, "adding", nodes=16, accuracy=1e-4)


def test_one_order_is_the_mean_over_the_azimuth(whole):
    """Behind a smooth interface, a rough metal has no closed form: one order alone is the same all around."""
    one = ur.solve(BASE, "adding", nodes=16, accuracy=1e-4, orders=1)
    assert one.diagnostics["orders"] == one.diagnostics["fixed_orders"] == 1 < whole.diagnostics["orders"]
    np.testing.assert_allclose(one.reflectance(WI), whole.reflectance(WI), atol=1e-12)
    found, expected = round_the_normal(one), round_the_normal(whole)
    assert np.ptp(expected, axis=0).min() > 0.02
    assert np.ptp(found, axis=0).max() < 1e-9
    np.testing.assert_allclose(found[0], expected.mean(axis=0), rtol=2e-3)


def test_what_has_a_closed_form_keeps_all_orders():
    one, every = (ur.solve(METAL, "adding", nodes=12, orders=n) for n in (1, None))
    found, expected = round_the_normal(one), round_the_normal(every)
    assert np.ptp(found, axis=0)[0] > 1e-4  # light that the medium scattered once
    np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), rtol=2e-3)


def test_orders_left_out_are_told(whole):
    """The error that is told is what the values are off by; with all orders there is none."""
    errors = []
    for orders in (1, 3, 9):
        few = ur.solve(BASE, "adding", nodes=16, accuracy=1e-4, orders=orders)
        said = few.diagnostics
        assert said["orders"] == orders and said["estimated_error"] >= said["left_out"]
        value, best = (np.concatenate([round_the_normal(b, t) for t in (40.0, 60.0)]) for b in (few, whole))
        assert np.max(np.abs(value - best) / best.max()) < 1.5 * said["left_out"]
        errors.append(said["left_out"])
    assert errors[0] > 4 * errors[1] > 16 * errors[2] > 0
    every = ur.solve(BASE, "adding", nodes=16, accuracy=1e-4, orders=500).diagnostics
    assert whole.diagnostics["orders"] <= every["orders"] < 500 and every["left_out"] == 0


def test_orders_are_fixed_while_nodes_are_chosen():
    """Nodes are added until the orders there are do not change any more."""
    found = ur.solve(BASE, "adding", accuracy=5e-3, orders=2)
    said = found.diagnostics
    assert said["orders"] == 2 and said["history"][-1][1] <= 5e-3 < said["left_out"]


@pytest.mark.parametrize("orders", [0, -3, 2.5, "4", True, 16385])
def test_numbers_of_orders_that_are_refused(orders):
    with pytest.raises(
        UrushiError, match=f"orders: found {orders!r}; allowed: a whole number from 1 to 16384"
    ):
        ur.solve(BASE, "adding", orders=orders)


def test_the_plugin_takes_orders(mi, tmp_path):
    ur.save(BASE, tmp_path / "base.yaml")
    few, every = (
        layered(mi, filename=str(tmp_path / "base.yaml"), method="adding", nodes=12, orders=n) for n in (1, 0)
    )
    wi = np.repeat(WI, 64, axis=0)
    wo = np.concatenate([degrees(60, phi) for phi in AROUND])
    found, expected = (Asked.of(mi, plugin, wi).value(wo) for plugin in (few, every))
    assert np.ptp(found, axis=0).max() < 1e-5 < 0.02 < np.ptp(expected, axis=0).min()


# ---------------------------------------------------------------------------------------- media


@pytest.mark.parametrize("stack", [SLAB, METAL], ids=["slab", "metal"])
def test_media_are_the_same_however_they_are_solved(stack, monkeypatch):
    from urushi.solvers.adding import doubling, ordinates, riccati

    asked = []

    def spied(module, own):
        def solve(*args):
            asked.append(module.__name__.rpartition(".")[2])
            return own(*args)

        return solve

    for module, name in ((ordinates, "solve"), (doubling, "solve"), (riccati, "homogeneous")):
        monkeypatch.setattr(module, name, spied(module, getattr(module, name)))
    wi = np.concatenate([degrees(0), degrees(50), degrees(80)])
    wo = np.concatenate([degrees(20), degrees(50, 180), degrees(75, 60)])
    values = {}
    for media in ("ordinates", "doubling", "riccati", None):
        asked.clear()
        bsdf = ur.solve(stack, "adding", nodes=10, media=media)
        assert set(asked) == {media or "ordinates"}
        values[media] = np.concatenate(
            [
                bsdf.reflectance(wi),
                np.zeros((3, 3)) if stack is METAL else bsdf.transmittance(wi),
                bsdf.eval(wi, wo),
            ]
        )
    assert values["ordinates"].min(axis=0).max() < 0.5 < values["ordinates"].max()
    np.testing.assert_array_equal(values[None], values["ordinates"])
    for media in ("doubling", "riccati"):
        np.testing.assert_allclose(values[media], values["ordinates"], atol=1e-6)


def test_a_colour_that_meets_no_medium_passes_the_slab():
    """Between the faces of a clear sheet stays what never got in; that another colour is scattered there is its own."""
    found = ur.solve(SLAB, "adding", nodes=10).reflectance(degrees(0))[0]
    assert found[2] == pytest.approx(2 * 0.04 / 1.04, abs=1e-9) and found[1] > 0.3


def test_an_unknown_way_of_solving_media_is_refused():
    with pytest.raises(UrushiError, match=r"media: found 'dubling'; did you mean 'doubling'\? allowed: "):
        ur.solve(SLAB, "adding", media="dubling")
    with pytest.raises(UrushiError, match=r"media: found 3; allowed: ordinates, doubling, riccati$"):
        ur.solve(SLAB, "adding", media=3)


def test_the_plugin_takes_media(mi, tmp_path, monkeypatch):
    from urushi.solvers.adding import doubling

    asked = []
    own = doubling.solve
    monkeypatch.setattr(doubling, "solve", lambda *args: asked.append(args) or own(*args))
    ur.save(SLAB, tmp_path / "slab.yaml")
    options = {"filename": str(tmp_path / "slab.yaml"), "method": "adding", "nodes": 9}
    layered(mi, **options)
    assert not asked
    layered(mi, **options, media="doubling")
    assert asked  # and nothing that was solved otherwise was taken for it
    with pytest.raises(Exception, match=r"layered\.media: found 'dubling'; did you mean 'doubling'"):
        layered(mi, **options, media="dubling")
    with pytest.raises(Exception, match=r"layered\.media: is no option of method 'walk'"):
        layered(mi, filename=options["filename"], media="doubling")
