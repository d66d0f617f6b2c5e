"""`mi.traverse`: what the parameters are called, that setting them is as good as loading others, and that numbers
compile nothing anew."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba
import numpy as np
import pytest
import yaml

from conftest import LLVM
from mitsuba_plugin import Asked, above, context, interaction, layered, vectors


def write(tmp_path, **changes) -> str:
    """A material file with every kind of number in it."""
    numbers = {
        "ior": 1.5,
        "alpha": 0.2,
        "depth": 0.7,
        "albedo": [0.8, 0.5, 0.3],
        "g": 0.4,
        "u": 0.1,
        "v": 0.3,
        "k": 3.0,
    }
    numbers.update(changes)
    stack = {
        "urushi": 1,
        "layers": [
            {"dielectric": {"ior": numbers["ior"], "alpha": numbers["alpha"]}},
            {
                "medium": {
                    "depth": numbers["depth"],
                    "albedo": numbers["albedo"],
                    "phase": {"henyey_greenstein": {"g": numbers["g"]}},
                }
            },
            {"conductor": {"eta": [0.2, 0.9, 1.4], "k": numbers["k"], "alpha": [numbers["u"], numbers["v"]]}},
        ],
    }
    path = tmp_path / "stack.yaml"
    path.write_text(yaml.safe_dump(stack))
    return str(path)


NAMES = {
    "layer_0.ior": "ior",
    "layer_0.alpha": "alpha",
    "layer_1.depth": "depth",
    "layer_1.albedo": "albedo",
    "layer_1.phase.g": "g",
    "layer_2.k": "k",
    "layer_2.alpha_u": "u",
    "layer_2.alpha_v": "v",
}
OTHER = {
    "ior": 1.3,
    "alpha": 0.35,
    "depth": 1.2,
    "albedo": [0.2, 0.6, 0.9],
    "g": 0.2,
    "u": 0.25,
    "v": 0.15,
    "k": 2.0,
}


def test_the_names_are_those_of_the_description(mi, tmp_path):
    parameters = mi.traverse(layered(mi, filename=write(tmp_path)))
    others = {"layer_0.rotation", "layer_2.rotation", "layer_2.eta"}
    assert set(dict(parameters).keys()) == set(NAMES) | others
    textured = layered(mi, filename="preset:varnished-wood")
    names = set(dict(mi.traverse(textured)).keys())
    assert {"layer_0.alpha.data", "layer_1.depth", "layer_1.albedo", "layer_2.reflectance.data"} <= names


def everything(mi, bsdf, wi, wo, u, uv) -> tuple[np.ndarray, ...]:
    asked = Asked.of(mi, bsdf, wi, uv=uv)
    sample, weight = asked.sample(u)
    return asked.value(wo), asked.density(wo), np.array(sample.wo).T, weight


@pytest.mark.parametrize("name", [*NAMES, "all at once"])
def test_setting_a_value_is_loading_a_stack_with_it(mi, rng, tmp_path, name):
    """eval, pdf and sample give the same bits; and others than before."""
    wi, wo, u, uv = above(rng, 500), above(rng, 500), rng.random((500, 3)), rng.random((500, 2))
    changes = OTHER if name == "all at once" else {NAMES[name]: OTHER[NAMES[name]]}
    bsdf = layered(mi, filename=write(tmp_path))
    before = everything(mi, bsdf, wi, wo, u, uv)
    parameters = mi.traverse(bsdf)
    for key, ours in NAMES.items():
        if ours in changes:
            value = changes[ours]
            parameters[key] = mi.Color3f(*value) if isinstance(value, list) else value
    parameters.update()
    found = everything(mi, bsdf, wi, wo, u, uv)
    truth = everything(mi, layered(mi, filename=write(tmp_path, **changes)), wi, wo, u, uv)
    for one, other in zip(found, truth, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.mean(before[0] != found[0]) > 0.5


@pytest.mark.skipif(not LLVM, reason="no LLVM")
def test_a_rough_surface_may_become_smooth_and_back(mi, rng, tmp_path):
    """The flags follow, and so does what is sampled."""
    bsdf = layered(mi, filename=write(tmp_path))
    parameters, flags = mi.traverse(bsdf), mi.BSDFFlags
    seen = [bool(mi.has_flag(bsdf.flags(), flags.DeltaReflection))]
    for alpha in (0.0, 0.3):
        parameters["layer_0.alpha"] = alpha
        parameters.update()
        sample, _ = Asked.of(mi, bsdf, above(rng, 2000)).sample(rng.random((2000, 3)))
        some = bool(np.any(np.array(sample.sampled_type) & int(flags.DeltaReflection)))
        assert some == bool(mi.has_flag(bsdf.flags(), flags.DeltaReflection))
        assert (bsdf.component_count() == 2) == some
        seen.append(some)
    assert seen == [False, True, False]


def test_values_can_be_set_in_scalar_variants(tmp_path):
    """Where numbers are plain floats, which Mitsuba cannot set in a plugin of Python's."""
    mi = mitsuba
    mi.set_variant("scalar_rgb")
    ctx, si = mi.BSDFContext(), dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    bsdf = layered(mi, filename=write(tmp_path))
    other = layered(mi, filename=write(tmp_path, alpha=0.35, albedo=[0.2, 0.6, 0.9]))
    parameters = mi.traverse(bsdf)
    parameters["layer_0.alpha"] = 0.35
    parameters["layer_1.albedo"] = mi.Color3f(0.2, 0.6, 0.9)
    parameters.update()
    values = [np.array(b.eval(ctx, si, mi.Vector3f(-0.6, 0, 0.8))) for b in (bsdf, other)]
    np.testing.assert_allclose(*values, rtol=1e-6)
    np.testing.assert_allclose(np.array(parameters["layer_0.alpha"]), 0.35)


