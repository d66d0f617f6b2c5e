"""Any number of channels in one solution: every one as if it were solved alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi.comparison.contenders import contender
from urushi.errors import MaterialError, UrushiError
from urushi.solvers.adding import build, whole
from urushi.solvers.adding.spectrum import Spectrum

pytestmark = needs_llvm

COUNT = 7
DEPTH = np.linspace(0.1, 1.5, COUNT)
ALBEDO = np.linspace(0.9, 0.3, COUNT)
MILK = ur.Medium(depth=0.5, albedo=0.5, phase=ur.HenyeyGreenstein(g=0.4))
SLAB = ur.Stack(layers=[ur.Dielectric(ior=1.4), MILK, ur.Dielectric(ior=1.0)])
GIVEN = {"layer_1.depth": DEPTH, "layer_1.albedo": ALBEDO}
COAT = ur.Dielectric(ior=1.5, alpha=0.3)
#: stacks, and what of them has channels: the first of them dark, metals, smooth and rough, and coloured walls
STACKS: dict[str, tuple[ur.Stack, dict[str, tuple[float, float]]]] = {
    "slab": (SLAB, {"layer_1.depth": (0.1, 1.5), "layer_1.albedo": (0.0, 0.95)}),
    "metal": (
        ur.Stack(layers=[COAT, MILK, ur.Conductor(eta=1.0, k=3.0, alpha=0.3)]),
        {"layer_1.albedo": (0.9, 0.3), "layer_2.eta": (0.2, 2.0), "layer_2.k": (3.0, 5.0)},
    ),
    "mirror": (ur.Stack(layers=[COAT, ur.Conductor(eta=1.0, k=3.0)]), {"layer_1.eta": (0.2, 2.0)}),
    "wall": (ur.Stack(layers=[COAT, ur.Diffuse(reflectance=0.5)]), {"layer_1.reflectance": (0.0, 0.9)}),
}


def spread(name: str, count: int) -> dict[str, np.ndarray]:
    return {key: np.linspace(*ends, count) for key, ends in STACKS[name][1].items()}


def one_of(given: dict[str, np.ndarray], channel: int) -> dict[str, float]:
    return {key: float(values[channel]) for key, values in given.items()}


@pytest.fixture(scope="module")
def several():
    return ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN)


def directions(count: int, above: bool = False) -> tuple[np.ndarray, np.ndarray]:
    wi, wo = np.random.default_rng(3).normal(size=(2, count, 3))
    if above:
        wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    return wi / np.linalg.norm(wi, axis=1, keepdims=True), wo / np.linalg.norm(wo, axis=1, keepdims=True)


def apart(one: Any, channel: int, other: Any) -> float:
    """The largest difference between a channel of one result and the only one of another, of any operator."""
    sides = [(True, True), (True, False), (False, True), (False, False)]
    sides = sides if (True, False) in other.solution.parts else sides[:1]
    return max(
        np.abs(one.matrices.operator(k, *s)[channel] - other.matrices.operator(k, *s)[0]).max()
        for k in range(max(one.matrices.orders, other.matrices.orders))
        for s in sides
    )


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("slab", 1),
        ("slab", 2),
        ("slab", 5),
        ("slab", 31),
        ("metal", 2),
        ("metal", 5),
        ("mirror", 5),
        ("wall", 5),
    ],
)
def test_every_channel_is_solved_as_if_alone(name: str, count: int) -> None:
    """On the same nodes and for the same orders all is the same: operators, values, energies."""
    stack, given = STACKS[name][0], spread(name, count)
    found = ur.solve(stack, "adding", nodes=8, orders=4, parameters=given)
    wi, wo = directions(40, above=name != "slab")
    values, reflectance, transmittance = found.eval(wi, wo), found.reflectance(wi), found.transmittance(wi)
    assert values.shape == reflectance.shape == (40, 3 if count == 1 else count)
    assert found.matrices.operator(0).shape[0] == found.diagnostics["channels"] == count
    assert found.matrices.operator(0).max() > 0.01
    for c in sorted({0, 3, count - 1} & set(range(count))):
        alone = ur.solve(stack, "adding", nodes=8, orders=4, parameters=one_of(given, c))
        assert apart(found, c, alone) < 1e-12
        np.testing.assert_allclose(values[:, c], alone.eval(wi, wo)[:, 0], rtol=1e-10, atol=1e-12)
        if name == "slab" and c == 0:
            continue  # alone it has nothing to interpolate: its energies are a closed form
        np.testing.assert_allclose(reflectance[:, c], alone.reflectance(wi)[:, 0], atol=1e-12)
        np.testing.assert_allclose(transmittance[:, c], alone.transmittance(wi)[:, 0], atol=1e-12)


def test_a_medium_may_be_dark_in_a_whole_third() -> None:
    """Whether it scatters is asked of all channels."""
    given = {"layer_1.albedo": np.array([0.0, 0.0, 0.0, 0.5, 0.9])}
    found = ur.solve(SLAB, "adding", nodes=8, orders=4, parameters=given)
    wi, wo = directions(40)
    for c in (0, 4):
        alone = ur.solve(SLAB, "adding", nodes=8, orders=4, parameters=one_of(given, c))
        assert apart(found, c, alone) < 1e-12
        np.testing.assert_allclose(found.eval(wi, wo)[:, c], alone.eval(wi, wo)[:, 0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.transmittance(wi)[:, 4], alone.transmittance(wi)[:, 0], atol=1e-12)
    drawn = found.sample(wi, np.random.default_rng(5).random((40, 3)))
    assert np.isfinite(drawn.weight).all() and drawn.weight.shape == (40, 5)


def test_all_channels_are_one_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not three at a time: the solver is called as often as for one channel, and its error is that of all."""
    channels: list[int] = []
    seen: list[tuple[int, float]] = []
    solve_on = whole.solve_on

    def counted(stack: Any, grid: Any, layers: Any, colours: int, *rest: Any) -> Any:
        channels.append(colours)
        return solve_on(stack, grid, layers, colours, *rest)

    monkeypatch.setattr(whole, "solve_on", counted)
    found = ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN, progress=lambda *told: seen.append(told))
    assert channels == [COUNT, COUNT] and found.diagnostics["history"] == seen and len(seen) == 1
    worst = max(
        ur.solve(SLAB, "adding", nodes=12, parameters=one_of(GIVEN, c)).diagnostics["estimated_error"]
        for c in range(COUNT)
    )
    # Values are compared with the brightest channel's.
    assert 0 < found.diagnostics["estimated_error"] <= worst


