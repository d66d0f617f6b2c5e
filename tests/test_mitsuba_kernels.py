"""Numbers are variables of the compiled code: another number compiles nothing anew."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import numpy as np
import pytest

from mitsuba_plugin import OTHER, above, context, interaction, layered, vectors, write


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
