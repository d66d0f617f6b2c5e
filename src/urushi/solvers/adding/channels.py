"""Other channels than a colour has: as many solutions as it takes, three channels each, as one BSDF.

Wavelengths know nothing of one another, in the equations as in nature, so a spectrum of C values is solved in thirds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from urushi.errors import MaterialError, UrushiError
from urushi.stack import Stack

from ..bsdf import BSDF, Sample, random_numbers, same_count
from ..bsdf import directions as checked
from ..ledger import Ledger, alike
from ..numbers import described, is_vector
from .result import AddingBSDF


def channels(parameters: Mapping[str, Any]) -> int:
    """How many channels the values ask for: the most that any of them has."""
    return max((np.size(value) for name, value in parameters.items() if not _pair(name, value)), default=1)


def _pair(name: str, value: Any) -> bool:
    """Whether a value is a roughness along x and along y, which are no channels."""
    return np.size(value) == 2 and name.endswith(".alpha")


def split(parameters: Mapping[str, Any], stack: Stack) -> list[dict[str, Any]]:
    """Parameters with C values each, three at a time; a single dictionary where C is 1 or 3.

    Raises:
        MaterialError: parameters with different numbers of values, or colours of the description, which say nothing of
            these channels.
    """
    arrays = {name: np.asarray(value, dtype=np.float64) for name, value in parameters.items()}
    many = [
        array.size
        for name, array in arrays.items()
        if array.ndim == 1 and array.size not in (1, 3) and not _pair(name, array)
    ]
    if not many:
        return [dict(parameters)]
    count = max(many)
    for name, value in described(stack).items():
        if name not in arrays and isinstance(value, tuple) and len(value) == 3 and not is_vector(name):
            raise MaterialError(
                f"found a colour, where other parameters have {count} channels; allowed: one number, or "
                f"parameters={{{name!r}: ...}} with {count}",
                where=name,
            )
    found = []
    for name, array in arrays.items():
        if array.ndim > 1 or (array.size not in (1, count) and not _pair(name, array)):
            raise MaterialError(
                f"found shape {array.shape}; allowed: one number or {count} channels, as others have",
                where=name,
            )
    for start in range(0, count, 3):
        some = {}
        for name, array in arrays.items():
            if array.size != count:
                some[name] = array
                continue
            values = array[start : start + 3]
            # A third that is not full repeats its last channel.
            some[name] = np.resize(np.append(values, [values[-1]] * 2), 3)
        found.append(some)
    return found


class ChannelsBSDF(BSDF):
    """Solutions of the same stack for different wavelengths, side by side: every value has C channels.

    `sample` draws from each solution alike, and `pdf` is the density of that.

    Args:
        stack: the description, without the values that differ.
        parts: three channels each, the last perhaps fewer.
        channels: C.
    """

    def __init__(self, stack: Stack, parts: Sequence[AddingBSDF], channels: int) -> None:
        self.stack, self.parts, self.channels = stack, tuple(parts), channels
        keys = ("estimated_error", "nodes", "orders", "seconds")
        worst = {key: max(part.diagnostics[key] for part in self.parts) for key in keys}
        worst["seconds"] = sum(part.diagnostics["seconds"] for part in self.parts)
        self.diagnostics = {"method": "adding", "channels": channels, "solutions": len(self.parts), **worst}

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        """f |cos theta_o|: numpy (N, 3), (N, 3) -> (N, C); with `with_error`, that and the error expected."""
        found = [part.eval(_numpy(wi), _numpy(wo), with_error=with_error) for part in self.parts]
        return tuple(self._joined(x) for x in zip(*found, strict=True)) if with_error else self._joined(found)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Directional-hemispherical reflectance: numpy (N, 3) -> (N, C)."""
        return self._flux(
            [part.reflectance(_numpy(wi), with_error=with_error) for part in self.parts], with_error
        )

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        """Flux transmitted to the other side: numpy (N, 3) -> (N, C)."""
        return self._flux(
            [part.transmittance(_numpy(wi), with_error=with_error) for part in self.parts], with_error
        )

    def absorption(self, wi: Any, *, with_error: bool = False) -> Ledger:
        """Where the light goes, in each of C channels; as `AddingBSDF.absorption`."""
        found = [part.absorption(_numpy(wi), with_error=with_error) for part in self.parts]
        ledger = replace(
            found[0],
            reflected=self._joined([part.reflected for part in found]),
            transmitted=self._joined([part.transmitted for part in found]),
            absorbed=self._joined([part.absorbed for part in found]),
            lost=self._joined([part.lost for part in found]),
            error=None,
        )
        error = max(float(part.diagnostics["estimated_error"]) for part in self.parts)
        return replace(ledger, error=alike(ledger, error)) if with_error else ledger

    def pdf(self, wi: Any, wo: Any) -> Any:
        """Density of `sample` per solid angle: numpy (N, 3), (N, 3) -> (N,)."""
        return np.mean([part.pdf(_numpy(wi), _numpy(wo)) for part in self.parts], axis=0)

    def sample(self, wi: Any, u: Any) -> Sample:
        """Sample wo: numpy wi (N, 3), u (N, 3) in [0, 1); u[:, 0] chooses a solution, and a part of it."""
        single = np.ndim(wi) == np.ndim(u) == 1
        w, numbers = same_count(checked(_numpy(wi), "wi"), random_numbers(u), "wi and u")
        scaled = numbers[:, 0] * len(self.parts)
        which = np.minimum(scaled.astype(int), len(self.parts) - 1)
        own = np.column_stack([np.minimum(scaled - which, 1 - 2.0**-53), numbers[:, 1:]])
        drawn = [part.sample(w, own) for part in self.parts]
        rows = np.arange(len(w))
        wo = np.stack([s.wo for s in drawn])[which, rows]
        delta = np.stack([s.delta for s in drawn])[which, rows]
        pdf = np.where(delta, 0.0, self.pdf(w, wo))
        weight = self.eval(w, wo) / np.maximum(pdf, 1e-30)[:, None]
        if delta.any():
            pdf, weight = self._delta(w, wo, delta, pdf, weight)
        weight = np.where((pdf > 0)[:, None], weight, 0)
        found = wo, weight, pdf, delta
        return Sample(*((x[0] for x in found) if single else found))

    def _delta(
        self, wi: np.ndarray, wo: np.ndarray, delta: np.ndarray, pdf: np.ndarray, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Probability and weight of the delta parts: each solution has the same directions, with chances of its own."""
        chance = np.zeros(len(wi))
        energy = []
        for part in self.parts:
            mirror, straight, carried = part.delta_parts(wi)
            up = wi[:, 2] * wo[:, 2] > 0
            chance += np.where(up, mirror, straight) / len(self.parts)
            energy.append(np.where(up[:, None], carried[0], carried[1]))
        value = self._joined(energy) / np.maximum(chance, 1e-30)[:, None]
        return np.where(delta, chance, pdf), np.where(delta[:, None], value, weight)

    def _flux(self, found: list[Any], with_error: bool) -> Any:
        return tuple(self._joined(x) for x in zip(*found, strict=True)) if with_error else self._joined(found)

    def _joined(self, values: Sequence[Any]) -> np.ndarray:
        return np.concatenate(list(values), axis=-1)[..., : self.channels]


def _numpy(w: Any) -> np.ndarray:
    if type(w).__module__.startswith(("drjit", "mitsuba")):
        raise UrushiError(
            f"found {type(w).__name__}; allowed: numpy arrays where there are more than three channels, or two"
        )
    return np.asarray(w, dtype=np.float64)
