"""Registers Urushi's plugins with Mitsuba 3, in the current variant and in every one set later.

    import urushi.mitsuba  # first, since it chooses the LLVM
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    bsdf = mi.load_dict({"type": "layered", "filename": "preset:enamel-on-gold"})

Where Mitsuba discovers the entry-point group ``mitsuba`` (from 3.10 on), not even the import is needed; Mitsuba then
reloads this module at each change of variant, so it holds no state of its own.
"""

from __future__ import annotations

from typing import Any

from urushi import llvm

llvm.prepare()

import mitsuba as mi  # noqa: E402  (LLVM has to be chosen before Dr.Jit looks for it)

from urushi.adapters.mitsuba import complete, fourier, plugin  # noqa: E402

_CALLBACK = "_urushi_registers"


def _on_variant(*_: Any) -> None:
    if mi.variant() is not None:
        for module in (plugin, complete, fourier):
            module.register(mi)


if not hasattr(mi.detail, _CALLBACK):
    mi.detail.add_variant_callback(_on_variant)
    setattr(mi.detail, _CALLBACK, _on_variant)
_on_variant()
