"""Mitsuba's own plugins as layers: alone they are what Mitsuba makes of them, together what a material file says."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from mitsuba_plugin import IMPORTANCE, RADIANCE, Asked, above, everywhere, layered

GLASS = {"int_ior": 1.5, "ext_ior": 1.0}
CHECKS = {"type": "checkerboard", "color0": 0.1, "color1": 0.4}
COLOURS = {
    "type": "checkerboard",
    "color0": {"type": "rgb", "value": [0.9, 0.2, 0.1]},
    "color1": {"type": "rgb", "value": [0.1, 0.3, 0.8]},
}
INDEX = {"eta": {"type": "rgb", "value": [0.2, 0.9, 1.5]}, "k": {"type": "rgb", "value": [3.9, 2.5, 1.9]}}
SMOOTH = {
    "dielectric": {"type": "dielectric"} | GLASS,
    "dielectric, named indices": {"type": "dielectric", "int_ior": "diamond", "ext_ior": "water"},
    "conductor": {"type": "conductor", "material": "Ag"},
    "mirror": {"type": "conductor", "material": "none"},
}
ROUGH = {
    "ggx glass": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.2} | GLASS,
    "beckmann glass": {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.3, "int_ior": "bk7"},
    "anisotropic glass": {"type": "roughdielectric", "distribution": "ggx", "alpha_u": 0.1, "alpha_v": 0.4}
    | GLASS,
    "textured glass": {"type": "roughdielectric", "distribution": "beckmann", "alpha": CHECKS} | GLASS,
    "ggx gold": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.1, "material": "Au"},
    "beckmann metal": {"type": "roughconductor", "distribution": "beckmann", "alpha": 0.5} | INDEX,
    "anisotropic metal": {
        "type": "roughconductor",
        "distribution": "beckmann",
        "alpha_u": 0.1,
        "alpha_v": 0.4,
    }
    | INDEX,
    "textured along u": {"type": "roughconductor", "distribution": "ggx", "alpha_u": CHECKS, "alpha_v": 0.2}
    | INDEX,
    "hardly rough": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.0} | INDEX,
    "without sampling of visible normals": {"type": "roughdielectric", "sample_visible": False, "alpha": 0.2}
    | GLASS,
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.8]}},
    "textured diffuse": {"type": "diffuse", "reflectance": COLOURS},
}


@pytest.mark.parametrize("mode", [RADIANCE, IMPORTANCE])
@pytest.mark.parametrize("name", ROUGH)
def test_one_layer_alone_is_the_plugin_it_came_from(mi, rng, name, mode):
    """f |cos| of Mitsuba's BSDF everywhere on the sphere; a single interface has no noise."""
    wi, wo, uv = everywhere(rng, 5000), everywhere(rng, 5000), rng.random((5000, 2))
    truth = Asked.of(mi, mi.load_dict(ROUGH[name]), wi, mode, uv=uv).value(wo)
    found = Asked.of(mi, layered(mi, layer_0=ROUGH[name]), wi, mode, uv=uv).value(wo)
    np.testing.assert_allclose(found, truth, rtol=1e-4, atol=2e-5)
    assert name == "hardly rough" or np.count_nonzero(truth > 1e-3) > 500


def test_a_smooth_lobe_of_a_rough_plugin_is_there(mi):
    """Alpha 0 counts as Mitsuba's smallest, 1e-4, in the mirror direction too."""
    wi, wo = np.array([[0.6, 0.0, 0.8]]), np.array([[-0.6, 0.0, 0.8]])
    metal = ROUGH["hardly rough"]
    truth = Asked.of(mi, mi.load_dict(metal), wi).value(wo)
    np.testing.assert_allclose(Asked.of(mi, layered(mi, layer_0=metal), wi).value(wo), truth, rtol=1e-4)
    assert truth.min() > 1e5


@pytest.mark.parametrize("name", [*SMOOTH, *(name for name in ROUGH if name != "hardly rough")])
def test_its_samples_carry_what_mitsubas_carry(mi, rng, name):
    """Mean weight, reflected and transmitted: the delta parts have nothing else by which to compare them."""
    n, child = 1 << 15, (SMOOTH | ROUGH)[name]
    cosines = np.repeat([0.95, 0.3, -0.95, -0.3], n)
    sin = np.sqrt(1 - cosines**2)
    wi = np.stack([0.8 * sin, 0.6 * sin, cosines], axis=1)
    uv, means = rng.random((4 * n, 2)), []
    for bsdf in (mi.load_dict(child), layered(mi, layer_0=child)):
        sample, weight = Asked.of(mi, bsdf, wi, uv=uv).sample(rng.random((4 * n, 3)))
        up = np.array(sample.wo.z)[:, None] > 0
        for part in (weight * up, weight * ~up):
            part = part.reshape(4, n, 3)
            means.append((part.mean(axis=1), part.std(axis=1) / np.sqrt(n)))
    for (truth, error), (found, spread) in zip(means[:2], means[2:], strict=True):
        assert np.all(np.abs(found - truth) < 5.5 * np.hypot(error, spread) + 1e-5)
    assert means[0][0].max() > 0.01


