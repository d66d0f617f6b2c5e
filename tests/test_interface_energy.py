"""Energies of interfaces: closed forms, printed numbers, and another way to integrate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanes import DOUBLE, direction, needs_llvm
from surface import albedo
from test_conductor import MIRROR, metal
from test_dielectric import rough, smooth
from test_fresnel import complex_fresnel
from urushi.errors import UrushiError
from urushi.interfaces import BoundDiffuse, Null, WalkedConductor, WalkedDielectric
from urushi.interfaces.energy import directional, hemisphere, hemispherical

pytestmark = needs_llvm

COSINES = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
#: GGX, a perfect mirror, by an independent Monte Carlo program: at COSINES, and the mean by cosine
REFLECTED = {
    ("correlated", 0.1): (0.8835, 0.9363, 0.9692, 0.9814, 0.9867, 0.9883, 0.9720),
    ("correlated", 0.2): (0.8913, 0.8616, 0.8952, 0.9236, 0.9415, 0.9477, 0.9158),
    ("correlated", 0.3): (0.8888, 0.8181, 0.8217, 0.8445, 0.8675, 0.8774, 0.8469),
    ("correlated", 0.5): (0.8601, 0.7453, 0.6983, 0.6830, 0.6840, 0.6879, 0.7002),
    ("correlated", 0.7): (0.8209, 0.6692, 0.5899, 0.5426, 0.5136, 0.5037, 0.5663),
    ("correlated", 1.0): (0.7602, 0.5601, 0.4507, 0.3789, 0.3275, 0.3069, 0.4091),
    ("separable", 0.1): (0.8728, 0.9355, 0.9691, 0.9814, 0.9867, 0.9883, 0.9716),
    ("separable", 0.5): (0.7723, 0.7142, 0.6860, 0.6785, 0.6830, 0.6879, 0.6894),
    ("separable", 1.0): (0.5579, 0.4721, 0.4091, 0.3610, 0.3230, 0.3069, 0.3766),
}
#: GGX of alpha 0.5, height-correlated, by the same program: (eta, cosine) -> reflectance
GLASS = {(1.5, 0.2): 0.078, (1.5, 0.9): 0.0292, (1 / 1.5, 0.2): 0.584, (1 / 1.5, 0.9): 0.1255}


@pytest.mark.parametrize(("masking", "alpha"), REFLECTED)
def test_printed_reflectances(masking: str, alpha: float) -> None:
    mirror = metal(DOUBLE, alpha, masking=masking, index=MIRROR)
    expected = REFLECTED[masking, alpha]
    found = directional(mirror, COSINES)
    assert np.allclose(found.reflectance, np.array(expected[:6])[:, None], atol=1.5e-4)
    assert np.all(found.transmittance == 0) and 0 < found.error <= 1e-4
    assert np.allclose(hemispherical(mirror).reflectance, expected[6], atol=1.5e-4)


def test_closed_form() -> None:
    """GGX of roughness 1 seen along the normal reflects 1 - log 2."""
    found = directional(metal(DOUBLE, 1.0, index=MIRROR), [1.0], accuracy=1e-6)
    assert np.allclose(found.reflectance, 1 - np.log(2), atol=1e-6)


@pytest.mark.parametrize(("eta", "cos"), GLASS)
def test_printed_glass(eta: float, cos: float) -> None:
    found = directional(rough(DOUBLE, max(eta, 1 / eta), 0.5), [cos], above=eta > 1)
    assert found.reflectance == pytest.approx(GLASS[eta, cos], abs=6e-4)


@pytest.mark.parametrize("above", [True, False])
@pytest.mark.parametrize("alphas", [(0.3, 0.3), (0.8, 0.2)])
def test_against_another_rule(alphas: tuple[float, float], above: bool) -> None:
    """Gauss's rule over outgoing directions, of 5e-4 itself, instead of a lattice of facets."""
    interface = rough(DOUBLE, 1.5, *alphas, masking="separable")
    w = direction([0.9, 0.4], [0.7, -2.0])
    found = directional(interface, w, above)
    for i in range(2):
        total = albedo(interface, w[i], above)
        assert found.reflectance[i] + found.transmittance[i] == pytest.approx(total, abs=8e-4)
    # The planted fault: the other side is another matter.
    other = directional(interface, w, not above)
    assert np.abs(other.reflectance - found.reflectance).max() > 0.02


