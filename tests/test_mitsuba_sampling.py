"""Mitsuba's own checks on the plugin: chi² of `sample` against `pdf`, the mean of the weights, flags and components."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import urushi as ur
from lanes import direction
from mitsuba_plugin import IMPORTANCE, RADIANCE, Asked, context, everywhere, interaction, layered, rows

ALPHA = 1e-5
"""Probability that a right plugin fails any of the chi² tests of this file: Mitsuba shares it out over their number."""

BINS = {"sample_count": 1_000_000, "res": 31, "ires": 64}
"""Coarse cells, each integrated finely, and many samples: a density off by two per cent is found.

That integral is by points, so the lobes here are none of the narrowest; the laws of `urushi.checks` look at those."""

CASES = [
    ("enamel", 0.8),
    ("enamel", 0.1),
    ("anodised-aluminium", 0.6),
    ("skin", 0.3),
    ("frosted-glass", 0.9),
    ("frosted-glass", -0.4),
    ("milky-glass", 0.5),
    ("milky-glass", -0.7),
]


def azimuthal(cos: float) -> np.ndarray:
    return direction(cos, 0.4) if cos > 0 else direction(-cos, 0.4) * [1, 1, -1]


def chi2(mi, bsdf, wi, fault=lambda density, wo: density) -> bool:
    """Mitsuba's chi² test on the sphere. Delta parts have no density; `fault` is for planting one."""
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    def sample(u):
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
        si.wi = mi.Vector3f(*map(float, wi))
        found, _ = bsdf.sample(mi.BSDFContext(), si, u.x, mi.Point2f(u.y, u.z))
        return found.wo, dr.select(
            (found.pdf > 0) & ~mi.has_flag(found.sampled_type, mi.BSDFFlags.Delta), 1.0, 0.0
        )

    def pdf(wo):
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wo))
        si.wi = mi.Vector3f(*map(float, wi))
        return fault(bsdf.pdf(mi.BSDFContext(), si, wo), wo)

    test = ChiSquareTest(SphericalDomain(), sample, pdf, sample_dim=3, **BINS)
    return test.run(ALPHA, test_count=len(CASES) + 1, quiet=True)


@pytest.mark.parametrize(("name", "cos"), CASES)
def test_samples_fall_where_the_density_says(mi, name, cos):
    assert chi2(mi, layered(mi, filename=f"preset:{name}"), azimuthal(cos))


