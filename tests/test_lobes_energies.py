"""Energies that lobes follow direction by direction: what they keep, what they know of colours, derivatives, places."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

THETA = np.radians([0.0, 30, 60, 75])
WI = np.stack([np.sin(THETA), 0 * THETA, np.cos(THETA)], axis=1)
GOLD = {"eta": 0.2, "k": 3.9}
HAZE = ur.Medium(depth=0.5, albedo=0.8, phase=ur.HenyeyGreenstein(g=0.6))


def _glass(ior: float, alpha: float, **more: object) -> ur.Dielectric:
    return ur.Dielectric(ior=ior, alpha=alpha, **more)


def _solved(*layers: object, **options: object):
    options = {"precision": "double", **options}
    return ur.solve(ur.Stack(layers=list(layers)), "lobes", **options)


# --- nodes and matrices ----------------------------------------------------------------------------------------------


def test_nodes_keep_light_where_it_is(rng: np.random.Generator) -> None:
    """All of it, and its mean cosine nearly: also of light that is reflected totally, and between limits."""
    from drjit.llvm.ad import Float64

    from urushi.solvers.lobes.nodes import Nodes

    nodes = Nodes([1.0, 1.5, 2.0, 1.3])
    for region in range(4):
        cos = rng.random((20, 50)) ** 2 + 1e-3
        weight = rng.random((2, 20, 50))
        arrays = [Float64(w.ravel()) for w in weight]
        found = nodes.shared(region, Float64(cos.ravel()), arrays, 50)
        assert found.shape == (2, nodes.count(region), 20)
        np.testing.assert_allclose(found.sum(axis=1), weight.sum(axis=2), rtol=1e-12)
        middle = np.einsum("n,cnk->ck", nodes.cosines(region), found)
        np.testing.assert_allclose(middle, (weight * cos).sum(axis=2), rtol=5e-3)
        assert nodes.weights(region).sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("full", [False, "compensated"])
def test_matrices_are_reciprocal(full: object) -> None:
    """As much even light goes down as up, by squared index; and a complete interface keeps all."""
    bsdf = _solved(
        _glass(1.5, 0.3, multiple_scattering=full), _glass(1.9, 0.2), ur.Conductor(**GOLD, alpha=0.1)
    )
    from drjit.llvm.ad import Float64

    from urushi.solvers.lobes.energies import Pile
    from urushi.solvers.lobes.kernels import numbers, values

    stack = bsdf._core(bsdf._module, True)[0].stack
    pile = Pile(stack, {key: values(x) for key, x in numbers(stack).items()}, Float64)
    for k, n in enumerate((1.5, 1.9 / 1.5)):
        slab, nodes = pile.layers[k][1], pile.nodes
        down = slab.t_down[0].sum(axis=0) @ nodes.weights(k)
        up = slab.t_up[0].sum(axis=0) @ nodes.weights(k + 1)
        assert down == pytest.approx(n**2 * up, rel=4e-3)
    first = pile.layers[0][1]
    kept = (first.r_bottom + 0)[0].sum(axis=0) + first.t_up[0].sum(axis=0)
    assert np.all(kept <= 1 + 1e-12)
    assert np.allclose(kept, 1, atol=1e-12) == bool(full)


# --- the whole -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("medium", [None, pytest.param(1.0, marks=pytest.mark.slow), "smooth"])
def test_nothing_is_lost(medium: object) -> None:
    complete = {"multiple_scattering": "compensated"}
    mirror = ur.Conductor(eta=0.0, k=3.0, alpha=0.2, **complete)
    coats = [_glass(2.0, 0.1, **complete), _glass(1.4, 0.0 if medium == "smooth" else 0.3, **complete)]
    if medium == 1.0:
        coats.insert(1, ur.Medium(depth=0.7, albedo=1.0, phase=ur.HenyeyGreenstein(g=-0.4)))
    np.testing.assert_allclose(_solved(*coats, mirror).reflectance(WI), 1, atol=1e-9)
    sheet = _solved(*coats, _glass(1.0, 0.2, **complete))
    wi = WI * [1, 1, -1]
    for w in (WI, wi):
        np.testing.assert_allclose(sheet.reflectance(w) + sheet.transmittance(w), 1, atol=1e-9)


def test_nearly_smooth_is_smooth() -> None:
    layers = _glass(1.5, 0.0), ur.Medium(depth=0.3, albedo=0.0), _glass(1.9, 0.0)
    smooth = _solved(*layers, ur.Conductor(**GOLD))
    rough = _solved(*layers, ur.Conductor(**GOLD, alpha=1e-3))
    assert smooth.diagnostics["energies"] == "recursion" != rough.diagnostics["energies"]
    np.testing.assert_allclose(rough.reflectance(WI), smooth.reflectance(WI), atol=2.5e-3)


@pytest.mark.parametrize("haze", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_colours_are_those_of_each(haze: bool) -> None:
    depths, eta, albedo = np.array([0.1, 0.5, 2.0]), np.array([0.2, 0.5, 1.2]), np.array([0.9, 0.5, 0.1])

    def layers(depth: object, index: object, white: object) -> list:
        dye, metal = ur.Medium(depth=depth, albedo=0.0), ur.Conductor(eta=index, k=3.0, alpha=0.2)
        between = [HAZE.model_copy(update={"albedo": white})] if haze else []
        return [_glass(1.6, 0.1), dye, _glass(1.3, 0.2), *between, metal]

    coloured = _solved(*layers(list(depths), list(eta), list(albedo))).reflectance(WI)
    for c, numbers in enumerate(zip(depths, eta, albedo, strict=True)):
        grey = _solved(*layers(*map(float, numbers))).reflectance(WI)
        np.testing.assert_allclose(coloured[:, c], grey[:, 0], rtol=1e-9)


@pytest.mark.parametrize(
    "layers",
    [
        [
            _glass(1.8, 0.1),
            ur.Medium(depth=0.4, albedo=0.0),
            _glass(1.4, 0.3),
            ur.Conductor(**GOLD, alpha=0.2),
        ],
        [_glass(1.5, 0.1), HAZE, _glass(1.0, 0.2)],
        [_glass(2.1, 0.2), _glass(1.4, 0.05), ur.Diffuse(0.8)],
    ],
    ids=["metal", "haze", "diffuse"],
)
@pytest.mark.slow
def test_the_ledger(layers: list) -> None:
    """Where the light stays, entry by entry, as adding has it."""
    stack = ur.Stack(layers=layers)
    lobes, exact = ur.solve(stack, "lobes"), ur.solve(stack, "adding", accuracy=2e-3)
    found, truth = lobes.absorption(WI), exact.absorption(WI)
    assert np.abs(found.total - 1).max() < 1e-12
    np.testing.assert_allclose(found.reflected, lobes.reflectance(WI), atol=1e-6)
    for a, b in zip((found.absorbed, found.lost), (truth.absorbed, truth.lost), strict=True):
        np.testing.assert_allclose(a, b, atol=4e-3)


# --- derivatives and backends ----------------------------------------------------------------------------------------

NUMBERS = [
    ("layer_0.alpha", 0.15, 1e-2),
    pytest.param("layer_0.ior", 1.7, 1e-2, marks=pytest.mark.slow),
    pytest.param("layer_1.depth", 0.4, 1e-2, marks=pytest.mark.slow),
    pytest.param("layer_2.ior", 1.4, 1e-2, marks=pytest.mark.slow),
    pytest.param("layer_3.eta", 0.2, 1e-2, marks=pytest.mark.slow),
    pytest.param("layer_3.alpha", 0.2, 1e-2, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "value", "half"), NUMBERS)
def test_derivatives(name: str, value: float, half: float) -> None:
    """Of what plain numbers give, which live ones do not change."""
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    dye = ur.Medium(depth=0.4, albedo=0.0)
    layers = _glass(1.7, 0.15), dye, _glass(1.4, 0.1), ur.Conductor(**GOLD, alpha=0.2)
    wi = Array3f64(0.6, 0, 0.8)

    def energy(x: object) -> Float64:
        return _solved(*layers, parameters={name: x}).reflectance(wi).x

    x = Float64(value)
    dr.enable_grad(x)
    found = energy(x)
    ends = [energy(value + step)[0] for step in (half, -half)]
    assert found[0] == pytest.approx(energy(value)[0], rel=1e-12)
    dr.backward(found)
    assert dr.grad(x)[0] == pytest.approx((ends[0] - ends[1]) / (2 * half), rel=0.03, abs=2e-4)


def test_scalar_numbers_and_lanes() -> None:
    """One value for all is the same in scalar numbers; one for each lane asks the recursion, and says so."""
    layers = _glass(1.8, 0.1), _glass(1.4, 0.2), ur.Conductor(**GOLD, alpha=0.1)
    plain, scalar = _solved(*layers), _solved(*layers, backend="scalar")
    assert plain.diagnostics["energies"] == scalar.diagnostics["energies"] == "direction by direction"
    np.testing.assert_allclose(scalar.eval(WI, WI), plain.eval(WI, WI), rtol=1e-9)
    lanes = _solved(*layers, parameters={"layer_0.alpha": np.full(len(WI), 0.1)})
    assert lanes.diagnostics["energies"] == "recursion"
    off = np.abs(lanes.reflectance(WI) - plain.reflectance(WI))
    assert 5e-3 < off.max() < 0.05


@pytest.mark.parametrize("layers", [[_glass(1.5, 0.0), _glass(1.0, 0.0)], [_glass(1.5, 0.1)]])
def test_the_recursion_is_asked(layers: list) -> None:
    assert _solved(*layers).diagnostics["energies"] == "recursion"


def test_in_mitsuba(mi, tmp_path) -> None:
    """The same in scalar and vector variants, with a live number, and after another is set."""
    import drjit as dr

    import urushi.mitsuba  # noqa: F401 (registers the plugin)

    layers = [_glass(1.8, 0.1), _glass(1.4, 0.2), ur.Conductor(**GOLD, alpha=0.1)]
    ur.save(ur.Stack(layers=layers), tmp_path / "stack.yaml")
    wi, wo = [0.6, 0.0, 0.8], [-0.55, 0.05, 0.8337]

    def value(alpha: float | None = None, live: bool = False) -> float:
        bsdf = mi.load_dict({"type": "layered", "filename": str(tmp_path / "stack.yaml"), "method": "lobes"})
        if alpha is not None:
            parameters = mi.traverse(bsdf)
            parameters["layer_1.alpha"] = mi.Float(alpha)
            if live:
                dr.enable_grad(parameters["layer_1.alpha"])
            parameters.update()
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Vector3f(wi)
        return float(np.ravel(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo)))[0])

    before, after, live = value(), value(0.3), value(0.3, True)
    truth = _solved(*layers).eval(np.array([wi]), np.array([wo]))[0, 0]
    assert before == pytest.approx(truth, rel=2e-3)
    assert after == pytest.approx(live, rel=2e-3) and abs(after / before - 1) > 0.02
    variant = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        assert value() == pytest.approx(truth, rel=1e-4)
    finally:
        mi.set_variant(variant)
