"""Other channels than a colour has: one solution of them all, evaluated three at a time.

Wavelengths know nothing of one another, but they share nodes, orders, phase functions and whatever has no colour: so a
spectrum of C values is one solution of C channels. Dr.Jit's colours have three, so it is looked up in thirds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from urushi.errors import UrushiError
from urushi.stack import Stack

from ..bsdf import BSDF, Sample, random_numbers, same_count
from ..bsdf import directions as checked
from ..ledger import Ledger, alike
from .result import AddingBSDF, Matrices
from .solution import Solution
from .spectrum import THREE, Spectrum

#: diagnostics of the tables of all parts, from those of each
TABLES: dict[str, Callable[[list[Any]], Any]] = {
    "azimuthal_terms": max,
    "azimuthal_error": max,
    "table_bytes": sum,
    "most_negative": min,
    "sampling_bytes": sum,
}


class _Diagnostics(dict[str, Any]):
    """What a solution says of itself; an entry of `TABLES` is there once ``diagnostics[...]`` has asked for it."""

    def __init__(self, known: dict[str, Any], parts: Sequence[AddingBSDF]) -> None:
        super().__init__(known)
        self._parts = parts

    def __missing__(self, key: str) -> Any:
        if key not in TABLES:
            raise KeyError(key)
        self[key] = TABLES[key]([part.diagnostics[key] for part in self._parts])
        return self[key]


class ChannelsBSDF(BSDF):
    """A solution of any number of channels as a BSDF: every value has C.

    `sample` draws from each third of the channels alike, and `pdf` is the density of that.

    Args:
        spectrum: the description that was solved, and the channels beside it.
        solution: its operators, of C channels.
        **options: `backend`, `precision`, `mode`, `order`: see `AddingBSDF`.

    Attributes:
        stack: the description, without the values that differ.
        parameters: these, by name: (C,) each, or ().
        channels: C.
        solution: the operators.
        parts: BSDFs of three channels each, of the same solution; the last one repeats its last channel.

    Raises:
        UrushiError: an option out of range, or a solution of another stack.
    """

    def __init__(self, spectrum: Spectrum, solution: Solution, **options: Any) -> None:
        if spectrum.channels != solution.colours:
            raise UrushiError(
                f"solution: found {solution.colours} channels; allowed: those of the parameters, {spectrum.channels}"
            )
        self.spectrum, self.solution, self.channels = spectrum, solution, solution.colours
        self.stack: Stack = spectrum.stack
        self._options = options
        self.parameters = dict(spectrum.parameters)
        thirds = [
            np.minimum(np.arange(THREE) + THREE * k, self.channels - 1) for k in range(len(spectrum.stacks))
        ]
        self.parts = tuple(
            AddingBSDF(stack, solution.some(third), **options)
            for stack, third in zip(spectrum.stacks, thirds, strict=True)
        )
        said = ("method", "backend", "precision", "closed_form")
        same = {key: self.parts[0].diagnostics[key] for key in said}
        self.diagnostics = _Diagnostics(
            {**solution.diagnostics, **same, "channels": self.channels}, self.parts
        )

    def _made_of(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.spectrum, self.solution), self._options

    @cached_property
    def matrices(self) -> Matrices:
        """The operators themselves, of all channels."""
        return Matrices.of(self.solution)

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
        error = float(self.solution.diagnostics.get("estimated_error", np.nan))
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
