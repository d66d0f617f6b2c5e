"""A stack solved by adding as a tool: numpy and Dr.Jit, both precisions, energies, errors, matrices, wrong use."""

from __future__ import annotations

from functools import cache, partial
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from quadrature import gauss, midpoints
from urushi.errors import UrushiError
from urushi.solvers.adding.result import AddingBSDF
from urushi.solvers.adding.whole import solution

pytestmark = needs_llvm

FOG = ur.Medium(depth=0.5, albedo=(0.95, 0.6, 0.2), phase=ur.HenyeyGreenstein(g=0.5))
STACKS = {
    "slab": ur.Stack(layers=[FOG]),
    "pane": ur.Stack(layers=[ur.Dielectric(ior=1.33), FOG, ur.Dielectric(ior=1.6)]),
    "coat": ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Diffuse(reflectance=0.5)]),
    "clear": ur.Stack(
        layers=[ur.Dielectric(ior=1.5), ur.Medium(depth=0.3, albedo=0.0), ur.Dielectric(ior=1.0)]
    ),
    "metal": ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Conductor(material="Cu")]),
}
every = pytest.mark.parametrize("name", STACKS)


@cache
def operators(name: str) -> Any:
    return solution(STACKS[name], 1e-3, 16)


def solved(name: str, **options: Any) -> AddingBSDF:
    return AddingBSDF(STACKS[name], operators(name), **options)


