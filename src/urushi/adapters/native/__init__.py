"""Solved stacks in a file of Urushi's own, ``.urushi.npz``: small, and all that `AddingBSDF` needs.

The operators of a stack as integers, at steps that keep a stated error, without what reciprocity repeats. The format is
defined in `docs/solved-file.md`.

    packing   a `Solution` as a few arrays and a header, and back
    symmetry, energies   what need not be stored twice, and what rounding may not take
    file      save, load: the same in a file, checked before anything is believed
"""

from __future__ import annotations

from .file import load, save, spare
from .packing import pack, unpack

__all__ = ["load", "pack", "save", "spare", "unpack"]
