"""Write src/urushi/interfaces/data/*.npz: the energy that single scattering between microfacets loses.

    python tools/make_energy_tables.py [NAME ...]

`urushi.interfaces.tables` says what the axes are. A name makes one file, so that what was stopped can go on; shares and
means need the tables of glass made before.
"""

from __future__ import annotations

import functools
import itertools
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MASKINGS = ("correlated", "separable")
MODELS = [(d, m) for d in ("ggx", "beckmann") for m in MASKINGS]
#: ranks of the lattices: 10 946 points, an error of 2e-4; and 4181 for the coarse tables, 5e-4
FINE, COARSE = 20, 18
#: lanes of one launch
LANES = 1 << 17
#: walks for each number of the shares
WALKS = 1 << 18


@functools.cache
def _loses(distribution: str, kind: str) -> dict[str, NDArray[np.float64]]:
    """What single scattering loses at the nodes of a table, by the masking."""
    return missing(distribution, FINE if kind in ("metal", "glass") else COARSE, **AXES[kind]())


def missing(distribution: str, rank: int, **axes: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """What single scattering loses, by the masking, for arrays of cos, phi, alpha_x, alpha_y and eta (0: a mirror)."""
    from drjit.llvm.ad import Float64

    from urushi.interfaces import BoundConductor, BoundDielectric
    from urushi.interfaces.base import Frame
    from urushi.interfaces.energy import _lanes, _lattice, _mean

    names = ("cos", "phi", "alpha_x", "alpha_y", "eta")
    arrays = np.broadcast_arrays(*(axes[name] for name in names))
    size = arrays[0].size
    found = np.empty((2, size))
    point, count = _lattice(Float64, rank)
    for start in range(0, size, LANES):
        at = np.unravel_index(np.arange(start, min(start + LANES, size)), arrays[0].shape)
        cos, phi, x, y, eta = (np.ascontiguousarray(a[at], np.float64) for a in arrays)
        cos = np.clip(cos, 1e-5, 1)
        sin = np.sqrt((1 - cos) * (1 + cos))
        w = _lanes(np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1))
        surfaces = [_surface(Float64(x), Float64(y), distribution, masking) for masking in MASKINGS]
        interfaces: list[Any] = [
            BoundConductor(0.0, 1.0, 1.0, surface, False, Frame(0.0))
            if eta[0] == 0
            else BoundDielectric(Float64(eta), surface, False, Frame(0.0))
            for surface in surfaces
        ]
        term = functools.partial(_lost, interfaces, w, point)
        found[:, start : start + LANES] = _mean(w, count, term)
    return {masking: part.reshape(arrays[0].shape) for masking, part in zip(MASKINGS, found, strict=True)}


def _surface(x: Any, y: Any, distribution: str, masking: str) -> Any:
    """A surface whose Beckmann normals are taken as they are, not as they are seen: by formulas a tenth as long."""
    import drjit as dr

    from urushi.optics.microfacet import Microfacets

    class Seen(Microfacets):
        def sample(self, w: Any, u1: Any, u2: Any) -> Any:
            if self.ggx:
                return super().sample(w, u1, u2)
            r = dr.sqrt(-dr.log(1 - u1))
            sin, cos = dr.sincos(2 * dr.pi * u2)
            return dr.normalize(type(w)(-self.alpha_x * r * cos, -self.alpha_y * r * sin, 1 + 0 * r))

        def importance(self, w: Any, u1: Any, u2: Any) -> Any:
            """How much of the light from w meets the facet of these numbers, 1 on the average."""
            if self.ggx:
                return 1.0
            m = self.sample(w, u1, u2)
            return dr.select(dr.dot(w, m) > 0, dr.dot(w, m) / (m.z * self.sigma(w)), 0)

    return Seen(x, y, distribution, masking)


def _lost(interfaces: list[Any], w: Any, point: Any, i: Any) -> tuple[Any, ...]:
    """What a facet loses, for both maskings: what is computed of the facets is the same, and is computed once."""
    import drjit as dr

    parts, u = [], point(i)
    for interface in interfaces:
        lost = 1.0
        for part in ("reflect", "transmit")[: 1 if interface.opaque else 2]:
            event = interface.sample(w, (0.5, *u), True, part)
            lost = lost - dr.select(event.o.z > 0 if part == "reflect" else event.o.z < 0, event.weight, 0)
        parts.append(lost * interface.facets.importance(w, *u))
    return tuple(parts)


def packed(energy: NDArray[np.float64], dtype: str) -> NDArray[Any]:
    """Square roots as integers; their differences along the last axes, which wrap around and compress well."""
    from urushi.interfaces.tables import LEVELS, packed_axes

    # Walter's fit to Beckmann's masking loses less than nothing, by 2e-3, near grazing.
    assert energy.min() > -5e-3 and energy.max() < 1 + 1e-3, (energy.min(), energy.max())
    roots = np.round(np.sqrt(np.clip(energy, 0, 1)) * LEVELS[dtype]).astype(dtype)
    for axis in packed_axes(roots.ndim):
        roots = np.diff(roots, axis=axis, prepend=roots.dtype.type(0))
    return roots


