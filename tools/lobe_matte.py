"""What rough diffuse bases send where: tables of `make_lobe_tables` (see `solvers.lobes.matte`).

The integral over the facets that light meets once is a product rule on the facets that the lower of both directions
sees; what goes on from facet to facet is the mean of many walks of `optics.bounces`. Energies are integrals of what the
tables say between their nodes, so that values and energies agree; what white facets keep by the error of the walks is
given to the last order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

#: nodes of the rule over facets: around, and outwards
AROUND, OUTWARDS = 32, 24
#: walks for each entry, and for each energy
WALKS, ENERGY_WALKS = 1 << 13, 1 << 14
#: reflectance that the last ratio is fitted to
GREY = 0.7
#: the smallest roughness that it is fitted for: less rough surfaces send next to nothing on to a third facet
FITTED = 0.3
#: lowest cosine that light is followed from
LOWEST = 1e-3


def vectors(cos: np.ndarray, phi: np.ndarray | float) -> np.ndarray:
    """(..., 3)"""
    sin = np.sqrt(1 - cos * cos)
    return np.stack(np.broadcast_arrays(sin * np.cos(phi), sin * np.sin(phi), cos), axis=-1)


def cosines(count: int) -> np.ndarray:
    """Cosines of the nodes."""
    return np.maximum(1 - (1 - np.linspace(0, 1, count)) ** 2, LOWEST)


def places(nodes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(w, o) of every entry of one roughness: (cosines, cosines, azimuths, 3)."""
    cos, phi = cosines(nodes[1]), np.arccos(1 - 2 * np.linspace(0, 1, nodes[3]))
    a, b, p = np.meshgrid(cos, cos, phi, indexing="ij")
    return vectors(a, 0.0), vectors(b, p)


def masking(w: np.ndarray, alpha: float, kind: str) -> np.ndarray:
    """Smith's Lambda."""
    from scipy.special import erf

    tan = alpha * np.sqrt(w[..., 0] ** 2 + w[..., 1] ** 2) / w[..., 2]
    if kind == "ggx":
        return np.asarray(0.5 * (np.sqrt(1 + tan**2) - 1))
    a = np.minimum(1 / np.maximum(tan, 1e-9), 9.0)
    return np.asarray(0.5 * (erf(a) - 1) + 0.5 * np.exp(-a * a) / (a * np.sqrt(np.pi)))


def once(w: np.ndarray, o: np.ndarray, alpha: float, kind: str) -> np.ndarray:
    """j of `solvers.lobes.matte` for facets alike in all directions: (..., 3), (..., 3) -> (...)."""
    if alpha == 0:
        return np.ones(w.shape[:-1])
    sigma_w, sigma_o = (v[..., 2] * (1 + masking(v, alpha, kind)) for v in (w, o))
    swap = w[..., 2:] > o[..., 2:]
    w, o = np.where(swap, o, w), np.where(swap, w, o)
    stretched = w * [alpha, alpha, 1]
    length = np.linalg.norm(stretched, axis=-1)
    w = stretched / length[..., None]
    cap, start = 1 + w[..., 2], np.arctan2(w[..., 1], w[..., 0])
    out, weights = np.polynomial.legendre.leggauss(OUTWARDS)
    found = np.zeros(w.shape[:-1])
    for turn in 2 * np.pi * (np.arange(AROUND) + 0.5) / AROUND:
        for u, weight in zip(0.5 * (out + 1), 0.5 * weights, strict=True):
            low = cap * u * u
            r = np.sqrt(low * (2 - low))
            x, y, z = r * np.cos(start + turn) + w[..., 0], r * np.sin(start + turn) + w[..., 1], cap - low
            m = np.stack([alpha * x, alpha * y, z], axis=-1)
            seen = np.maximum((m * o).sum(-1), 0) / np.linalg.norm(m, axis=-1) * 2 * u * weight / AROUND
            if kind == "beckmann":
                slope = (x**2 + y**2) / np.maximum(z**2, 1e-6)
                seen = seen * np.exp(-slope) * (1 + slope) ** 2
            found += seen
    return found * 0.5 * (length + stretched[..., 2]) / (sigma_w * sigma_o)


