"""Colour in every kind of variant: wavelengths, grey, polarised; metals and spectra as Mitsuba itself has them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mitsuba
import numpy as np
import pytest

from lanes import needs_llvm
from mitsuba_plugin import Asked, above, layered

pytestmark = needs_llvm

WAVELENGTHS = [(380.0, 430.0, 480.0, 530.0), (580.0, 610.0, 660.0, 720.0)]
METAL = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
COAT = {"type": "roughdielectric", "alpha": 0.2, "distribution": "ggx", "int_ior": 1.5, "ext_ior": 1.0}
ROSE = {"type": "rgb", "value": [0.8, 0.3, 0.4]}


@pytest.fixture(
    params=["llvm_ad_spectral", "llvm_ad_mono", "llvm_ad_spectral_polarized", "llvm_ad_mono_polarized"]
)
def variant(request) -> Iterator[Any]:
    """Mitsuba in each of the variants without RGB."""
    mitsuba.set_variant(request.param)
    yield mitsuba
    mitsuba.set_variant("llvm_ad_rgb")


def lit(mi: Any, bsdf: Any, wi: np.ndarray, wavelengths: Any) -> Asked:
    return Asked.of(mi, bsdf, wi, wavelengths=wavelengths if "spectral" in mi.variant() else ())


def plain(mi: Any, value: Any) -> np.ndarray:
    """The upper left element of a Mueller matrix, or the spectrum itself: (N, wavelengths)."""
    array = np.asarray(np.array(value), np.float64)
    return (array[0, 0] if "polarized" in mi.variant() else array).T


def write(tmp_path, *layers: str) -> str:
    path = tmp_path / "stack.yaml"
    path.write_text("urushi: 1\nlayers:\n" + "".join(f"  - {layer}\n" for layer in layers))
    return str(path)


@pytest.mark.parametrize("material", ["Au", "Cu", "Cr"])
@pytest.mark.parametrize("wavelengths", WAVELENGTHS, ids=["short", "long"])
def test_a_metal_by_name_has_its_index_at_every_wavelength(variant, rng, tmp_path, material, wavelengths):
    """Against `roughconductor` of the same name: the measured spectrum, not one made of three numbers."""
    mi = variant
    wi, wo = above(rng, 500), above(rng, 500)
    path = write(tmp_path, f"conductor: {{material: {material}, alpha: 0.3, masking: separable}}")
    bsdfs = mi.load_dict(METAL | {"material": material}), layered(mi, filename=path)
    bsdfs += (layered(mi, layer_0=METAL | {"material": material}),)
    truth, *found = (
        plain(mi, b.eval(mi.BSDFContext(), lit(mi, b, wi, wavelengths).si, mi.Vector3f(np.float32(wo.T))))
        for b in bsdfs
    )
    if "polarized" in mi.variant():
        # Mitsuba's metal polarises; what it does to unpolarised light is the same but for a rotation's rounding.
        np.testing.assert_allclose(found[0], truth, rtol=1e-3)
    for one in found:
        np.testing.assert_allclose(one, truth, rtol=1e-3 if "polarized" in mi.variant() else 1e-4, atol=1e-6)
    if "spectral" in mi.variant() and material != "Cr":
        assert np.ptp(truth / truth.max(axis=1, keepdims=True)) > 0.05


def test_a_colour_is_mitsubas_spectrum_of_it(variant, rng, tmp_path):
    """A diffuse base from a file, from a child, and Mitsuba's own."""
    mi = variant
    wi, wo = above(rng, 200), above(rng, 200)
    child = {"type": "diffuse", "reflectance": ROSE}
    path = write(tmp_path, "diffuse: {reflectance: [0.8, 0.3, 0.4]}")
    values = [
        plain(mi, b.eval(mi.BSDFContext(), lit(mi, b, wi, WAVELENGTHS[1]).si, mi.Vector3f(np.float32(wo.T))))
        for b in (mi.load_dict(child), layered(mi, layer_0=child), layered(mi, filename=path))
    ]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-5)
    np.testing.assert_allclose(values[2], values[0], rtol=1e-5)


