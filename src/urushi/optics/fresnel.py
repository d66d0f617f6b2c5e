"""Fresnel's equations for unpolarised light at a dielectric and at a conductor.

Source: Hecht, Optics, ch. 4; Born & Wolf, Principles of Optics, sections 1.5 and 14.2. The cosine of incidence is
taken on the incident side and is never negative: sides and their index ratios are the business of the interface.
Both are written over a common denominator: divisions are what they cost.
"""

from __future__ import annotations

import drjit as dr

from .vectors import Array, at_least, root


def fresnel_dielectric(cos_i: Array, eta: Array, inv_eta: Array) -> tuple[Array, Array]:
    """Reflectance of a dielectric boundary.

    Args:
        cos_i: cosine of incidence, in [0, 1].
        eta: index beyond the boundary over the index before it; below 1 allows total internal reflection.
        inv_eta: 1 / eta, which callers know.

    Returns:
        (reflectance, cosine of refraction); (1, 0) beyond the critical angle. Equal indices reflect nothing.
    """
    # Snell as (eta^2 - 1 + cos^2) / eta^2, which cancels nowhere but at the critical angle itself.
    cos_t_sq = dr.square(inv_eta) * dr.fma(eta - 1, eta + 1, dr.square(cos_i))
    cos_t = root(cos_t_sq)
    reflectance = fresnel_between(cos_i, cos_t, eta)
    return dr.select(cos_t_sq <= 0, dr.select(eta == 1, 0.0, 1.0), reflectance), cos_t


def fresnel_between(cos_i: Array, cos_t: Array, eta: Array) -> Array:
    """The same reflectance where both cosines are known, as between two given directions; both >= 0."""
    eta_t, eta_i = eta * cos_t, eta * cos_i
    s_sum, p_sum = cos_i + eta_t, eta_i + cos_t
    s, p = (cos_i - eta_t) * p_sum, (eta_i - cos_t) * s_sum
    # The floor only serves grazing angles, where plain floats would divide by 0.
    return 0.5 * (dr.square(s) + dr.square(p)) / at_least(dr.square(s_sum * p_sum), 1e-37)


def fresnel_conductor(cos_i: Array, eta: Array, k: Array) -> Array:
    """Reflectance of a conductor of complex index eta - i k, relative to the medium before it.

    Args:
        cos_i: cosine of incidence, in [0, 1].
        eta, k: real and imaginary part, each over the index of the medium before the conductor; a colour or a number.
    """
    cos2 = dr.square(cos_i)
    sin2 = 1 - cos2
    # z = (eta - i k)^2 - sin^2 and its root a - i b (Born & Wolf). The larger of a and b is `larger`; where that is b,
    # a = eta k / b, and everything is multiplied by it instead of divided.
    difference = dr.fma(eta - k, eta + k, -sin2)
    product = eta * k
    modulus = dr.fma(difference, difference, at_least(dr.square(2 * product), 1e-20))
    modulus = modulus * dr.rsqrt(modulus)
    square = 0.5 * (modulus + dr.abs(difference))
    larger = square * dr.rsqrt(square)
    cross = 2 * cos_i * dr.select(difference > 0, square, product)
    s_sum = (modulus + cos2) * larger
    p_sum = dr.fma(modulus, cos2, dr.square(sin2)) * larger
    # (R_s + R_p) / 2 with R_p = R_s (p_sum - cross sin2) / (p_sum + cross sin2).
    return at_least(s_sum - cross, 0) * p_sum / ((s_sum + cross) * dr.fma(cross, sin2, p_sum))
