"""The Mitsuba plugin under test: how it is loaded and asked for directions in its own frame, in any variant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from lanes import unit

RADIANCE, IMPORTANCE = "Radiance", "Importance"


def layered(mi: Any, **options: Any) -> Any:
    """The plugin `layered` with these options, in the current variant."""
    import urushi.mitsuba  # noqa: F401  (registers it)

    return mi.load_dict({"type": "layered", **options})


def context(mi: Any, mode: str = RADIANCE, **options: Any) -> Any:
    """A BSDF context; options are `type_mask` and `component`."""
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    for name, value in options.items():
        setattr(ctx, name, value)
    return ctx


def interaction(mi: Any, wi: np.ndarray, uv: Any = None, time: float = 0.0, wavelengths: Any = ()) -> Any:
    """Surface interactions for directions (N, 3), in a vectorised variant; uv (N, 2)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = vectors(mi, wi)
    si.time = mi.Float(time)
    if uv is not None:
        uv = np.broadcast_to(np.asarray(uv, np.float32), (len(wi), 2))
        si.uv = mi.Point2f(np.ascontiguousarray(uv.T))
    if len(wavelengths):
        si.wavelengths = type(si.wavelengths)(*wavelengths)
    return si


def vectors(mi: Any, w: np.ndarray) -> Any:
    return mi.Vector3f(np.ascontiguousarray(np.asarray(w, np.float32).T))


def rows(value: Any) -> np.ndarray:
    """Dr.Jit to numpy in double precision: (N,) or (N, channels)."""
    array = np.asarray(np.array(value), np.float64)
    return array.T if array.ndim == 2 else array


@dataclass(frozen=True)
class Asked:
    """Answers of a BSDF for directions (N, 3)."""

    mi: Any
    bsdf: Any
    si: Any
    ctx: Any

    @classmethod
    def of(cls, mi: Any, bsdf: Any, wi: np.ndarray, mode: str = RADIANCE, **options: Any) -> Asked:
        return cls(mi, bsdf, interaction(mi, wi, **options), context(mi, mode))

    def value(self, wo: np.ndarray) -> np.ndarray:
        return rows(self.bsdf.eval(self.ctx, self.si, vectors(self.mi, wo)))

    def density(self, wo: np.ndarray) -> np.ndarray:
        return rows(self.bsdf.pdf(self.ctx, self.si, vectors(self.mi, wo)))

    def sample(self, u: np.ndarray) -> tuple[Any, np.ndarray]:
        """Mitsuba's sample and the weights; u (N, 3), the first chooses what happens."""
        mi, u = self.mi, np.asarray(u, np.float32)
        point = mi.Point2f(np.ascontiguousarray(u[:, 1:].T))
        sample, weight = self.bsdf.sample(self.ctx, self.si, mi.Float(np.ascontiguousarray(u[:, 0])), point)
        return sample, rows(weight)


def everywhere(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random directions on both sides."""
    return unit(rng.normal(size=(n, 3)))


def above(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random directions above the surface."""
    w = everywhere(rng, n)
    w[:, 2] = np.abs(w[:, 2])
    return w
