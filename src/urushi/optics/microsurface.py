"""The Smith microsurface as a random medium: what light does that bounces between facets (Heitz et al. 2016).

A rough surface is a half-space filled with facets. Where light is in it is told by its optical depth t, 0 at the top,
such that a ray along d meets facets at a constant rate per depth: Lambda(d) on its way up, 1 + Lambda(-d) on its way
down. In these units Heitz's free flight with its heights and their distribution becomes that of a homogeneous medium,
and what the distribution of heights is does not matter (Bitterli & d'Eon 2022, section 4).

Seen from inside a dielectric the same surface is upside down: light at depth t there is at depth -log(1 - exp(-t)).

    rate(d) = sigma(-d) / |d.z|     with sigma the projected area, of any direction, also of those from below
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from .exponential import decay, minus_log
from .microfacet import Microfacets
from .random import Generator, uniform
from .vectors import Array, Vector, at_least, at_most, azimuth, polynomial

#: nearest to the horizon that a direction counts as; keeps rates finite in single precision
FLATTEST = 1e-9
#: exp(x^2) erfc(x) = t exp(P(t)) with t = 1 / (1 + x / 2), x >= 0, to 1.2e-7 (Press et al., Numerical Recipes, 6.2)
_ERFCX = (
    -1.26551223, 1.00002368, 0.37409196, 0.09678418, -0.18628806, 0.27886807, -1.13520398, 1.48851587, -0.82215223,
    0.17087277,
)  # fmt: skip


class Microsurface(Microfacets):
    """A rough surface with height-correlated masking, seen from anywhere: directions may have z < 0, too.

    Args:
        alpha_x, alpha_y: roughness along x and y, in (0, 1].
        distribution: "ggx" or "beckmann".
    """

    def __init__(self, alpha_x: Array, alpha_y: Array, distribution: str) -> None:
        super().__init__(alpha_x, alpha_y, distribution, "correlated")

    def area(self, w: Vector) -> Array:
        """Projected area sigma(w) = integral of D(m) max(0, w.m), for w on either side; above 0.

        sigma(w) - sigma(-w) = w.z, so the smaller one says both without cancellation.
        """
        z, spread_sq = dr.abs(w.z), dr.square(self.alpha_x * w.x) + dr.square(self.alpha_y * w.y)
        if self.ggx:
            below = 0.5 * spread_sq / (z + dr.sqrt(dr.fma(z, z, at_least(spread_sq, 1e-30))))
        else:
            spread = dr.sqrt(at_least(spread_sq, 1e-30))
            a = at_most(z / spread, 9.0)  # exp(-81) is the end of single precision
            t = dr.rcp(dr.fma(a, 0.5, 1))
            scaled = t * dr.exp(polynomial(t, _ERFCX))
            below = (0.5 * dr.inv_sqrt_pi) * spread * dr.exp(-dr.square(a))
            below = below * at_least(1 - dr.sqrt(dr.pi) * a * scaled, 1e-6)
        return at_least(below, 1e-30) + at_least(w.z, 0)

    def rate(self, d: Vector, area: Array) -> Array:
        """How often light along d meets a facet, per unit of depth; `area` is that of -d."""
        return area / at_least(dr.abs(d.z), FLATTEST)

    def masking(self, o: Vector) -> Array:
        """Lambda of a direction that leaves upwards: from depth t, exp(-Lambda t) of the light gets out."""
        return self.rate(o, self.area(-o))

    def visible(self, m: Vector, area: Array) -> Array:
        """D(m) / sigma(w): times max(0, w.m), the density of facets that light from w meets; 0 for m.z <= 0."""
        return dr.select(m.z > 0, self.density(m) / at_least(area, 1e-30), 0)

    def normal(self, w: Vector, rng: Generator) -> Vector:
        """A facet that light from w meets, with density `visible` max(0, w.m) per solid angle."""
        u1, u2 = uniform(rng, w), uniform(rng, w)
        if self.ggx:
            return self._sample_ggx(w, u1, u2)
        up = self._sample_beckmann(type(w)(w.x, w.y, at_least(w.z, 0)), u1, u2)
        return dr.select(w.z >= 0, up, self._beckmann_from_below(w, u2, rng))

    def _sample_ggx(self, w: Vector, u1: Array, u2: Array) -> Vector:
        """By spherical caps (Dupuy & Benyoub 2023), in the height 1 + z of the cap: exact for w straight down, too."""
        s = self._stretched(w)
        flat_sq = dr.square(s.x) + dr.square(s.y)
        cap = dr.select(s.z > 0, 1 + s.z, flat_sq / (1 + dr.abs(s.z)))
        low = u2 * cap
        r = dr.sqrt(low * (2 - low))
        sin, cos = azimuth(u1)
        x, y = self.alpha_x * dr.fma(r, cos, s.x), self.alpha_y * dr.fma(r, sin, s.y)
        z = at_least(cap - low, 1e-15)
        return type(w)(x, y, z) * dr.rsqrt(dr.fma(x, x, dr.fma(y, y, dr.square(z))))

    def _beckmann_from_below(self, w: Vector, u2: Array, rng: Generator) -> Vector:
        """Slopes steeper than the view from below: c + y with density ~ y exp(-y^2 - 2 c y), c = cot(theta) > 0.

        By rejection from the one factor or the other, whichever fits: a third is accepted at the worst.
        """
        s = self._stretched(w)
        c = at_most(dr.abs(s.z) * dr.rsqrt(at_least(dr.square(s.x) + dr.square(s.y), 1e-12)), 1e3)
        flat = c < dr.sqrt(0.5)

        def attempt(state: dict[str, Any]) -> tuple[dict[str, Any]]:
            rng, open_ = state["rng"], state["open"]
            e1, e2 = exponential(rng, w), exponential(rng, w)
            y = dr.select(flat, dr.sqrt(e1), (e1 + e2) / at_least(2 * c, 1e-3))
            refused = uniform(rng, w) >= decay(dr.select(flat, 2 * c * y, dr.square(y)))
            y = dr.select(open_, y, state["y"])
            return ({"y": y, "open": open_ & refused, "rng": rng},)

        state = {"y": 0 * c, "open": w.z < 0, "rng": rng}
        (state,) = dr.while_loop((state,), lambda s: s["open"], attempt, label="facet from below")
        follow(rng, state["rng"])
        return self._from_slopes(s, -(c + state["y"]), u2)


def follow(rng: Generator, later: Generator) -> None:
    """Set a generator to the state that a loop left it in."""
    rng.a, rng.b, rng.c, rng.count = later.a, later.b, later.c, later.count


def exponential(rng: Generator, like: Vector) -> Array:
    """A number with density exp(-x), above 0."""
    return minus_log(1 - uniform(rng, like)) + 3e-8


def fly(t: Array, d: Vector, rate: Array, e: Array) -> tuple[Array, Any]:
    """From depth t along d to the next facet.

    Args:
        rate: see `Microsurface.rate`.
        e: an exponentially distributed number.

    Returns:
        (depth of the next facet, mask of the lanes that meet one); the others have left the surface, upwards.
    """
    up = d.z > 0
    step = e / at_least(rate, 1e-30)
    meets = (d.z <= 0) | (step < t)  # what is no number meets nothing, so that no walk goes on for ever
    return at_most(at_least(dr.select(up, t - step, t + step), 1e-30), 80.0), meets


def other_depth(t: Array) -> Array:
    """The depth in the same surface as seen from the other side, -log(1 - exp(-t)); its own inverse."""
    kept = decay(t)
    flat = t * dr.fma(t, dr.fma(t, dr.fma(t, -1 / 24, 1 / 6), -0.5), 1)  # 1 - exp(-t)
    logarithm = minus_log(at_least(dr.select(t < 0.1, flat, 1 - kept), 1e-30))
    return dr.select(kept < 0.01, kept * dr.fma(kept, dr.fma(kept, 1 / 3, 0.5), 1), logarithm)


def seen_next(t: Array, d: Vector, rate: Array, masking: Array) -> Array:
    """Mean of exp(-masking t') over the depth t' of the next facet along d, 0 where there is none.

    The height of the next collision integrated in closed form: what leaves at `masking` from it, whether or not the
    walk then gets there.
    """
    # Upwards: rate (exp(-masking t) - exp(-rate t)) / (rate - masking), by the mean of exp between both.
    x = dr.abs(rate - masking) * t
    mean = dr.select(
        x < 0.05, dr.fma(x, dr.fma(x, dr.fma(x, -1 / 24, 1 / 6), -0.5), 1), (1 - decay(x)) / at_least(x, 0.01)
    )
    up = rate * t * decay(at_most(rate, masking) * t) * mean
    return dr.select(d.z > 0, up, decay(masking * t) * rate / (rate + masking))


def seen_second(first: Array, d: Vector, rate: Array, masking: Array) -> Array:
    """`seen_next` averaged over the depth of the first facet, too, which light meets at rate `first`."""
    return first / (first + masking) * (rate / (rate + dr.select(d.z > 0, first, masking)))


def seen_through(a: Array, b: Array) -> Array:
    """Beta(1 + a, 1 + b): the part of the light that enters at masking a and, refracted once, leaves at masking b.

    By Stirling's series of the three gamma functions, two steps up from where it is needed; written in ratios, since
    the logarithms of each would cancel in single precision when a direction grazes.
    """
    x, y = at_least(a, b) + 3, at_most(a, b) + 3
    z = x + y
    q = y / z
    r = q / (2 - q)
    r_sq = dr.square(r)
    # log(x / z) = log(1 - q) = -2 artanh(r), r <= 1/3
    series = polynomial(r_sq, (2.0, 2 / 3, 2 / 5, 2 / 7, 2 / 9, 2 / 11, 2 / 13, 2 / 15))
    exponent = (x - 0.5) * (r * series) + (y - 0.5) * minus_log(q) + 0.5 * dr.log(z)
    exponent = exponent - _stirling(x) - _stirling(y) + _stirling(z)
    stepped = ((z - 4) / (x - 2)) * ((z - 3) / (x - 1)) * ((z - 2) / (y - 2)) * ((z - 1) / (y - 1))
    return dr.sqrt(2 * dr.pi) * stepped * decay(exponent)


def _stirling(x: Array) -> Array:
    inverse = dr.rcp(x)
    return inverse * polynomial(dr.square(inverse), (1 / 12, -1 / 360, 1 / 1260))
