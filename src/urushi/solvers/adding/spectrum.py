"""A description with any number of channels, and its layers with all of them at once.

A description holds numbers and colours. Channels by the dozen are given beside it, as parameters, and here they become
colours three at a time, since that is what the interfaces compute with. The operators know nothing of threes: a medium
takes all its depths and albedos together, an interface without colour is integrated once for all channels, and only one
with channels of its own (the index of a metal, say) is put together from its thirds.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.stack import Stack

from ...adding import Slab
from ..bound import BoundStack
from ..ledger import owners
from ..numbers import as_numbers, described, is_vector, replaced
from . import build
from .basis import Grid
from .layers import Layer, numbers
from .operator import Operator
from .phase import Phase

#: channels of a colour, which are bound together
THREE = 3


@dataclass(frozen=True)
class Spectrum:
    """A description and the values in place of its own.

    Attributes:
        stack: the description, without the values that differ.
        parameters: by name (``layer_0.albedo``), numbers () and channels (C,), and (2,) for a roughness along x and y.
        channels: C; None where numbers and colours do, which `stacks` then has.
        stacks: the description with channels 0 to 2, 3 to 5, ...; in the last one its last channel is repeated.
    """

    stack: Stack
    parameters: Mapping[str, np.ndarray]
    channels: int | None
    stacks: tuple[Stack, ...]

    @classmethod
    def of(cls, stack: Stack, parameters: Mapping[str, Any] | None = None) -> Spectrum:
        """From what `solve` is given.

        Raises:
            MaterialError: parameters with different numbers of values, or colours of the description, which say
                nothing of these channels.
        """
        arrays = {name: as_numbers(name, value) for name, value in (parameters or {}).items()}
        many = [a.size for n, a in arrays.items() if a.ndim == 1 and a.size not in (1, 3) and not _pair(n, a)]
        if not many:
            return cls(stack, {}, None, (replaced(stack, arrays) if arrays else stack,))
        count = max(many)
        for name, value in described(stack).items():
            if name not in arrays and isinstance(value, tuple) and len(value) == 3 and not is_vector(name):
                raise MaterialError(
                    f"found a colour, where other parameters have {count} channels; allowed: one number, or "
                    f"parameters={{{name!r}: ...}} with {count}",
                    where=name,
                )
        for name, array in arrays.items():
            if array.ndim > 1 or (array.size not in (1, count) and not _pair(name, array)):
                raise MaterialError(
                    f"found shape {array.shape}; allowed: one number or {count} channels, as others have",
                    where=name,
                )
        thirds = [np.minimum(np.arange(k, k + THREE), count - 1) for k in range(0, count, THREE)]
        stacks = [
            replaced(
                stack,
                {n: a[third] if a.size == count and not _pair(n, a) else a for n, a in arrays.items()},
            )
            for third in thirds
        ]
        return cls(stack, arrays, count, tuple(stacks))

    @classmethod
    def joined(cls, stack: Stack, upper: Spectrum, lower: Spectrum) -> Spectrum:
        """Of one description on another, with the parameters of both.

        Args:
            stack: the joined description.
            upper, lower: both, of the same number of channels, or None of either.
        """
        below = {}
        for name, value in lower.parameters.items():
            layer, _, field = name.partition(".")
            if layer != "exterior":
                number = int(layer.removeprefix("layer_")) + len(upper.stack.layers)
                below[f"layer_{number}.{field}"] = value
        return cls.of(stack, {**upper.parameters, **below})

    def bind(self, bind: Callable[[Stack], tuple[BoundStack, int]]) -> Bound:
        """With numbers, by one of `build`'s functions."""
        found = [bind(stack) for stack in self.stacks]
        thirds = [bound for bound, _ in found]
        if self.channels is None:
            return Bound(thirds[0], thirds, found[0][1], [])
        media = [
            _medium([bound.media[region] for bound in thirds], self.channels)
            for region in range(len(thirds[0].media))
        ]
        varied = {
            name.split(".")[0] for name, array in self.parameters.items() if array.size == self.channels
        }
        own = [k for k, layer in enumerate(owners(self.stack)[0]) if f"layer_{layer}" in varied]
        return Bound(replace(thirds[0], media=media), thirds, self.channels, own)


@dataclass(frozen=True)
class Bound:
    """A spectrum with its numbers, in double precision.

    Attributes:
        whole: the stack; its media have all channels, as numpy arrays, its interfaces those of the first third.
        thirds: three channels each, as `Spectrum.stacks`.
        channels: C.
        own: the interfaces that have channels of their own.
    """

    whole: BoundStack
    thirds: Sequence[BoundStack]
    channels: int
    own: Sequence[int]

    def layers(
        self, phases: list[Phase], grid: Grid, tolerance: float, complete: bool, **options: Any
    ) -> list[Layer | None]:
        """As `build.layers`, with all channels."""
        found = build.layers(self.whole, phases, grid, tolerance, complete, **options)
        for k in self.own:
            place = k + sum(medium is not None for medium in self.whole.media[1 : k + 1])
            first = found[place]
            assert first is not None
            others = [
                build.interface_layer(bound.interfaces[k], grid, k, tolerance) for bound in self.thirds[1:]
            ]
            found[place] = Beside([first, *others], self.channels)
        return found


class Beside:
    """An interface in several thirds, as a layer of C channels.

    Args:
        thirds: the same interface with three channels each.
        channels: C.
    """

    def __init__(self, thirds: Sequence[Layer], channels: int) -> None:
        self._thirds, self._channels = thirds, channels
        self.orders = max(layer.orders for layer in thirds)

    def first(self, orders: range) -> int:
        return min(layer.first(orders) for layer in self._thirds)

    def slab(self, orders: range, first: int) -> Slab:
        slabs = [layer.slab(orders, first) for layer in self._thirds]
        return Slab(*(self._joined(operators) for operators in zip(*slabs, strict=True)))

    def _joined(self, operators: Sequence[Operator]) -> Operator:
        deltas, dense = [o.delta for o in operators], [o.dense for o in operators]
        return Operator(operators[0].shape, self._side_by_side(deltas), self._side_by_side(dense))

    def _side_by_side(self, arrays: Sequence[np.ndarray | None]) -> np.ndarray | None:
        """(C, ...) of arrays (1 or 3, ...); where they have fewer orders, or are not there, with zeros."""
        there = [array for array in arrays if array is not None]
        if not there:
            return None
        shape = np.max([array.shape[1:] for array in there], axis=0)
        found = np.zeros((self._channels, *shape))
        for k, array in enumerate(arrays):
            if array is not None:
                some = found[THREE * k : THREE * (k + 1), : array.shape[1]]
                some[...] = array[: len(some)]
        return found


def _pair(name: str, value: np.ndarray) -> bool:
    """Whether a value is a roughness along x and along y, which are no channels."""
    return value.size == 2 and name.endswith(".alpha")


def _medium(thirds: Sequence[Any], channels: int) -> Any:
    """A medium with the depths and albedos of all thirds."""
    if thirds[0] is None:
        return None
    found = copy.copy(thirds[0])
    for name in ("depth", "albedo"):
        values = [np.broadcast_to(numbers(getattr(medium, name)), (THREE,)) for medium in thirds]
        setattr(found, name, np.concatenate(values)[:channels])
    found.scatters = any(medium.scatters for medium in thirds)
    return found