def again(nodes: tuple[int, ...], alpha: float, kind: str, seed: int, walks: int) -> np.ndarray:
    """(cosines, cosines, azimuths, 2): pi f_2, and pi f_3 of white facets."""
    from drjit.llvm.ad import Array3f, Float

    from urushi.optics.bounces import begin, gather
    from urushi.optics.facets import Event, Paper
    from urushi.optics.microsurface import Microsurface

    class Last(Paper):
        """White facets whose light goes no further."""

        def scatter(self, *arguments: Any) -> Event:
            event = super().scatter(*arguments)
            event.factor = 0 * event.factor
            return event

    w, o = places(nodes)
    shape = w.shape[:-1]
    if alpha == 0:
        return np.zeros((*shape, 2))
    one, other = (Array3f(*np.repeat(v.reshape(-1, 3), walks, axis=0).T.astype(np.float32)) for v in (w, o))
    surface, white = Microsurface(Float(alpha), Float(alpha), kind), Paper(Float(1))
    sums = []
    for facet in (Last(Float(1)), white):
        rng = generator(one, seed)
        event = white.scatter(surface, one, surface.normal(one, rng), surface.area(one), False, rng)
        value = gather(surface, facet, begin(surface, one, event, event.factor, one.z > 0, rng), other, rng)
        sums.append(np.array(value, np.float64).reshape(*shape, walks).mean(axis=-1) * np.pi / o[..., 2])
    found = np.stack([sums[0], sums[1] - sums[0]], axis=-1)
    return np.asarray(0.5 * (found + found.swapaxes(0, 1)))


def generator(like: Any, seed: int) -> Any:
    """Random numbers for every lane."""
    import drjit as dr
    from drjit.llvm.ad import UInt

    from urushi.optics import random

    return random.generator(like, [], UInt(seed), dr.arange(UInt, dr.width(like)))


def grey(cos: np.ndarray, alpha: float, kind: str, seed: int, walks: int) -> np.ndarray:
    """What facets of reflectance `GREY` send out in the end, by cosine."""
    from drjit.llvm.ad import Array3f, Float

    from urushi.optics.bounces import begin, escape
    from urushi.optics.facets import Paper
    from urushi.optics.microsurface import Microsurface

    w = Array3f(*np.repeat(vectors(cos, 0.0), walks, axis=0).T.astype(np.float32))
    surface, facet, rng = (
        Microsurface(Float(alpha), Float(alpha), kind),
        Paper(Float(GREY)),
        generator(w, seed),
    )
    event = facet.scatter(surface, w, surface.normal(w, rng), surface.area(w), False, rng)
    weight = escape(surface, facet, begin(surface, w, event, event.factor, w.z > 0, rng), rng)[1]
    return np.array(weight, np.float64).reshape(len(cos), walks).mean(axis=1)


def interpolated(table: np.ndarray, axes_: list[np.ndarray]) -> np.ndarray:
    """A table between its nodes: places (N,) along each axis -> (N, C)."""
    from scipy.interpolate import RegularGridInterpolator

    nodes = [np.linspace(0, 1, n) for n in table.shape[:-1]]
    return np.asarray(RegularGridInterpolator(nodes, table)(np.stack(axes_, axis=-1)))