def pairs(n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    wi, wo = (direction(rng.uniform(-1, 1, n), rng.uniform(0, 7, n)) for _ in range(2))
    edges = direction(np.array([1.0, -1.0, 1e-6, -1e-6, 1e-3, 1 - 1e-6]), 1.0)
    return np.concatenate([wi, edges, edges]), np.concatenate([wo, edges, edges[::-1]])


# ------------------------------------------------------------------------------- the same question, the same answer


@every
def test_the_same_bits_whole_or_in_parts(name: str) -> None:
    wi, wo = pairs()
    u = np.random.default_rng(1).random((len(wi), 3))
    one, again = solved(name), solved(name)
    for question in (
        lambda b, s: b.eval(wi[s], wo[s]),
        lambda b, s: b.pdf(wi[s], wo[s]),
        lambda b, s: b.reflectance(wi[s]),
        lambda b, s: b.transmittance(wi[s]),
        lambda b, s: b.sample(wi[s], u[s]).weight,
    ):
        whole = question(one, slice(None))
        assert np.array_equal(whole, question(again, slice(None)))
        assert np.array_equal(
            whole, np.concatenate([question(one, slice(0, 50)), question(one, slice(50, None))])
        )
        assert np.isfinite(whole).all() and (whole >= 0).all()


@every
def test_single_precision_and_plain_floats(name: str) -> None:
    wi, wo = (w[-60:] for w in pairs())
    u = np.random.default_rng(1).random((len(wi), 3))
    double = solved(name)
    for options, tolerance in (({"precision": "single"}, 2e-5), ({"backend": "scalar"}, 1e-9)):
        other = solved(name, **options)
        # Rounding moves a cosine of 1e-6 by a few parts in 100 of a grazing factor.
        for one, two in (
            (double.eval(wi, wo), other.eval(wi, wo)),
            (double.pdf(wi, wo), other.pdf(wi, wo)),
            (double.reflectance(wi), other.reflectance(wi)),
            (double.transmittance(wi), other.transmittance(wi)),
        ):
            assert np.allclose(one, two, rtol=50 * tolerance, atol=tolerance), options
        one, two = double.sample(wi, u), other.sample(wi, u)
        # Rounding may decide between two parts of the mixture.
        same = one.delta == two.delta
        assert same.mean() > 0.95 and np.allclose(one.wo[same], two.wo[same], atol=2e-3)


def test_dr_jit_in_dr_jit_out() -> None:
    from drjit.llvm.ad import Array3f, Array3f64

    wi, wo = pairs(50)
    for name in ("pane", "coat"):
        bsdf = solved(name)
        truth = bsdf.eval(wi, wo)
        for kind, dtype, tolerance in ((Array3f, np.float32, 2e-5), (Array3f64, np.float64, 1e-9)):
            a, b = (kind(np.ascontiguousarray(w.T, dtype)) for w in (wi, wo))
            value, error = bsdf.eval(a, b, with_error=True)
            assert isinstance(value, kind) and isinstance(error, kind)
            assert np.allclose(value.numpy().T, truth, rtol=1e-3, atol=tolerance)
            assert np.allclose(bsdf.pdf(a, b).numpy(), bsdf.pdf(wi, wo), rtol=1e-3, atol=tolerance)
            assert np.allclose(bsdf.reflectance(a).numpy().T, bsdf.reflectance(wi), atol=tolerance)
            sample = bsdf.sample(a, kind(0.3, 0.6, 0.9))
            there = bsdf.sample(wi, np.full((1, 3), (0.3, 0.6, 0.9)))
            assert np.mean(np.abs(sample.wo.numpy().T - there.wo).max(axis=1) < 1e-3) > 0.9
            assert isinstance(sample.weight, kind) and dr.is_mask_v(sample.delta)


def test_symbolic_calls_take_it() -> None:
    """Everything is evaluated beforehand, so it may be traced: within a loop, as a renderer does."""
    from drjit.llvm.ad import Array3f, Float, UInt

    bsdf = solved("pane")
    wi, wo = Array3f(0.6, 0, 0.8), Array3f(-0.6, [0, 0.1], 0.8)
    direct = bsdf.eval(wi, wo).x
    _, total = dr.while_loop(
        (UInt(0), Float(0, 0)),
        lambda i, _: i < 3,
        lambda i, s: (i + 1, s + bsdf.eval(wi, wo).x + 0 * bsdf.sample(wi, wo * 0.5).pdf),
        mode="symbolic",
    )
    assert np.allclose(total.numpy(), 3 * direct.numpy(), rtol=1e-5)


def test_shapes() -> None:
    wi, wo = pairs(3)
    bsdf = solved("coat")
    assert bsdf.eval(wi, wo).shape == (len(wi), 3) and bsdf.eval(wi[0], wo[0]).shape == (3,)
    assert bsdf.eval(wi[:1], wo).shape == (len(wo), 3) and bsdf.pdf(wi, wo).shape == (len(wi),)
    assert bsdf.reflectance(wi[0]).shape == (3,) and np.ndim(bsdf.pdf(wi[0], wo[0])) == 0
    sample = bsdf.sample(wi[0], np.array([0.1, 0.2, 0.3]))
    assert sample.wo.shape == (3,) and sample.weight.shape == (3,) and np.ndim(sample.pdf) == 0
    assert bsdf.sample(wi[0], np.full((5, 3), 0.4)).wo.shape == (5, 3)


# ------------------------------------------------------------------------------------------------------- physics


@pytest.mark.parametrize("name", ["slab", "pane", "coat"])
def test_energies_are_integrals_of_values(name: str) -> None:
    """Reflectance and transmittance, from their own table, are what `eval` integrates to, with the delta parts."""
    bsdf, slices = solved(name, mode="importance"), np.full((64, 3), 0.5)
    slices[:, 0] = midpoints(64)
    x, weight = gauss(32, 0, 1)
    # Panels between the cosines at which something in the pane is totally reflected, dense at their lower ends.
    ends = {1: [0.0, 1.0], -1: [0.0, np.sqrt(1 - (1.33 / 1.6) ** 2), np.sqrt(1 - (1 / 1.6) ** 2), 1.0]}
    for mu in (1.0, 0.7, 0.2):
        for side in (1, -1) if name != "coat" else (1,):
            wi = direction(mu, 0.2) * (1, 1, side)
            sharp = bsdf.sample(wi[None], slices)
            for up, energy in ((side, bsdf.reflectance(wi)), (-side, bsdf.transmittance(wi))):
                here = sharp.delta & (sharp.wo[:, 2] * up > 0)
                value = (sharp.weight[here] * sharp.pdf[here][:, None])[:1].sum(axis=0)
                for low, high in pairwise(ends[up if name == "pane" else 1]):
                    cos, phi = np.meshgrid(
                        low + (high - low) * x**2, 2 * np.pi * midpoints(64), indexing="ij"
                    )
                    solid = np.repeat(2 * x * weight * (high - low), 64) * (2 * np.pi / 64)
                    value = value + solid @ bsdf.eval(
                        wi[None], direction(cos.ravel(), phi.ravel()) * (1, 1, up)
                    )
                assert np.allclose(value, energy, atol=2e-4 + bsdf.diagnostics["estimated_error"]), (
                    mu,
                    side,
                    up,
                )


def test_delta_parts_have_no_error() -> None:
    """Fresnel's slab and a clear coat on metal: the geometric series, not an interpolation."""
    mu = np.array([1.0, 0.83, 0.41, 0.013])
    cos = np.sqrt(1 - (1 - mu**2) / 2.25)
    r = 0.5 * (((mu - 1.5 * cos) / (mu + 1.5 * cos)) ** 2 + ((1.5 * mu - cos) / (1.5 * mu + cos)) ** 2)
    t = np.exp(-0.3 / cos)
    bsdf = solved("clear")
    passed = (1 - r) ** 2 * t / (1 - (r * t) ** 2)
    assert np.allclose(bsdf.transmittance(direction(mu))[:, 0], passed, rtol=1e-9)
    assert np.allclose(bsdf.reflectance(direction(mu))[:, 0], r + r * t * passed, rtol=1e-9)
    assert not bsdf.eval(*pairs()).any() and not bsdf.pdf(*pairs()).any()
    walk = ur.solve(STACKS["metal"], "walk", samples=1 << 12)
    value, error = walk.reflectance(direction(mu), with_error=True)
    assert (np.abs(solved("metal").reflectance(direction(mu)) - value) < 4 * error + 1e-6).all()


@pytest.mark.parametrize("name", ["slab", "pane", "coat"])
def test_reciprocity(name: str) -> None:
    """f(wi, wo) n_i^-2 = f(wo, wi) n_o^-2: by the symmetry of what is interpolated, so to rounding."""
    bsdf, (wi, wo) = solved(name, mode="importance"), pairs()
    keep = (np.abs(wi[:, 2]) > 1e-5) & (np.abs(wo[:, 2]) > 1e-5)
    wi, wo = wi[keep], wo[keep]
    below = 1.6 if name == "pane" else 1.0
    n_i, n_o = (np.where(w[:, 2] > 0, 1.0, below)[:, None] for w in (wi, wo))
    there = bsdf.eval(wi, wo) / (np.abs(wo[:, 2:]) * n_o**2)
    back = bsdf.eval(wo, wi) / (np.abs(wi[:, 2:]) * n_i**2)
    assert np.allclose(there, back, rtol=1e-6, atol=1e-6 * there.max())


def test_radiance_is_scaled_by_the_squared_index() -> None:
    wi, wo = pairs()
    radiance, flux = solved("pane").eval(wi, wo), solved("pane", mode="importance").eval(wi, wo)
    n_i, n_o = (np.where(w[:, 2:] > 0, 1.0, 1.6) for w in (wi, wo))
    assert np.allclose(radiance, flux * (n_i / n_o) ** 2, rtol=1e-12)
    bsdf, u = solved("pane"), np.random.default_rng(2).random((len(wi), 3))
    one, other = bsdf.sample(wi, u), solved("pane", mode="importance").sample(wi, u)
    ratio = (n_i / np.where(one.wo[:, 2:] > 0, 1.0, 1.6)) ** 2
    assert np.allclose(one.weight, other.weight * ratio, rtol=1e-12)


def test_beyond_the_horizon() -> None:
    """Below an opaque stack there is nothing; in the plane of the surface neither."""
    bsdf, (wi, wo) = solved("coat"), pairs()
    below = (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    assert not bsdf.eval(wi, wo)[below].any() and bsdf.eval(wi, wo)[~below].all()
    assert not bsdf.reflectance(wi)[wi[:, 2] <= 0].any() and not bsdf.transmittance(wi).any()
    flat = np.array([[1.0, 0, 0]])
    assert (
        not solved("pane").eval(flat, direction(0.5)[None]).any()
        and not solved("pane").reflectance(flat).any()
    )


# --------------------------------------------------------------------------------------------- what it says of itself


def test_the_error_is_relative_to_the_peak() -> None:
    import drjit.llvm.ad
    from drjit.llvm.ad import Array3f64

    bsdf = solved("coat")
    wi, wo = pairs()
    up = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    value, error = bsdf.eval(wi[up], wo[up], with_error=True)
    expected = bsdf.diagnostics["estimated_error"]
    assert np.array_equal(value, bsdf.eval(wi[up], wo[up])) and (error > 0).all()
    # The largest f is that of the table, here what lies under the coat.
    core = bsdf.core(drjit.llvm.ad, True)
    rng = np.random.default_rng(8)
    there = direction(rng.uniform(0, 1, 4000), rng.uniform(0, 7, 4000))
    for mu in (1.0, 0.6, 0.2):
        _, error = bsdf.eval(direction(mu), there, with_error=True)
        found = np.array(core.tabulated(Array3f64(*map(float, direction(mu))), Array3f64(there.T.copy())))
        peak = error[:, 0] / (expected * there[:, 2])
        assert np.ptp(peak) < 1e-9 and 0.9 * peak[0] < (found / there[:, 2]).max() < 1.001 * peak[0]
    value, error = bsdf.reflectance(wi, with_error=True)
    assert np.array_equal(value, bsdf.reflectance(wi)) and np.allclose(error, expected)


@pytest.mark.parametrize("name", ["slab", "pane", "coat"])
def test_matrices(name: str) -> None:
    """Columns of order 0 are the energies of the nodes; with the etendue of its nodes an operator is symmetric."""
    bsdf = solved(name)
    matrices = bsdf.matrices
    above = direction(matrices.mu[0], 0.0)
    assert np.allclose(matrices.operator(0).sum(axis=1).T[:, 0], bsdf.reflectance(above)[:, 0], atol=1e-9)
    index = [1.0, 1.6 if name == "pane" else 1.0]
    etendue = [w * mu * n**2 for w, mu, n in zip(matrices.weights, matrices.mu, index, strict=False)]
    for order in (0, 1, matrices.orders - 1):
        symmetric = matrices.operator(order) / etendue[0][:, None]
        assert np.allclose(symmetric, np.swapaxes(symmetric, 1, 2), atol=1e-9 * symmetric.max() + 1e-14)
        if name != "coat":
            down = matrices.operator(order, True, False) / etendue[1][:, None]
            up = matrices.operator(order, False, True) / etendue[0][:, None]
            assert np.allclose(down, np.swapaxes(up, 1, 2), atol=1e-9 * down.max() + 1e-14)
    assert not matrices.operator(matrices.orders)[:, 0, 1:].any()
    if name != "coat":
        energy = matrices.operator(0, True, False).sum(axis=1).T
        assert np.allclose(energy, bsdf.transmittance(above)[:, : energy.shape[1]], atol=1e-9)


def test_wrong_arguments_are_named() -> None:
    bsdf = solved("coat")
    up = direction(0.5)
    for call, words in (
        (lambda: bsdf.eval(up, [1, 2, 3]), "wo.*length"),
        (lambda: bsdf.eval(np.ones((2, 2)), up), r"wi.*shape"),
        (lambda: bsdf.pdf([np.nan, 0, 1], up), "finite"),
        (lambda: bsdf.sample(up, [1.0, 0, 0]), r"u.*\[0, 1\)"),
        (lambda: bsdf.eval(np.tile(up, (2, 1)), np.tile(up, (3, 1))), "rows"),
        (lambda: bsdf.matrices.operator(0, False, True), "opaque"),
        (lambda: bsdf.matrices.operator(-1), "order.*-1"),
        (lambda: solved("coat", order=5), "order.*5.*2, 4, 6, 8"),
        (lambda: solved("coat", mode="flux"), "mode.*radiance"),
        (lambda: solved("coat", precision="half"), "precision"),
        (lambda: solved("coat", backend="metal"), "backend"),
        (lambda: AddingBSDF(STACKS["slab"], operators("coat")), "another stack"),
    ):
        with pytest.raises(UrushiError, match=words):
            call()
    bare = operators("slab")
    silent = AddingBSDF(STACKS["slab"], type(bare)(**(vars(bare) | {"diagnostics": {}})))
    for call in (partial(silent.eval, up), silent.reflectance, silent.transmittance, silent.absorption):
        with pytest.raises(UrushiError, match="no estimate"):
            call(up, with_error=True)


def test_diagnostics() -> None:
    said = solved("pane").diagnostics
    assert said["method"] == "adding" and said["closed_form"] == "single" and said["channels"] == 3
    assert said["nodes"] > 0 and said["azimuthal_terms"] > 0 and said["table_bytes"] > 0
    assert solved("coat").diagnostics["closed_form"] == "interface"
