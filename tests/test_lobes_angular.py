"""Lobes tabulated over the angle: as the recursion has them, made anew when numbers change, left out where need be."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

import urushi as ur
from conftest import LLVM
from lanes import needs_llvm

if LLVM is not None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

    from urushi.solvers.lobes import angular, rows
    from urushi.solvers.lobes.result import LobesBSDF

pytestmark = needs_llvm

GOLD = {"eta": 0.2, "k": 3.9}


def _stack(kind: str, rng: np.random.Generator) -> ur.Stack:
    def rough() -> ur.Dielectric:
        return ur.Dielectric(
            ior=rng.uniform(1.2, 2.2), alpha=float(np.exp(rng.uniform(*np.log([0.02, 0.8]))))
        )

    def medium() -> ur.Medium:
        phase = ur.HenyeyGreenstein(g=rng.uniform(-0.5, 0.9))
        return ur.Medium(depth=rng.uniform(0.05, 2), albedo=rng.uniform(0.3, 0.99), phase=phase)

    base = ur.Conductor(**GOLD, alpha=float(rng.uniform(0.05, 0.5)))
    water = ur.Dielectric(ior=1.33, alpha=float(rng.uniform(0.05, 0.5)))
    layers = {
        "coat on metal": [rough(), base],
        "three interfaces and two media": [rough(), ur.Medium(0.3, albedo=0.0), rough(), medium(), base],
        "a sheet on water": [rough(), water],
        "a medium under a coat": [rough(), medium(), ur.Diffuse((0.2, 0.5, 0.8))],
        "a rough diffuse base": [rough(), ur.Diffuse(0.7, alpha=0.4)],
    }
    return ur.Stack(layers=layers[kind])


SLOW = pytest.mark.slow
KINDS = (
    "coat on metal",
    pytest.param("three interfaces and two media", marks=SLOW),
    pytest.param("a sheet on water", marks=SLOW),
    "a medium under a coat",
    "a rough diffuse base",
)


def _core(stack: ur.Stack, **options: object):
    bsdf = LobesBSDF(stack, **options)
    return bsdf._core(bsdf._module, bsdf.double)[0]


def _directions(count: int, above: bool, rng: np.random.Generator) -> Array3f:
    """All angles, evenly by u: more of them near the horizon."""
    cos, phi = np.maximum(rng.random(count), 1e-3) ** 2, 2 * np.pi * rng.random(count)
    sin = np.sqrt(1 - cos**2)
    z = cos if above else -cos
    return Array3f(*(Float(v.astype(np.float32)) for v in (sin * np.cos(phi), sin * np.sin(phi), z)))


def _array(value: object, w: Array3f) -> np.ndarray:
    array = np.array(value + 0 * w.x, dtype=float)
    return array.mean(axis=0) if array.ndim == 2 else array


# --- as the recursion ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*KINDS[:2], "a sheet on water", *KINDS[3:]])
def test_between_the_rows(kind: str, rng: np.random.Generator) -> None:
    """But for one angle in a hundred, where the recursion itself may jump."""
    for _ in range(5):
        core = _core(_stack(kind, rng))
        sides = angular.tabulate(core, Array3f)
        assert list(sides) == list(core.sides)
        for above, side in sides.items():
            assert side.bytes <= angular.BYTES
            w = _directions(4000, above, rng)
            exact, found = core.find(w, above), side.find(w)
            assert [field.name for field in fields(exact)] == [field.name for field in fields(found)]
            for name in {field.name for field in fields(exact)} - {"lobes", "first"}:
                error = np.abs(_array(getattr(found, name), w) - _array(getattr(exact, name), w))
                assert np.quantile(error, 0.99) < angular.LIMITS["energy"]
            for a, b in zip(exact.all(), found.all(), strict=True):
                assert (a.same, a.layer, a.kind) == (b.same, b.layer, b.kind)
                energy = _array(a.energy, w)
                assert np.quantile(np.abs(_array(b.energy, w) - energy), 0.99) < angular.LIMITS["energy"]
                bright = np.minimum(energy / angular.FAINT, 1)
                for wanted, got in zip(_widths(a, w), _widths(b, w), strict=True):
                    assert np.quantile(np.abs(got / wanted - 1) * bright, 0.99) < angular.LIMITS["shape"]
                far = np.linalg.norm(np.array(a.axis - b.axis), axis=0) * bright
                narrow = _widths(a, w)[0]
                assert np.quantile(far / narrow, 0.99) < 0.015


def _widths(lobe: object, w: Array3f) -> tuple[np.ndarray, np.ndarray]:
    """Narrowest and widest roughness."""
    x, y = _array(lobe.alpha_x, w), _array(lobe.alpha_y, w)
    return np.minimum(x, y), np.maximum(x, y)


def test_a_lobe_of_two_widths_lies_in_the_plane_of_incidence(rng: np.random.Generator) -> None:
    """Light through two rough interfaces at every azimuth: beside the plane of incidence, too, its values are those of
    the recursion."""
    core = _core(ur.Stack(layers=[ur.Dielectric(ior=1.8, alpha=0.2), ur.Dielectric(ior=1.33, alpha=0.1)]))
    (side,) = (table for above, table in angular.tabulate(core, Array3f).items() if above)
    w = _directions(2000, True, rng)
    w = dr.select(w.z > 0.2, w, Array3f(0.6, 0.0, 0.8))
    turn = Float((2 * np.pi * rng.random(2000)).astype(np.float32))
    two = 0
    for exact, found in zip(core.find(w, True).all(), side.find(w).all(), strict=True):
        narrow, wide = _widths(exact, w)
        two += int(np.median(wide / narrow) > 1.1)
        o = dr.normalize(exact.direction() + Array3f(0.2 * dr.cos(turn), 0.2 * dr.sin(turn), 0))
        truth, value = _array(exact.value(o), w), _array(found.value(o), w)
        assert np.quantile(np.abs(value - truth), 0.98) < 0.01 * truth.max()
    assert two


@pytest.mark.parametrize("kind", KINDS)
def test_values_densities_and_samples(kind: str, rng: np.random.Generator) -> None:
    """Of the whole: eval, pdf and sample with tables are those without."""
    stack = _stack(kind, rng)
    quick = LobesBSDF(stack)
    wi = np.array(_directions(2000, True, rng)).T
    if kind == "a sheet on water":
        wi[::2, 2] *= -1
    u = rng.random((len(wi), 3))
    found = quick.sample(wi, u)
    core = quick._core(quick._module, False)[0]
    assert list(core.tables) == list(core.sides)
    keeps = LobesBSDF(stack)
    keeps._core(keeps._module, False)
    keeps._untabulated.clear()
    for a, b in ((quick.eval, keeps.eval), (quick.pdf, keeps.pdf)):
        value, truth = a(wi, found.wo), b(wi, found.wo)
        assert not keeps._core(keeps._module, False)[0].tables
        error = np.abs(value - truth) / np.maximum(np.abs(truth), 1e-3)
        assert np.quantile(error, 0.98) < 0.01
    other = keeps.sample(wi, u)
    # A sample that chose another lobe is another one, and transmitted lobes have their axes the other way round.
    same = other.wo[:, 2] * wi[:, 2] > 0
    assert np.mean(np.linalg.norm(other.wo - found.wo, axis=1)[same] < 0.01) > 0.98
    np.testing.assert_allclose(found.pdf, quick.pdf(wi, found.wo), rtol=1e-3)


def test_a_forward_medium_without_a_coat(rng: np.random.Generator) -> None:
    """What it does not scatter is a lobe as wide at all angles: one number for any count of directions."""
    medium = ur.Medium(depth=1.0, albedo=0.5, phase=ur.HenyeyGreenstein(g=0.5))
    stack = ur.Stack(layers=[medium, ur.Conductor(**GOLD, alpha=0.2)])
    wi, wo = (np.array(_directions(20, True, rng)).T.astype(float) for _ in range(2))
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    table, recursion = (LobesBSDF(stack, precision=p).eval(wi, wo) for p in ("single", "double"))
    np.testing.assert_allclose(table, recursion, rtol=5e-3, atol=1e-4)


def test_energies_of_a_table_in_the_furnace() -> None:
    """What is white by the recursion stays so: reflectance asks the recursion, samples carry what the tables say."""
    complete = {"alpha": 0.3, "multiple_scattering": "compensated"}
    mirror = ur.Conductor(material="none", **complete)
    bsdf = ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, **complete), mirror]), "lobes")
    wi = np.array([[0.6, 0.0, 0.8]])
    w = Array3f(0.6, 0, 0.8)
    bsdf.eval(wi, wi)
    side = bsdf._core(bsdf._module, False)[0].tables[True]
    assert _array(side.find(w).energy(True), w) == pytest.approx(bsdf.reflectance(wi)[0, 0], abs=2e-4)
    assert bsdf.reflectance(wi)[0, 0] == pytest.approx(1, abs=5e-3)


# --- rows ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("critical", [None, 0.6])
@pytest.mark.parametrize("count", [1, 3, 8, 11])
def test_rows_hold_what_they_are_given(critical: float | None, count: int, rng: np.random.Generator) -> None:
    columns = [rng.random(33) for _ in range(count)]
    k = None if critical is None else Float(critical)
    table = rows.Rows(columns, Float, k)
    assert table.bytes == rows.size(count, 32)
    cos = rows.cosines(33, critical)
    found = np.array(table(Float(cos.astype(np.float32))))
    np.testing.assert_allclose(found, columns, atol=2e-3)  # near the critical angle u has few digits
    between = rows.cosines(65, critical)[1::2]
    found = np.array(table(Float(between.astype(np.float32))))
    np.testing.assert_allclose(found, [(c[1:] + c[:-1]) / 2 for c in columns], atol=2e-3)


# --- when there is none ----------------------------------------------------------------------------------------------

COAT, BASE = ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(**GOLD, alpha=0.2)


@pytest.mark.parametrize(
    ("layers", "options"),
    [
        ([COAT, BASE], {"precision": "double"}),
        ([COAT, BASE], {"symmetric": True}),
        ([COAT, BASE], {"published": True}),
        ([COAT, BASE], {"parameters": {"layer_0.alpha": np.array([0.1, 0.2])}}),
        ([COAT, ur.Conductor(**GOLD, alpha=(0.1, 0.2))], {}),
        ([COAT, ur.Conductor(**GOLD, alpha=0.2, normal=(0.1, 0, 0.99))], {}),
        ([ur.Dielectric(ior=1.5), ur.Diffuse(0.5)], {}),
    ],
    ids=["double", "symmetric", "published", "lanes", "anisotropic", "tilted", "smooth"],
)
def test_the_recursion_is_kept(layers: list, options: dict) -> None:
    bsdf = LobesBSDF(ur.Stack(layers=layers), **options)
    wi = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    bsdf.eval(wi, wi)
    assert not bsdf._core(bsdf._module, bsdf.double)[0].tables


def test_derivatives_ask_the_recursion() -> None:
    x = Float(0.1)
    dr.enable_grad(x)
    bsdf = LobesBSDF(ur.Stack(layers=[COAT, BASE]), parameters={"layer_0.alpha": x})
    w = Array3f(0.6, 0, 0.8)
    dr.backward(bsdf.eval(w, Array3f(-0.6, 0, 0.8)).x)
    assert not bsdf._core(bsdf._module, False)[0].tables
    assert abs(dr.grad(x)[0]) > 1e-2


def test_a_table_that_is_not_good_enough_gets_more_rows_or_none(monkeypatch: pytest.MonkeyPatch) -> None:
    core = _core(ur.Stack(layers=[COAT, BASE]))
    coarse = angular.tabulate(core, Array3f)[True]
    monkeypatch.setattr(angular, "LIMITS", {key: limit / 10 for key, limit in angular.LIMITS.items()})
    assert angular.tabulate(core, Array3f)[True].bytes > coarse.bytes
    monkeypatch.setattr(angular, "LIMITS", {key: limit / 300 for key, limit in angular.LIMITS.items()})
    assert angular.tabulate(core, Array3f) == {}


# --- in Mitsuba ------------------------------------------------------------------------------------------------------


@pytest.fixture
def plugin(mi, tmp_path):
    """Loads a coated metal."""
    import urushi.mitsuba  # noqa: F401 (registers the plugin)

    def loaded(alpha: float = 0.1):
        path = tmp_path / f"{alpha}.yaml"
        ur.save(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=alpha), BASE]), path)
        return mi.load_dict({"type": "layered", "filename": str(path), "method": "lobes"})

    return loaded


def _seen(mi, bsdf, alpha: float | None = None) -> tuple[float, str]:
    """The value at one pair of directions, with the parameter set anew, and what code that took."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        if alpha is not None:
            parameters = mi.traverse(bsdf)
            parameters["layer_0.alpha"] = mi.Float(alpha)
            parameters.update()
        si = dr.zeros(mi.SurfaceInteraction3f, 4)
        si.wi = mi.Vector3f(0.6, 0, 0.8)
        value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(-0.5, 0.1, 0.8602))
        dr.eval(value)
        kernels = [h["hash"] for h in dr.kernel_history() if h["type"] == dr.KernelType.JIT]
    return float(value.x[0]), kernels[-1]


