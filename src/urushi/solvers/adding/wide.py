"""What a stochastic interface sends from facet to facet, as matrices.

Light that meets two facets or more leaves in wide lobes, which few nodes and few azimuthal orders hold; and it is only
known as the mean of random estimates. So it is computed on a coarse grid, at a cost that the fine one does not raise,
and f, which is flux density over cosine, is interpolated from there by the coarse grid's own basis functions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .basis import Grid, Panel
from .columns import Side, columns

#: azimuthal orders, nodes per panel at most, estimates of each value, and Gauss points per panel of the integrals
ORDERS, NODES, DRAWS, POINTS = 8, 12, 16, 8


def wide(side: Side) -> np.ndarray:
    """(C, ORDERS, n_out, n_in) the matrix of all light of one side that meets two facets or more."""
    fine = side.grid
    coarse = Grid.build(fine.indices, [min(p.count, NODES) for p in fine.panels])
    matrix = columns(replace(side, grid=coarse, draws=DRAWS), range(ORDERS), POINTS)
    matrix /= (coarse.mu[side.target] * coarse.weights[side.target])[:, None]
    found = np.zeros((len(matrix), ORDERS, fine.count(side.target), fine.count(side.source)))
    for odd in (False, True):
        out, into = (_functions(coarse, fine, region, odd) for region in (side.target, side.source))
        found[:, odd::2] = out @ matrix[:, odd::2] @ into.T
    return found * (fine.mu[side.target] * fine.weights[side.target])[:, None]


def _functions(coarse: Grid, fine: Grid, region: int, odd: bool) -> np.ndarray:
    """(n, n') basis functions of the coarse grid at the nodes of the fine one."""
    found = np.zeros((fine.count(region), coarse.count(region)))
    for own, panel in zip(coarse.panels, fine.panels, strict=True):
        if panel.first < len(found):
            found[panel.nodes, own.nodes] = coarse.functions(own, _cosines(fine, panel), odd)
    return found


def _cosines(grid: Grid, panel: Panel) -> np.ndarray:
    """Cosines of the nodes of a panel in its own medium."""
    cosines: np.ndarray = panel.cosine(grid.x[panel.nodes])
    return cosines