def test_the_peak_of_a_metal_is_that_of_its_brightest_channel() -> None:
    metal = ur.Stack(layers=[ur.Conductor(eta=1.0, k=3.0, alpha=0.3)])
    every = Spectrum.of(metal, {"layer_0.k": np.linspace(0.5, 5.0, 7)}).bind(build.bind_numbers)
    indices = build.indices(every.whole)
    found = whole._heights(every.thirds, indices)
    each = [whole._heights([third], indices) for third in every.thirds]
    assert len(each) == 3
    for side, height in found.items():
        np.testing.assert_array_equal(height, np.max([heights[side] for heights in each], axis=0))
        assert np.all(height > each[0][side]) and height[0] > 1.5 * each[0][side][0]


def test_a_spectrum_is_as_good_as_it_says() -> None:
    """Every channel of it."""
    given = spread("slab", 5)
    found = ur.solve(SLAB, "adding", parameters=given)
    best = ur.solve(SLAB, "adding", accuracy=1e-5, parameters=given)
    assert best.diagnostics["nodes"] > found.diagnostics["nodes"]
    mu = np.linspace(0.12, 1, 60) * np.resize([1, -1], 60)
    wi = np.column_stack([np.sqrt(1 - mu**2), 0 * mu, mu])
    for question in ("reflectance", "transmittance"):
        value, error = getattr(found, question)(wi, with_error=True)
        assert np.all(error == found.diagnostics["estimated_error"]) and error.max() <= 1e-3
        assert np.abs(value - getattr(best, question)(wi)).max() < error.max()
    value, error = found.eval(wi, wi[::-1], with_error=True)
    brightest = error.max(axis=1, keepdims=True)
    assert np.all(np.abs(value - best.eval(wi, wi[::-1])) < brightest)


