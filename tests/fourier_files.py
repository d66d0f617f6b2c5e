"""Fourier files for the tests: two that layerlab wrote, and small ones of every shape."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from urushi.adapters.fourier import FourierTable, fourier_table

DATA = Path(__file__).parent / "data"
SLAB, COATED = DATA / "layerlab_slab.bsdf", DATA / "layerlab_coated_diffuse.bsdf"

#: cosines dense enough for splines to be exact to a part in a thousand
MU = np.sin(np.linspace(0.02, np.pi / 2, 24))


def kernel(
    mu: np.ndarray = MU, orders: int = 12, ratio: float = 0.5, energy: Any = (0.6,), g: float = 0.3
) -> np.ndarray:
    """Series (C, K, n, n) of a smooth lobe: f |mu_o| = (energy / pi) mu_o (1 + 2 sum r^k cos(k phi)), r < 1.

    r falls to 0 at normal incidence, as it does for any BSDF; its sum is Poisson's kernel (1 - r^2) / (1 - 2 r cos(phi)
    + r^2), nowhere negative.
    """
    sine = np.sqrt(1 - mu**2)
    r = ratio * sine[:, None] * sine
    k = np.arange(orders)[:, None, None]
    shape = np.where(k == 0, 1, 2) * r**k * (1 + g * mu[:, None] * mu) * mu[:, None] / np.pi
    return np.asarray(energy)[:, None, None, None] * shape


def small(channels: int = 1, sizes: tuple[int, ...] = (), **options: Any) -> FourierTable:
    """A table that reflects and transmits on both sides, in a few hundred bytes, of any number of parameters."""
    rng = np.random.default_rng(5)
    mu = np.array([0.2, 0.6, 1.0])
    bases = int(np.prod(sizes))
    blocks = {
        name: np.stack([kernel(mu, 4, energy=rng.uniform(0.1, 0.4, channels)) for _ in range(bases)])
        for name in ("r_top", "t_down", "r_bottom", "t_up")
    }
    positions = tuple(np.linspace(0.1 * i, 1, size) for i, size in enumerate(sizes))
    return fourier_table(mu, **blocks, positions=positions, **options)
