"""Where the light goes: what leaves a stack, what every layer of it absorbs, and what is lost between facets.

A ledger has one row for each layer of the description. What is missing from the light that a layer got is

    absorbed   by particles or dye in a medium, by the metal or the paint of a base
    lost       at a rough interface that scatters once: what its facets send into other facets
               (`multiple_scattering` gives it back)

and with what is reflected and transmitted all of it adds up to 1 (theory (adding.11)).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np

from urushi.errors import UrushiError
from urushi.stack import Stack

from .bsdf import directions

#: most directions that a table shows
SHOWN = 8


@dataclass(frozen=True)
class Errors:
    """Standard errors of the entries of a `Ledger` of the same names, or what a deterministic solver expects."""

    reflected: np.ndarray
    transmitted: np.ndarray
    absorbed: np.ndarray
    lost: np.ndarray
    total: np.ndarray


@dataclass(frozen=True, repr=False)
class Ledger:
    """Shares of the flux from N directions, in C channels, for a stack of L layers; prints as a table.

    Attributes:
        wi: (N, 3) directions that the light comes from.
        reflected: (N, C) what leaves on the side of wi, delta parts included.
        transmitted: (N, C) what leaves on the other side.
        absorbed: (L, N, C) what each layer of the description absorbs.
        lost: (L, N, C) what single-scattering microfacets lose at each layer.
        names: L names, such as "layers[0] dielectric".
        error: standard errors, if they were asked for.
    """

    wi: np.ndarray
    reflected: np.ndarray
    transmitted: np.ndarray
    absorbed: np.ndarray
    lost: np.ndarray
    names: tuple[str, ...]
    error: Errors | None = None

    @property
    def total(self) -> np.ndarray:
        """(N, C) the sum of all entries: 1, but for rounding, or within its error for a result of the walk."""
        return self.reflected + self.transmitted + self.absorbed.sum(axis=0) + self.lost.sum(axis=0)

    def __repr__(self) -> str:
        count, shown = len(self.wi), min(len(self.wi), SHOWN)
        tables = [self._table(i) for i in range(shown)]
        if count > shown:
            tables.append(f"... and {count - shown} more directions")
        return "\n\n".join(tables)

    def _table(self, i: int) -> str:
        """The rows for one direction; those of losses only where there are any."""
        errors = self.error
        rows = [
            ("reflected", self.reflected[i], None if errors is None else errors.reflected[i]),
            ("transmitted", self.transmitted[i], None if errors is None else errors.transmitted[i]),
        ]
        for k, name in enumerate(self.names):
            for word, values in (("absorbed", self.absorbed), ("lost", self.lost)):
                if word == "absorbed" or np.abs(values[k]).max(initial=0) > 1e-9:
                    own = None if errors is None else getattr(errors, word)[k, i]
                    rows.append((f"{name} {word}", values[k, i], own))
        rows.append(("total", self.total[i], None if errors is None else errors.total[i]))
        wide = max(len(name) for name, _, _ in rows)
        lines = [f"light from ({', '.join(f'{x:.3f}' for x in self.wi[i])})"]
        lines += [f"  {name:{wide}s}  {_cells(values, own)}" for name, values, own in rows]
        return "\n".join(lines)


def _cells(values: np.ndarray, errors: np.ndarray | None) -> str:
    if errors is None:
        return "  ".join(f"{v:7.4f}" for v in values)
    return "  ".join(f"{v:7.4f} ± {e:.4f}" for v, e in zip(values, errors, strict=True))


# --- how solvers fill one in -----------------------------------------------------------------------------------------


def lit(wi: Any, opaque: bool) -> np.ndarray:
    """(N, 3) directions that light can come from.

    Raises:
        UrushiError: a Dr.Jit array, or a direction along the surface or below an opaque stack, from where none gets in.
    """
    if dr.is_array_v(wi):
        raise UrushiError(f"wi: found {type(wi).__name__}; allowed: numpy arrays (a ledger is not traced)")
    array = directions(wi, "wi")
    dark = (array[:, 2] <= 0) if opaque else (array[:, 2] == 0)
    if dark.any():
        i = int(np.argmax(dark))
        allowed = "z > 0, since nothing gets into an opaque stack from below" if opaque else "z other than 0"
        raise UrushiError(f"wi[{i}]: found z = {array[i, 2]:g}; allowed: {allowed}")
    return array


def owners(stack: Stack) -> tuple[list[int | None], list[int | None]]:
    """Which layer of the description each interface of the bound stack is, and the medium of each region.

    Returns:
        interfaces, media: numbers of layers in the order of `bound.bind`; None for an index-matched boundary that the
        description leaves out, and for a region without a medium.
    """
    interfaces: list[int | None] = []
    media: list[int | None] = [None]
    for i, layer in enumerate(stack.layers):
        if not layer.is_medium:
            interfaces.append(i)
            media.append(None)
            continue
        if media[-1] is not None or not interfaces:
            interfaces.append(None)
            media.append(None)
        media[-1] = i
    if media[-1] is not None:
        interfaces.append(None)
        media.append(None)
    return interfaces, media


def filed(
    stack: Stack,
    wi: np.ndarray,
    leaving: tuple[np.ndarray, np.ndarray],
    absorbed: Mapping[int, np.ndarray],
    lost: Mapping[int, np.ndarray],
) -> Ledger:
    """A ledger with a row for every layer.

    Args:
        wi: (N, 3) directions.
        leaving: (N, C) reflected and transmitted.
        absorbed, lost: (N, C) by number of the layer; others have 0.
    """
    zeros = np.zeros((len(stack.layers), *leaving[0].shape))
    found = zeros, zeros.copy()
    for whole, entries in zip(found, (absorbed, lost), strict=True):
        for layer, values in entries.items():
            whole[layer] = values
    return Ledger(wi, leaving[0], leaving[1], found[0], found[1], names(stack))


def coloured(values: np.ndarray) -> np.ndarray:
    """(N, C) one channel, (N,) or (N, 1), given as three alike."""
    values = values[:, None] if values.ndim == 1 else values
    return np.repeat(values, 3, axis=1) if values.shape[1] == 1 else values


def names(stack: Stack) -> tuple[str, ...]:
    """What the layers are called in a ledger."""
    return tuple(f"layers[{i}] {layer.kind}" for i, layer in enumerate(stack.layers))


def alike(ledger: Ledger, error: float) -> Errors:
    """The same error for every entry."""
    values = {field.name: np.full_like(getattr(ledger, field.name), error) for field in fields(Errors)}
    return Errors(**values)
