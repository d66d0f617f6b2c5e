"""How light that is told by `nodes` lies in azimuth, in a stack with interfaces that have two roughnesses.

A brushed metal sends light across its scratches, and what is reflected totally there comes back to it from there: what
gets out in the end hangs on azimuths all the way. Facets look the same from phi and phi + pi, so light is told by its
means of

    Y_0 = 1        sqrt 2 cos 2 j phi        sqrt 2 sin 2 j phi        j = 1 .. HARMONICS

which are orthonormal; without the sines if all axes agree, up to right angles. Matrices have a block of nodes for each.
Energies are told by the first.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ...optics.vectors import Array, at_least

#: of 2 phi
HARMONICS = 3


class Azimuths:
    """Harmonics, and the azimuths that stand for all.

    Args:
        turns: angles of the x axes of interfaces that have two roughnesses.
        free: whether these may change.
    """

    def __init__(self, turns: list[float], free: bool) -> None:
        order = HARMONICS if turns else 0
        aligned = not free and all(abs(np.sin(2 * (turn - turns[0]))) < 1e-6 for turn in turns)
        #: harmonics, (j, whether it is a sine)
        self._of = [
            (j, sine) for j in range(1, order + 1) for sine in ((False,) if aligned else (False, True))
        ]
        self.count = 1 + len(self._of)
        #: what all angles are told from
        self.axis = turns[0] if turns else 0.0
        size = 2 * order + 2
        angles = (np.arange(size) + 0.5) * np.pi / size
        #: (A,) equally far from one another; half of them where the others are their mirror images
        self.angles = (angles[: size // 2] if aligned else angles) + self.axis if turns else np.zeros(1)
        told = 2 * (self.angles - self.axis)
        more = [np.sqrt(2) * (np.sin(j * told) if sine else np.cos(j * told)) for j, sine in self._of]
        #: (M, A) Y at these
        self._values = np.array([np.ones(len(told)), *more])

    def at(self, x: Array, y: Array) -> list[Array]:
        """Y_1 .. of the direction (x, y), however long it is; their mean over all azimuths, 0, if it is too short."""
        if not self._of:
            return []
        square = dr.square(x) + dr.square(y)
        inverse = dr.rcp(at_least(square, 1e-12))
        a, b = (dr.square(x) - dr.square(y)) * inverse, 2 * x * y * inverse
        c0, s0 = float(np.cos(2 * self.axis)), float(np.sin(2 * self.axis))
        cos, sin = a * c0 + b * s0, b * c0 - a * s0
        powers: list[tuple[Any, Any]] = [(cos, sin)]
        while len(powers) < self._of[-1][0]:
            c, s = powers[-1]
            powers.append((c * cos - s * sin, c * sin + s * cos))
        return [float(np.sqrt(2)) * powers[j - 1][sine] for j, sine in self._of]

    def kept(self, light: np.ndarray) -> np.ndarray:
        """(C, n, N) where light of some cosines goes that keeps its azimuth -> (C, M n, A N)."""
        found = self._values[None, :, None, :, None] * light[:, None, :, None, :]
        return found.reshape(len(light), self.count * light.shape[1], -1)

    def evened(self, light: np.ndarray) -> np.ndarray:
        """(C, n, A N) where light goes that has no azimuth any more -> (C, M n, A N)."""
        return np.pad(light, ((0, 0), (0, (self.count - 1) * light.shape[1]), (0, 0)))

    def scattered(self, light: np.ndarray, still: np.ndarray) -> np.ndarray:
        """(C, M n, M n) from what becomes of light (C, n, n), and of the part of it that keeps its azimuth."""
        blocks = np.einsum("ab,cnk->canbk", np.eye(self.count), np.broadcast_to(still, light.shape))
        blocks[:, 0, :, 0] = light
        return blocks.reshape(len(light), self.count * light.shape[1], -1)

    def told(self, values: np.ndarray) -> np.ndarray:
        """(..., A N) what is known at the azimuths -> (..., M N) its harmonics."""
        if self.count == 1:
            return values
        size = len(self.angles)
        split = values.reshape(*values.shape[:-1], size, values.shape[-1] // size)
        found = np.einsum("ma,...an->...mn", self._values / size, split)
        return found.reshape(*values.shape[:-1], self.count * split.shape[-1])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """(A N,) -> (N,)."""
        return np.asarray(values.reshape(len(self.angles), -1).mean(axis=0))

    def energy(self, light: np.ndarray) -> np.ndarray:
        """(C, M n, N) -> (C, N) all of it."""
        return np.asarray(light[:, : light.shape[1] // self.count].sum(axis=1))
