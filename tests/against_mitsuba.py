"""Mitsuba's own plugins, evaluated directly, as truth from outside (in `llvm_ad_rgb`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lanes import SINGLE, back


@dataclass(frozen=True)
class Plugin:
    """A BSDF of Mitsuba's for directions in its own frame; importance transport, so values are flux densities.

    Args:
        mi: Mitsuba.
        bsdf: the BSDF.
        mode: "Importance" (flux densities) or "Radiance".
    """

    mi: Any
    bsdf: Any
    mode: str = "Importance"

    @classmethod
    def load(cls, mi: Any, mode: str = "Importance", **description: Any) -> Plugin:
        return cls(mi, mi.load_dict(description), mode)

    def _ask(self, wi: np.ndarray) -> tuple[Any, Any]:
        si = self.mi.SurfaceInteraction3f()
        si.wi = self.mi.Vector3f(SINGLE.vectors(wi))
        si.t = 0
        return self.mi.BSDFContext(getattr(self.mi.TransportMode, self.mode)), si

    def eval_pdf(self, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values, one column per channel, and densities."""
        context, si = self._ask(wi)
        value, pdf = self.bsdf.eval_pdf(context, si, self.mi.Vector3f(SINGLE.vectors(wo)))
        return back(value), back(pdf)

    def sample(self, wi: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Directions, weights and densities for numbers u (N, 3): component first, then the two others."""
        context, si = self._ask(wi)
        point = self.mi.Point2f(SINGLE(u[:, 1]), SINGLE(u[:, 2]))
        sample, weight = self.bsdf.sample(context, si, SINGLE(u[:, 0]), point)
        return back(sample.wo), back(weight), back(sample.pdf)