@pytest.fixture
def history() -> Iterator[None]:
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    yield
    dr.kernel_history_clear()
    dr.set_flag(dr.JitFlag.KernelHistory, before)


def kernels(ask) -> set[str]:
    """The hashes of the kernels that a question launches."""
    dr.kernel_history_clear()
    dr.eval(ask())
    found = {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}
    assert found
    return found


def questions(mi, bsdf, rng):
    """eval, pdf, sample and albedo in one kernel."""
    si, wo, ctx = (
        interaction(mi, above(rng, 64), uv=rng.random((64, 2))),
        vectors(mi, above(rng, 64)),
        context(mi),
    )
    u = mi.Float(np.float32(rng.random(64))), mi.Point2f(np.float32(rng.random((2, 64))))
    dr.eval(si, wo, u)
    return lambda: (
        bsdf.eval(ctx, si, wo),
        bsdf.pdf(ctx, si, wo),
        bsdf.sample(ctx, si, *u),
        bsdf.eval_diffuse_reflectance(si),
    )


def test_another_number_compiles_nothing(mi, rng, tmp_path, history):
    """Stacks of one structure share kernels: freshly loaded, set by `mi.traverse`, or given another seed."""
    first = kernels(questions(mi, layered(mi, filename=write(tmp_path)), rng))
    bsdf = layered(mi, filename=write(tmp_path, **OTHER), seed=3)
    assert kernels(questions(mi, bsdf, rng)) == first
    parameters = mi.traverse(bsdf)
    for alpha in (0.1, 0.4):
        parameters["layer_0.alpha"] = alpha
        parameters["layer_1.albedo"] = mi.Color3f(alpha, 0.5, 0.7)
        parameters["layer_2.alpha_u"] = alpha
        parameters.update()
        assert kernels(questions(mi, bsdf, rng)) == first
    # The planted fault: another structure is another kernel.
    assert kernels(questions(mi, layered(mi, filename=write(tmp_path, alpha=0.0)), rng)) != first


def test_another_number_compiles_nothing_in_children(mi, rng, history):
    """The same for nested plugins."""

    def nested(a: float, grey: float):
        return layered(
            mi,
            layer_0={"type": "roughdielectric", "alpha": a, "int_ior": 1.4 + a, "ext_ior": 1.0},
            layer_1={
                "type": "homogeneous",
                "albedo": {"type": "rgb", "value": [0.5, grey, 0.1]},
                "sigma_t": a,
            },
            layer_2={"type": "diffuse", "reflectance": grey},
        )

    first, second = nested(0.1, 0.2), nested(0.3, 0.7)
    known = kernels(questions(mi, first, rng))
    assert kernels(questions(mi, second, rng)) == known
    parameters = mi.traverse(second)
    parameters["layer_0.alpha.value"] = 0.5
    parameters["layer_1.albedo"] = mi.Color3f(0.1, 0.2, 0.3)
    parameters.update()
    assert kernels(questions(mi, second, rng)) == known


def test_another_number_compiles_nothing_in_a_render(mi, tmp_path, history):
    """Scenes that differ in the numbers of a stack only."""

    def render(**changes):
        bsdf = {"type": "layered", "filename": write(tmp_path, **changes)}
        look = mi.ScalarTransform4f().look_at([0, 1, 3], [0, 0, 0], [0, 1, 0])
        film = {"type": "hdrfilm", "width": 8, "height": 8}
        layered(mi, filename=bsdf["filename"])
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 3},
                "light": {"type": "constant"},
                "ball": {"type": "sphere", "bsdf": bsdf},
                "camera": {"type": "perspective", "to_world": look, "film": film},
            }
        )
        return kernels(lambda: mi.render(scene, spp=4))

    assert render() == render(**OTHER)


def test_it_prints_what_it_is(mi, tmp_path):
    """Every option, every layer, every value that it has now."""
    bsdf = layered(mi, filename=write(tmp_path), samples=3, seed=7, max_depth=20)
    parameters = mi.traverse(bsdf)
    parameters["layer_0.alpha"] = 0.125
    parameters.update()
    text = str(bsdf)
    for words in (
        *("samples = 3", "seed = 7", "max_depth = 20", "method = walk", "exterior = 1.0"),
        *(
            "dielectric ggx correlated",
            "ior = 1.5",
            "alpha = 0.125",
            "medium henyey_greenstein",
            "depth = 0.7",
        ),
        *(
            "albedo = 0.8, 0.5, 0.3",
            "phase.g = 0.4",
            "eta = 0.2, 0.9, 1.4",
            "k = 3",
            "alpha_u = 0.1",
            "alpha_v = 0.3",
        ),
    ):
        assert words in text, words
    assert "Bitmap" in str(layered(mi, filename="preset:varnished-wood"))