def test_where_the_light_goes_in_every_channel(several) -> None:
    wi = np.array([[0.6, 0.0, 0.8], [0.0, 0.28, -0.96]])
    found = several.absorption(wi, with_error=True)
    assert found.absorbed.shape[-1] == COUNT and found.error is not None
    alone = ur.solve(SLAB, "adding", nodes=12, parameters=one_of(GIVEN, 4)).absorption(wi)
    np.testing.assert_allclose(found.absorbed[..., 4], alone.absorbed[..., 0], atol=1e-9)
    np.testing.assert_allclose(found.reflected, several.reflectance(wi), atol=1e-6)


def test_samples_weigh_what_they_carry(several) -> None:
    """The mean weight is what leaves on both sides, delta parts included, where no index scales it."""
    importance = ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN, mode="importance")
    wi = np.array([[0.6, 0.0, 0.8]])
    u = np.random.default_rng(8).random((100_000, 3))
    drawn = importance.sample(wi, u)
    both = importance.reflectance(wi)[0] + importance.transmittance(wi)[0]
    mean, error = drawn.weight.mean(axis=0), drawn.weight.std(axis=0) / np.sqrt(len(u))
    assert np.all(np.abs(mean - both) < 5 * error + 2e-4), (mean, both, error)
    assert drawn.delta.any() and not drawn.delta.all()
    smooth = ~drawn.delta
    np.testing.assert_allclose(
        importance.pdf(np.broadcast_to(wi, (smooth.sum(), 3)), drawn.wo[smooth]), drawn.pdf[smooth], rtol=1e-6
    )


def test_what_does_not_fit_together() -> None:
    with pytest.raises(MaterialError, match=r"layer_1\.albedo.*found shape \(4,\); allowed: one number or 7"):
        ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN | {"layer_1.albedo": np.full(4, 0.5)})
    with pytest.raises(UrushiError, match="numpy arrays where there are more than three channels"):
        import drjit as dr
        from drjit.llvm.ad import Array3f64

        wi = Array3f64(0, 0, 1)
        dr.eval(wi)
        ur.solve(SLAB, "adding", nodes=12, parameters=GIVEN).eval(wi, wi)


def test_diagnostics_are_those_of_the_solution(several) -> None:
    assert several.diagnostics["channels"] == COUNT and several.diagnostics["method"] == "adding"
    assert several.diagnostics["nodes"] == len(several.solution.grid.s)
    assert several.diagnostics["orders"] == several.solution.diagnostics["orders"]
    assert several.diagnostics["closed_form"] == "single" and several.diagnostics["precision"] == "double"


def test_diagnostics_of_the_tables_are_those_of_all_parts() -> None:
    found = ur.solve(SLAB, "adding", nodes=6, orders=2, parameters=GIVEN)
    assert "table_bytes" not in found.diagnostics
    each = [part.diagnostics for part in found.parts]
    each[1]["most_negative"], each[1]["azimuthal_error"] = -0.5, 0.5
    for name, of_all in (("table_bytes", sum), ("sampling_bytes", sum), ("azimuthal_error", max)):
        assert found.diagnostics[name] == of_all(said[name] for said in each)
    assert found.diagnostics["most_negative"] == -0.5
    with pytest.raises(KeyError):
        found.diagnostics["magic"]


