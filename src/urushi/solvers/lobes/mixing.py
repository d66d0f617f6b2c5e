"""What interfaces make of diffuse light that media scattered: matrices of moments, from tables.

    dielectric      side, index ratio, roughness -> moments of what is reflected and transmitted, of each polynomial
    metal           roughness -> weights of the reflectance at `tables.METAL`, likewise

    backs           side, index ratio, roughness, width, cosine -> moments of what comes back down of what entered

All are made of single scattering at facets of GGX (tools/lobe_mixing.py). Interfaces of another kind send out the same
light, in proportion to what they do of even light; the complete ones send out, evenly, what facets sent to one another.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from ...optics.fresnel import fresnel_conductor
from ...optics.vectors import Array, at_least
from . import axes, tables
from .grid import Grid
from .moments import COUNT, EVEN, Mixing, Moments
from .settled import settled


@cache
def _grid(name: str) -> Grid:
    with np.load(Path(__file__).parent / "data" / "mixing.npz") as file:
        return Grid(file[name] * tables.STEP)


def dielectric(
    kind: tuple[str, str], eta: Array, alpha: Array, full: bool, like: Array
) -> tuple[Mixing, Mixing]:
    """What a dielectric reflects and transmits.

    Args:
        kind: distribution and masking.
        eta: index beyond over index before.
        alpha: roughness; 0 where it is smooth.
        full: with what its facets send to one another.
        like: a value whose type the answer has.
    """

    grid = _grid("dielectric")

    def places(eta: Array) -> list[Array]:
        return [dr.select(eta >= 1, 0.0 * eta, 1.0 + 0 * eta), axes.along_ratio(eta)]

    if isinstance(alpha, float):
        alpha = alpha + 0 * eta
    rough = axes.along_square(alpha)
    values = settled("mixing", (eta, alpha), lambda: grid([*places(eta), rough], alpha))
    if values is None:
        leading = settled("ratio", (eta,), lambda: places(eta))
        part = None if leading is None else grid.at(leading, ("mixing", "dielectric"))
        if part is None:
            values = grid([*places(eta + 0 * like), rough + 0 * like], like)
        else:
            values = part([rough + 0 * like], like)
    r, t = Mixing.told(values[: COUNT**2]), Mixing.told(values[COUNT**2 :])
    if kind != tables.COMMON:
        own, common = (tables.dielectric_diffuse(k, eta, alpha, like) for k in (kind, tables.COMMON))
        r, t = (m * (a / at_least(b, 1e-6)) for m, a, b in zip((r, t), own, common, strict=True))
    return r.completed(t) if full else (r, t)


def backs(cos: Array, eta: Array, alpha: Array, width: Array) -> Moments:
    """Light that entered through a dielectric, was sent up by a mirror, and is sent back down: its moments per energy.

    Args:
        cos: cosine of incidence, before it entered.
        eta: index below over index above.
        alpha: roughness of the interface.
        width: of the mirror that would send the light up as wide as it is.
    """
    places = [
        dr.select(eta >= 1, 0.0 * cos, 1.0 + 0 * cos),
        axes.along_ratio(eta + 0 * cos),
        *(axes.along_square(a + 0 * cos) for a in (alpha, width)),
        axes.along_cosine(cos, eta),
    ]
    return Moments(1.0 + 0 * cos, *_grid("backs")(places, cos))


def metal(kind: tuple[str, str], eta: Array, k: Array, alpha: Array, full: bool, like: Array) -> Mixing:
    """What a metal reflects; eta and k are its complex index over that of the medium above."""
    alpha = alpha + 0 * like
    weights = _grid("metal")([axes.along_square(alpha)], like)
    fresnel: list[Any] = [1.0, *(fresnel_conductor(c + 0 * like, eta, k) for c in tables.METAL[1:])]
    size = COUNT**2
    values = [sum(weights[n * size + i] * f for n, f in enumerate(fresnel)) for i in range(size)]
    found = Mixing.told(values)
    once = tables.metal_diffuse(kind, eta, k, alpha, False, like)
    if kind != tables.COMMON:
        found = found * (once / tables.metal_diffuse(tables.COMMON, eta, k, alpha, False, like))
    if not full:
        return found
    lost = [sum(weights[n * size + j] for n in range(len(fresnel))) * -(2 * j + 1) for j in range(COUNT)]
    lost[0] = lost[0] + 1
    more = tables.metal_diffuse(kind, eta, k, alpha, True, like) - once
    more = more / at_least(lost[0] + lost[1] * EVEN[1], 1e-4)
    return found + Mixing([[share * even * more for share in lost] for even in EVEN])
