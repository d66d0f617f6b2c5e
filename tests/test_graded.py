"""Media whose albedo varies with depth: the description, the limit of many slabs, both sides, who can solve them."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from mitsuba_plugin import Asked, layered
from outside import degrees
from urushi.adapters import native
from urushi.checks.energy import lossless
from urushi.solvers.adding.graded import Piece

pytestmark = needs_llvm

FORWARD = ur.HenyeyGreenstein(g=0.6)
UNEVEN = (0.95, 0.6, 0.9)
NODES = 12
WI = np.concatenate([degrees(0), degrees(45), degrees(70), degrees(110), degrees(150)])
WO = np.concatenate([degrees(30), degrees(45, 180), degrees(120, 60), degrees(20), degrees(140, 90)])


def pane(*media: ur.Medium | ur.GradedMedium, above: float = 1.0, below: float = 1.0) -> ur.Stack:
    return ur.Stack(layers=[ur.Dielectric(ior=1.5), *media, ur.Dielectric(ior=below)], exterior=above)


def slabs(count: int, albedo=UNEVEN, depth: float = 2.0, phase=FORWARD) -> list[ur.Medium]:
    """As many homogeneous slabs, each of the albedo in its middle."""
    middles = np.interp((np.arange(count) + 0.5) / count, np.linspace(0, 1, len(albedo)), albedo)
    return [ur.Medium(depth=depth / count, albedo=float(a), phase=phase) for a in middles]


def values(stack: ur.Stack, **options) -> np.ndarray:
    bsdf = ur.solve(stack, "adding", **({"nodes": NODES, "accuracy": 1e-5} | options))
    return np.hstack([bsdf.reflectance(WI), bsdf.transmittance(WI), bsdf.eval(WI, WO)])


# ---------------------------------------------------------------------------------- the description


def test_it_is_a_description_like_others(tmp_path):
    layer = ur.GradedMedium(depth=2, albedo=np.array(UNEVEN), phase=FORWARD)
    assert eval(repr(layer), vars(ur)) == layer == layer.model_copy() != ur.GradedMedium(2.0, UNEVEN)
    assert layer.mean_albedo == pytest.approx((0.775 + 0.75) / 2)
    stack = pane(layer)
    ur.save(stack, tmp_path / "pane.yaml")
    assert ur.load(tmp_path / "pane.yaml") == stack
    assert "albedo: [0.95, 0.6, 0.9]" in (tmp_path / "pane.yaml").read_text()
    assert "graded" in stack.describe() and "albedo 0.95 0.6 0.9" in stack.describe()
    assert stack.replace({"layer_1.albedo": (0.1, 0.2)}).layers[1].albedo == (0.1, 0.2)
    assert list(stack.parameters()) == [
        name
        for name in pane(ur.Medium(depth=1, albedo=0, phase=FORWARD)).parameters()
        if "albedo" not in name
    ]
    assert "polygon" in ur.Stack(layers=[ur.GradedMedium(depth=2.0, albedo=(0.2, 0.9))])._repr_html_()


@pytest.mark.parametrize(
    ("given", "where", "said"),
    [
        ({"albedo": 0.5}, "albedo", "varies nowhere: that is a medium"),
        ({"albedo": [0.5]}, "albedo", "which has 1 values; allowed: a list of 2 to 64 numbers from 0 to 1"),
        ({"albedo": [0.5] * 65}, "albedo", "which has 65 values"),
        ({"albedo": [0.5, 1.5]}, "albedo[1]", "found 1.5"),
        ({"albedo": [0.5, float("nan")]}, "albedo[1]", "not finite"),
        ({"albedo": [0.5, "x"]}, "albedo[1]", "found 'x'"),
        ({"depth": 101}, "depth", "0 to 100"),
        ({"depth": (1, 1, 2)}, "depth", "one depth serves every colour"),
        ({"albdo": [0, 1]}, "albdo", "did you mean 'albedo'?"),
    ],
)
def test_what_is_refused(given, where, said):
    with pytest.raises(ur.MaterialError) as caught:
        ur.GradedMedium(**({"depth": 1.0, "albedo": UNEVEN} | given))
    assert caught.value.where == where and said in str(caught.value)


# ------------------------------------------------------------------------------------- the solution


def test_many_slabs_approach_it_with_the_square_of_their_depth():
    stack = pane(ur.GradedMedium(depth=2.0, albedo=UNEVEN, phase=FORWARD))
    fluxes = values(stack)[:, :6]
    errors = [np.abs(values(pane(*slabs(count)))[:, :6] - fluxes).max() for count in (8, 16, 32)]
    assert 1e-4 < errors[0] < 1e-3 and errors[2] < 2e-5
    assert 3 < errors[0] / errors[1] < 6 and 3 < errors[1] / errors[2] < 6
    # Their closed forms differ, so that values agree as far as the nodes go.
    best = values(pane(*slabs(32)), nodes=24)[:, 6:]
    np.testing.assert_allclose(values(stack, nodes=24)[:, 6:], best, atol=1e-5)


def test_what_is_scattered_once_leaves_the_rest_smooth():
    """With the mean albedo: few nodes do, and the values are those of many nodes."""
    stack = ur.Stack(layers=[ur.GradedMedium(depth=2.0, albedo=UNEVEN, phase=FORWARD)])
    few, many = (ur.solve(stack, "adding", nodes=n, accuracy=1e-5) for n in (24, 40))
    assert few.diagnostics["closed_form"] == "single"
    value, best = few.eval(WI, WO), many.eval(WI, WO)
    np.testing.assert_allclose(value, best, atol=1e-3 * best.max())


def test_alone_it_has_all_orders_of_what_is_scattered_once():
    """What is scattered once is taken out with the mean albedo, and what is left of it has as many orders."""
    graded = ur.GradedMedium(depth=1.0, albedo=(0.9, 0.5), phase=FORWARD)
    plain = slabs(32, (0.9, 0.5), 1.0)
    found, expected = (values(ur.Stack(layers=layers), nodes=16) for layers in ([graded], plain))
    np.testing.assert_allclose(found[:, :6], expected[:, :6], atol=1e-4)
    bsdf, slices = (
        ur.solve(ur.Stack(layers=layers), "adding", nodes=16, accuracy=1e-5, orders=500)
        for layers in ([graded], plain)
    )
    assert bsdf.diagnostics["orders"] == slices.diagnostics["orders"] >= 10
    for order in range(0, 24, 3):
        one, other = (b.matrices.operator(order) for b in (bsdf, slices))
        steep = np.s_[:, :10, :10]  # light that grazes sees only the first of the slabs
        np.testing.assert_allclose(one[steep], other[steep], atol=2e-3 * other[steep].max())


def test_a_peak_that_the_nodes_do_not_resolve():
    """Its light counts as not scattered, more of it where the albedo is higher: slabs do so each by itself."""
    sharp = ur.HenyeyGreenstein(g=0.9)
    grading, few = (0.0, 1.0, 0.5), {"nodes": 6}
    found = values(pane(ur.GradedMedium(depth=1.5, albedo=grading, phase=sharp)), **few)
    slices = values(pane(*slabs(32, grading, 1.5, sharp)), **few)
    np.testing.assert_allclose(found[:, :6], slices[:, :6], atol=5e-5)
    forward, exact = 0.3, Piece(2.0, 0.2, 0.9, 0.3)
    s = np.linspace(0, 1, 10_001)
    scaled = np.concatenate([[0], np.cumsum(np.diff(s) * (1 - forward * (0.2 + 0.7 * (s[1:] + s[:-1]) / 2)))])
    assert exact.scaled == pytest.approx(2 * scaled[-1], rel=1e-12)
    for k in (0, 2500, 7000, 10_000):
        here = 0.2 + 0.7 * s[k]
        expected = here * (1 - forward) / (1 - here * forward)
        assert exact.albedo(scaled[k] / scaled[-1])[0] == pytest.approx(expected, rel=1e-9)


def test_upside_down_it_is_seen_from_the_other_side():
    """The stack turned over, lit from above, does what the stack does, lit from below."""
    layer = ur.GradedMedium(depth=2.0, albedo=UNEVEN, phase=FORWARD)
    turned = ur.GradedMedium(depth=2.0, albedo=UNEVEN[::-1], phase=FORWARD)
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5), layer, ur.Dielectric(ior=1.2)])
    other = ur.Stack(layers=[ur.Dielectric(ior=1.5), turned, ur.Dielectric(ior=1.0)], exterior=1.2)
    one, two = (ur.solve(s, "adding", nodes=NODES, accuracy=1e-5) for s in (stack, other))
    flip = np.array([1, 1, -1])
    np.testing.assert_allclose(one.reflectance(WI), two.reflectance(WI * flip), atol=1e-6)
    np.testing.assert_allclose(one.transmittance(WI), two.transmittance(WI * flip), atol=1e-6)
    np.testing.assert_allclose(one.eval(WI, WO), two.eval(WI * flip, WO * flip), atol=1e-6)
    assert np.abs(one.reflectance(degrees(0)) - one.reflectance(degrees(180))).max() > 1e-3


def test_an_even_one_is_a_medium():
    even = ur.GradedMedium(depth=1.5, albedo=(0.8, 0.8, 0.8), phase=FORWARD)
    plain = ur.Medium(depth=1.5, albedo=0.8, phase=FORWARD)
    np.testing.assert_allclose(values(pane(even)), values(pane(plain)), atol=1e-9)
    clear, dark = ur.GradedMedium(0.0, (0.1, 0.9)), ur.GradedMedium(1.5, (0.0, 0.0))
    nothing, black = ur.Medium(depth=0.0, albedo=0.5), ur.Medium(depth=1.5, albedo=0.0)
    for graded, medium in ((clear, nothing), (dark, black)):
        np.testing.assert_allclose(values(pane(graded)), values(pane(medium)), atol=1e-12)


def test_nothing_is_lost_where_nothing_absorbs():
    """Of an albedo of 1 at both ends only; otherwise the ledger says where the rest went."""
    stack = pane(ur.GradedMedium(depth=3.0, albedo=(1.0, 0.7, 1.0)))
    bsdf = ur.solve(stack, "adding", nodes=NODES, accuracy=1e-6)
    ledger = bsdf.absorption(WI)
    total = ledger.reflected + ledger.transmitted + ledger.absorbed.sum(axis=0) + ledger.lost.sum(axis=0)
    np.testing.assert_allclose(total, 1, atol=1e-6)
    assert ledger.absorbed[1].min() > 0.05 and np.abs(ledger.absorbed[[0, 2]]).max() < 1e-6


def test_beside_colours_and_under_rough_faces():
    """A base with colours below it, and many channels given beside the description."""
    base = ur.Diffuse(reflectance=(0.8, 0.5, 0.2))
    graded = ur.GradedMedium(depth=1.0, albedo=(0.9, 0.5))
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.4), graded, base])
    red = ur.solve(stack, "adding", nodes=NODES).reflectance(degrees(30))[0]
    five = {"layer_2.reflectance": [0.8, 0.7, 0.5, 0.3, 0.2]}
    many = ur.solve(
        stack.replace({"layer_2.reflectance": 0.5}), "adding", nodes=NODES, parameters=five
    ).reflectance(degrees(30))[0]
    np.testing.assert_allclose(many[[0, 2, 4]], red, rtol=1e-9)
    assert red[0] > red[1] > red[2]


def test_what_cannot_absorb_is_known_to():
    for albedo, depth, known in (((1, 1), 1, "smooth"), ((1, 0.9), 1, ""), ((0, 1), 0, "smooth")):
        assert lossless(pane(ur.GradedMedium(depth=depth, albedo=albedo))) == known


# ---------------------------------------------------------------------------------- who can solve it


def test_adding_alone_solves_it():
    stack = pane(ur.GradedMedium(depth=1.0, albedo=UNEVEN))
    for method in ("walk", "lobes"):
        with pytest.raises(ur.UnsupportedStack, match=r"layers\[1\] is a graded medium.*that can: adding"):
            ur.solve(stack, method)
    bsdf = ur.solve(stack, accuracy=0.05)
    assert bsdf.diagnostics["auto"]["method"] == "adding"


def test_a_file_of_its_solution(tmp_path):
    bsdf = ur.solve(pane(ur.GradedMedium(depth=1.0, albedo=UNEVEN)), "adding", nodes=NODES)
    native.save(bsdf, tmp_path / "pane.urushi.npz")
    again = native.load(tmp_path / "pane.urushi.npz")
    assert again.stack == bsdf.stack
    np.testing.assert_allclose(again.reflectance(WI), bsdf.reflectance(WI), atol=1e-3)


def test_the_plugin(mi, tmp_path):
    stack = pane(ur.GradedMedium(depth=1.0, albedo=UNEVEN, phase=FORWARD))
    ur.save(stack, tmp_path / "pane.yaml")
    plugin = layered(mi, filename=str(tmp_path / "pane.yaml"), method="adding", nodes=NODES)
    expected = ur.solve(stack, "adding", nodes=NODES).eval(WI, WO)
    np.testing.assert_allclose(Asked.of(mi, plugin, WI).value(WO), expected, rtol=2e-3, atol=2e-5)
    assert "graded henyey_greenstein" in str(plugin) and "layer_1.depth" in mi.traverse(plugin)
    with pytest.raises(Exception, match="graded medium"):
        layered(mi, filename=str(tmp_path / "pane.yaml"))
