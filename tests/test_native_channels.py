"""Files of solved stacks with other channels than a colour's."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from native_files import reheaded
from urushi.adapters import native
from urushi.adapters.fourier.export import fourier_of
from urushi.adapters.native import header
from urushi.errors import MaterialError, UrushiError

pytestmark = needs_llvm


def directions(rng, n):
    w = rng.normal(size=(n, 3))
    w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def spectra():
    """By number of channels: light scattered once, delta parts, and a base of many colours."""
    stack = ur.Stack(
        name="dyed", layers=[ur.Dielectric(ior=1.4), ur.Medium(depth=0.5, albedo=0.5), ur.Diffuse(0.5)]
    )

    def made(count: int):
        given = {
            "layer_0.ior": 1.3,
            "layer_1.depth": np.linspace(0.1, 1.5, count),
            "layer_1.albedo": np.linspace(0.0, 0.9, count),
            "layer_2.reflectance": np.linspace(0.7, 0.2, count),
        }
        return ur.solve(stack, "adding", nodes=8, parameters=given)

    return {count: made(count) for count in (2, 5, 31)}


@pytest.mark.parametrize("count", [2, 5, 31])
def test_any_number_of_channels_comes_back(spectra, tmp_path, rng, count):
    one, path = spectra[count], tmp_path / "dyed.urushi.npz"
    native.save(one, path, error=1e-4)
    other = native.load(path)
    assert other.stack == one.stack and other.channels == count
    assert {k: v.tolist() for k, v in other.parameters.items()} == {
        k: v.tolist() for k, v in one.parameters.items()
    }
    assert other.diagnostics == one.diagnostics | {"file_error": 1e-4}
    wi, wo = (directions(rng, 300) for _ in range(2))
    value, error = one.eval(wi, wo, with_error=True)
    scale = error / one.diagnostics["estimated_error"]
    allowed = 1e-4 + 2 * max(part.diagnostics["azimuthal_error"] for part in one.parts)
    assert (
        value.shape == (300, count) and (np.abs(other.eval(wi, wo) - value) <= allowed * scale + 1e-12).all()
    )
    assert np.abs(other.reflectance(wi) - one.reflectance(wi)).max() < 1e-6
    assert other.matrices.operator(0).shape == one.matrices.operator(0).shape


DYES = [
    ("channels", {}, "channels: found {}; allowed: 1 to"),
    ("channels", [0.1] * 5, "channels: found .*; allowed: 1 to"),
    ("channels", {"layer_1.albedo": [0.1, 0.2]}, "found 3 regions|found operators"),
    ("channels", {"layer_1.albedo": 0.5}, "found no other channels"),
    ("channels", {"layer_1.albedo": [0.1, 0.2, 0.3, 0.4, 2.0]}, "albedo.*allowed"),
    (
        "channels",
        {"layer_1.albedo": [0.1, 0.2, 0.3, 0.4, float("nan")]},
        r"channels\[layer_1.albedo\]: found",
    ),
    ("channels", {"layer_1.albedo": [[0.1]] * 5}, r"channels\[layer_1.albedo\]: found"),
    ("channels", {"layer_1.albedo": "white"}, r"channels\[layer_1.albedo\]: found"),
    ("channels", {"layer_1.albedo": [0.1] * 6}, r"channels\[layer_1.albedo\]: found"),
    ("channels", {"layer_9.albedo": [0.1] * 5}, "layer_9"),
    ("channels", {"name": [0.1] * 5}, "name"),
    ("colours", 4, "channels"),
    ("colours", 6, "channels|bytes"),
    ("colours", 10**9, "colours: found 1000000000; allowed: 1 to 4096"),
    ("colours", 0, "colours: found 0"),
]


@pytest.mark.parametrize(("key", "value", "match"), DYES)
def test_channels_that_no_stack_has_are_refused(spectra, tmp_path, key, value, match):
    path = tmp_path / "dyed.urushi.npz"
    native.save(spectra[5], path)
    with pytest.raises(MaterialError, match=match) as caught:
        native.load(reheaded(path, **{key: value}))
    assert "dyed.urushi.npz" in str(caught.value)


def test_the_channels_of_a_colour_are_in_its_description(tmp_path):
    """Beside it they would be left unread."""
    path = tmp_path / "fog.urushi.npz"
    fog = ur.Stack(layers=[ur.Medium(depth=1.0, albedo=[0.9, 0.5, 0.2])])
    native.save(ur.solve(fog, "adding", nodes=8), path)
    with pytest.raises(MaterialError, match="channels: found no other channels"):
        native.load(reheaded(path, channels={"layer_0.albedo": [0.1, 0.2, 0.3]}))


def test_channels_have_no_place_in_a_fourier_file(spectra):
    """But three of them have, as red, green and blue."""
    with pytest.raises(UrushiError, match="channels: found 5; allowed: 1 or 3"):
        fourier_of(spectra[5])
    table, error = fourier_of(spectra[5].parts[0], nodes=30, delta="omit")
    assert len(table.nodes) > 0 and error < 1


def test_more_channels_than_a_file_holds_are_refused(spectra, tmp_path, monkeypatch):
    monkeypatch.setattr(header, "MOST_CHANNELS", 30)
    with pytest.raises(MaterialError, match="found 31 channels; allowed: at most 30"):
        native.save(spectra[31], tmp_path / "dyed.urushi.npz")
    assert list(tmp_path.iterdir()) == []