def test_smooth() -> None:
    """Fresnel's equations; the mean over the hemisphere of glass is 0.0918, and from within 0.596."""
    cos = np.array([0.05, 0.3, 0.7, 1.0])
    for eta in (1.5, 1 / 1.5):
        found = directional(smooth(DOUBLE, 1.5), cos, above=eta > 1)
        assert np.allclose(found.reflectance, complex_fresnel(cos, eta), atol=1e-12)
        assert np.allclose(found.reflectance + found.transmittance, 1)
    one, other = (hemispherical(smooth(DOUBLE, 1.5), above=above) for above in (True, False))
    assert one.reflectance == pytest.approx(0.09178, abs=2e-5)
    # n1^2 T12 = n2^2 T21.
    assert other.transmittance == pytest.approx(one.transmittance / 1.5**2, abs=1e-4)
    assert hemispherical(Null()).transmittance == pytest.approx(1)
    assert hemispherical(BoundDiffuse(0.25)).reflectance == pytest.approx(0.25)


@pytest.mark.parametrize("alpha", [1e-3, 0.03, 1.0])
def test_means_are_reciprocal(alpha: float) -> None:
    """Single scattering transmits n1^2 T12 = n2^2 T21, at any roughness."""
    glass = rough(DOUBLE, 1.5, alpha)
    one, other = (hemispherical(glass, above=above, accuracy=5e-4) for above in (True, False))
    assert other.transmittance == pytest.approx(one.transmittance / 1.5**2, abs=1e-3)


def test_colours_and_azimuths() -> None:
    gold = metal(DOUBLE, 0.3, 0.05)
    found = directional(gold, direction([0.5, 0.5], [0.0, np.pi / 2]))
    assert found.reflectance.shape == (2, 3)
    assert found.reflectance[0, 0] > found.reflectance[0, 2] + 0.2
    assert abs(found.reflectance[0, 0] - found.reflectance[1, 0]) > 0.01
    assert hemispherical(gold, accuracy=1e-3).reflectance.shape == (3,)


def test_the_hemisphere_is_whole() -> None:
    w, weight = hemisphere(6, 5, 0.01)
    assert weight.sum() == pytest.approx(1, abs=1e-12)
    assert weight @ w[:, 2] == pytest.approx(2 / 3, abs=1e-12)
    assert weight @ w[:, 0] ** 2 == pytest.approx(1 / 4, abs=1e-12)


@pytest.mark.parametrize("kind", ["metal", "glass"])
def test_a_walk_loses_nothing(kind: str) -> None:
    """Stochastic interfaces are sampled, to the standard error asked for."""
    interface: Any = (
        WalkedConductor(metal(DOUBLE, 0.6, index=MIRROR))
        if kind == "metal"
        else WalkedDielectric(rough(DOUBLE, 1.5, 0.6))
    )
    found = directional(interface, [0.3, 0.9], accuracy=2e-3)
    assert found.error <= 2e-3
    total = found.reflectance + found.transmittance
    assert np.allclose(total, 1, atol=4 * 2e-3)


def test_refusals() -> None:
    glass = rough(DOUBLE, 1.5, 0.5)
    with pytest.raises(UrushiError, match=r"w: found \[0.6, 0.0, -0.8\]"):
        directional(glass, [[0.6, 0.0, -0.8]])
    with pytest.raises(UrushiError, match=r"w: found"):
        directional(glass, [0.0])
    with pytest.raises(UrushiError, match="accuracy: found 1e-15; reached"):
        directional(glass, [0.5], accuracy=1e-15)
