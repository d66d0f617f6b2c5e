"""Fresnel's equations for unpolarised light at a dielectric and at a conductor.

Source: Hecht, Optics, ch. 4; Born & Wolf, Principles of Optics, sections 1.5 and 14.2. The cosine of incidence is
taken on the incident side and is never negative: sides and their index ratios are the business of the interface.
Both are written over a common denominator: divisions are what they cost.
"""

from __future__ import annotations

import drjit as dr

from .vectors import Array


def fresnel_dielectric(cos_i: Array, eta: Array, inv_eta: Array) -> tuple[Array, Array]:
    """Reflectance of a dielectric boundary.

    Args:
        cos_i: cosine of incidence, in [0, 1].
        eta: index beyond the boundary over the index before it; below 1 allows total internal reflection.
        inv_eta: 1 / eta, which callers know.

    Returns:
        (reflectance, cosine of refraction); (1, 0) beyond the critical angle. Equal indices reflect nothing.
    """
    cos_t_sq = dr.fma(-dr.square(inv_eta), 1 - dr.square(cos_i), 1)
    cos_t = dr.safe_sqrt(cos_t_sq)
    eta_t, eta_i = eta * cos_t, eta * cos_i
    s_sum, p_sum = cos_i + eta_t, eta_i + cos_t
    s, p = (cos_i - eta_t) * p_sum, (eta_i - cos_t) * s_sum
    reflectance = 0.5 * (dr.square(s) + dr.square(p)) / dr.square(s_sum * p_sum)
    return dr.select(cos_t_sq <= 0, dr.select(eta == 1, 0.0, 1.0), reflectance), cos_t


def fresnel_conductor(cos_i: Array, eta: Array, k: Array) -> Array:
    """Reflectance of a conductor of complex index eta - i k, relative to the medium before it.

    Args:
        cos_i: cosine of incidence, in [0, 1].
        eta, k: real and imaginary part, each over the index of the medium before the conductor; a colour or a number.
    """
    cos2 = dr.square(cos_i)
    sin2 = 1 - cos2
    difference = dr.square(eta) - dr.square(k) - sin2
    modulus = dr.sqrt(dr.square(difference) + dr.square(2 * eta * k))  # a^2 + b^2 of Born & Wolf
    cross = 2 * cos_i * dr.safe_sqrt(0.5 * (modulus + difference))
    s_sum = modulus + cos2
    p_sum = dr.fma(modulus, cos2, dr.square(sin2))
    # (R_s + R_p) / 2 with R_p = R_s (p_sum - cross sin2) / (p_sum + cross sin2).
    return (s_sum - cross) * p_sum / ((s_sum + cross) * dr.fma(cross, sin2, p_sum))