def test_mitsubas_own_adapter_agrees(mi):
    """`BSDFAdapter` as it is; it takes a weight of 0 for a void sample, so the first surface has to be rough."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    layered(mi, filename="preset:plastic")
    functions = BSDFAdapter("layered", '<string name="filename" value="preset:plastic"/>', wi=[0.6, 0.0, 0.8])
    test = ChiSquareTest(SphericalDomain(), *functions, sample_dim=3, **BINS)
    assert test.run(ALPHA, test_count=len(CASES) + 1, quiet=True)


@pytest.mark.parametrize(
    "fault", [lambda d, wo: 1.02 * d, lambda d, wo: d * (1 + 0.05 * wo.x)], ids=["scale", "tilt"]
)
def test_a_wrong_density_is_noticed(mi, fault):
    """Planted faults of the two tests above."""
    assert not chi2(mi, layered(mi, filename="preset:frosted-glass"), azimuthal(0.8), fault)


@pytest.mark.parametrize("mode", [RADIANCE, IMPORTANCE])
@pytest.mark.parametrize(
    "name",
    ["enamel-on-gold", "frosted-glass", "milky-glass", "thin-slab", "brushed-metal-lacquer", "wet-stone"],
)
def test_weights_add_up_to_reflectance_and_transmittance(mi, rng, name, mode):
    """Side by side, from above and below; radiance carries (n_i / n_o)² across, which is undone here."""
    n, cosines = 1 << 16, (0.9, 0.4, -0.9, -0.4)
    stack = ur.load(f"preset:{name}")
    wi = np.stack([azimuthal(cos) for cos in cosines if cos > 0 or not stack.layers[-1].opaque])
    bsdf = layered(mi, filename=f"preset:{name}")
    asked = Asked.of(mi, bsdf, np.repeat(wi, n, axis=0), mode, uv=rng.random((n * len(wi), 2)))
    sample, weight = asked.sample(rng.random((n * len(wi), 3)))
    weight, up = weight.reshape(len(wi), n, 3), np.array(sample.wo.z).reshape(len(wi), n, 1) > 0
    solved = ur.solve(stack, method="walk", samples=1 << 14, backend="llvm")
    ratio = 1.0
    if mode == RADIANCE and not stack.layers[-1].opaque:
        ratio = (stack.exterior / stack.layers[-1].ior) ** 2
    for same, truth in ((True, solved.reflectance), (False, solved.transmittance)):
        expected, error = truth(wi, with_error=True)
        if not same:
            scale = np.where(wi[:, 2:] > 0, ratio, 1 / ratio)
            expected, error = expected * scale, error * scale
        part = weight * (up == ((wi[:, 2] > 0)[:, None, None] == same))
        mean, spread = part.mean(axis=1), part.std(axis=1) / np.sqrt(n)
        tolerance = 5.5 * np.hypot(error, spread) + 1e-5
        assert np.all(np.abs(mean - expected) < tolerance), (same, mean, expected, tolerance)
        assert np.all(tolerance < 0.05)


WATER = {"type": "roughdielectric", "int_ior": 1.33, "ext_ior": 1.0, "alpha": 0.3}
SMOOTH = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
METAL = {"type": "roughconductor", "material": "Cu", "alpha": 0.2}
WHITE = {"type": "diffuse"}
FOG = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.9}
CHECKS = {"type": "checkerboard", "color0": 0.1, "color1": 0.4}
BRUSHED = {"type": "roughconductor", "material": "Cu", "alpha_u": 0.1, "alpha_v": 0.3}

FLAGS = {
    "rough coat, metal": ([WATER, METAL], ["GlossyReflection"], "FrontSide"),
    "diffuse": ([WHITE], ["DiffuseReflection"], "FrontSide"),
    "rough coat, diffuse": ([WATER, WHITE], ["GlossyReflection DiffuseReflection"], "FrontSide"),
    "textured": ([WATER, METAL | {"alpha": CHECKS}], ["GlossyReflection"], "FrontSide SpatiallyVarying"),
    "anisotropic": ([BRUSHED], ["GlossyReflection"], "FrontSide Anisotropic"),
    "smooth coat, diffuse": ([SMOOTH, WHITE], ["DiffuseReflection", "DeltaReflection"], "FrontSide"),
    "smooth metal": ([{"type": "conductor"}], ["DeltaReflection"], "FrontSide"),
    "smooth glass": ([SMOOTH], ["DeltaReflection", "DeltaTransmission NonSymmetric"], "FrontSide BackSide"),
    "rough glass": ([WATER], ["GlossyReflection", "GlossyTransmission NonSymmetric"], "FrontSide BackSide"),
    "foggy glass": (
        [SMOOTH, FOG],
        [
            "GlossyReflection",
            "GlossyTransmission NonSymmetric",
            "DeltaReflection",
            "DeltaTransmission NonSymmetric",
        ],
        "FrontSide BackSide",
    ),
}


@pytest.mark.parametrize("name", FLAGS)
def test_flags_say_what_the_stack_does(mi, name):
    """One component for each way to scatter, delta parts only where the outermost interfaces are smooth."""
    layers, parts, common = FLAGS[name]
    bsdf = layered(mi, **{f"layer_{i}": layer for i, layer in enumerate(layers)})
    flags = mi.BSDFFlags
    expected = []
    for part in parts:
        expected.append(0)
        for word in (part + " " + common).split():
            expected[-1] |= int(getattr(flags, word))
    found = [int(bsdf.flags(i)) for i in range(bsdf.component_count())]
    assert found == expected
    assert int(bsdf.flags()) == int(np.bitwise_or.reduce(expected))


@pytest.mark.parametrize("name", ["foggy glass", "rough glass", "smooth glass", "rough coat, diffuse"])
def test_a_context_may_ask_for_one_component(mi, rng, name):
    """By number or by type: the parts sum to the whole, each samples itself only, and nothing else is possible."""
    layers, _, _ = FLAGS[name]
    bsdf = layered(mi, **{f"layer_{i}": layer for i, layer in enumerate(layers)})
    wi, wo, u = everywhere(rng, 3000), everywhere(rng, 3000), rng.random((3000, 3))
    whole = Asked.of(mi, bsdf, wi)
    sample, weight = whole.sample(u)
    number, kind = np.array(sample.sampled_component), np.array(sample.sampled_type)
    valid = weight.any(axis=1)
    for i in range(bsdf.component_count()):
        own = int(bsdf.flags(i)) & int(mi.BSDFFlags.All)
        assert np.all((kind[valid & (number == i)] & own) != 0)
        assert np.any(valid & (number == i))
    asks = [{"component": i} for i in range(bsdf.component_count())]
    if "diffuse" not in name:
        asks += [
            {"type_mask": int(bsdf.flags(i)) & int(mi.BSDFFlags.All)} for i in range(bsdf.component_count())
        ]
    values, densities = [], []
    for i, ask in enumerate(asks):
        part = Asked(mi, bsdf, interaction(mi, wi), context(mi, **ask))
        values.append(part.value(wo))
        densities.append(part.density(wo))
        one, w = part.sample(u)
        mine = number == i % bsdf.component_count()
        np.testing.assert_array_equal(w, np.where(mine[:, None], weight, 0))
        assert not np.array(one.pdf)[~mine].any()
    for k in range(0, len(asks), bsdf.component_count()):
        np.testing.assert_allclose(sum(values[k : k + bsdf.component_count()]), whole.value(wo), rtol=1e-6)
        np.testing.assert_allclose(
            sum(densities[k : k + bsdf.component_count()]), whole.density(wo), rtol=1e-6
        )


def test_eta_is_the_ratio_of_indices_along_the_path(mi, rng):
    """1 where light is reflected, n_o / n_i where it passes, as in Mitsuba's own glass."""
    wi, u = everywhere(rng, 2000), rng.random((2000, 3))
    glass = {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.2}
    for layers, index in (([glass], 1.5), ([SMOOTH], 1.5), ([WATER, SMOOTH, FOG], 1.33 * 1.5)):
        bsdf = layered(mi, **{f"layer_{i}": layer for i, layer in enumerate(layers)})
        sample, _ = Asked.of(mi, bsdf, wi).sample(u)
        wo, eta, valid = np.array(sample.wo).T, np.array(sample.eta), np.array(sample.pdf) > 0
        expected = np.where(wi[:, 2] * wo[:, 2] > 0, 1, np.where(wi[:, 2] > 0, index, 1 / index))
        np.testing.assert_allclose(eta[valid], expected[valid], rtol=1e-6)
        assert len(np.unique(np.round(eta[valid], 4))) == 3