def cones(first: np.ndarray, later: np.ndarray, alphas: np.ndarray, kind: str, counts: tuple) -> np.ndarray:
    """(roughness, cosine, rim, 3): means of the three parts of pi f over the directions above a rim."""
    cos, rims = cosines(counts[1]), np.linspace(0, 1, counts[2])
    x, weight = np.polynomial.legendre.leggauss(48)
    s = 0.5 * (x + 1)
    phi = np.pi * (np.arange(24) + 0.5) / 24
    found = np.zeros((*counts, 3))
    for k, rim in enumerate(rims):
        z = np.sqrt(np.maximum(rim**2 + (1 - rim**2) * s**2, LOWEST**2))
        c, z, p = (v.ravel() for v in np.meshgrid(cos, z, phi, indexing="ij"))
        apart = 0.5 - 0.5 * np.cos(p)
        places_ = [1 - np.sqrt(1 - c), 1 - np.sqrt(np.maximum(1 - z, 0)), apart]
        for a, alpha in enumerate(alphas):
            rough = np.full_like(c, np.sqrt(alpha))
            j = interpolated(first, [rough, *places_])[:, 0]
            masked_w, masked_o = (masking(vectors(v, 0.0), max(alpha, 1e-9), kind) for v in (c, z))
            j = j * (1 + masked_w) * (1 + masked_o) / (1 + masked_w + masked_o)
            parts = np.concatenate([j[:, None], interpolated(later, [rough, *places_])], axis=1)
            mean = parts.reshape(len(cos), len(s), len(phi), 3).mean(axis=2)
            found[a, :, k] = np.einsum("isc,s->ic", mean, weight * s)  # 2 z dz / (1 - rim^2) = 2 s ds
    return found


def tables() -> dict[str, np.ndarray]:
    """Every table, by distribution and name, as `solvers.lobes.matte` reads them, before rounding."""
    from urushi.solvers.lobes import axes, matte

    made = {}
    for kind in ("ggx", "beckmann"):
        alphas, coarse = axes.squares(matte.ONCE[0]), axes.squares(matte.AGAIN[0])
        w, o = places(matte.ONCE)
        first = np.stack([once(w, o, float(a), kind) for a in alphas])[..., None]
        later = np.stack([again(matte.AGAIN, float(a), kind, k, WALKS) for k, a in enumerate(coarse)])
        above = cones(first, later, alphas, kind, matte.CONES)
        # White facets lose nothing: what the walks make of the last order is set right, for every cosine and rim.
        lost = 1 - above[:, :, 0, :2].sum(axis=-1)
        scale = np.where(above[:, :, 0, 2] > 1e-6, lost / np.maximum(above[:, :, 0, 2], 1e-6), 1)
        above[..., 2] *= scale[..., None]
        above[:, :, 0, 2] = lost
        x, weight = np.polynomial.legendre.leggauss(48)
        c = 0.5 * (x + 1)
        place = 1 - np.sqrt(1 - c)
        rows = np.linspace(0, 1, matte.CONES[1])
        even = np.stack(
            [
                [(weight * c) @ np.interp(place, rows, above[a, :, 0, n]) for n in range(3)]
                for a in range(len(alphas))
            ]
        )
        tail = []
        for a, alpha in enumerate(alphas):
            left = 0.0
            if alpha > FITTED:
                whole = weight * c @ grey(c, float(alpha), kind, 100 + a, ENERGY_WALKS)
                rest = (whole - GREY * even[a, 0] - GREY**2 * even[a, 1]) / (GREY**3 * even[a, 2])
                left = max((1 - rest) / (1 - GREY * rest), 0.0)  # rest = (1 - q) / (1 - GREY q)
            tail.append(left)
        tail = [
            value if alpha > FITTED else tail[np.argmax(alphas > FITTED)]
            for value, alpha in zip(tail, alphas, strict=True)
        ]
        print("matte", kind, np.round(tail, 3), flush=True)
        made[f"{kind}_once"], made[f"{kind}_again"] = first, later
        made[f"{kind}_cones"] = above
        made[f"{kind}_even"] = np.concatenate([even, np.array(tail)[:, None]], axis=1)
    return made


def rounded(name: str, table: np.ndarray) -> np.ndarray:
    """As the file has it, sixteen bits."""
    from urushi.solvers.lobes import matte

    step = matte.COARSE if name.endswith("once") else matte.STEP
    assert np.abs(table).max() < 2**15 * step, (name, np.abs(table).max())
    return np.asarray(np.round(table / step), np.int16)
