"""Write src/urushi/solvers/lobes/data/*.npz: how much light rough interfaces send where, from Urushi's own interfaces.

    python tools/make_lobe_tables.py

Directional energies are means over a Fibonacci lattice of the samples of `BoundDielectric` and of the facets of
`Microfacets` (`solvers.lobes.tables` says what each table holds, and how far interpolation is off). Light that is a
lobe already is the average of those over the directions of that lobe.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from urushi.llvm import ensure

OUT = Path(__file__).parents[1] / "src" / "urushi" / "solvers" / "lobes" / "data"
#: cosines of the fine tables that lobes are averaged over
FINE = 97
#: samples of one lobe
SAMPLES = 4181


def lattice(count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count`, a Fibonacci number, of points in the unit square."""
    small, size = 1, 1
    while size < count:
        small, size = size, small + size
    i = np.arange(size)
    return (i + 0.5) / size, (i * small % size + 0.5) / size


def beams(cos: np.ndarray, samples: int) -> tuple[Any, tuple[Any, Any]]:
    """For every sample, cosine by cosine, the direction (N `samples`,) and two even numbers, in double precision."""
    from drjit.llvm.ad import Array3f64, Float64

    u1, u2 = lattice(samples)
    c = np.repeat(cos, len(u1))
    w = Array3f64(np.sqrt((1 - c) * (1 + c)), 0 * c, c)
    return w, (Float64(np.tile(u1, len(cos))), Float64(np.tile(u2, len(cos))))


