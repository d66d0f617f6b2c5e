"""Smooth interfaces as operators: diagonals, since every region has the nodes of Snell's directions: theory
(basis.5)."""

from __future__ import annotations

import numpy as np

from ...adding import Slab
from ...interfaces import Interface
from ..arrays import padded
from .basis import Grid
from .operator import Operator, identity, zero


def smooth(interface: Interface, grid: Grid, region: int) -> Slab:
    """The delta parts of the interface under a region.

    Args:
        interface: a bound interface, in double precision or of plain numbers.
        grid: the nodes; where the interface is not opaque, `region` + 1 is below it.
        region: the region above.

    Returns:
        Diagonal operators. Below an opaque interface are the nodes of the region above it, and no light.
    """
    n = grid.count(region)
    r_top, t_down = _energy(interface, grid.mu[region], above=True)
    if interface.opaque:
        return Slab(Operator((n, n), r_top), zero(n), zero(n), zero(n))
    n_below = grid.count(region + 1)
    r_bottom, t_up = _energy(interface, grid.mu[region + 1], above=False)
    both = min(n, n_below)
    # What passes is the same both ways. The rarer medium, where the cosine is small as total reflection is near, knows
    # it to more digits; the other side reflects what it does not lose.
    if n <= n_below:
        r_bottom[:, :both] += t_up[:, :both] - t_down[:, :both]
        t = t_down[:, :both]
    else:
        r_top[:, :both] += t_down[:, :both] - t_up[:, :both]
        t = t_up[:, :both]
    return Slab(
        Operator((n, n), r_top),
        Operator((n_below, n), t),
        Operator((n_below, n_below), r_bottom),
        Operator((n, n_below), t),
    )


def nothing(n: int) -> Slab:
    """No interface at all, between regions of n nodes."""
    none, everything = zero(n), identity(n)
    return Slab(none, everything, none, everything)


def _energy(interface: Interface, mu: np.ndarray, above: bool) -> tuple[np.ndarray, np.ndarray]:
    """(C, n) reflectance and transmittance."""
    from drjit.llvm.ad import Float64

    found = []
    for part in interface.smooth_energy(Float64(padded(mu)), above):
        values = np.atleast_2d(np.array(part))
        found.append(np.array(np.broadcast_to(values, (len(values), len(mu)))))
    return found[0], found[1]
