"""Media: what happens to light between two interfaces.

A medium is a slab of given optical depth. It answers two questions about light that starts inside it in some
direction: how much arrives at the boundary unscattered, and where and with what weight it meets a particle instead.
A new medium is one file with such a class and one line in `MEDIA`.
"""

from __future__ import annotations

from typing import Any

from .graded import BoundGraded
from .homogeneous import BoundMedium, entry_height, inverse_cosine

#: the class that binds the numbers of each described medium
MEDIA: dict[str, Any] = {"medium": BoundMedium, "graded": BoundGraded}

__all__ = ["MEDIA", "BoundGraded", "BoundMedium", "entry_height", "inverse_cosine"]
