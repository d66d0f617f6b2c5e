"""The plugin with the method adding: the numbers of the Python result, textures between solved corners, the cache."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from lanes import direction, needs_llvm
from mitsuba_plugin import IMPORTANCE, RADIANCE, Asked, layered
from test_mitsuba_sampling import chi2
from test_mitsuba_textures import checks
from urushi.adapters.mitsuba import adding

pytestmark = needs_llvm

NODES = 12
"""Few nodes: the plugin must give what the solution says, however good that is."""

COATED = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.3),
        ur.Medium(depth=(0.2, 0.5, 1.0), albedo=0.8, phase=ur.HenyeyGreenstein(g=0.3)),
        ur.Diffuse(reflectance=(0.8, 0.5, 0.2)),
    ]
)
PANE = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.5),
        ur.Medium(depth=1.0, albedo=0.9, phase=ur.Rayleigh()),
        ur.Dielectric(ior=1.33),
    ]
)
COAT = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3, "int_ior": 1.5, "ext_ior": 1.0}
WHITE = {"type": "diffuse", "reflectance": 0.8}


def written(folder, stack: ur.Stack) -> str:
    ur.save(stack, folder / "stack.yaml")
    return str(folder / "stack.yaml")


def directions(count: int, both: bool) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    wi, wo = rng.normal(size=(2, count, 3))
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    return (wi, wo) if both else (wi * np.sign(wi[:, 2:]), wo * np.sign(wo[:, 2:]))


@pytest.mark.parametrize("mode", [RADIANCE, IMPORTANCE])
@pytest.mark.parametrize("stack", [COATED, PANE], ids=["coated", "pane"])
def test_the_plugin_gives_what_the_solution_says(mi, tmp_path, stack, mode):
    plugin = layered(mi, filename=written(tmp_path, stack), method="adding", nodes=NODES)
    solved = ur.solve(stack, "adding", nodes=NODES, mode=mode.lower())
    wi, wo = directions(200, both=stack is PANE)
    asked = Asked.of(mi, plugin, wi, mode)
    np.testing.assert_allclose(asked.value(wo), solved.eval(wi, wo), rtol=2e-3, atol=2e-5)
    np.testing.assert_allclose(asked.density(wo), solved.pdf(wi, wo), rtol=2e-3, atol=2e-5)
    u = np.random.default_rng(5).random((200, 3))
    sample, weight = asked.sample(u)
    expected = solved.sample(wi, u.astype(np.float32).astype(float))
    same = np.abs(np.array(sample.wo).T - expected.wo).max(axis=1) < 1e-3
    assert same.mean() > 0.97  # a sample at the very edge of a choice may fall on its other side
    np.testing.assert_allclose(weight[same], expected.weight[same], rtol=2e-2, atol=1e-3)


@pytest.mark.parametrize("cos", [0.8, 0.15])
def test_samples_fall_where_the_density_says(mi, tmp_path, cos):
    plugin = layered(mi, filename=written(tmp_path, COATED), method="adding", nodes=NODES)
    assert chi2(mi, plugin, direction(cos, 0.4))


def test_the_albedo_is_that_of_the_solution(mi, tmp_path):
    plugin = layered(mi, filename=written(tmp_path, COATED), method="adding", nodes=NODES)
    wi, _ = directions(20, both=False)
    asked = Asked.of(mi, plugin, wi)
    albedo = np.array(plugin.eval_diffuse_reflectance(asked.si)).T
    solved = ur.solve(COATED, "adding", nodes=NODES).reflectance(wi)
    np.testing.assert_allclose(albedo, solved, atol=1e-4)


def test_a_texture_is_solved_at_its_corners(mi):
    """On the values of a corner a texture is the plain material; half-way it is near it."""
    wi, wo = directions(100, both=False)
    textured = layered(
        mi,
        method="adding",
        nodes=NODES,
        corners=3,
        layer_0=COAT | {"alpha": checks(0.2, 0.6)},
        layer_1=WHITE,
    )
    uv = {0.2: (0.25, 0.25), 0.6: (0.75, 0.25)}
    for alpha, place in uv.items():
        plain = layered(mi, method="adding", nodes=NODES, layer_0=COAT | {"alpha": alpha}, layer_1=WHITE)
        here, there = Asked.of(mi, textured, wi, uv=place), Asked.of(mi, plain, wi)
        np.testing.assert_allclose(here.value(wo), there.value(wo), rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(here.density(wo), there.density(wo), rtol=1e-3, atol=1e-5)


def test_between_the_corners(mi):
    """What is interpolated is linear in reflectance nowhere, and yet near; what has a closed form is exact."""
    wi, wo = directions(100, both=False)
    image = np.full((4, 4, 1), 0.5, np.float32)
    image[0, 0], image[3, 3] = 0.2, 0.8
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "filter_type": "nearest"}
    textured = layered(
        mi,
        method="adding",
        nodes=NODES,
        corners=5,
        layer_0=COAT,
        layer_1={"type": "diffuse", "reflectance": bitmap},
    )
    plain = layered(
        mi, method="adding", nodes=NODES, layer_0=COAT, layer_1={"type": "diffuse", "reflectance": 0.5}
    )
    here, there = Asked.of(mi, textured, wi, uv=(0.5, 0.5)), Asked.of(mi, plain, wi)
    np.testing.assert_allclose(here.value(wo), there.value(wo), rtol=0.02, atol=1e-5)
    assert chi2(mi, textured, direction(0.6, 0.4))


def test_a_corner_where_nothing_is_scattered(mi, tmp_path):
    """Black dye in some places takes nothing from the light that is scattered once in others."""
    squares = np.array([[0.0, 0.8], [0.8, 0.0]], np.float32)[..., None]
    mi.Bitmap(squares).write(str(tmp_path / "dye.exr"))

    def layers(albedo):
        return ur.Stack(layers=[ur.Medium(depth=1.0, albedo=albedo), ur.Diffuse(reflectance=0.3)])

    wi, wo = directions(100, both=False)
    image = ur.Texture(file=str(tmp_path / "dye.exr"), raw=True)
    options = {"method": "adding", "nodes": NODES}
    textured = layered(mi, filename=written(tmp_path, layers(image)), corners=2, **options)
    plain = layered(mi, filename=written(tmp_path, layers(0.8)), **options)
    here, there = Asked.of(mi, textured, wi, uv=(0.75, 0.25)), Asked.of(mi, plain, wi)
    np.testing.assert_allclose(here.value(wo), there.value(wo), rtol=1e-3, atol=1e-5)


def test_a_material_is_solved_once(mi, tmp_path, monkeypatch):
    name = written(tmp_path, COATED)
    solved = []
    plain = adding.solution
    monkeypatch.setattr(adding, "_solved", type(adding._solved)())
    monkeypatch.setattr(adding, "solution", lambda *given, **more: solved.append(1) or plain(*given, **more))
    for _ in range(3):
        plugin = layered(mi, filename=name, method="adding", nodes=NODES)
    assert len(solved) == 1
    parameters = mi.traverse(plugin)
    before = np.array(plugin.eval_diffuse_reflectance(Asked.of(mi, plugin, np.array([[0.0, 0.0, 1.0]])).si))
    parameters["layer_2.reflectance"] = mi.Color3f(0.1)
    parameters.update()
    assert len(solved) == 2
    after = np.array(plugin.eval_diffuse_reflectance(Asked.of(mi, plugin, np.array([[0.0, 0.0, 1.0]])).si))
    assert np.all(after < before)


def test_large_solutions_make_room(mi, tmp_path, monkeypatch):
    """The last one stays, whatever it takes."""
    monkeypatch.setattr(adding, "_solved", type(adding._solved)())
    coats = [ur.Stack(layers=[ur.Dielectric(ior=n), ur.Diffuse(reflectance=0.5)]) for n in (1.4, 1.5)]
    for coat in coats:
        layered(mi, filename=written(tmp_path, coat), method="adding", accuracy=0.1)
    assert len(adding._solved) == 2
    monkeypatch.setattr(adding, "BYTES", 0)
    layered(mi, filename=written(tmp_path, coats[0]), method="adding", accuracy=0.2)
    assert [key[1] for key in adding._solved] == [0.2]


def test_what_it_refuses(mi, tmp_path):
    brushed = ur.Stack(layers=[ur.Conductor(material="Al", alpha=(0.1, 0.4))])
    with pytest.raises(RuntimeError, match="anisotropic"):
        layered(mi, filename=written(tmp_path, brushed), method="adding")
    with pytest.raises(RuntimeError, match=r"samples.*no option of method 'adding'"):
        layered(mi, filename=written(tmp_path, COATED), method="adding", samples=4)
    with pytest.raises(RuntimeError, match=r"accuracy.*no option of method 'walk'"):
        layered(mi, filename=written(tmp_path, COATED), accuracy=1e-2)
    with pytest.raises(RuntimeError, match=r"accuracy.*allowed: a number from 1e-9"):
        layered(mi, filename=written(tmp_path, COATED), method="adding", accuracy=3.0)
    many = {f"layer_{i}": COAT | {"alpha": checks(0.2, 0.6)} for i in range(3)}
    with pytest.raises(RuntimeError, match="125 stacks to solve"):
        layered(mi, method="adding", **many, layer_3=WHITE)


def test_other_variants(mi, tmp_path):
    """Scalar gives the same; monochrome gives what lies among the colours."""
    name = written(tmp_path, COATED)
    wi, wo = direction(0.8, 0.1), direction(0.6, 2.0)
    found = {}
    before = mi.variant()
    try:
        for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_mono"):
            mi.set_variant(variant)
            plugin = layered(mi, filename=name, method="adding", nodes=NODES)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wi = mi.Vector3f(*map(float, wi))
            found[variant] = np.ravel(
                np.array(plugin.eval(mi.BSDFContext(), si, mi.Vector3f(*map(float, wo))))
            )
    finally:
        mi.set_variant(before)
    np.testing.assert_allclose(found["scalar_rgb"], found["llvm_ad_rgb"], rtol=1e-4)
    assert found["llvm_ad_rgb"].min() < found["llvm_ad_mono"][0] < found["llvm_ad_rgb"].max()
