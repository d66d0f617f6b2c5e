"""Delta-M: a peak too sharp for the nodes becomes light that goes straight on, or straight back (Wiscombe 1977).

The series of a sharp phase function is cut after L terms. What would follow is nearly the series of a delta peak,
whose moments are all alike, f; so f of the scattered light counts as not scattered at all (or, for a backward peak,
as sent back where it came from), and the rest has moments chi_l - f (theory (basis.12)). Reflectance and
transmittance are then those of the true phase function to the order that the nodes resolve; the peak itself, in the
light scattered once, comes back from the exact formula in `single` (Nakajima & Tanaka 1988).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .mixture import Mixture, parts
from .phase import Phase, resolved, terms

#: terms, as a share of those that the nodes can tell apart: light scattered twice is exact only up to half of these
SHARE = 0.5
#: a peak does no such harm if its share times its height is less than so many times what goes straight back
FAINT = 15


@dataclass(frozen=True)
class Truncated:
    """A phase function as its smooth part and its peaks.

    Attributes:
        moments: (L,) of everything but the forward peak, per light it scatters: chi_0 = 1 - `backward`.
        forward: share of the scattered light that counts as not scattered.
        backward: share that goes back exactly where it came from; no phase function has both.
    """

    moments: np.ndarray
    forward: float
    backward: float

    @classmethod
    def of(cls, phase: Phase, count: int) -> Truncated:
        """The first `count` terms of a phase function and the peaks that stand for the others.

        A peak is forward if the first two moments left out are positive, backward if they alternate in sign from
        positive even ones; otherwise they are dropped. A mixture has the peaks of its parts.
        """
        if isinstance(phase, Mixture):
            return cls._mixed([cls.of(part, count) for part in phase.parts], phase.shares)
        chi = phase.moments(count + 2)
        sign = (-1.0) ** np.arange(count + 2)
        forward = float(chi[count]) if (chi[count:] > 0).all() else 0.0
        backward = float(abs(chi[count])) if (sign * chi)[count:].min() > 0 and not forward else 0.0
        chi, sign = chi[:count], sign[:count]
        return cls((chi - forward - backward * sign) / (1 - forward), forward, backward)

    @classmethod
    def _mixed(cls, cuts: Sequence[Truncated], shares: Sequence[float]) -> Truncated:
        """Of light that is scattered by each in its share."""
        pairs = list(zip(cuts, shares, strict=True))
        forward = sum(share * cut.forward for cut, share in pairs)
        left = [share * (1 - cut.forward) / (1 - forward) for cut, share in pairs]
        moments = np.sum([part * cut.moments for cut, part in zip(cuts, left, strict=True)], axis=0)
        return cls(moments, forward, sum(part * cut.backward for cut, part in zip(cuts, left, strict=True)))

    @classmethod
    def fit(cls, phase: Phase, mu: np.ndarray, weights: np.ndarray, tolerance: float = 1e-9) -> Truncated:
        """As many terms as the phase function needs, and no more than the nodes of a region can multiply.

        Sums over the nodes are exact up to the degree they resolve, and light scattered twice has products of two
        terms: where the nodes cannot tell all of a forward peak apart, half as many terms are taken. With more, high
        degrees would come back as low ones, which does most harm where least light goes, straight back.

        Args:
            phase: the phase function.
            mu, weights: (n,) the nodes.
            tolerance: what may be left out, relative to the peak of the phase function.
        """
        pieces = parts(phase)
        needed, known = max(terms(piece, tolerance) for piece in pieces), resolved(mu, weights)
        cuts = [cls.of(piece, min(needed, known)) for piece in pieces]
        if needed > known:
            ends = [piece.eval(np.array([-1.0, 1.0])) for piece in pieces]
            if any(cut.forward * end[1] > FAINT * end[0] for cut, end in zip(cuts, ends, strict=True)):
                return cls.of(phase, int(SHARE * known))
        return cls._mixed(cuts, phase.shares) if isinstance(phase, Mixture) else cuts[0]

    def scale(self, depth: Any, albedo: Any) -> tuple[Any, Any]:
        """Depth and albedo of the same medium, the forward peak not counted as scattering: numbers or arrays (C,)."""
        depth, albedo = np.asarray(depth, float), np.asarray(albedo, float)
        left = 1 - albedo * self.forward
        return depth * left, np.where(left > 0, albedo * (1 - self.forward) / np.where(left > 0, left, 1), 0)
