"""How a solved stack shows itself in a notebook: as a figure.

Figures stand above the solvers, so this is the one way up in the house: taken by name, when a notebook asks, and by
nobody else. Without matplotlib a notebook shows the plain text.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any


def picture(bsdf: Any) -> bytes | None:
    """A PNG file of the lobe in the plane of incidence; None without matplotlib, or where there is nothing to draw."""
    if importlib.util.find_spec("matplotlib") is None:
        return None
    found: bytes | None = importlib.import_module("urushi.plot.notebook").picture(bsdf)
    return found
