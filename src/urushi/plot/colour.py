"""Linear sRGB to what a screen shows."""

from __future__ import annotations

import numpy as np

SHOULDER = 0.75
"""Values up to here are shown as they are; highlights above are rolled off towards white."""


def encoded(linear: np.ndarray, tonemap: bool = False) -> np.ndarray:
    """Linear sRGB (..., 3) to sRGB in [0, 1]; with `tonemap` bright values roll off, else they end at 1."""
    x = np.maximum(linear, 0.0)
    if tonemap:  # the curve of the renders
        room = 1.0 - SHOULDER
        x = np.where(x > SHOULDER, 1.0 - room * np.exp(-(np.maximum(x, SHOULDER) - SHOULDER) / room), x)
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def code(linear: np.ndarray) -> str:
    """Linear sRGB (3,) as #rrggbb."""
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in encoded(linear))