def test_two_values_are_channels_unless_they_are_a_roughness() -> None:
    """A roughness along x and along y is refused as such, not taken for two channels."""
    stack = ur.Stack(layers=[COAT, ur.Diffuse(reflectance=0.5)])
    with pytest.raises(ur.UnsupportedStack, match="anisotropic"):
        ur.solve(stack, "adding", nodes=8, parameters={"layer_0.alpha": np.array([0.2, 0.3])})
    assert (
        ur.solve(SLAB, "adding", nodes=8, parameters={"layer_1.albedo": ALBEDO[:2], "layer_0.ior": [1.3]})
        .matrices.operator(0)
        .shape[0]
        == 2
    )


def test_colours_are_no_channels() -> None:
    """What the description says in red, green and blue says nothing of seven wavelengths."""
    for layer, name in (
        (ur.Conductor(material="Au", alpha=0.3), "eta"),
        (ur.Diffuse((0.8, 0.5, 0.2)), "reflectance"),
    ):
        stack = ur.Stack(layers=[*SLAB.layers[:2], layer])
        with pytest.raises(MaterialError, match=rf"layer_2\.{name}: found a colour.*7 channels"):
            ur.solve(stack, "adding", nodes=8, parameters=GIVEN)


def test_a_spectrum_is_not_compared_with_colours(several) -> None:
    with pytest.raises(UrushiError, match="contender: found 7 channels; allowed: one or three"):
        contender(several)


# --- one spectrum on another -----------------------------------------------------------------------------------------

VARNISH = ur.Stack(layers=[ur.Dielectric(ior=1.4), MILK])
WOOD = ur.Stack(exterior=1.4, layers=[ur.Medium(depth=0.4, albedo=0.8), ur.Diffuse(reflectance=0.5)])
TINT = {"layer_1.depth": DEPTH[:5], "layer_1.albedo": ALBEDO[:5]}
GRAIN = {"layer_0.albedo": np.linspace(0.0, 0.95, 5), "layer_1.reflectance": np.linspace(0.1, 0.6, 5)}


def solved(stack: ur.Stack, parameters: dict[str, np.ndarray] | None = None) -> Any:
    return ur.solve(stack, "adding", nodes=10, orders=6, indices=(1.0, 1.4), parameters=parameters)


@pytest.mark.parametrize(("tint", "grain"), [(TINT, GRAIN), (TINT, None), (None, GRAIN)])
def test_one_spectrum_on_another_is_the_whole_solved_at_once(tint, grain) -> None:
    """Or on something grey; neither is solved anew."""
    both = ur.add(solved(VARNISH, tint), solved(WOOD, grain))
    given = {**(tint or {})}
    for name, values in (grain or {}).items():
        number = int(name[6]) + 2
        given[f"layer_{number}{name[7:]}"] = values
    stack = ur.Stack(layers=[*VARNISH.layers, *WOOD.layers])
    once = solved(stack, given)
    assert both.stack == once.stack and both.channels == 5
    assert {k: v.tolist() for k, v in both.parameters.items()} == {k: v.tolist() for k, v in given.items()}
    for order in range(6):
        assert np.abs(both.matrices.operator(order) - once.matrices.operator(order)).max() < 1e-12
    wi, wo = directions(50, above=True)
    np.testing.assert_allclose(both.eval(wi, wo), once.eval(wi, wo), rtol=1e-6, atol=1e-9)
    assert both.diagnostics["interpolation_error"] == 0 and both.diagnostics["estimated_error"] > 0


def test_spectra_that_do_not_fit_are_not_put_on_one_another() -> None:
    with pytest.raises(UrushiError, match="found 5 channels on 2; allowed: the same, or one"):
        ur.add(solved(VARNISH, TINT), solved(WOOD, {name: values[:2] for name, values in GRAIN.items()}))
    with pytest.raises(
        UrushiError, match=r"coat: found a Walk.*; allowed: what solve\(stack, 'adding'\) gives"
    ):
        ur.add(ur.solve(VARNISH, "walk"), solved(WOOD, GRAIN))
