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

#: terms of a sharp phase function, as a share of those that the nodes can tell apart: of a forward and a backward peak
SHARES = 1.0, 0.7
#: of these, the share from which on they fade, and where the moments are those of the peak
FADES, MIDDLE = 0.8, 0.9
#: a peak of less than this share of the light is none
LEAST = 1e-6
#: of degrees, the share from which on they are high
HIGH = 0.15
#: a peak is not sharp if its share times its height is less than so much of what goes the opposite way
FAINT = 1e-3
#: phase functions of so many terms, less than this left out, have no sharp peak
FEW_TERMS, NOTHING = 64, 1e-7


@dataclass(frozen=True)
class Truncated:
    """A phase function as its smooth part and its peaks.

    Attributes:
        moments: (L,) of everything but the forward peak, per light it scatters: chi_0 = 1 - `backward`.
        forward: share of the scattered light that counts as not scattered.
        backward: share that goes back exactly where it came from; no phase function but a mixture has both.
        sharp: whether the last terms fade, as sharp peaks need, and are to be projected on the nodes (`projection`).
    """

    moments: np.ndarray
    forward: float
    backward: float
    sharp: bool = False

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
        peak = 0.0
        for way in (np.ones(count + 2), sign):
            if not peak and (way * chi)[count:].min() > 0:
                peak, sign = float(abs(chi[count])), way
        straight = peak > 0 and sign[1] > 0
        chi, sign = chi[:count], sign[:count]
        ends = phase.eval(np.array([1.0, -1.0]) if straight else np.array([-1.0, 1.0]))
        sharp = peaked(phase) and bool(peak * ends[0] > FAINT * ends[1])
        faded = np.ones(count)
        if sharp:
            # A corner in the moments would ring, loudest in the direction opposite to the peak.
            peak = float(sign[int(MIDDLE * count)] * chi[int(MIDDLE * count)])
            u = (np.arange(count) / count - FADES) / (1 - FADES)
            faded = np.cos(0.5 * np.pi * np.clip(u, 0, 1)) ** 2
        forward, backward = (peak, 0.0) if straight else (0.0, peak)
        return cls(faded * (chi - peak * sign) / (1 - forward), forward, backward, sharp)

    @classmethod
    def _mixed(cls, cuts: Sequence[Truncated], shares: Sequence[float]) -> Truncated:
        """Of light that is scattered by each in its share."""
        pairs = list(zip(cuts, shares, strict=True))
        forward = sum(share * cut.forward for cut, share in pairs)
        left = [share * (1 - cut.forward) / (1 - forward) for cut, share in pairs]
        moments = np.sum([part * cut.moments for cut, part in zip(cuts, left, strict=True)], axis=0)
        backward = sum(part * cut.backward for cut, part in zip(cuts, left, strict=True))
        return cls(moments, forward, backward, any(cut.sharp for cut in cuts))

    @classmethod
    def fit(cls, phase: Phase, mu: np.ndarray, weights: np.ndarray, tolerance: float = 1e-9) -> Truncated:
        """As many terms as the phase function needs, and no more than the nodes of a region can multiply.

        Where the nodes cannot tell all of a sharp peak apart, as many as they can are taken. More is better for grazing
        light, worse along the normal, where nodes are far apart: fewer where what goes on is compared with what of it
        went to and fro.

        Args:
            phase: the phase function.
            mu, weights: (n,) the nodes.
            tolerance: what may be left out, relative to the peak of the phase function.
        """
        pieces = parts(phase)
        needed, known = max(terms(piece, tolerance) for piece in pieces), resolved(mu, weights)
        cuts = [cls.of(piece, min(needed, known)) for piece in pieces]
        if needed > known and any(cut.sharp for cut in cuts):
            return cls.of(phase, int(SHARES[1 if any(cut.backward for cut in cuts) else 0] * known))
        return cls._mixed(cuts, phase.shares) if isinstance(phase, Mixture) else cuts[0]

    @property
    def again(self) -> bool:
        """Whether light scattered again within the peak has a closed form: a sharp one, either way."""
        return self.sharp and (self.forward > LEAST) != (self.backward > LEAST)

    @property
    def low(self) -> np.ndarray:
        """(L,) what of each degree counts as low: such light is not sharp."""
        l = np.arange(len(self.moments))  # noqa: E741
        return np.asarray(np.exp(-((l / (HIGH * len(l))) ** 2)))

    def times(self, n: int) -> np.ndarray:
        """(L,) high degrees of the moments of light scattered n times, but for what goes exactly on or back."""
        sign = (-1.0) ** np.arange(len(self.moments)) if self.backward else np.ones(len(self.moments))
        found = ((sign * self.moments + self.backward) ** n - self.backward**n) * sign**n
        return np.asarray(found * (1 - self.low))

    def scale(self, depth: Any, albedo: Any) -> tuple[Any, Any]:
        """Depth and albedo of the same medium, the forward peak not counted as scattering: numbers or arrays (C,)."""
        depth, albedo = np.asarray(depth, float), np.asarray(albedo, float)
        left = 1 - albedo * self.forward
        return depth * left, np.where(left > 0, albedo * (1 - self.forward) / np.where(left > 0, left, 1), 0)


def peaked(phase: Phase) -> bool:
    """Whether a phase function may have a peak that some nodes do not resolve."""
    return any(abs(part.moments(FEW_TERMS)[-1]) > NOTHING for part in parts(phase))