def even_axes(index: bool) -> dict[str, Any]:
    """Nodes of isotropic surfaces: [roughness, cosine] of a metal, [index, roughness, cosine] of glass."""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.ROUGHNESSES)[:, None]
    cos = np.array([t.cosines(a, t.COSINES) for a in alpha[:, 0]])
    eta = t.indices(t.INDICES)[:, None, None] if index else 0.0
    return {"cos": cos, "phi": 0.0, "alpha_x": alpha, "alpha_y": alpha, "eta": eta}


def brushed_metal_axes() -> dict[str, Any]:
    """[roughness, ratio, azimuth, cosine]"""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.COARSE_ROUGHNESSES)[:, None, None, None]
    ratio = t.ratios(t.RATIOS)[:, None, None]
    cos = t.cosines((alpha / np.sqrt(ratio))[..., 0], t.COARSE_COSINES)
    phi = np.linspace(0, np.pi / 2, t.AZIMUTHS)[:, None]
    return {"cos": cos, "phi": phi, "alpha_x": alpha, "alpha_y": alpha / ratio, "eta": 0.0}


def brushed_glass_axes() -> dict[str, Any]:
    """[index, roughness, ratio, azimuth, cosine]"""
    from urushi.interfaces import tables as t

    n_alpha, n_ratio, n_phi, n_cos = t.BRUSHED
    alpha = t.brushed_roughnesses(n_alpha)[:, None, None, None]
    ratio = t.ratios(n_ratio)[:, None, None]
    turn = np.linspace(0, np.pi / 2, n_phi)[:, None]
    phi = np.arctan2(np.sin(turn), np.cos(turn) * ratio**-t.LEAN)
    along = np.hypot(alpha * np.cos(phi), alpha / ratio * np.sin(phi))
    cos = t.cosines(t.WIDER * along[..., 0], n_cos)
    return {"cos": cos, "phi": phi, "alpha_x": alpha, "alpha_y": alpha / ratio, "eta": t.bends(along)}


AXES: dict[str, Any] = {
    "metal": functools.partial(even_axes, False),
    "glass": functools.partial(even_axes, True),
    "brushed_metal": brushed_metal_axes,
    "brushed_glass": brushed_glass_axes,
}


def energies(kind: str, model: tuple[str, str]) -> NDArray[Any]:
    """One table of lost energy, as its file has it."""
    found = _loses(model[0], kind)[model[1]]
    return packed(found, "uint8" if kind.startswith("brushed") else "uint16")


def brushed_means(model: tuple[str, str]) -> NDArray[Any]:
    """[what, index, roughness, ratio]: the two `tables.means` of what is interpolated in the table of brushed glass.

    The first over the roughness, not its square: what the table rounds, smooth surfaces lose at all angles.
    """
    from urushi.interfaces import tables as t

    nodes = t.brushed_roughnesses(4 * t.BRUSHED[0] - 3), t.ratios(t.BRUSHED[1])
    found = np.empty((2, t.MEAN_INDICES, *(len(axis) for axis in nodes)))
    for (j, alpha), (k, ratio) in itertools.product(*map(enumerate, nodes)):
        if j > 0:
            found[:, :, j, k] = brushed_mean(model, float(alpha), float(ratio))
    found[:, :, 0] = found[:, :, 1]  # the smoothest is as the next
    return found.astype(np.float16)


def brushed_mean(model: tuple[str, str], alpha: float, ratio: float) -> NDArray[np.float64]:
    """The same for one roughness and one ratio, of all indices: (2, MEAN_INDICES)."""
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.interfaces import tables as t
    from urushi.interfaces.energy import hemisphere
    from urushi.interfaces.missing import Missing
    from urushi.optics.microfacet import Microfacets

    w, weight = hemisphere(12, 48, alpha / ratio)
    lanes = np.tile(w, (t.MEAN_INDICES, 1))
    eta = np.repeat(t.indices(t.MEAN_INDICES), len(w))
    surface = Microfacets(Float64(alpha), Float64(alpha / ratio), *model)
    lost = Missing(surface, Float64(eta), False, Float64)(Array3f64(*np.ascontiguousarray(lanes.T)), True)
    lost = np.array(lost).reshape(-1, len(w))
    return np.stack([lost @ weight / alpha, lost @ (weight * w[:, 2]) / (lost @ weight)])


