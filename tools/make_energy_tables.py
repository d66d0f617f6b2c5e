"""Write src/urushi/interfaces/data/*.npz: the energy that single scattering between microfacets loses.

    python tools/make_energy_tables.py [NAME ...]

`urushi.interfaces.tables` says what the axes are. Half an hour on two cores; the shares need the tables of glass.
"""

from __future__ import annotations

import functools
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
#: ranks of the lattices: 10 946 points, an error of 2e-4; and 4181 for the coarse tables, 5e-4
FINE, COARSE = 20, 18
#: lanes of one launch
LANES = 1 << 17
#: walks for each number of the shares
WALKS = 1 << 18


def missing(model: tuple[str, str], rank: int, **axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """What single scattering loses, for arrays of cos, phi, alpha_x, alpha_y and eta (0: a mirror)."""
    from drjit.llvm.ad import Float64

    from urushi.interfaces import BoundConductor, BoundDielectric
    from urushi.interfaces.base import Frame
    from urushi.interfaces.energy import _facets
    from urushi.optics.microfacet import Microfacets

    names = ("cos", "phi", "alpha_x", "alpha_y", "eta")
    arrays = np.broadcast_arrays(*(axes[name] for name in names))
    flat = [np.ascontiguousarray(a, np.float64).ravel() for a in arrays]
    found = np.empty(flat[0].size)
    # Its sampling leaves less for the lattice to do, and takes longer.
    rank -= 2 if model[0] == "beckmann" else 0
    for start in range(0, found.size, LANES):
        cos, phi, x, y, eta = (a[start : start + LANES] for a in flat)
        cos = np.clip(cos, 1e-5, 1)
        sin = np.sqrt((1 - cos) * (1 + cos))
        w = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1)
        facets = Microfacets(Float64(x), Float64(y), *model)
        interface: Any = (
            BoundConductor(0.0, 1.0, 1.0, facets, False, Frame(0.0))
            if eta[0] == 0
            else BoundDielectric(Float64(eta), facets, False, Frame(0.0))
        )
        r, t = _facets(interface, w, True, rank)
        found[start : start + LANES] = 1 - r - t
    return found.reshape(arrays[0].shape)


def packed(energy: NDArray[np.float64], kind: str) -> NDArray[Any]:
    """Square roots as integers; their differences along the cosine, which wrap around and compress to half."""
    from urushi.interfaces.tables import LEVELS

    # Walter's fit to Beckmann's masking loses less than nothing, by 2e-3, near grazing.
    assert energy.min() > -5e-3 and energy.max() < 1, (energy.min(), energy.max())
    roots = np.round(np.sqrt(np.maximum(energy, 0)) * LEVELS[kind]).astype(kind)
    return np.diff(roots, axis=-1, prepend=roots.dtype.type(0))


def metal(model: tuple[str, str]) -> NDArray[Any]:
    """[roughness, cosine]"""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.ROUGHNESSES)[:, None]
    cos = np.array([t.cosines(a, t.COSINES) for a in alpha[:, 0]])
    return packed(missing(model, FINE, cos=cos, phi=0.0, alpha_x=alpha, alpha_y=alpha, eta=0.0), "uint16")


def glass(model: tuple[str, str]) -> NDArray[Any]:
    """[index, roughness, cosine]"""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.ROUGHNESSES)[:, None]
    cos = np.array([t.cosines(a, t.COSINES) for a in alpha[:, 0]])
    eta = t.indices(t.INDICES)[:, None, None]
    return packed(missing(model, FINE, cos=cos, phi=0.0, alpha_x=alpha, alpha_y=alpha, eta=eta), "uint16")


def _brushed(n: int) -> dict[str, NDArray[np.float64]]:
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.COARSE_ROUGHNESSES)[:, None, None, None]
    ratio = t.ratios(t.RATIOS)[:, None, None]
    mean = (alpha / np.sqrt(ratio)).ravel()
    cos = np.array([t.cosines(a, n) for a in mean]).reshape(len(alpha), t.RATIOS, 1, n)
    phi = np.linspace(0, np.pi / 2, t.AZIMUTHS)[:, None]
    return {"cos": cos, "phi": phi, "alpha_x": alpha, "alpha_y": alpha / ratio}


def brushed_metal(model: tuple[str, str]) -> NDArray[Any]:
    """[roughness, ratio, azimuth, cosine]"""
    from urushi.interfaces import tables as t

    return packed(missing(model, COARSE, **_brushed(t.COARSE_COSINES), eta=0.0), "uint8")


def brushed_glass(model: tuple[str, str]) -> NDArray[Any]:
    """[index, roughness, ratio, azimuth, cosine]"""
    from urushi.interfaces import tables as t

    eta = t.indices(t.COARSE_INDICES)[:, None, None, None, None]
    return packed(missing(model, COARSE, **_brushed(t.COARSE_COSINES), eta=eta), "uint8")


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
    """[index from 1, roughness]: what is lost and then transmitted, over all that could be (`Missing.exchanged`).

    What the walk reflects and single scattering does not, is the rest; with separable masking that is more.
    """
    from drjit.llvm.ad import Float64

    from urushi.interfaces import BoundDielectric, energy
    from urushi.interfaces import tables as t
    from urushi.interfaces.base import Frame
    from urushi.interfaces.missing import Missing
    from urushi.optics.microfacet import Microfacets

    found = np.ones((t.SHARE_INDICES, t.SHARE_ROUGHNESSES))
    for j, alpha in enumerate(t.roughnesses(t.SHARE_ROUGHNESSES)):
        for i, eta in enumerate(t.indices(2 * t.SHARE_INDICES - 1)[t.SHARE_INDICES - 1 :]):
            if i == 0 or j == 0:
                continue  # equal indices reflect nothing; the smoothest is as the next
            facets = Microfacets(Float64(alpha), Float64(alpha), *model)
            missing = Missing(facets, Float64(eta), True, Float64)
            reflected = bounced(model[0], float(alpha), float(eta))
            if model[1] == "separable":
                facing = Microfacets(Float64(alpha), Float64(alpha), model[0], "correlated")
                for sign, one in ((1, facing), (-1, facets)):
                    interface = BoundDielectric(Float64(eta), one, False, Frame(0.0))
                    reflected += sign * float(energy.hemispherical(interface, accuracy=1e-3).reflectance)
            one, other = float(missing.mean(True)[0]), float(eta**2 * missing.mean(False)[0])
            found[i, j] = (one - reflected) / min(one, other)
        print(model, f"{alpha:.4f}", found[:, j].round(3), flush=True)
    found[:, 0] = found[:, 1]
    assert found.min() > 0 and found.max() < 1.02, (found.min(), found.max())
    return np.minimum(found, 1).astype(np.float32)


KINDS = {
    "metal": metal,
    "glass": glass,
    "brushed_metal": brushed_metal,
    "brushed_glass": brushed_glass,
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
        np.savez_compressed(path, **{"_".join(model): make(model) for model in MODELS})
        print(f"{path}: {path.stat().st_size} bytes, {time.time() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
