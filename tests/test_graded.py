"""Media that vary with depth: the description, the limit of many slabs, both sides, adding and the walk."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from mitsuba_plugin import Asked, layered
from outside import degrees
from urushi.adapters import native
from urushi.checks.energy import lossless
from urushi.solvers.adding import phase
from urushi.solvers.adding.delta_m import Truncated
from urushi.solvers.adding.graded import Piece
from urushi.solvers.adding.mixture import Mixture

pytestmark = needs_llvm

FORWARD = ur.HenyeyGreenstein(g=0.6)
KINDS = (ur.HenyeyGreenstein(g=0.8), ur.Rayleigh(), ur.HenyeyGreenstein(g=-0.4))
KNOTS = (0.0, 0.3, 1.0)
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


def test_phase_functions_by_depth_are_written_and_read(tmp_path):
    layer = ur.GradedMedium(2.0, 0.9, KINDS, KNOTS)
    assert eval(repr(layer), vars(ur)) == layer != ur.GradedMedium(2.0, 0.9, KINDS)
    stack = pane(layer)
    for name in ("pane.yaml", "pane.json"):
        ur.save(stack, tmp_path / name)
        assert ur.load(tmp_path / name) == stack
    written = (tmp_path / "pane.yaml").read_text()
    assert "phase: [henyey_greenstein: {g: 0.8}, rayleigh," in written.replace("[{", "[").replace("}}", "}")
    assert "at: [0.0, 0.3, 1.0]" in written and "albedo: 0.9" in written
    assert "henyey greenstein (g 0.8), rayleigh, henyey greenstein (g -0.4), at 0 0.3 1" in stack.describe()
    assert "layer_1.depth" in stack.parameters() and not any("phase" in name for name in stack.parameters())
    assert stack.replace({"layer_1.albedo": (0.1, 0.2, 0.3)}).layers[1].mean_albedo == pytest.approx(0.22)
    assert [albedos for _, albedos in layer.scatterers] == [(0.9, 0, 0), (0, 0.9, 0), (0, 0, 0.9)]
    np.testing.assert_allclose(layer.shares, [0.15, 0.5, 0.35])
    assert ur.GradedMedium(1.0, (0, 0), KINDS[:2]).shares == [0.5, 0.5]
    assert ur.GradedMedium(1.0, 1.0, KINDS, (0.0, 0.1, 1.0)).mean_albedo <= 1


def test_where_a_file_is_wrong_is_said(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(
        "urushi: 1\nlayers:\n  - graded:\n      depth: 1\n      albedo: 0.5\n      phase:\n"
        "        - isotropic\n        - henyey_greenstein: {g: 2}\n"
    )
    with pytest.raises(ur.MaterialError, match=r"wrong\.yaml: layers\[0\]\.phase\[1\]\.g: found 2.*line 8"):
        ur.load(path)


@pytest.mark.parametrize(
    ("given", "where", "said"),
    [
        ({"albedo": 0.5}, "albedo", "vary nowhere: that is a medium"),
        (
            {"albedo": [0.5]},
            "albedo",
            "which has 1 values; allowed: a number from 0 to 1 or a list of 2 to 64 such",
        ),
        ({"albedo": 1.5, "phase": KINDS}, "albedo", "found 1.5"),
        ({"phase": KINDS[:2]}, "phase", "found 2 values, where albedo has 3; allowed: as many"),
        ({"phase": KINDS[:1]}, "phase", "which has 1 of them"),
        ({"phase": ["isotropic", "raylei", "isotropic"]}, "phase[1]", "did you mean 'rayleigh'?"),
        ({"phase": [*KINDS[:2], ur.HenyeyGreenstein(g=ur.Texture("g.png"))]}, "phase[2].g", "a number"),
        ({"albedo": 0.5, "phase": KINDS, "at": [0, 1]}, "at", "found 2 values, where phase has 3"),
        ({"at": [0, 0.5, 0.9]}, "at[2]", "found 0.9; allowed: a list of 2 to 64 numbers from 0 to 1"),
        ({"at": [0.1, 0.5, 1]}, "at[0]", "the first 0"),
        ({"at": [0, 0.5, 0.5]}, "at[2]", "found 0.5, after 0.5"),
        ({"at": [0, 0.7, 0.5]}, "at[2]", "found 0.5, after 0.7"),
        ({"at": 0.5}, "at", "found 0.5; allowed: a list"),
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


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [False, True])
def test_values_of_many_slabs(kinds):
    """Their closed forms differ, so that values agree as far as the nodes go."""
    layer = GRAINS if kinds else ur.GradedMedium(depth=2.0, albedo=UNEVEN, phase=FORWARD)
    best = values(pane(*(grains(16) if kinds else slabs(32))), nodes=24)[:, 6:]
    np.testing.assert_allclose(values(pane(layer), nodes=24)[:, 6:], best, atol=2e-4 if kinds else 1e-5)


def grains(count: int, kind=FORWARD) -> list[ur.Medium]:
    """The same as `GRAINS` in slabs: what is of one kind at the top gives way to another at the bottom."""
    found = []
    for k in range(count):
        thin, share = 2.0 / count, (k + 0.5) / count
        first = ur.Medium(depth=0.5 * thin * (1 - share), albedo=0.9, phase=kind)
        found += [first, ur.Medium(depth=thin * share, albedo=0.9, phase=ur.Rayleigh()), first]
    return found


GRAINS = ur.GradedMedium(depth=2.0, albedo=0.9, phase=(FORWARD, ur.Rayleigh()))


def test_grains_of_two_kinds_approach_it_with_the_square_of_their_depth():
    """A kind that settles: its share of all grains, which are equally bright, grows with the depth."""
    options = {"accuracy": 1e-4}
    fluxes = values(pane(GRAINS), **options)[:, :6]
    errors = [np.abs(values(pane(*grains(n)), **options)[:, :6] - fluxes).max() for n in (4, 8, 16)]
    assert 3e-4 < errors[0] < 3e-3 and errors[2] < 2e-4
    assert 3 < errors[0] / errors[1] < 6 and 3 < errors[1] / errors[2] < 6


def test_values_between_two_others_say_nothing_new():
    """On the line between its neighbours a height is superfluous, at the albedos' and at the phase functions' ends."""
    plain = ur.GradedMedium(depth=2.0, albedo=(0.9, 0.5), phase=FORWARD)
    told = ur.GradedMedium(depth=2.0, albedo=(0.9, 0.8, 0.5), phase=FORWARD, at=(0.0, 0.25, 1.0))
    np.testing.assert_allclose(values(pane(told)), values(pane(plain)), atol=2e-7)
    turn = ur.GradedMedium(2.0, (0.8, 0.8, 0.8), (FORWARD, FORWARD, ur.Rayleigh()), (0.0, 0.5, 1.0))
    apart = [
        ur.Medium(depth=1.0, albedo=0.8, phase=FORWARD),
        ur.GradedMedium(1.0, 0.8, (FORWARD, ur.Rayleigh())),
    ]
    fluxes = slice(0, 6)  # the closed forms differ
    np.testing.assert_allclose(values(pane(turn))[:, fluxes], values(pane(*apart))[:, fluxes], atol=2e-7)


def test_peaks_of_several_phase_functions():
    """Where few nodes cut two series, each loses its own share of the light to the peak: as in slabs."""
    sharp = ur.HenyeyGreenstein(g=0.9)
    found = values(pane(ur.GradedMedium(2.0, 0.9, (sharp, ur.Rayleigh()))), nodes=6)[:, :6]
    np.testing.assert_allclose(found, values(pane(*grains(16, sharp)), nodes=6)[:, :6], atol=2e-4)
    made = Mixture(
        [phase.HenyeyGreenstein(0.9), phase.Rayleigh(), phase.HenyeyGreenstein(-0.9)], [0.5, 0.2, 0.3]
    )
    one, two, three = (Truncated.of(part, 12) for part in made.parts)
    both = Truncated.of(made, 12)
    assert both.forward == pytest.approx(0.5 * one.forward) and one.forward > 0 < three.backward
    assert (1 - both.forward) * both.backward == pytest.approx(0.3 * three.backward)
    left = 0.5 * (1 - one.forward) * one.moments + 0.2 * two.moments + 0.3 * three.moments
    np.testing.assert_allclose((1 - both.forward) * both.moments, left, atol=1e-15)
    np.testing.assert_allclose(made.moments(5)[2], 0.8 * 0.81 + 0.02)
    x, w = np.polynomial.legendre.leggauss(200)
    assert 2 * np.pi * w @ made.eval(x) == pytest.approx(1, abs=1e-9)


@pytest.mark.slow
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
    forward, exact = 0.3, Piece(2.0, (0.2,), (0.9,), (0.3,))
    s = np.linspace(0, 1, 10_001)
    scaled = np.concatenate([[0], np.cumsum(np.diff(s) * (1 - forward * (0.2 + 0.7 * (s[1:] + s[:-1]) / 2)))])
    assert exact.scaled == pytest.approx(2 * scaled[-1], rel=1e-12)
    for k in (0, 2500, 7000, 10_000):
        here = 0.2 + 0.7 * s[k]
        expected = here * (1 - forward) / (1 - here * forward)
        assert exact.albedo(0, scaled[k] / scaled[-1])[0] == pytest.approx(expected, rel=1e-9)


def test_upside_down_it_is_seen_from_the_other_side():
    """The stack turned over, lit from above, does what the stack does, lit from below."""
    layer = ur.GradedMedium(2.0, UNEVEN, KINDS, (0.0, 0.2, 1.0))
    turned = ur.GradedMedium(2.0, UNEVEN[::-1], KINDS[::-1], (0.0, 0.8, 1.0))
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


UNLIKE = pane(ur.GradedMedium(1.5, UNEVEN, KINDS, KNOTS), below=1.2)


def test_the_walk_agrees_with_adding():
    """Fluxes, values and what the medium keeps, from both sides, within errors."""
    exact = ur.solve(UNLIKE, "adding", nodes=24)
    walk = ur.solve(UNLIKE, "walk", samples=10_000, seed=1)
    for name, given in (("reflectance", ()), ("transmittance", ()), ("eval", (WO,))):
        value, error = getattr(walk, name)(WI, *given, with_error=True)
        expected = getattr(exact, name)(WI, *given)
        assert np.all(np.abs(value - expected) < 4.5 * error + 1e-3 * expected.max()), name
        assert error.max() < 0.03 * max(expected.max(), 0.1)
    kept = walk.absorption(WI, with_error=True)
    assert np.all(np.abs(kept.absorbed - exact.absorption(WI).absorbed) < 4.5 * kept.error.absorbed + 3e-4)


def test_alone_it_takes_off_what_the_mean_medium_has_too_much():
    """Where light grazes it sees one end only, darker than the mean: slabs agree, direction by direction."""
    layer = ur.GradedMedium(depth=1.0, albedo=(0.9, 0.5))
    wi, wo = (
        np.concatenate([degrees(90.8), degrees(150)]),
        np.concatenate([degrees(99.5, 180), degrees(120, 60)]),
    )
    one, many = (
        ur.solve(ur.Stack(layers=layers), "adding", nodes=20).eval(wi, wo)
        for layers in ([layer], slabs(40, (0.9, 0.5), 1.0, ur.Isotropic()))
    )
    np.testing.assert_allclose(one, many, rtol=5e-3)


def test_the_walk_follows_lanes_and_derivatives():
    """Depths of their own are other media, and the slope is that of adding."""
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    depths = np.array([0.5, 1.5, 3.0, 3.0])
    wi = np.repeat(degrees(30), 4, axis=0)
    value, error = ur.solve(
        UNLIKE, "walk", samples=30_000, seed=2, parameters={"layer_1.depth": depths}
    ).reflectance(wi, with_error=True)
    best = [
        ur.solve(UNLIKE.replace({"layer_1.depth": d}), "adding", nodes=NODES).reflectance(wi[:1])[0]
        for d in (*depths, 0.48, 0.52)
    ]
    assert np.all(np.abs(value - best[:4]) < 4.5 * error + 2e-3)
    depth = Float(0.5)
    dr.enable_grad(depth)
    bsdf = ur.solve(UNLIKE, "walk", samples=16, seed=3, parameters={"layer_1.depth": depth})
    x = dr.linspace(Float, 0.49, 0.51, 16384)  # all a little different, so that their noise is
    found = bsdf.reflectance(Array3f(x, 0, dr.sqrt(1 - x * x)))
    dr.backward(dr.mean(dr.ravel(found)))
    assert float(dr.grad(depth)[0]) == pytest.approx(float((best[5] - best[4])[0]) / 0.04, rel=0.05)


def test_three_numbers_are_no_colour_of_it():
    """One depth serves every colour: three are of three evaluations. What it is at each height is no parameter."""
    stack = ur.Stack(layers=[ur.GradedMedium(1.0, (0.1, 0.5))])
    clear = {"layer_0.depth": np.array([0.0, 0.0, 1.0])}
    through = ur.solve(stack, "walk", samples=64, parameters=clear).transmittance(
        np.repeat(degrees(0), 3, axis=0)
    )
    assert through[0].tolist() == through[1].tolist() == [1, 1, 1] and through[2].max() < 0.9
    with pytest.raises(ur.MaterialError, match="one depth serves every colour"):
        ur.solve(stack, "adding", nodes=4, parameters=clear)
    with pytest.raises(
        ur.MaterialError, match=r"layer_0\.albedo: is no continuous parameter; allowed: layer_0\.depth"
    ):
        ur.solve(stack, "adding", nodes=4, parameters={"layer_0.albedo": [0.1, 0.2, 0.3]})


def test_lobes_refuse_it_and_auto_takes_adding():
    stack = pane(ur.GradedMedium(depth=1.0, albedo=UNEVEN))
    with pytest.raises(ur.UnsupportedStack, match=r"layers\[1\] is a graded medium.*that can: walk, adding"):
        ur.solve(stack, "lobes")
    bsdf = ur.solve(stack, accuracy=0.05)
    assert bsdf.diagnostics["auto"]["method"] == "adding"


def test_a_file_of_its_solution(tmp_path):
    bsdf = ur.solve(pane(ur.GradedMedium(depth=1.0, albedo=UNEVEN)), "adding", nodes=NODES)
    native.save(bsdf, tmp_path / "pane.urushi.npz")
    again = native.load(tmp_path / "pane.urushi.npz")
    assert again.stack == bsdf.stack
    np.testing.assert_allclose(again.reflectance(WI), bsdf.reflectance(WI), atol=1e-3)


def test_the_plugin(mi, tmp_path):
    ur.save(UNLIKE, tmp_path / "pane.yaml")
    file = str(tmp_path / "pane.yaml")
    plugin = layered(mi, filename=file, method="adding", nodes=NODES)
    expected = ur.solve(UNLIKE, "adding", nodes=NODES).eval(WI, WO)
    np.testing.assert_allclose(Asked.of(mi, plugin, WI).value(WO), expected, rtol=2e-3, atol=2e-5)
    kinds = "graded henyey_greenstein to rayleigh to henyey_greenstein"
    assert kinds in str(plugin) and "layer_1.depth" in mi.traverse(plugin)
    walked = Asked.of(mi, layered(mi, filename=file, samples=20_000), WI).value(WO)
    np.testing.assert_allclose(walked, expected, rtol=0.05, atol=1e-3)
