"""Random numbers that depend on nothing but the question: (wi, wo, seed, sample).

Each evaluation owns a small generator whose state comes from a hash of the directions, the seed and the number of the
sample. The answer therefore does not depend on the order of a batch, on how it is split, or on the number of
threads. The generator is sfc32 (Doty-Humphrey, PractRand): additions, shifts and xors of 32-bit words only, which
costs a vector unit half of what the 64-bit products of PCG32 do, and the walk draws a dozen numbers per bounce.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from .vectors import Array, Vector, float_type, module_of

_WORD = 0xFFFFFFFF


def _avalanche(word: Array) -> Array:
    """A bijection of 32-bit words whose every output bit depends on every input bit (Wellons' low-bias hash)."""
    word = ((word ^ (word >> 16)) * 0x7FEB352D) & _WORD
    word = ((word ^ (word >> 15)) * 0x846CA68B) & _WORD
    return word ^ (word >> 16)


@dataclass
class Generator:
    """One sfc32 generator per lane; loops carry it like any other state."""

    a: Array
    b: Array
    c: Array
    count: Array

    def next_word(self) -> Array:
        """32 random bits."""
        word = (self.a + self.b + self.count) & _WORD
        self.count = (self.count + 1) & _WORD
        self.a = self.b ^ (self.b >> 9)
        self.b = (self.c + (self.c << 3)) & _WORD
        self.c = ((((self.c << 21) & _WORD) | (self.c >> 11)) + word) & _WORD
        return word


def generator(w: Vector, values: Sequence[Array], seed: Array, sample: Array) -> Generator:
    """A generator for each lane.

    Args:
        w: any direction of the evaluation; tells the backend.
        values: floats that identify the evaluation (components of wi and wo, texture coordinates, ...).
        seed, sample: integers below 2**32.
    """
    module, scalar = module_of(w), float_type(w) is float
    state: Array = 0x9E3779B9
    other: Array = 0x85EBCA6B
    for word in [*(_float_bits(v, module, scalar) for v in values), seed, sample]:
        state = ((state ^ word) * 0x2C1B3C6D) & _WORD
        state = state ^ (state >> 15)
        other = ((((other << 5) & _WORD) | (other >> 27)) + state) & _WORD
    return Generator(_avalanche(state), _avalanche(other), _avalanche(state ^ (other >> 3)), 1 + 0 * state)


def _float_bits(value: Array, module: Any, scalar: bool) -> Array:
    if scalar:
        return int(struct.unpack("<I", struct.pack("<f", value))[0])
    return dr.reinterpret_array(module.UInt, module.Float32(dr.detach(value)))


def uniform_three(rng: Generator, like: Vector) -> tuple[Array, Array, Array]:
    """Three numbers in [0, 1), the third for a choice: in single precision of the bits that the others leave, 18 of
    them, and half-way between what these can tell apart.
    """
    value = float_type(like)
    if value is not float and dr.type_v(value) != dr.VarType.Float32:
        return uniform(rng, like), uniform(rng, like), uniform(rng, like)
    one, two = rng.next_word(), rng.next_word()
    rest = ((one & 511) << 9) | (two & 511)
    if value is float:
        return (one >> 9) * 2.0**-23, (two >> 9) * 2.0**-23, (rest + 0.5) * 2.0**-18
    return _of_bits(one >> 9, value), _of_bits(two >> 9, value), _of_bits((rest << 5) | 16, value)


def _of_bits(bits: Array, value: type) -> Array:
    """23 bits as a number in [0, 1)."""
    return dr.reinterpret_array(value, bits | 0x3F800000) - 1


def uniform(rng: Generator, like: Vector) -> Array:
    """One number in [0, 1) per lane, in the precision of `like`."""
    value = float_type(like)
    word = rng.next_word()
    if value is float:
        return (word >> 9) * 2.0**-23  # the same 23 bits as in single precision, for the same numbers
    if dr.type_v(value) == dr.VarType.Float32:
        return _of_bits(word >> 9, value)
    return (value(word) + value(rng.next_word()) * 2.0**-32) * 2.0**-32 * (1 - 2.0**-53)