def test_a_parameter_that_is_set_makes_another_table(mi, plugin) -> None:
    bsdf = plugin()
    assert bsdf.method._tables
    before, _ = _seen(mi, bsdf)
    _, code = _seen(mi, bsdf, 0.2)
    cells = bsdf.method._tables[True].table.cells[0]
    after, same = _seen(mi, bsdf, 0.3)
    assert after == pytest.approx(_seen(mi, plugin(0.3))[0], rel=1e-5)
    assert abs(after / before - 1) > 0.1
    assert bsdf.method._tables[True].table.cells[0] != cells
    assert same == code


def test_a_gradient_that_is_asked_for_leaves_the_table(mi, plugin) -> None:
    bsdf = plugin()
    parameters = mi.traverse(bsdf)
    x = parameters["layer_0.alpha"]
    dr.enable_grad(x)  # no update
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    wo = mi.Vector3f(-0.5, 0.1, 0.8602)
    value = bsdf.eval(mi.BSDFContext(), si, wo)
    dr.forward(x)
    slope = float(dr.grad(value).x[0])
    with dr.suspend_grad():
        assert not bsdf.method.at(None, si, True).tabulated
    dr.disable_grad(x)
    assert bsdf.method.at(None, si, True).tabulated
    ends = [_seen(mi, plugin(0.1 + step))[0] for step in (0.002, -0.002)]
    assert slope == pytest.approx((ends[0] - ends[1]) / 0.004, rel=0.1)


def test_textures_keep_the_recursion(mi) -> None:
    import urushi.mitsuba  # noqa: F401 (registers the plugin)

    texture = {"type": "checkerboard", "color0": 0.1, "color1": 0.3}
    coat = {"type": "roughdielectric", "alpha": texture}
    bsdf = mi.load_dict(
        {"type": "layered", "method": "lobes", "layer_0": coat, "layer_1": {"type": "diffuse"}}
    )
    assert not bsdf.method._tables