@pytest.mark.parametrize("layers", [[WATER], [SMOOTH], [WATER, FOG]], ids=["rough", "smooth", "foggy"])
def test_radiance_and_importance_differ_by_the_square_of_eta(mi, rng, layers):
    """The same noise in both modes, so the ratio is exact: eta² where light passes, 1 where it is reflected."""
    bsdf = layered(mi, **{f"layer_{i}": layer for i, layer in enumerate(layers)})
    index = 1.33 if layers[0] is WATER else 1.5
    wi, wo, u = everywhere(rng, 2000), everywhere(rng, 2000), rng.random((2000, 3))
    one, other = (Asked.of(mi, bsdf, wi, mode) for mode in (RADIANCE, IMPORTANCE))
    ratio = np.where(wi[:, 2] > 0, index**-2, index**2)[:, None]
    crossed = (wi[:, 2] * wo[:, 2] < 0)[:, None]
    np.testing.assert_allclose(one.value(wo), other.value(wo) * np.where(crossed, ratio, 1), rtol=1e-5)
    (sample, w1), (_, w2) = one.sample(u), other.sample(u)
    crossed = (wi[:, 2] * np.array(sample.wo.z) < 0)[:, None]
    np.testing.assert_allclose(w1, w2 * np.where(crossed, ratio, 1), rtol=1e-5)


def test_the_albedo_is_the_reflectance(mi, rng):
    """`eval_diffuse_reflectance`, which albedo images and denoisers read, is the directional-hemispherical one."""
    n, stack = 1 << 15, ur.load("preset:urushi-red")
    wi = np.stack([direction(0.9), direction(0.3, 1.0)])
    solved, error = ur.solve(stack, method="walk", samples=1 << 14, backend="llvm").reflectance(
        wi, with_error=True
    )
    bsdf = layered(mi, filename="preset:urushi-red")
    si = interaction(mi, np.repeat(wi, n, axis=0), uv=rng.random((2 * n, 2)))
    found = rows(bsdf.eval_diffuse_reflectance(si)).reshape(2, n, 3)
    off = np.abs(found.mean(axis=1) - solved) / np.hypot(error, found.std(axis=1) / np.sqrt(n))
    assert off.max() < 5.5
