"""What rough interfaces reflect and transmit, from tables that Urushi made of its own interfaces.

A table is for one distribution of normals and one masking. The light it answers for is a lobe: that of a GGX surface
of roughness `width` around the direction of mean cosine `cos` (0: all light in one direction), since that is how
light comes back from the layers below. So the part of a lobe that is totally reflected is in the table, and so is
what Belcour's separate table of total reflection is for.

    dielectric      side, index ratio, roughness, width, cosine -> reflectance, transmittance, mean cosines transmitted
                    and reflected
    diffuse         side, index ratio, roughness -> reflectance and transmittance of light that comes evenly from a side
    metal           roughness, width, cosine -> weights w_j: the reflectance is sum w_j F(c_j), whatever Fresnel's F is
    metal diffuse   likewise for even light
    round trips     side, index ratio, roughness, width, cosine -> what happens to light that entered through a
                    dielectric under this cosine and is sent back by a mirror as rough as `width`, the first time and
                    later (of GGX, for all distributions)
    sheets          index, both roughnesses, cosine -> the same between two dielectrics (of GGX, likewise)
    exits           side, index ratio, roughness, width, cosine in the thinner medium -> width and middle of what gets
                    through (of GGX, likewise)
    escaping        index ratio, width, cosine -> how much of a lobe in the denser medium is not totally reflected
    anisotropic     roughness along x, along y, cosine, squared sine of the azimuth -> what perfect mirrors reflect
    centre          width, mean cosine -> centre of a lobe, as all others take it; `mean` is the inverse

Interpolation is off by at most 0.004 from the thinner side, and 0.012 from the denser one, near the critical angle
(test_lobes_operators; GGX, alpha 0.07 to 0.6).

All are for one scattering at the facets; `complete` adds what facets send to one another.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import drjit as dr
import numpy as np

from ...optics.fresnel import fresnel_conductor
from ...optics.vectors import Array, Vector, at_least, at_most
from . import axes
from .grid import Grid
from .settled import settled

#: steps of the fixed-point numbers in the files
STEP = 2.0**-14
#: the distribution and masking whose tables know lobes; those of the others are for one direction
COMMON = ("ggx", "correlated")
#: cosines at which the reflectance of a metal is asked for; the first is 0, where it is 1
METAL = tuple(float((0.5 - 0.5 * np.cos(np.pi * j / 4)) ** 2) for j in range(5))


@cache
def _grid(kind: tuple[str, ...], name: str) -> Grid:
    with np.load(Path(__file__).parent / "data" / f"{'_'.join(kind)}.npz") as file:
        first, last = {"dielectric": (0, 2), "transmitted": (2, 3), "reflected": (3, 4)}.get(name, (0, None))
        return Grid(file["dielectric" if last else name][..., first:last] * STEP)


def _of(kind: tuple[str, str], width: Array | None) -> tuple[str, str]:
    """Whose table to ask: once light is a lobe, that of GGX serves all."""
    return kind if width is None else COMMON


def _side(eta: Array) -> Array:
    """The node of the side: a whole number, between which there is nothing to interpolate."""
    if isinstance(eta, float):
        return 0 if eta >= 1 else 1
    whole = dr.uint32_array_t(type(eta))
    return dr.select(eta >= 1, whole(0), whole(1))


def dielectric(
    kind: tuple[str, str], cos: Array, eta: Array, alpha: Array, width: Array | None
) -> tuple[Array, Array]:
    """Reflectance and transmittance of a rough dielectric.

    Args:
        kind: distribution and masking.
        cos: mean cosine of incidence.
        eta: index beyond over index before.
        alpha: roughness of the interface.
        width: roughness of the lobe that the light is; None for one direction.
    """
    r, t = _interface((_of(kind, width), "dielectric"), cos, eta, alpha, width)
    return r, t


def round_trip(cos: Array, eta: Array, alpha: Array, width: Array) -> list[Array]:
    """What happens to light that entered through a rough dielectric, each time it comes back from below.

    Args:
        cos: cosine of incidence, before it entered.
        eta: index below over index above.
        alpha: roughness of the interface.
        width: roughness of a mirror that would send the light back as wide as it is.

    Returns:
        reflectance and transmittance the first time, both in the mean over all later times if half of the light is left
        from one to the next, and if nine tenths are, the mean cosine of the light on its way back down, and the
        roughness of what gets out in terms of what derivatives say it is.
    """
    return _interface((("round_trips",), "round_trips"), cos, eta, alpha, width)


def sheet(cos: Array, eta: Array, alpha: Array, other: Array) -> list[Array]:
    """What goes back and forth in a sheet of rough glass.

    Args:
        cos: cosine of incidence, outside.
        eta: index within over index around, above 1.
        alpha, other: roughnesses of the interface that light enters through, and of the other.

    Returns:
        reflectance and transmittance of the other interface, the first time and in the mean over all later ones; the
        same of the first interface, for what comes back to it.
    """
    places: list[Array | int] = [
        axes.along_ratio(at_least(eta, 1.0) + 0 * cos),
        *(axes.along_square(a + 0 * cos) for a in (alpha, other)),
        dr.sqrt(at_most(at_least(cos, 1e-8), 1.0)),
    ]
    return _grid(("sheets",), "sheets")(places, cos)


def exit(cos: Array, eta: Array, alpha: Array, width: Array) -> list[Array]:
    """The lobe that gets through a rough dielectric to the far side of a stack.

    Args:
        cos: cosine of its middle in the thinner medium.
        eta: index beyond over index before.
        alpha: roughness of the interface.
        width: of the light before, as the roughness of a mirror.

    Returns:
        roughness in the plane of incidence and across it, and the angle by which the middle is farther from the normal
        than Snell's law says: all over the roughness of first-order derivatives.
    """
    places: list[Array | int] = [
        _side(eta + 0 * cos),
        axes.along_ratio(eta + 0 * cos),
        *(axes.along_square(a + 0 * cos) for a in (alpha, width)),
        dr.sqrt(at_most(at_least(cos, 1e-8), 1.0)),
    ]
    return _grid(("exits",), "exits")(places, cos)


def mean_cosine(
    kind: tuple[str, str], cos: Array, eta: Array, alpha: Array, width: Array | None, through: bool
) -> Array:
    """Mean cosine of what a rough dielectric transmits or reflects; arguments as for `dielectric`."""
    name = "transmitted" if through else "reflected"
    return _interface((_of(kind, width), name), cos, eta, alpha, width)[0]


def escaping(cos: Array, eta: Array, width: Array) -> Array:
    """How much of a lobe of this centre and roughness a boundary of index ratio eta does not reflect totally."""
    places = [
        axes.along_ratio(eta + 0 * cos),
        axes.along_square(width + 0 * cos),
        axes.along_cosine(cos, at_most(eta, 0.999)),
    ]
    return dr.select(eta < 1, _grid(("lobes",), "escaping")(places, cos)[0], 1)


def centre(mean: Array, width: Array) -> Array:
    """The cosine of the direction around which a lobe lies, of which roughness and mean cosine are known."""
    return _grid(("lobes",), "centre")([axes.along_square(width + 0 * mean), at_most(mean, 1.0)], mean)[0]


def mean(cos: Array, width: Array) -> Array:
    """The mean cosine of the lobe around a direction, the inverse of `centre`."""
    return _grid(("lobes",), "mean")([axes.along_square(width + 0 * cos), at_most(cos, 1.0)], cos)[0]


def _interface(
    where: tuple[tuple[str, ...], str], cos: Array, eta: Array, alpha: Array, width: Array | None
) -> list[Array]:
    """A table of rough dielectrics."""
    grid = _grid(*where)
    last: list[Array | int] = [
        0 if width is None else axes.along_square(width + 0 * cos),
        axes.along_cosine(cos, eta),
    ]
    if isinstance(alpha, float):
        alpha = type(cos)(alpha)
    leading = settled("places", (eta, alpha), lambda: _leading(eta, alpha))
    part = None if leading is None else grid.at(leading, where)
    if part is not None:
        return part(last, cos)
    return grid([*_leading(eta + 0 * cos, alpha + 0 * cos), *last], cos)


def _leading(eta: Array, alpha: Array) -> list[Array]:
    return [_side(eta), axes.along_ratio(eta), axes.along_square(alpha)]


def dielectric_diffuse(kind: tuple[str, str], eta: Array, alpha: Array, like: Array) -> tuple[Array, Array]:
    """Reflectance and transmittance of a rough dielectric for light that comes evenly from the side it comes from."""
    grid = _grid(kind, "dielectric_diffuse")
    found = settled((kind, "even"), (eta, alpha), lambda: grid(_leading(eta, alpha), alpha))
    r, t = grid(_leading(eta + 0 * like, alpha + 0 * like), like) if found is None else found
    return r, t


def complete(r: Array, t: Array) -> tuple[Array, Array]:
    """Nothing lost: what one scattering does not send out leaves in the end, shared as the first scattering shares."""
    whole = dr.rcp(at_least(r + t, 1e-6))
    r = r * whole
    return r, 1 - r


def metal(
    kind: tuple[str, str],
    cos: Array,
    eta: Array,
    k: Array,
    alpha: Array,
    width: Array | None,
    full: bool,
) -> Array:
    """Reflectance of a rough metal.

    Args:
        eta, k: its complex index over that of the medium above.
        full: with what its facets send to one another (Kulla & Conty 2017, with the mean reflectance of all angles).
        Others as for `dielectric`.
    """
    last: list[Array | int] = [
        0 if width is None else axes.along_square(width + 0 * cos),
        dr.sqrt(at_most(at_least(cos, 1e-8), 1.0)),
    ]
    where = _of(kind, width), "metal"
    if isinstance(alpha, float):
        alpha = type(cos)(alpha)
    leading = settled("rough", (alpha,), lambda: [axes.along_square(alpha)])
    part = None if leading is None else _grid(*where).at(leading, where)
    rough = [axes.along_square(alpha + 0 * cos)]
    weights = _grid(*where)([*rough, *last], cos) if part is None else part(last, cos)
    return _metal(kind, weights, eta, k, alpha + 0 * cos, full)


def metal_diffuse(
    kind: tuple[str, str], eta: Array, k: Array, alpha: Array, full: bool, like: Array
) -> Array:
    """Reflectance of a rough metal for light that comes evenly from all directions."""
    alpha = alpha + 0 * like
    return _metal(kind, _grid(kind, "metal_diffuse")([axes.along_square(alpha)], like), eta, k, alpha, full)


def albedo(cos: Array | None, alpha: Array, like: Array) -> Array:
    """What a mirror of GGX facets reflects by single scattering from this cosine; None: from all directions."""
    alpha = at_least(alpha + 0 * like, 0)
    if cos is None:
        weights = _grid(COMMON, "metal_diffuse")([axes.along_square(alpha)], like)
    else:
        places: list[Array | int] = [axes.along_square(alpha), 0, dr.sqrt(at_least(cos, 1e-8))]
        weights = _grid(COMMON, "metal")(places, like)
    return sum(weights[1:], weights[0])


def albedo_towards(w: Vector, alpha_x: Array, alpha_y: Array) -> Array:
    """The same of facets that are not alike in all directions, in their frame, from the direction w with z > 0."""
    x, y = dr.square(w.x), dr.square(w.y)
    places = [
        axes.along_square(alpha_x + 0 * w.z),
        axes.along_square(alpha_y + 0 * w.z),
        dr.sqrt(at_most(at_least(w.z, 1e-8), 1.0)),
        y / at_least(x + y, 1e-12),
    ]
    return _grid(("lobes",), "anisotropic")(places, w.z)[0]


def _metal(
    kind: tuple[str, str], weights: list[Array], eta: Array, k: Array, alpha: Array, full: bool
) -> Array:
    fresnel = settled(
        "metal", (eta, k), lambda: [fresnel_conductor(type(alpha)(c), eta, k) for c in METAL[1:]]
    )
    if fresnel is None:
        fresnel = [fresnel_conductor(c + 0 * alpha, eta, k) for c in METAL[1:]]
    single = weights[0] + sum(w * f for w, f in zip(weights[1:], fresnel, strict=True))
    if not full:
        return single
    share = sum(weights[1:], weights[0])
    average = _grid(kind, "metal_diffuse")([axes.along_square(alpha)], alpha)
    albedo = sum(average[1:], average[0])
    even = _EVEN[0] + sum(w * f for w, f in zip(_EVEN[1:], fresnel, strict=True))
    return single + (1 - share) * dr.square(even) * albedo / (1 - even * (1 - albedo))


def _even_weights() -> tuple[float, ...]:
    """Weights of the reflectances at `METAL` in the mean over all directions, by cosine."""
    x, weight = np.polynomial.legendre.leggauss(16)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    nodes = np.sqrt(METAL)
    found = []
    for j in range(len(nodes)):
        lagrange = np.ones_like(x)
        for i in range(len(nodes)):
            if i != j:
                lagrange *= (x - nodes[i]) / (nodes[j] - nodes[i])
        found.append(float(weight @ (lagrange * 4 * x**3)))  # the cosine is x^2: 2 c dc = 4 x^3 dx
    return tuple(found)


_EVEN = _even_weights()