@functools.cache
def bounced(distribution: str, alpha: float, eta: float) -> float:
    """Reflectance, for light from the hemisphere above by cosine, of light that meets two facets at least.

    A walk among the facets (Heitz et al. 2016) is made to meet a second one and carries the chance that it does.
    """
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.bounces import Way, escape
    from urushi.optics.facets import Pane
    from urushi.optics.microsurface import Microsurface, exponential, fly, other_depth
    from urushi.optics.random import generator, uniform
    from urushi.optics.vectors import mirror

    surface, facet = (
        Microsurface(Float64(alpha), Float64(alpha), distribution),
        Pane(Float64(eta), Float64(1 / eta)),
    )
    # As many of the directions for each octave of cosines above the roughness: what is lost falls off steeply.
    lane = (dr.arange(Float64, WALKS) + 0.5) / WALKS
    cos = alpha * (dr.power(1 + 1 / alpha, lane) - 1)
    share = 2 * cos * (cos + alpha) * np.log1p(1 / alpha)
    w = Array3f64(dr.sqrt((1 - cos) * (1 + cos)), 0, cos)
    rng = generator(w, [*w], 1, 0)
    area = surface.area(w)
    event = facet.scatter(surface, w, surface.sample(w, uniform(rng, w), uniform(rng, w)), area, False, rng)
    t = exponential(rng, w) / surface.rate(w, area)
    t = dr.select(event.through, other_depth(t), t)
    d = dr.select(event.through, mirror(event.d), event.d)
    area = surface.area(-d)
    rate = surface.rate(-d, area)
    stays = dr.select(d.z > 0, 1 - dr.exp(-rate * t), 1.0)
    to_next = dr.select(d.z > 0, -dr.log(1 - uniform(rng, w) * stays), exponential(rng, w))
    t, _ = fly(t, d, rate, to_next)
    inside = event.through
    event = facet.scatter(surface, -d, surface.normal(-d, rng), area, inside, rng)
    d = dr.select(event.through, mirror(event.d), event.d)
    t = dr.select(event.through, other_depth(t), t)
    way = Way(t, d, event.density, stays, inside ^ event.through, True & (cos > 0), w, t, rate)
    _, weight, through = escape(surface, facet, way, rng)
    return float(dr.mean(dr.select(through, 0, weight * share))[0])


def shares(model: tuple[str, str]) -> NDArray[Any]:
    """[index from 1, roughness]: what is lost and then transmitted, over all that could be (`Missing.exchanged`)."""
    from urushi.interfaces import tables as t

    found = np.ones((t.SHARE_INDICES, t.SHARE_ROUGHNESSES))
    for j, alpha in enumerate(t.roughnesses(t.SHARE_ROUGHNESSES)):
        for i, eta in enumerate(t.indices(2 * t.SHARE_INDICES - 1)[t.SHARE_INDICES - 1 :]):
            if i > 0 and j > 0:  # equal indices reflect nothing; the smoothest is as the next
                found[i, j] = share(model, float(alpha), float(eta))
        print(model, f"{alpha:.4f}", found[:, j].round(3), flush=True)
    found[:, 0] = found[:, 1]
    assert found.min() > 0 and found.max() < 1.02, (found.min(), found.max())
    return np.minimum(found, 1).astype(np.float32)


def share(model: tuple[str, str], alpha: float, eta: float) -> float:
    """The same for one roughness and one index.

    What the walk reflects and single scattering does not, is the rest; with separable masking that is more.
    """
    from drjit.llvm.ad import Float64

    from urushi.interfaces import BoundDielectric, energy
    from urushi.interfaces.base import Frame
    from urushi.interfaces.missing import Missing
    from urushi.optics.microfacet import Microfacets

    facets = Microfacets(Float64(alpha), Float64(alpha), *model)
    missing = Missing(facets, Float64(eta), True, Float64)
    reflected = bounced(model[0], alpha, eta)
    if model[1] == "separable":
        facing = Microfacets(Float64(alpha), Float64(alpha), model[0], "correlated")
        for sign, one in ((1, facing), (-1, facets)):
            interface = BoundDielectric(Float64(eta), one, False, Frame(0.0))
            reflected += sign * float(energy.hemispherical(interface, accuracy=1e-3).reflectance)
    one, other = float(missing.mean(True)[0]), float(eta**2 * missing.mean(False)[0])
    return (one - reflected) / min(one, other)


#: tables and what makes them, in the order in which one needs the other
KINDS: dict[str, Any] = {
    **{kind: functools.partial(energies, kind) for kind in AXES},
    "brushed_means": brushed_means,
    "shares": shares,
}


def main(chosen: list[str]) -> None:
    from urushi.llvm import ensure

    ensure()
    from urushi.interfaces import tables

    tables.DATA.mkdir(exist_ok=True)
    for kind, make in KINDS.items():
        if chosen and kind not in chosen:
            continue
        start = time.time()
        path = Path(tables.DATA) / f"{kind}.npz"
        made = {}
        for model in MODELS:
            made["_".join(model)] = make(model)
            print(f"{kind} {' '.join(model)}: {time.time() - start:.0f} s", flush=True)
        np.savez_compressed(path, **made)
        print(f"{path}: {path.stat().st_size} bytes, {time.time() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
