"""What a notebook shows of a solved stack."""

from __future__ import annotations

from urushi.errors import UrushiError
from urushi.solvers import BSDF

from .polar import polar
from .style import encoded

SCREEN = 90
"""Pixels an inch of a notebook."""


def picture(bsdf: BSDF, theta: float = 45.0) -> bytes | None:
    """The polar figure as PNG; None where it cannot be drawn: no light, other colours, one stack per evaluation."""
    try:
        return encoded(polar(bsdf, theta=theta), dpi=SCREEN)
    except UrushiError:
        return None
