"""Microfacet surfaces: the distribution of normals, their masking, and sampling of the visible ones.

Sources: Walter et al. 2007 (GGX, Beckmann and its rational masking); Heitz 2014 (masking, visible normals);
Dupuy & Benyoub 2023 (GGX by spherical caps); Jakob 2014 (Beckmann by inversion in erf).

The projected area of the microsurface, sigma(w) = cos(theta) (1 + Lambda(w)), stands in for Lambda wherever possible:
G1(w) / cos(theta) = 1 / sigma(w) stays finite at grazing angles, where Lambda does not.
All directions have z >= 0 (an interface mirrors what comes from below before it asks).
"""

from __future__ import annotations

import drjit as dr

from .vectors import Array, Vector, at_least, at_most, azimuth, quick_root, root


class Microfacets:
    """A rough surface.

    Args:
        alpha_x, alpha_y: roughness along x and y, in (0, 1]; 0 on lanes that are smooth.
        distribution: "ggx" or "beckmann".
        masking: "correlated" (height-correlated Smith, Heitz 2014) or "separable" (G1 G1; for Beckmann with Walter's
            rational G1), as Mitsuba's `roughconductor` and `roughdielectric` have it.
    """

    def __init__(self, alpha_x: Array, alpha_y: Array, distribution: str, masking: str) -> None:
        self.alpha_x = alpha_x
        self.alpha_y = alpha_y
        # Lanes may be smooth (their interface ignores the density): finite there, so that nothing becomes NaN.
        self.inv_x = 1 / at_least(alpha_x, 1e-6)
        self.inv_y = 1 / at_least(alpha_y, 1e-6)
        self.norm = dr.inv_pi * self.inv_x * self.inv_y
        self.ggx = distribution == "ggx"
        self.correlated = masking == "correlated"

    def density(self, m: Vector) -> Array:
        """D(m): area of facets of normal m per solid angle and unit area of the surface; integrates to 1 with cos."""
        slope = dr.square(m.x * self.inv_x) + dr.square(m.y * self.inv_y)
        z2 = dr.square(m.z)
        if self.ggx:
            return self.norm / dr.square(slope + z2)
        inv_z2 = dr.rcp(at_least(z2, 1e-18))
        return self.norm * dr.exp(-slope * inv_z2) * dr.square(inv_z2)

    def sigma(self, w: Vector) -> Array:
        """Projected area of the microsurface seen from w, over that of the surface."""
        if self.ggx:
            return 0.5 * (w.z + quick_root(dr.squared_norm(self._scaled(w))))
        stretch = dr.square(self.alpha_x * w.x) + dr.square(self.alpha_y * w.y)
        spread = at_least(dr.sqrt(stretch), 1e-20)
        a = w.z / spread
        return 0.5 * (w.z * (1 + dr.erf(a)) + spread * dr.exp(-dr.square(a)) * dr.inv_sqrt_pi)

    def _g1_walter(self, w: Vector) -> Array:
        """Walter's rational fit (2007, section 5.2) to the masking of a Beckmann surface."""
        spread = dr.sqrt(dr.square(self.alpha_x * w.x) + dr.square(self.alpha_y * w.y))
        a = w.z / at_least(spread, 1e-20)
        a2 = dr.square(a)
        return dr.select(a >= 1.6, 1.0, (3.535 * a + 2.181 * a2) / (1 + 2.276 * a + 2.577 * a2))

    def masked(self, w: Vector, o: Vector, sigma_w: Array) -> Array:
        """G2(w, o) / G1(w): the part of the facets visible from w that o sees too. Both directions have z >= 0."""
        if not self.ggx and not self.correlated:
            return self._g1_walter(w) * self._g1_walter(o) * sigma_w / at_least(w.z, 1e-20)
        sigma_o = self.sigma(o)
        if not self.correlated:
            return o.z / sigma_o
        # (1 + Lambda_w) / (1 + Lambda_w + Lambda_o), times cos_w cos_o above and below.
        return sigma_w * o.z / at_least(dr.fma(sigma_w - w.z, o.z, sigma_o * w.z), 1e-20)

    def weigh(self, w: Vector, o: Vector, m: Vector) -> tuple[Array, Array]:
        """(D(m) / sigma(w), `masked`): all that an interface needs; finite for o on the other side, too."""
        sigma_w = self.sigma(w)
        masked = self.masked(w, o, sigma_w)
        if not self.ggx:
            return self.density(m) / at_least(sigma_w, 1e-20), masked
        return self.norm / at_least(sigma_w * self.rarity(m), 1e-30), masked

    def single(self, w: Vector, o: Vector, m: Vector) -> Array:
        """The product of both of `weigh`, with one division less."""
        if not (self.ggx and self.correlated):
            visible, masked = self.weigh(w, o, m)
            return visible * masked
        sigma_w = self.sigma(w)
        both = dr.fma(sigma_w - w.z, o.z, self.sigma(o) * w.z)
        return self.norm * o.z / at_least(both * self.rarity(m), 1e-30)

    def rarity(self, m: Vector) -> Array:
        """1 / D(m), in units of what it is for the normal of the surface."""
        if not self.ggx:
            return self.norm / at_least(self.density(m), 1e-18)
        slope = dr.square(m.x * self.inv_x) + dr.square(m.y * self.inv_y)
        return dr.square(dr.fma(m.z, m.z, slope))

    def sample(self, w: Vector, u1: Array, u2: Array) -> Vector:
        """A facet normal visible from w, with density D(m) max(0, w.m) / sigma(w) per solid angle."""
        return self._sample_ggx(w, u1, u2) if self.ggx else self._sample_beckmann(w, u1, u2)

    def _stretched(self, w: Vector) -> Vector:
        """Where w points when the roughness is scaled to 1; no direction at all in the plane of a smooth lane."""
        s = self._scaled(w)
        return s * dr.rsqrt(at_least(dr.squared_norm(s), 1e-30))

    def _scaled(self, w: Vector) -> Vector:
        return type(w)(self.alpha_x * w.x, self.alpha_y * w.y, w.z)

    def _sample_ggx(self, w: Vector, u1: Array, u2: Array) -> Vector:
        return dr.normalize(self.opposites(w, u1, u2)[0])

    def opposites(self, w: Vector, u1: Array, u2: Array) -> tuple[Vector, Vector]:
        """Two normals visible from w, not of unit length, each with the density of `sample`: of a GGX surface only.

        They come from opposite azimuths about the mean of all, so that one is steep where the other is flat.
        """
        s = self._stretched(w)
        height = (1 - u2) * (1 + s.z)
        z = height - s.z
        r = root((1 - z) * (1 + z))
        sin, cos = azimuth(u1)
        x, y = self.alpha_x * s.x, self.alpha_y * s.y
        dx, dy = self.alpha_x * r, self.alpha_y * r
        one = type(w)(dr.fma(dx, cos, x), dr.fma(dy, sin, y), height)
        return one, type(w)(dr.fma(-dx, cos, x), dr.fma(-dy, sin, y), height)

    def _sample_beckmann(self, w: Vector, u1: Array, u2: Array) -> Vector:
        """Slopes of a surface of unit roughness seen from the stretched direction, then stretched back.

        Along the view the slope x has the cumulative distribution
            C(x) ~ cos (1 + erf x) / 2 + sin exp(-x^2) / (2 sqrt(pi)),   x <= cot(theta),
        monotonic there; three steps of Newton's method on erf(x), kept inside a shrinking bracket, invert it to 1e-6.
        """
        s = self._stretched(w)
        sin = root(1 - dr.square(s.z))
        cos = at_least(s.z, 1e-7)
        tan = sin / cos
        end = dr.erf(dr.rcp(at_least(tan, 1e-7)))  # erf of the steepest visible slope

        def cumulative(b: Array) -> tuple[Array, Array]:
            x = dr.erfinv(b)
            return 0.5 * (1 + b) + 0.5 * dr.inv_sqrt_pi * tan * dr.exp(-dr.square(x)), x

        limit = 1 - 1e-6
        total = cumulative(at_most(end, limit))[0]
        goal = at_least(u1, 1e-6) * total
        low, high = -limit + 0 * goal, at_most(end, limit)
        # Jakob's first guess: (1 - u) to a power that depends on the angle.
        theta = dr.acos(at_most(cos, 1))
        power = dr.fma(theta, dr.fma(theta, dr.fma(theta, -0.0594, 0.4265), -0.876), 1)
        b = at_most(at_least(end - (1 + end) * dr.power(at_least(1 - u1, 1e-7), power), low), high)
        for _ in range(3):
            value, x = cumulative(b)
            value = value - goal
            low, high = dr.select(value < 0, b, low), dr.select(value < 0, high, b)
            newton = b - value / (0.5 * (1 - x * tan))
            # The bounds themselves are allowed: that is where a converged step ends.
            b = dr.select((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        return self._from_slopes(s, dr.erfinv(b), u2)

    def _from_slopes(self, s: Vector, x: Array, u2: Array) -> Vector:
        """The normal of slope x along the stretched view s, and any slope across it, of a Beckmann surface."""
        limit = 1 - 1e-6
        y = dr.erfinv(at_most(at_least(2 * u2 - 1, -limit), limit))
        length = at_least(dr.sqrt(dr.square(s.x) + dr.square(s.y)), 1e-20)
        turned = length > 1e-10
        c = dr.select(turned, s.x / length, 1.0)
        n = dr.select(turned, s.y / length, 0.0)
        slope_x, slope_y = c * x - n * y, n * x + c * y
        return dr.normalize(type(s)(-self.alpha_x * slope_x, -self.alpha_y * slope_y, 1 + 0 * slope_x))
