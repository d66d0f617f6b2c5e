"""The indices of conductors, against Mitsuba's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from urushi.optics.ior import conductor_index, conductor_names, conductor_rgb


def test_names() -> None:
    names = conductor_names()
    assert {"Au", "Ag", "Al", "Cu", "none"} <= set(names)
    assert list(names) == sorted(names)


@pytest.mark.parametrize("name", conductor_names())
def test_rgb_is_what_mitsuba_uses(mi: Any, name: str) -> None:
    values = mi.traverse(mi.load_dict({"type": "roughconductor", "material": name}))
    for found, key in zip(conductor_rgb(name), ("eta.value", "k.value"), strict=True):
        expected = np.broadcast_to(np.ravel(np.array(values[key])), 3)
        assert np.array_equal(np.float32(found), expected)


@pytest.mark.parametrize("name", ["Au", "Cu", "TiN", "Te"])
def test_spectra_are_interpolated_as_mitsuba_does(mi: Any, name: str) -> None:
    if "scalar_spectral" not in mi.variants():
        pytest.skip("this Mitsuba has no spectral variant")
    mi.set_variant("scalar_spectral")
    folder = Path(mi.__file__).parent / "data" / "ior"
    wavelengths = np.linspace(365.0, 815.0, 40)
    for found, part in zip(conductor_index(name, wavelengths), ("eta", "k"), strict=True):
        texture = mi.load_dict({"type": "spectrum", "filename": str(folder / f"{name}.{part}.spd")})
        expected = []
        for chunk in wavelengths.reshape(-1, 4):
            si = mi.SurfaceInteraction3f()
            si.wavelengths = list(chunk)
            expected.extend(np.array(texture.eval(si)))
        assert np.allclose(found, expected, rtol=1e-5)


def test_spectra_keep_shape_and_refuse_what_the_table_does_not_hold() -> None:
    eta, k = conductor_index("Au", [[400.0, 500.0]])
    assert eta.shape == k.shape == (1, 2) and eta.dtype == np.float64
    mirror = conductor_index("none", [100.0, 1e5])
    assert np.array_equal(mirror[0], [0, 0]) and np.array_equal(mirror[1], [1, 1])
    for wavelength in (298.0, 886.0, np.nan):
        with pytest.raises(ur.MaterialError, match=r"298\.757 to 885\.601 nm"):
            conductor_index("Au", [500.0, wavelength])
    with pytest.raises(ur.MaterialError, match="did you mean"):
        conductor_rgb("Aluu")
