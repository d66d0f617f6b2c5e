"""The adding equations: what two layers do together, given what each does alone.

Light goes back and forth between the two layers; the sum over all bounces is a geometric series (Stokes 1862):

    R_top = R1_top + T1_up (1 - R2_top R1_bottom)^-1 R2_top T1_down
    T_down = T2_down (1 - R1_bottom R2_top)^-1 T1_down          and mirrored for R_bottom, T_up

Written here for quantities that commute: numbers, colours, arrays of either.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Slab(NamedTuple):
    """Reflection and transmission of a layer: light from above (`r_top`, `t_down`), from below (`r_bottom`, `t_up`)."""

    r_top: Any
    t_down: Any
    r_bottom: Any
    t_up: Any


def add(upper: Slab, lower: Slab) -> Slab:
    """Put `upper` on `lower`. Nothing reflects everything between them for ever, so the series converges."""
    series = 1 / (1 - lower.r_top * upper.r_bottom)
    return Slab(
        upper.r_top + upper.t_up * lower.r_top * upper.t_down * series,
        lower.t_down * upper.t_down * series,
        lower.r_bottom + lower.t_down * upper.r_bottom * lower.t_up * series,
        upper.t_up * lower.t_up * series,
    )