def test_a_nested_medium_has_its_spectrum(variant, rng, tmp_path):
    """The colour of a medium's albedo in a child and in a file: the same light, path for path, at every wavelength.

    What `mi.traverse` shows of a spectrum are coefficients; taken for a colour they gave another medium altogether.
    """
    mi = variant
    wi, wo, uv = above(rng, 3000), above(rng, 3000), rng.random((3000, 2))
    fog = {"type": "homogeneous", "sigma_t": 0.5, "scale": 4.0, "albedo": ROSE}
    nested = layered(mi, layer_0=COAT, layer_1=fog, layer_2={"type": "diffuse", "reflectance": 0.5})
    path = write(
        tmp_path,
        "dielectric: {ior: 1.5, alpha: 0.2, masking: separable}",
        "medium: {depth: 2.0, albedo: [0.8, 0.3, 0.4]}",
        "diffuse: {reflectance: 0.5}",
    )
    values = []
    for bsdf in (nested, layered(mi, filename=path)):
        asked = lit(mi, bsdf, wi, WAVELENGTHS[1])
        asked.si.uv = mi.Point2f(np.float32(uv.T))
        values.append(plain(mi, bsdf.eval(asked.ctx, asked.si, mi.Vector3f(np.float32(wo.T)))))
    # Depths are grey in one form and a spectrum in the other, so a walk may draw its channel otherwise: means agree.
    difference = values[0] - values[1]
    error = difference.std(axis=0) / np.sqrt(len(difference)) + 1e-6
    assert np.all(np.abs(difference.mean(axis=0)) < 5.5 * error)
    assert np.all(error < 0.02 * values[0].mean(axis=0))
    if "spectral" in mi.variant():
        assert np.ptp(values[0].mean(axis=0)) > 0.2 * values[0].mean()


@pytest.mark.parametrize("name", ["llvm_ad_spectral_polarized", "llvm_ad_mono_polarized"])
def test_polarised_light_leaves_unpolarised(rng, name):
    """Mueller matrices whose only element is the first; and that is the value of the plain variant, noise and all."""
    mi = mitsuba
    wi, wo, u = above(rng, 500), above(rng, 500), rng.random((500, 3))
    found = []
    for variant in (name, name.removesuffix("_polarized")):
        mi.set_variant(variant)
        bsdf = layered(mi, filename="preset:enamel-on-gold")
        asked = lit(mi, bsdf, wi, WAVELENGTHS[1])
        value = np.array(bsdf.eval(asked.ctx, asked.si, mi.Vector3f(np.float32(wo.T))))
        point = mi.Point2f(np.float32(u[:, 1:].T))
        _, weight = bsdf.sample(asked.ctx, asked.si, mi.Float(np.float32(u[:, 0])), point)
        found += [value, np.array(weight)]
    mi.set_variant("llvm_ad_rgb")
    for matrix, number in zip(found[:2], found[2:], strict=True):
        assert matrix.shape[:2] == (4, 4)
        np.testing.assert_allclose(matrix[0, 0], number, rtol=1e-6)
        rest = matrix.copy()
        rest[0, 0] = 0
        assert not rest.any() and number.any()


def test_grey_stacks_have_one_value_for_all_wavelengths(rng, tmp_path):
    """Where nothing is coloured the walk carries one number."""
    mi = mitsuba
    mi.set_variant("llvm_ad_spectral")
    bsdf = layered(
        mi, filename=write(tmp_path, "dielectric: {ior: 1.5, alpha: 0.2}", "diffuse: {reflectance: 0.5}")
    )
    asked = lit(mi, bsdf, above(rng, 100), WAVELENGTHS[0])
    value = asked.value(above(rng, 100))
    mi.set_variant("llvm_ad_rgb")
    assert value.shape == (100, 4) and np.all(value == value[:, :1]) and value.all()
