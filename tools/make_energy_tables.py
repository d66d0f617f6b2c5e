"""Write src/urushi/interfaces/data/*.npz: the energy that single scattering between microfacets loses.

    python tools/make_energy_tables.py [NAME ...]

`urushi.interfaces.tables` says what the axes are. About half an hour on two cores.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
#: ranks of the lattices: 17 711 points, an error of 1e-4; and 4181 for the coarse tables, 5e-4
FINE, COARSE = 21, 18
#: lanes of one launch
LANES = 1 << 17


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


def packed(energy: NDArray[np.float64], kind: Any) -> NDArray[Any]:
    """Square roots as integers that fill the range of their type."""
    assert energy.min() > -5e-3 and energy.max() < 1, (energy.min(), energy.max())
    most = np.iinfo(kind).max
    roots = np.round(np.sqrt(np.maximum(energy, 0)) * most).astype(kind)
    # Differences along the cosine (they wrap around) compress to half.
    return np.diff(roots, axis=-1, prepend=kind(0))


def metal(model: tuple[str, str]) -> NDArray[Any]:
    """[roughness, cosine]"""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.ROUGHNESSES)[:, None]
    cos = np.array([t.cosines(a, t.COSINES) for a in alpha[:, 0]])
    return packed(missing(model, FINE, cos=cos, phi=0.0, alpha_x=alpha, alpha_y=alpha, eta=0.0), np.uint16)


def glass(model: tuple[str, str]) -> NDArray[Any]:
    """[index, roughness, cosine]"""
    from urushi.interfaces import tables as t

    alpha = t.roughnesses(t.ROUGHNESSES)[:, None]
    cos = np.array([t.cosines(a, t.COSINES) for a in alpha[:, 0]])
    eta = t.indices(t.INDICES)[:, None, None]
    return packed(missing(model, FINE, cos=cos, phi=0.0, alpha_x=alpha, alpha_y=alpha, eta=eta), np.uint16)


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

    return packed(missing(model, COARSE, **_brushed(t.COARSE_COSINES), eta=0.0), np.uint8)


def brushed_glass(model: tuple[str, str]) -> NDArray[Any]:
    """[index, roughness, ratio, azimuth, cosine]"""
    from urushi.interfaces import tables as t

    eta = t.indices(t.COARSE_INDICES)[:, None, None, None, None]
    return packed(missing(model, COARSE, **_brushed(t.COARSE_COSINES), eta=eta), np.uint8)


KINDS = {"metal": metal, "glass": glass, "brushed_metal": brushed_metal, "brushed_glass": brushed_glass}


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
