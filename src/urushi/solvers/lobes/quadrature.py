"""Gauss's rule for integrals over the cosine."""

from __future__ import annotations

import numpy as np


def gauss(count: int, power: int = 1) -> tuple[tuple[float, float], ...]:
    """Cosines c and weights, whose sum of weight f(c) is the integral of f over (0, 1).

    Args:
        count: of nodes.
        power: the rule is Gauss's in c^(1/power): more than 1 for what is steep, or has a root, towards grazing.
    """
    x, weight = np.polynomial.legendre.leggauss(count)
    x, weight = 0.5 * (x + 1), 0.5 * weight * power
    return tuple((float(a) ** power, float(b * a ** (power - 1))) for a, b in zip(x, weight, strict=True))
