"""A white furnace all over the range that compensated interfaces promise: random roughness, index, direction."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from lanes import DOUBLE, direction, needs_llvm
from test_compensated import glass, mirror
from urushi.interfaces.energy import _facets, _lattice, _mean

pytestmark = needs_llvm

MODELS = [(d, m) for d in ("ggx", "beckmann") for m in ("correlated", "separable")]
#: (rows, models): a slice of each for every run, all of it when there is time
QUICK, WHOLE = 250, 2000
#: of the lattices for facets and for the lobe
RANK = 20


def rows(n: int, seed: int) -> dict[str, np.ndarray]:
    """Roughness 0.01 to 1 along both axes, up to 10 : 1; index ratio 1.05 to 3; half of all near grazing or match."""
    rng = np.random.default_rng(seed)
    large = 10 ** rng.uniform(-2, 0, n)
    small = np.maximum(large / 10 ** rng.uniform(0, 1, n), 0.01)
    turned = rng.random(n) < 0.5
    near = rng.random(n) < 0.4
    eta = np.exp(rng.uniform(np.log(1.05), np.log(3), n))
    eta[near] = 1.05 + 0.25 * rng.random(near.sum()) ** 2
    grazing = rng.random(n) < 0.4
    cos = rng.uniform(0.003, 1, n)
    cos[grazing] = np.clip(2 * large[grazing] * rng.random(grazing.sum()), 0.003, 1)
    found = {"x": np.where(turned, small, large), "y": np.where(turned, large, small), "eta": eta, "cos": cos}
    found["phi"] = rng.uniform(-np.pi, np.pi, n)
    return found


def lobe(interface: Any, w: np.ndarray, smallest: np.ndarray, above: bool) -> np.ndarray:
    """What is added to single scattering, over all directions: as many of them for each octave of cosines."""
    one, single = DOUBLE.vectors(w), interface.single
    point, count = _lattice(type(one.x), RANK)
    alpha = DOUBLE(smallest)
    octaves = dr.log(1 + 1 / alpha)

    def term(i: Any) -> tuple[Any, Any]:
        s, turn = point(i)
        scale = alpha * dr.exp(octaves * s)
        cos = scale - alpha
        sin = dr.sqrt(dr.maximum((1 - cos) * (1 + cos), 0))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * turn)
        measure = 2 * dr.pi * scale * octaves
        o = type(one)(sin * cos_phi, sin * sin_phi, cos)
        up = interface.reflect(one, o, above)[0] - single.reflect(one, o, above)[0]
        if interface.opaque:
            return up * measure, 0 * measure
        o = type(one)(o.x, o.y, -cos)
        down = interface.transmit(one, o, above)[0] - single.transmit(one, o, above)[0]
        return up * measure, down * measure

    up, down = _mean(one, count, term)
    return up + down


def furnace(kind: str, model: tuple[str, str], n: int, seed: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """R + T - 1 of each row, half of them from each side."""
    row = rows(n, seed)
    w = direction(row["cos"], row["phi"])
    off = np.empty(n)
    for above in (True, False) if kind == "glass" else (True,):
        half = slice(0 if above else 1, None, 2) if kind == "glass" else slice(None)
        x, y, eta = (row[name][half] for name in ("x", "y", "eta"))
        interface: Any = glass(DOUBLE, eta, x, y, *model) if kind == "glass" else mirror(DOUBLE, x, y, *model)
        up, down = _facets(interface.single, w[half], above, RANK)
        single = up + down if kind == "glass" else (up + down)[:, 0]
        more = lobe(interface, w[half], np.minimum(x, y), above)
        off[half] = single + (more if more.ndim == 1 else more[:, 0]) - 1
    return off, row


def check(kind: str, model: tuple[str, str], n: int) -> None:
    off, row = furnace(kind, model, n, 2017)
    worst = np.argmax(np.abs(off))
    assert np.abs(off).max() < 1e-2, (off[worst], {name: values[worst] for name, values in row.items()})
    assert np.quantile(np.abs(off), 0.9) < 5e-3


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_brushed_glass_is_clear(distribution: str) -> None:
    check("glass", (distribution, "correlated"), QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["metal", "glass"])
@pytest.mark.parametrize("model", MODELS)
def test_brushed_surfaces_lose_nothing(model: tuple[str, str], kind: str) -> None:
    check(kind, model, WHOLE)
