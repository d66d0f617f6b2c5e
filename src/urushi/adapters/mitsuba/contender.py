"""Any BSDF of Mitsuba's as an answer: what checks, comparisons and plots take in the place of a solved stack.

    bsdf = MitsubaBSDF(mi.load_dict({"type": "principled", "roughness": 0.3}))
    bsdf.reflectance([[0.6, 0.0, 0.8]], with_error=True)

A plugin says nothing of its layers, so `stack` holds what its flags and its samples tell: whether light gets to the
other side, and the index there.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np

from urushi import llvm
from urushi.errors import UrushiError
from urushi.solvers import BSDF, Sample
from urushi.solvers.bsdf import directions, random_numbers, same_count

VARIANT = "llvm_ad_rgb"
#: lanes of one launch
LANES = 1 << 20
#: independent estimates that a flux is the mean of; their spread is its error
REPLICATES = 64
#: makes the error of so few replicates (Student's t) as safe as one of many, at a chance of one in a million
WIDER = 1.12
#: steps of the additive recurrence of three dimensions: powers of the root of x^4 = x + 1 (Roberts 2018)
STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


@dataclass(frozen=True)
class Whole:
    """All there is, seen from outside: a layer of which only the ends are known."""

    opaque: bool
    ior: float
    kind: str = "bsdf"


@dataclass(frozen=True)
class Foreign:
    """What stands in the place of a `Stack` for a BSDF that has none.

    Attributes:
        name: what it is called.
        layers: one, `Whole`.
        exterior: the index above; others are relative to it.
    """

    name: str
    layers: tuple[Whole]
    exterior: float = 1.0
    description: str = ""

    def describe(self) -> str:
        """In words, for a terminal."""
        whole = self.layers[0]
        sides = "from above" if whole.opaque else f"from both sides, index {whole.ior:.4g} below"
        return f"{self.name or 'unnamed BSDF'}\n  seen {sides}"


class MitsubaBSDF(BSDF):
    """A Mitsuba BSDF behind the contract of `urushi.solvers.BSDF`.

    It is asked at one point of the surface with a flat frame, light unpolarised, as radiance. `reflectance` and
    `transmittance` are means of the weights of `sample` over shifted lattices, their errors from independent shifts.

    Args:
        bsdf: an instance, of the variant that is set (an RGB variant that is not scalar).
        name: what to call it; by default its class.
        samples: draws for a flux.
        seed: of those draws.
        uv: the point, for textures.
        eta: index below over index above; by default what its samples of transmitted light say.

    Raises:
        UrushiError: the variant is none of those, or an option is out of range.
    """

    stack: Any  # a `Foreign`

    def __init__(
        self,
        bsdf: Any,
        *,
        name: str = "",
        samples: int = 1 << 14,
        seed: int = 0,
        uv: tuple[float, float] = (0.5, 0.5),
        eta: float | None = None,
    ) -> None:
        self.mi = mitsuba()
        if not isinstance(bsdf, self.mi.BSDF):
            kind = type(bsdf).__name__
            raise UrushiError(f"bsdf: found a {kind}; allowed: a BSDF of variant {self.mi.variant()}")
        if samples < 2:
            raise UrushiError(f"samples: found {samples}; allowed: at least 2")
        if eta is not None and not 0 < eta < np.inf:
            raise UrushiError(f"eta: found {eta}; allowed: a positive number")
        self.bsdf, self.samples, self.seed, self.uv, self.mode = bsdf, samples, seed, uv, "radiance"
        flags = self.mi.BSDFFlags
        parts = [int(bsdf.flags(i)) for i in range(bsdf.component_count())] or [int(bsdf.flags())]
        through = any(part & int(flags.Transmission | flags.Null) for part in parts)
        behind = through or any(part & int(flags.BackSide) for part in parts)
        self.stack = Foreign(name or _class(bsdf), (Whole(False, 1.0),))
        opaque = not (behind and self._lit_below())
        found = self._index() if eta is None and through else float(eta or 1.0)
        self.stack = Foreign(self.stack.name, (Whole(opaque, found),))
        self.diagnostics = {
            "method": "mitsuba",
            "plugin": _class(bsdf),
            "variant": str(self.mi.variant()),
            "delta_parts": any(part & int(flags.Delta) for part in parts),
            "index_below": found,
            "estimated_error": "unknown: it is what is looked at",
        }

    def with_samples(self, samples: int) -> MitsubaBSDF:
        """The same with another number of draws for a flux."""
        other = copy.copy(self)
        other.samples = samples
        return other

    # --- the contract ------------------------------------------------------------------------------------------

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: (N, 3), (N, 3) -> (N, 3); with `with_error`, that and 0."""
        if dr.is_array_v(wi):
            value = self._eval(wi, wo)
            return (value, 0 * value) if with_error else value
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (value,) = self._map(lambda a, b: (self._eval(a, b),), pair)
        value = value[0] if np.ndim(wi) == np.ndim(wo) == 1 else value
        return (value, np.zeros_like(value)) if with_error else value

    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: (N, 3), (N, 3) -> (N,); delta parts are 0."""
        if dr.is_array_v(wi):
            return self._pdf(wi, wo)
        pair = same_count(directions(wi, "wi"), directions(wo, "wo"), "wi and wo")
        (density,) = self._map(lambda a, b: (self._pdf(a, b),), pair)
        return density[0] if np.ndim(wi) == np.ndim(wo) == 1 else density

    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: wi (N, 3), u (N, 3) in [0, 1); u[:, 0] is what Mitsuba calls sample1."""
        if dr.is_array_v(wi):
            return self._sample(wi, u)[0]

        def run(a: Any, b: Any) -> tuple[Any, ...]:
            found, _ = self._sample(a, b)
            # Mitsuba says by a weight of 0 that there is no sample, and may leave any direction and density with it;
            # where both are right, something black was hit.
            nowhere = ~(dr.squared_norm(found.wo) > 0.5)
            nowhere |= ~found.delta & ~(
                dr.abs(self._pdf(a, found.wo) - found.pdf) <= 0.05 * dr.abs(found.pdf)
            )
            if self.stack.layers[0].opaque:
                nowhere |= found.wo.z < 0
            dark = dr.max(dr.abs(found.weight)) == 0
            pdf = dr.select(dark & nowhere, 0, found.pdf)
            return found.wo, found.weight, pdf, dr.select(found.delta, 1.0, 0.0)

        pair = same_count(directions(wi, "wi"), random_numbers(u), "wi and u")
        wo, weight, pdf, delta = self._map(run, pair)
        if np.ndim(wi) == np.ndim(u) == 1:
            return Sample(wo[0], weight[0], pdf[0], bool(delta[0] > 0.5))
        return Sample(wo, weight, pdf, delta > 0.5)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance on the side of wi: (N, 3) -> (N, 3)."""
        return self._flux(wi, True, with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side (no factor of radiance): (N, 3) -> (N, 3)."""
        return self._flux(wi, False, with_error)

    # --- how Mitsuba is asked ----------------------------------------------------------------------------------

    @cached_property
    def _context(self) -> Any:
        return self.mi.BSDFContext(self.mi.TransportMode.Radiance)

    def _point(self, wi: Any) -> Any:
        mi = self.mi
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
        si.t, si.uv = mi.Float(1.0), mi.Point2f(*self.uv)
        si.n = mi.Normal3f(0, 0, 1)
        si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Normal3f(0, 0, 1))
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.wi = mi.Vector3f(wi.x, wi.y, wi.z)
        return si

    def _eval(self, wi: Any, wo: Any) -> Any:
        value = self.bsdf.eval(self._context, self._point(wi), self.mi.Vector3f(wo.x, wo.y, wo.z), True)
        return type(wi)(value.x, value.y, value.z)

    def _pdf(self, wi: Any, wo: Any) -> Any:
        return self.bsdf.pdf(self._context, self._point(wi), self.mi.Vector3f(wo.x, wo.y, wo.z), True)

    def _sample(self, wi: Any, u: Any) -> tuple[Sample, Any]:
        """Also the index of refraction where the sample goes, over that where it came from."""
        mi = self.mi
        found, weight = self.bsdf.sample(self._context, self._point(wi), u.x, mi.Point2f(u.y, u.z), True)
        delta = mi.has_flag(found.sampled_type, mi.BSDFFlags.Delta)
        delta |= mi.has_flag(found.sampled_type, mi.BSDFFlags.Null)
        vector = type(wi)
        wo = vector(found.wo.x, found.wo.y, found.wo.z)
        return Sample(wo, vector(weight.x, weight.y, weight.z), found.pdf, delta), found.eta

    def _map(self, run: Any, inputs: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        """Run a function of directions on rows (N, 3), piece by piece."""
        parts = []
        for start in range(0, len(inputs[0]), LANES):
            rows = [np.ascontiguousarray(array[start : start + LANES].T) for array in inputs]
            lanes = [self.mi.Vector3f(row) for row in rows]
            out = tuple(x + 0 * lanes[0].x for x in run(*lanes))
            dr.eval(out)
            parts.append([np.asarray(np.array(x), np.float64).T for x in out])
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def _flux(self, wi: Any, reflected: bool, with_error: bool) -> Any:
        if dr.is_array_v(wi):
            raise UrushiError(
                "wi: found Dr.Jit arrays; allowed for the fluxes of a Mitsuba BSDF: numpy arrays"
            )
        array = directions(wi, "wi")
        replicates = min(REPLICATES, self.samples)
        each = self.samples // replicates
        rng = np.random.default_rng((self.seed, self.samples))
        shift = rng.random((replicates, 1, 3))
        u = ((shift + np.arange(each)[:, None] * STEPS) % 1.0).reshape(-1, 3)
        u = np.minimum(u, 1 - 2.0**-24)
        step = max(LANES // len(u), 1)
        means = []
        for start in range(0, len(array), step):
            some = array[start : start + step]
            there = np.repeat(some, len(u), axis=0)
            found = self.sample(there, np.tile(u, (len(some), 1)))
            same = found.wo[:, 2] * there[:, 2] > 0
            weight = np.where((same == reflected)[:, None], found.weight, 0)
            if not reflected:
                weight = weight * np.where(there[:, 2:] > 0, self._ratio**2, self._ratio**-2)
            means.append(weight.reshape(len(some), replicates, each, 3).mean(axis=2))
        values = np.concatenate(means)
        mean, error = values.mean(axis=1), values.std(axis=1, ddof=1) * (WIDER / np.sqrt(replicates))
        if np.ndim(wi) == 1:
            mean, error = mean[0], error[0]
        return (mean, error) if with_error else mean

    @property
    def _ratio(self) -> float:
        return float(self.stack.layers[0].ior / self.stack.exterior)

    def _lit_below(self) -> bool:
        """Whether any light from above or below leaves below; flags may promise more than there is."""
        u = np.random.default_rng(self.seed).random((4096, 3))
        for side in (1.0, -1.0):
            found = self.sample(np.broadcast_to([0.6, 0.0, 0.8 * side], u.shape), u)
            if ((found.wo[:, 2] < 0) & (found.weight > 0).any(axis=1)).any():
                return True
        return False

    def _index(self) -> float:
        """Index below over index above, as samples that pass say."""
        u = np.random.default_rng(self.seed).random((4096, 3))
        for side in (1.0, -1.0):
            wi = np.broadcast_to([0.6, 0.0, 0.8 * side], u.shape)

            def run(a: Any, b: Any) -> tuple[Any, ...]:
                found, eta = self._sample(a, b)
                lit = dr.max(found.weight) > 0  # one of no weight went nowhere
                return eta, dr.select((found.wo.z * a.z < 0) & lit, 1.0, 0.0)

            eta, passed = self._map(run, (wi, u))
            etas = eta[passed > 0.5]
            if len(etas):
                middle = float(np.median(etas))
                if not 0 < middle < np.inf or np.ptp(etas) > 1e-3 * middle:
                    raise UrushiError(
                        f"{self.stack.name}: its samples give {etas.min():.4g} to {etas.max():.4g} for the index "
                        "that light passes into; allowed: one positive number (say it with eta=...)"
                    )
                return middle**side
        return 1.0


def mitsuba() -> Any:
    """Mitsuba in a variant that a BSDF can be asked in; where none is set, llvm_ad_rgb.

    Raises:
        UrushiError: another kind of variant is set.
    """
    llvm.ensure()
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant(VARIANT)
    name = mi.variant()
    if name.startswith("scalar") or not name.endswith("_rgb"):
        raise UrushiError(f"variant: found {name}; allowed: {VARIANT}, or another of RGB that is not scalar")
    return mi


def _class(bsdf: Any) -> str:
    name = bsdf.class_name() if callable(getattr(bsdf, "class_name", None)) else ""
    return str(name or type(bsdf).__name__)
