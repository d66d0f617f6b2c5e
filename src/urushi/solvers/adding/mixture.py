"""Several phase functions as one: each scatters its share of the light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .phase import Phase


class Mixture:
    """A phase function made of others.

    Args:
        parts: these.
        shares: of the scattered light; they sum to 1.
    """

    def __init__(self, parts: Sequence[Phase], shares: Sequence[float]) -> None:
        self.parts, self.shares = tuple(parts), tuple(shares)

    def moments(self, count: int) -> np.ndarray:
        return self._sum([part.moments(count) for part in self.parts])

    def eval(self, cos: np.ndarray) -> np.ndarray:
        return self._sum([part.eval(cos) for part in self.parts])

    def _sum(self, values: Sequence[np.ndarray]) -> np.ndarray:
        found: np.ndarray = sum(share * value for share, value in zip(self.shares, values, strict=True))  # type: ignore[assignment]
        return found


def parts(phase: Phase) -> tuple[Phase, ...]:
    """What a phase function is made of; itself, if of nothing else."""
    return phase.parts if isinstance(phase, Mixture) else (phase,)