def sent(
    cos: np.ndarray, alpha: float, eta: float, transmit: bool, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cosines (N, `samples`) of what a dielectric of GGX facets sends out, and weights, whose means are the energies.

    Args:
        cos: (N,) of incidence.
        alpha: roughness; 0 for a smooth interface, of which there is one sample.
        eta: index beyond over index before.
        transmit: which side.
    """
    from drjit.llvm.ad import Float64

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.microfacet import Microfacets

    if alpha == 0:
        r, t, below, _ = smooth(cos, eta)
        return (below[:, None], t[:, None]) if transmit else (cos[:, None], r[:, None])
    w, u = beams(cos, samples)
    facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
    interface = BoundDielectric(Float64(eta), facets, False, Frame(0.0))
    found = interface.sample(w, (0.5, *u), True, "transmit" if transmit else "reflect")
    out, weight = (np.array(x).reshape(len(cos), -1) for x in (found.o.z, found.weight))
    right = out < 0 if transmit else out > 0
    return np.abs(out), np.where(right & np.isfinite(weight), weight, 0)


def directional(cos: np.ndarray, alpha: np.ndarray, eta: np.ndarray, kind: tuple[str, str]) -> np.ndarray:
    """(4, N): reflectance, transmittance and the mean cosines of what is transmitted and reflected, of rough
    dielectrics.

    Args:
        cos, alpha, eta: (N,) cosine of incidence, roughness > 0, index beyond over index before.
        kind: distribution and masking.
    """
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64, UInt

    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.optics.microfacet import Microfacets

    w = Array3f64(np.sqrt((1 - cos) * (1 + cos)), 0 * cos, cos)
    facets = Microfacets(Float64(alpha), Float64(alpha), *kind)
    interface = BoundDielectric(Float64(eta), facets, False, Frame(0.0))
    small, size = 6765, 10946

    def body(i: UInt, r: Float64, t: Float64, c: Float64, d: Float64) -> tuple:
        second = (Float64(i) * small + 0.5) / size
        u = (0.5, (Float64(i) + 0.5) / size, second - dr.floor(second))
        up, down = interface.sample(w, u, True, "reflect"), interface.sample(w, u, True, "transmit")
        sent, passed = dr.select(up.o.z > 0, up.weight, 0), dr.select(down.o.z < 0, down.weight, 0)
        return i + 1, r + sent, t + passed, c + passed * dr.abs(down.o.z), d + sent * dr.abs(up.o.z)

    zero = Float64(0 * cos)
    _, *sums = dr.while_loop((UInt(0), zero, zero, zero, zero), lambda i, *_: i < size, body)
    r, t, c, d = (np.array(x) / size for x in sums)
    return np.stack([r, t, over(c, t), over(d, r)])


def over(moment: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """The mean of what has this energy and this first moment; 0 of nothing."""
    return np.divide(moment, energy, out=np.zeros_like(moment), where=energy > 1e-9)


def lobe(cos: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """Cosines (N, SAMPLES) of the reflections of a GGX surface, and weights that sum to 1; alpha 0: the mirror."""
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect

    if alpha == 0:
        return cos[:, None], np.ones((len(cos), 1))
    w, u = beams(cos, SAMPLES)
    facets = Microfacets(Float64(alpha), Float64(alpha), "ggx", "correlated")
    o = reflect(w, facets.sample(w, *u))
    weight = dr.select(o.z > 0, facets.masked(w, Array3f64(o.x, o.y, dr.abs(o.z)), facets.sigma(w)), 0)
    weight = np.array(weight).reshape(len(cos), -1)
    return np.maximum(np.array(o.z).reshape(weight.shape), 1e-6), weight / weight.sum(axis=1, keepdims=True)


def mean_over(values: np.ndarray, place: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Mean over lobes of a function given at nodes of u: (C, F) values, (N, S) places in u and weights -> (C, N)."""
    return np.asarray(values @ spread_over(place, weight, values.shape[1]).T)


def spread_over(place: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """(N, count) weights of the nodes of u, for (N, S) places in u and weights."""
    x = np.clip(place, 0, 1) * (count - 1)
    i = np.minimum(x.astype(int), count - 2)
    f = x - i
    row = np.arange(len(place))[:, None] * count
    found = np.bincount((row + i).ravel(), (weight * (1 - f)).ravel(), len(place) * count)
    found += np.bincount((row + i + 1).ravel(), (weight * f).ravel(), len(place) * count)
    return found.reshape(len(place), count)


def along(cos: np.ndarray, eta: float) -> np.ndarray:
    """u of cosines, as `axes.along_cosine`."""
    if eta >= 1:
        return np.sqrt(cos)
    excess, critical = cos**2 - (1 - eta**2), 1 - eta**2
    return 0.5 + 0.5 * np.where(
        excess > 0, np.sqrt(np.maximum(excess, 0)) / eta, -np.sqrt(np.maximum(-excess / critical, 0))
    )


def smooth(cos: np.ndarray, eta: float) -> np.ndarray:
    """(4, N) of a smooth boundary, as `directional`."""
    from drjit.llvm.ad import Float64

    from urushi.optics.fresnel import fresnel_dielectric

    r, t = fresnel_dielectric(Float64(cos), Float64(eta), Float64(1 / eta))
    r = np.array(r)
    return np.stack([r, 1 - r, np.array(t), cos])


def dielectric(kind: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """(2, INDICES, ROUGHNESSES, WIDTHS, COSINES, 4) for lobes, (2, INDICES, ROUGHNESSES, 2) for diffuse light."""
    from urushi.solvers.lobes import axes

    alphas, widths = axes.squares(axes.ROUGHNESSES), axes.squares(axes.WIDTHS)
    shape = (2, axes.INDICES, axes.ROUGHNESSES, axes.WIDTHS, axes.COSINES, 4)
    table, diffuse = np.zeros(shape), np.zeros((*shape[:3], 2))
    for side in (0, 1):
        for k, ratio in enumerate(axes.ratios()):
            eta = float(ratio if side == 0 else 1 / ratio)
            cos = axes.cosines(eta, FINE)
            a, c = (x.ravel() for x in np.meshgrid(alphas[1:], cos, indexing="ij"))
            fine = directional(c, a, np.full_like(c, eta), kind).reshape(4, -1, FINE).swapaxes(0, 1)
            fine = np.concatenate([smooth(cos, eta)[None], fine])
            moments = [fine[:, 0], fine[:, 1], fine[:, 1] * fine[:, 2], fine[:, 0] * fine[:, 3]]
            values = np.stack(moments, axis=1).reshape(-1, FINE)
            for b, width in enumerate(widths):
                o, weight = lobe(axes.cosines(eta), width)
                matrix = spread_over(along(o, eta), weight, FINE)
                mean = (values @ matrix.T).reshape(-1, 4, axes.COSINES)
                mean[:, 2], mean[:, 3] = over(mean[:, 2], mean[:, 1]), over(mean[:, 3], mean[:, 0])
                table[side, k, :, b] = mean.swapaxes(1, 2)
            u, weight = np.polynomial.legendre.leggauss(64)
            u, weight = 0.5 * (u + 1), 0.5 * weight
            flux = mean_over(values, along(np.sqrt(u), eta)[None], weight[None])
            diffuse[side, k] = flux.reshape(-1, 4)[:, :2]
        print(kind, side, flush=True)
    return table, diffuse


def centres() -> dict[str, np.ndarray]:
    """(WIDTHS, MEANS, 1), evenly spaced in the cosine that is given.

    Returns:
        "centre": of the lobe of a width, by its mean cosine; "mean": the inverse; "escaping": (INDICES, WIDTHS,
        COSINES, 1) how much of a lobe lies within the critical angle.
    """
    from urushi.solvers.lobes import axes

    cos = np.concatenate([np.linspace(1e-3, 0.02, 8), np.linspace(0.03, 1, 98)])
    means = np.linspace(0, 1, axes.MEANS)
    centre, back = [], []
    for width in axes.squares(axes.WIDTHS):
        o, weight = lobe(cos, width)
        mean = np.maximum.accumulate((o * weight).sum(axis=1) + 1e-9 * np.arange(len(cos)))
        centre.append(np.interp(means, mean, cos))
        back.append(np.interp(means, cos, mean))
    within = []
    for ratio in axes.ratios():
        lobes = [lobe(axes.cosines(1 / ratio), width) for width in axes.squares(axes.WIDTHS)]
        critical = np.sqrt(1 - 1 / ratio**2)
        within.append(np.stack([(weight * (o >= critical)).sum(axis=1) for o, weight in lobes]))
    found = {"centre": np.stack(centre), "mean": np.stack(back), "escaping": np.stack(within)}
    return {name: table[..., None] for name, table in found.items()}


def anisotropic() -> np.ndarray:
    """(ROUGHNESSES, ROUGHNESSES, COSINES, AZIMUTHS, 1): what perfect mirrors of GGX facets reflect by one scattering.

    The axes are both roughnesses, the root of the cosine, and the squared sine of the azimuth from x.
    """
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect
    from urushi.solvers.lobes import axes

    alphas = np.maximum(axes.squares(axes.ROUGHNESSES), 1e-4)
    cos, turn = axes.cosines(2.0), np.linspace(0, 1, axes.AZIMUTHS)
    u1, u2 = lattice(2584)
    found = np.zeros((len(alphas), len(alphas), len(cos), len(turn)))
    c, s2 = (x.ravel() for x in np.meshgrid(cos, turn, indexing="ij"))
    sin = np.sqrt((1 - c) * (1 + c))
    grid = [np.repeat(x, len(u1)) for x in (sin * np.sqrt(1 - s2), sin * np.sqrt(s2), c)]
    w = Array3f64(*grid)
    first, second = (Float64(np.tile(u, len(c))) for u in (u1, u2))
    for i, x in enumerate(alphas):
        for j, y in enumerate(alphas):
            facets = Microfacets(Float64(x), Float64(y), "ggx", "correlated")
            o = reflect(w, facets.sample(w, first, second))
            kept = facets.masked(w, Array3f64(o.x, o.y, dr.abs(o.z)), facets.sigma(w))
            kept = np.array(dr.select(o.z > 0, kept, 0)).reshape(-1, len(u1)).mean(axis=1)
            found[i, j] = kept.reshape(len(cos), len(turn))
    return found[..., None]


#: cosines at which the reflectance of a metal is asked for
NODES = 5


def metal(kind: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the reflectance at `NODES` cosines: (ROUGHNESSES, WIDTHS, COSINES, NODES); for diffuse light without
    WIDTHS and COSINES."""
    import drjit as dr
    from drjit.llvm.ad import Array3f64, Float64

    from urushi.optics.microfacet import Microfacets
    from urushi.optics.vectors import reflect
    from urushi.solvers.lobes import axes

    alphas, widths = axes.squares(axes.ROUGHNESSES), axes.squares(axes.WIDTHS)
    cos = axes.cosines(2.0, FINE)
    w, u = beams(cos, SAMPLES)
    rows = []
    for alpha in alphas:
        if alpha == 0:
            rows.append(hats(cos))
            continue
        facets = Microfacets(Float64(alpha), Float64(alpha), *kind)
        m = facets.sample(w, *u)
        o = reflect(w, m)
        kept = facets.masked(w, Array3f64(o.x, o.y, dr.abs(o.z)), facets.sigma(w))
        kept = np.array(dr.select(o.z > 0, kept, 0))
        rows.append((hats(np.array(dr.dot(w, m))) * kept).reshape(NODES, FINE, -1).mean(axis=2))
    fine = np.stack(rows).reshape(-1, FINE)
    table = np.zeros((axes.ROUGHNESSES, axes.WIDTHS, axes.COSINES, NODES))
    for b, width in enumerate(widths):
        o, weight = lobe(axes.cosines(2.0), width)
        mean = mean_over(fine, np.sqrt(o), weight).reshape(-1, NODES, axes.COSINES)
        table[:, b] = mean.swapaxes(1, 2)
    u, weight = np.polynomial.legendre.leggauss(64)
    flux = mean_over(fine, np.sqrt(np.sqrt(0.5 * (u + 1)))[None], 0.5 * weight[None])
    return table, flux.reshape(-1, NODES)


def hats(cos: np.ndarray) -> np.ndarray:
    """(NODES, N): Lagrange's polynomials in the root of the cosine, at Chebyshev's extrema."""
    x = np.sqrt(np.clip(cos, 0, 1))
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    found = np.ones((NODES, len(x)))
    for j in range(NODES):
        for i in range(NODES):
            if i != j:
                found[j] *= (x - nodes[i]) / (nodes[j] - nodes[i])
    return found


def fixed_point(table: np.ndarray) -> np.ndarray:
    """Sixteen bits with a step of 2^-14, for values in [-2, 2)."""
    assert np.abs(table).max() < 2
    return np.asarray(np.round(table * 2**14), np.int16)


def main() -> None:
    """Compute and write every table."""
    ensure()
    import lobe_exits
    import lobe_matte
    import lobe_mixing
    import lobe_round_trips
    import lobe_sheets
    from urushi.solvers.lobes import tables

    OUT.mkdir(exist_ok=True)
    for name, made in (("slabs", lobe_mixing.slabs()), ("mixing", lobe_mixing.tables())):
        low = {key: fixed_point(table) for key, table in made.items()}
        np.savez_compressed(OUT / f"{name}.npz", **low)
    low = centres() | {"anisotropic": anisotropic()}
    np.savez_compressed(OUT / "lobes.npz", **{name: fixed_point(table) for name, table in low.items()})
    np.savez_compressed(OUT / "round_trips.npz", round_trips=fixed_point(lobe_round_trips.tables()))
    np.savez_compressed(OUT / "sheets.npz", sheets=fixed_point(lobe_sheets.tables()))
    np.savez_compressed(OUT / "exits.npz", exits=fixed_point(lobe_exits.tables()))
    low = {name: lobe_matte.rounded(name, table) for name, table in lobe_matte.tables().items()}
    np.savez_compressed(OUT / "matte.npz", **low)
    for distribution in ("ggx", "beckmann"):
        for masking in ("correlated", "separable"):
            made = [*dielectric((distribution, masking)), *metal((distribution, masking))]
            names = ("dielectric", "dielectric_diffuse", "metal", "metal_diffuse")
            low = {name: fixed_point(table) for name, table in zip(names, made, strict=True)}
            if (distribution, masking) != tables.COMMON:
                low["dielectric"], low["metal"] = low["dielectric"][:, :, :, :1], low["metal"][:, :1]
            path = OUT / f"{distribution}_{masking}.npz"
            np.savez_compressed(path, **low)
            print(path.name, path.stat().st_size)


if __name__ == "__main__":
    sys.exit(main())