def same_light(mi, rng, tmp_path, children, layers, **options) -> None:
    """Nested children and a material file of the same stack: the same paths, so the same values but for rounding.

    A path of a walk may part from its twin where rounding decides; few do.
    """
    path = tmp_path / "stack.yaml"
    path.write_text(yaml.safe_dump({"urushi": 1, "layers": layers}))
    nested = layered(mi, **{f"layer_{i}": child for i, child in enumerate(children)}, **options)
    wi, wo, uv = above(rng, 4000), above(rng, 4000), rng.random((4000, 2))
    if layers[-1].keys() <= {"dielectric", "medium"}:
        wi, wo = everywhere(rng, 4000), everywhere(rng, 4000)
    truth = Asked.of(mi, layered(mi, filename=str(path)), wi, uv=uv).value(wo)
    found = Asked.of(mi, nested, wi, uv=uv).value(wo)
    differs = np.abs(found - truth).max(axis=1) > 2e-3 * np.abs(truth).max(axis=1) + 1e-5
    assert np.mean(differs) < 0.01, (np.mean(differs), found[differs][:3], truth[differs][:3])
    assert np.count_nonzero(truth) > 2000


COAT = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.2} | GLASS
OUR_COAT = {"dielectric": {"ior": 1.5, "alpha": 0.2, "masking": "separable"}}
FOG = {
    "type": "homogeneous",
    "sigma_t": 2.0,
    "scale": 3.0,
    "albedo": {"type": "rgb", "value": [0.9, 0.5, 0.2]},
}
PHASES = {
    "isotropic": ({"type": "isotropic"}, "isotropic"),
    "hg": ({"type": "hg", "g": 0.7}, {"henyey_greenstein": {"g": 0.7}}),
    "rayleigh": ({"type": "rayleigh"}, "rayleigh"),
}


@pytest.mark.parametrize("phase", PHASES)
def test_a_homogeneous_medium_is_a_medium(mi, rng, tmp_path, phase):
    """Depth = sigma_t * scale * thickness; colour, phase function and what lies around it as in the file."""
    theirs, ours = PHASES[phase]
    medium = {"medium": {"depth": 1.5, "albedo": [0.9, 0.5, 0.2], "phase": ours}}
    grey = {"diffuse": {"reflectance": 0.5}}
    children = [COAT, FOG | {"phase": theirs}, {"type": "diffuse", "reflectance": 0.5}]
    same_light(mi, rng, tmp_path, children, [OUR_COAT, medium, grey], thickness_1=0.25)
    with pytest.raises(AssertionError):  # the planted fault: a thickness off by a tenth
        same_light(mi, rng, tmp_path, children, [OUR_COAT, medium, grey], thickness_1=0.275)


def test_a_thickness_is_one_where_none_is_given(mi, rng, tmp_path):
    fog = FOG | {"sigma_t": 0.25}
    same_light(
        mi, rng, tmp_path, [COAT, fog], [OUR_COAT, {"medium": {"depth": 0.75, "albedo": [0.9, 0.5, 0.2]}}]
    )


def test_indices_multiply_and_those_of_metals_do_not(mi, rng, tmp_path):
    """A dielectric's index is relative to what lies above it, a conductor's is absolute."""
    water = COAT | {"int_ior": 1.33}
    glass = COAT | {"int_ior": 1.5, "ext_ior": 1.33}
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3} | INDEX
    layers = [
        {"dielectric": {"ior": 1.33, "alpha": 0.2, "masking": "separable"}},
        {"dielectric": {"ior": 1.5, "alpha": 0.2, "masking": "separable"}},
        {"conductor": {"eta": [0.2, 0.9, 1.5], "k": [3.9, 2.5, 1.9], "alpha": 0.3, "masking": "separable"}},
    ]
    same_light(mi, rng, tmp_path, [water, glass, metal], layers)
    with pytest.raises(AssertionError):
        layers[1]["dielectric"]["ior"] = 1.5 / 1.33
        same_light(mi, rng, tmp_path, [water, glass, metal], layers)


def test_a_slab_ends_in_air_again(mi):
    """In and out again: the product of single-precision ratios is one, not 0.99999995, which no material has."""
    bk7 = {"int_ior": "bk7", "ext_ior": "air"}
    slab = layered(
        mi,
        layer_0={"type": "roughdielectric"} | bk7,
        layer_1={"type": "roughdielectric", "int_ior": "air", "ext_ior": "bk7"},
    )
    assert float(mi.traverse(slab)["layer_1.ior"][0]) == 1.0
    assert float(mi.traverse(slab)["layer_0.ior"][0]) == pytest.approx(1.5046 / 1.000277, rel=1e-6)


def test_layers_are_in_the_order_of_their_numbers(mi):
    """Mitsuba hands them over by the alphabet, layer_10 before layer_2."""
    children = {
        f"layer_{i}": {"type": "dielectric", "int_ior": 1.05 + 0.01 * i, "ext_ior": 1.0} for i in range(11)
    }
    bsdf = layered(mi, **children, layer_11={"type": "diffuse"})
    parameters = mi.traverse(bsdf)
    expected = np.cumprod([1.05 + 0.01 * i for i in range(11)])
    np.testing.assert_allclose(
        [float(parameters[f"layer_{i}.ior"][0]) for i in range(11)], expected, rtol=1e-5
    )
    assert "layer_11.reflectance.value" in parameters
