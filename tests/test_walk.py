"""The walk as a tool: the same question has the same answer, errors are honest, options do what they say, and wrong
arguments are named."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy import stats

import urushi as ur
from lanes import direction, needs_llvm
from outside import Tally
from urushi.errors import MaterialError, UnsupportedStack, UrushiError
from urushi.solvers import BSDF

pytestmark = needs_llvm

FOG = ur.Medium(depth=0.8, albedo=(0.9, 0.7, 0.5), phase=ur.HenyeyGreenstein(g=0.5))
ENAMEL = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), FOG, ur.Conductor(material="Au", alpha=0.3)])
PANE = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.2), FOG, ur.Dielectric(ior=1.3, alpha=0.3)])

COSINES = np.array([0.95, 0.7, 0.4, 0.2])
WI = direction(COSINES, 0.3)
WO = direction(COSINES[::-1], 2.0)
ACROSS = WO * (1, 1, -1)


def solve(stack: ur.Stack, samples: int = 256, **options: Any) -> BSDF:
    return ur.solve(stack, "walk", samples=samples, **options)


# ------------------------------------------------------------------------- the same question, the same answer


def test_same_seed_same_bits_and_another_seed_others() -> None:
    one, again, other = solve(ENAMEL), solve(ENAMEL), solve(ENAMEL, seed=1)
    assert np.array_equal(one.eval(WI, WO), again.eval(WI, WO))
    assert np.array_equal(one.reflectance(WI), again.reflectance(WI))
    assert not np.any(one.eval(WI, WO) == other.eval(WI, WO))
    assert not np.any(one.reflectance(WI) == other.reflectance(WI))


def test_splitting_a_batch_changes_nothing(rng: np.random.Generator) -> None:
    wi, wo = (direction(rng.uniform(-1, 1, 1000), rng.uniform(0, 7, 1000)) for _ in range(2))
    u = rng.random((1000, 3))
    bsdf = solve(PANE, samples=40)
    whole = bsdf.eval(wi, wo), bsdf.pdf(wi, wo), bsdf.sample(wi, u).weight, bsdf.transmittance(wi)
    for part in (slice(0, 1), slice(1, 300), slice(300, 1000)):
        a, b, c = wi[part], wo[part], u[part]
        parts = bsdf.eval(a, b), bsdf.pdf(a, b), bsdf.sample(a, c).weight, bsdf.transmittance(a)
        for all_of_it, some in zip(whole, parts, strict=True):
            assert np.array_equal(all_of_it[part], some)


def test_threads_change_nothing() -> None:
    before, found = dr.thread_count(), []
    try:
        for threads in (1, 2):
            dr.set_thread_count(threads)
            found.append((solve(PANE).eval(WI, ACROSS), solve(PANE).reflectance(WI)))
    finally:
        dr.set_thread_count(before)
    assert all(np.array_equal(one, other) for one, other in zip(*found, strict=True))


def test_single_directions_and_broadcasting() -> None:
    bsdf = solve(ENAMEL)
    rows = bsdf.eval(WI[:1], WO)
    assert rows.shape == (4, 3) and bsdf.pdf(WI, WO).shape == (4,)
    assert np.array_equal(bsdf.eval(WI[0], WO[2]), rows[2])
    assert bsdf.eval(WI[0], WO[2]).shape == (3,) and bsdf.reflectance(WI[0]).shape == (3,)
    one = bsdf.sample(WI[0], np.array([0.1, 0.2, 0.3]))
    assert one.wo.shape == (3,) and one.weight.shape == (3,) and np.ndim(one.pdf) == 0


def test_plain_floats_take_one_value_each() -> None:
    from drjit.llvm.ad import Float64

    one, same = (
        solve(ENAMEL, 4, backend="scalar", parameters={"layer_0.alpha": alpha}).pdf(WI, WO)
        for alpha in (0.2, [0.2])
    )
    np.testing.assert_allclose(one, same, rtol=1e-6)
    for values, said in (([0.1, 0.2], "2 evaluations"), (Float64(0.1, 0.2), "a Dr.Jit array")):
        with pytest.raises(ur.MaterialError, match=rf"layer_0\.alpha: found .*{said}.*'scalar'"):
            solve(ENAMEL, 4, backend="scalar", parameters={"layer_0.alpha": values})


@pytest.mark.parametrize("stack", [ENAMEL, PANE], ids=["opaque", "transmits"])
def test_plain_floats_do_what_vectors_do(stack: ur.Stack) -> None:
    """The scalar backend draws the same numbers: a few paths differ where rounding decides between two events."""
    vectors, floats = solve(stack, 64), solve(stack, 64, backend="scalar")
    for question in (
        lambda bsdf: bsdf.pdf(WI, WO)[:, None],
        lambda bsdf: bsdf.sample(WI, np.full((4, 3), 0.4)).wo,
        lambda bsdf: bsdf.eval(WI, WO),
        lambda bsdf: bsdf.reflectance(WI),
    ):
        one, other = question(vectors), question(floats)
        close = np.isclose(one, other, rtol=1e-3, atol=1e-5)
        assert close.mean() >= 0.7, (one, other)
        assert np.allclose(one, other, rtol=0.2, atol=0.02)


def test_dr_jit_in_dr_jit_out() -> None:
    from drjit.llvm.ad import Array3f

    bsdf = solve(PANE, 8)
    wi, wo = (Array3f(np.ascontiguousarray(w.T, np.float32)) for w in (WI, ACROSS))
    value, error = bsdf.eval(wi, wo, with_error=True)
    there, there_error = bsdf.eval(WI.astype(np.float32), ACROSS.astype(np.float32), with_error=True)
    assert isinstance(value, Array3f) and isinstance(bsdf.reflectance(wi), Array3f)
    # Not the same bits: numpy's directions are normalised once more, and so draw other numbers.
    spread = 6 * np.hypot(error.numpy().T, there_error) + 1e-6
    assert np.all(np.abs(value.numpy().T - there) < spread)
    assert np.allclose(bsdf.pdf(wi, wo).numpy(), bsdf.pdf(WI, ACROSS), rtol=1e-4)


# -------------------------------------------------------------------------------------- honest errors


@pytest.mark.parametrize("stack", [ENAMEL, PANE], ids=["opaque", "transmits"])
def test_standard_errors_are_honest(stack: ur.Stack) -> None:
    """The spread over 64 seeds is the standard error that each of them gives (chi² of the variance)."""
    seeds, wo = 64, WO if stack is ENAMEL else ACROSS
    runs = [solve(stack, 1024, seed=seed) for seed in range(seeds)]
    for question in (
        lambda bsdf: bsdf.eval(WI, wo, with_error=True),
        lambda bsdf: bsdf.reflectance(WI, with_error=True),
    ):
        value, error = (np.array(x) for x in zip(*(question(bsdf) for bsdf in runs), strict=True))
        ratio = value.var(axis=0, ddof=1) / np.mean(error**2, axis=0)
        low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], seeds - 1) / (seeds - 1)
        # Estimates are not normal, so their variances spread a little more than chi² says.
        assert np.all((ratio > 0.8 * low) & (ratio < 1.25 * high)), ratio
        assert abs(np.log(ratio.mean())) < 0.25


def test_errors_fall_with_the_root_of_the_number_of_samples() -> None:
    few, many = (solve(ENAMEL, n).eval(WI, WO, with_error=True)[1] for n in (1024, 16384))
    assert np.all(np.abs(few / many / 4 - 1) < 0.4)


# ------------------------------------------------------------------------------------------- options


def test_more_depth_is_more_light() -> None:
    """Reflectance grows with `max_depth` towards that without a limit, which it never passes."""
    depths = [0, 1, 2, 4, 16, 64, None]
    found = [solve(ENAMEL, 8192, max_depth=depth).reflectance(WI, with_error=True) for depth in depths]
    for (less, less_error), (more, more_error) in pairwise(found):
        assert np.all(less <= more + 5 * np.hypot(less_error, more_error))
    assert np.all(found[0][0] < found[2][0]) and np.all(found[2][0] < found[-1][0])
    assert np.allclose(found[-2][0], found[-1][0], rtol=0.05)


@pytest.mark.parametrize("stack", [ENAMEL, PANE], ids=["opaque", "transmits"])
def test_double_precision_agrees(stack: ur.Stack) -> None:
    one, other = solve(stack, 8192), solve(stack, 8192, precision="double", seed=1)
    assert np.allclose(one.pdf(WI, WO), other.pdf(WI, WO), rtol=1e-4)
    tally = Tally()
    for question in (
        lambda bsdf: bsdf.eval(WI, WO, with_error=True),
        lambda bsdf: bsdf.eval(-WI, ACROSS, with_error=True),
        lambda bsdf: bsdf.transmittance(WI, with_error=True),
    ):
        tally.add("double", *question(one), *question(other))


def test_radiance_and_importance() -> None:
    """Across the pane radiance carries (n_i / n_o)^2 more than flux, the other way round less; on one side neither."""
    radiance, importance = solve(PANE), solve(PANE, mode="importance")
    up = -WI * (-1, -1, 1)
    for wi, wo, factor in ((WI, ACROSS, 1 / 1.3**2), (up, WO, 1.3**2), (WI, WO, 1), (up, ACROSS, 1)):
        assert np.allclose(radiance.eval(wi, wo), factor * importance.eval(wi, wo), rtol=1e-5, atol=1e-9)
        u = np.random.default_rng(0).random((len(wi), 3))
        one, other = radiance.sample(wi, u), importance.sample(wi, u)
        same = one.wo[:, 2] * wi[:, 2] > 0
        ratio = np.where(same, 1, 1 / 1.3**2 if wi is WI else 1.3**2)
        assert np.allclose(one.weight, other.weight * ratio[:, None], rtol=1e-5, atol=1e-9)
    assert np.array_equal(radiance.transmittance(WI), importance.transmittance(WI))


def test_transmission_is_reciprocal() -> None:
    """f(wi, wo) / n_i^2 = f(wo, wi) / n_o^2 in radiance, through the pane."""
    bsdf, tally = solve(PANE, 16384), Tally()
    there, there_error = bsdf.eval(WI, ACROSS, with_error=True)
    back, back_error = bsdf.eval(ACROSS, WI, with_error=True)
    one, other = np.abs(ACROSS[:, 2:]), np.abs(WI[:, 2:]) * 1.3**2
    tally.add("across", there / one, there_error / one, back / other, back_error / other)


def test_a_value_for_each_lane() -> None:
    """Values by `parameters`, one for each evaluation, give what as many stacks give."""
    alpha, depth = np.array([0.05, 0.2, 0.5, 1.0]), np.random.default_rng(0).uniform(0, 2, (4, 3))
    parameters = {"layer_0.alpha": alpha, "layer_1.depth": depth, "layer_1.phase.g": alpha / 2}
    together = solve(PANE, 2048, parameters=parameters)
    tally = Tally()
    for i in range(4):
        stack = PANE.replace({
            "layer_0.alpha": alpha[i], "layer_1.depth": tuple(depth[i]), "layer_1.phase.g": alpha[i] / 2
        })  # fmt: skip
        alone = solve(stack, 2048)
        assert np.allclose(together.pdf(WI, WO)[i], alone.pdf(WI[i], WO[i]), rtol=1e-5)
        for question in ("reflectance", "transmittance"):
            pairs = [getattr(bsdf, question)(WI, with_error=True) for bsdf in (together, alone)]
            tally.add(question, pairs[0][0][i], pairs[0][1][i], pairs[1][0][i], pairs[1][1][i])
        pairs = [bsdf.eval(WI, ACROSS, with_error=True) for bsdf in (together, alone)]
        tally.add("eval", pairs[0][0][i], pairs[0][1][i], pairs[1][0][i], pairs[1][1][i])


def test_one_value_in_place_of_the_described() -> None:
    changed = {"layer_0.alpha": 0.4, "layer_1.albedo": (0.1, 0.2, 0.3)}
    one, other = solve(PANE, parameters=changed), solve(PANE.replace(changed))
    assert np.array_equal(one.eval(WI, WO), other.eval(WI, WO))


def test_diagnostics() -> None:
    said = solve(PANE, 128, seed=7).diagnostics
    assert said["method"] == "walk" and said["samples"] == 128 and said["seed"] == 7
    assert said["interfaces"] == 2 and said["media"] == 1 and said["coloured"] and not said["delta_parts"]


# -------------------------------------------------------------------------------------- wrong arguments

WRONG: list[tuple[dict[str, Any], str]] = [
    ({"samples": 0}, "samples: found 0"),
    ({"samples": 1.5}, "samples: found 1.5"),
    ({"samples": True}, "samples: found True"),
    ({"seed": -1}, "seed: found -1"),
    ({"seed": 2**32}, "seed: found 4294967296"),
    ({"max_depth": -1}, "max_depth: found -1"),
    ({"backend": "metal"}, "backend: found 'metal'"),
    ({"precision": "half"}, "precision: found 'half'"),
    ({"mode": "flux"}, "mode: found 'flux'"),
    ({"parameters": {"layer_0.alhpa": 0.1}}, "layer_0.alhpa"),
    ({"parameters": {"layer_0.alpha": 2.0}}, "alpha"),
    ({"parameters": {"layer_0.alpha": np.array([0.1, 2.0])}}, "alpha"),
    ({"parameters": {"layer_0.alpha": np.array([0.1, np.nan])}}, "not finite"),
    ({"parameters": {"layer_0.ior": np.ones((4, 3)) * 1.5}}, "found shape"),
    ({"parameters": {"layer_1.depth": np.ones((4, 2))}}, "found shape"),
    ({"parameters": {"layer_0.alpha": np.ones(4) * 0.1, "layer_1.depth": np.ones(5)}}, "5 evaluations"),
]


@pytest.mark.parametrize(("options", "said"), WRONG, ids=[said for _, said in WRONG])
def test_wrong_options(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UrushiError, match=said.replace("(", r"\(")):
        ur.solve(PANE, "walk", **options)


WRONG_DIRECTIONS: list[tuple[Any, str]] = [
    (np.ones((2, 3)), "found length 1.73"),
    (np.ones((2, 2)), r"found shape \(2, 2\)"),
    (np.array([[0, 0, np.nan]]), r"wi\[0\]: not finite"),
    (np.array([[0, 0, 1], [0, 0, 0]]), r"wi\[1\]: found length 0"),
    ("up", "found str"),
]


@pytest.mark.parametrize(("wi", "said"), WRONG_DIRECTIONS, ids=[said for _, said in WRONG_DIRECTIONS])
def test_wrong_directions(wi: Any, said: str) -> None:
    bsdf = solve(PANE)
    for question in (
        lambda: bsdf.eval(wi, WO),
        lambda: bsdf.reflectance(wi),
        lambda: bsdf.sample(wi, WO[:1] ** 2),
    ):
        with pytest.raises(UrushiError, match=said):
            question()


def test_wrong_numbers_of_rows_and_random_numbers() -> None:
    bsdf = solve(PANE)
    with pytest.raises(UrushiError, match="found 4 and 3 rows"):
        bsdf.eval(WI, WO[:3])
    with pytest.raises(UrushiError, match=r"u\[1\]: found"):
        bsdf.sample(WI[:2], np.array([[0.5, 0.5, 0.5], [0.5, 1.0, 0.5]]))
    with pytest.raises(UrushiError, match="found 3 rows; allowed: 4"):
        solve(PANE, parameters={"layer_0.alpha": np.full(4, 0.1)}).eval(WI[:3], WO[:3])
    with pytest.raises(UrushiError, match="samples: found 1; allowed with with_error=True: at least 2"):
        solve(PANE, 1).eval(WI, WO, with_error=True)


def test_what_only_the_walk_can_do_auto_gives_to_it() -> None:
    stack = ur.Stack(
        layers=[ur.Dielectric(ior=1.5, alpha=0.1, normal=(0.0, 0.1, 1.0)), ur.Diffuse(reflectance=0.5)]
    )
    with pytest.raises(UnsupportedStack, match=r"layers\[0\]\.normal"):
        ur.solve(stack, "adding")
    assert ur.solve(stack, "auto").diagnostics["method"] == "walk"


def test_a_texture_needs_a_value() -> None:
    wood = ur.load("preset:varnished-wood")
    with pytest.raises(UnsupportedStack, match=r"layer_0\.alpha is a texture"):
        ur.solve(wood, "walk").eval(WI, WO)
    values = {"layer_0.alpha": 0.1, "layer_2.reflectance": (0.4, 0.3, 0.1)}
    assert np.all(solve(wood, parameters=values).eval(WI, WO) > 0)


def test_unknown_methods() -> None:
    with pytest.raises(UrushiError, match="did you mean 'walk'"):
        ur.solve(PANE, "wlak")
    with pytest.raises(MaterialError):
        ur.solve("preset:no such thing", "walk")


def test_an_unknown_option_is_refused_by_name() -> None:
    """A misspelt option is no TypeError from within: it names the option and what is allowed."""
    with pytest.raises(ur.UrushiError, match=r"sampels.*did you mean 'samples'"):
        ur.solve(ur.load("preset:plastic"), sampels=3)


# -------------------------------------------------------------------------------------------- one strategy or two


def test_a_broad_base_is_connected_to_and_no_more() -> None:
    """Known to be broad, a base is connected to only: the same light, less noise where a mirror would send it."""
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(eta=0.2, k=3.9, alpha=0.2)])
    wi = np.concatenate([WI, WI])
    wo = np.concatenate([WI * (-1, -1, 1), WO])
    alone, error = (x[:, 0] for x in solve(stack, 1 << 15).eval(wi, wo, with_error=True))
    unknown = {"layer_1.alpha": np.full(len(wi), 0.2)}
    both, more = (x[:, 0] for x in solve(stack, 1 << 15, parameters=unknown).eval(wi, wo, with_error=True))
    exact = ur.solve(stack, "adding", accuracy=3e-4).eval(wi, wo)[:, 0]
    for value, noise in ((alone, error), (both, more)):
        assert np.all(np.abs(value - exact) < 4 * noise + 1e-3 * exact)
    assert np.all(error[:2] < 0.8 * more[:2])
