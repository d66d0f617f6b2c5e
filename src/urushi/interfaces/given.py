"""A described layer with its numbers: what an interface or a medium is bound from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..optics.microfacet import Microfacets
from ..optics.vectors import Array, at_least
from .base import Frame

#: stands for the roughness of a smooth lane among rough ones, whose density nobody asks for
SMALLEST = 1e-4


@dataclass
class Given:
    """One layer of a description.

    Attributes:
        layer: the description.
        name: where its parameters are: ``layer_0``.
        values: the number of every continuous parameter of the stack, by name.
        fixed: those of them that are known in Python; they shape the code that is compiled.
        above: absolute index of what lies above.
        known_above: the same, if it is known in Python.
    """

    layer: Any
    name: str
    values: Mapping[str, Array]
    fixed: Mapping[str, Any]
    above: Array
    known_above: float | None

    def __getitem__(self, key: str) -> Array:
        return self.values[f"{self.name}.{key}"]

    def known(self, key: str) -> Any:
        """The value of a parameter in Python, None if it may be anything."""
        return self.fixed.get(f"{self.name}.{key}")

    def is_zero(self, key: str) -> bool:
        """Whether a parameter is known to be 0, in every channel."""
        known = self.known(key)
        return known is not None and max(known if isinstance(known, tuple) else (known,)) == 0

    def facets(self) -> tuple[Microfacets | None, Any]:
        """Microfacets (None when smooth everywhere) and the mask of smooth lanes (True or False where certain)."""
        if self.is_zero("alpha"):
            return None, True
        alpha = self["alpha"]
        x, y = alpha if isinstance(alpha, (tuple, list)) else (alpha, alpha)
        delta: Any = False
        if self.known("alpha") is None:
            delta = (x <= 0) & (y <= 0)
            if delta is True:
                return None, True
            # One object where it is one number: that is how others know it is the same in all directions.
            alike, x = x is y, at_least(x, SMALLEST)
            y = x if alike else at_least(y, SMALLEST)
        return Microfacets(x, y, self.layer.distribution, getattr(self.layer, "masking", "correlated")), delta

    def frame(self) -> Frame:
        """The rotation of the tangent frame, unless the roughness is the same in all directions."""
        isotropic = not isinstance(self["alpha"], (tuple, list))
        return Frame(0.0 if isotropic or self.is_zero("rotation") else self["rotation"])

    def phase_parameters(self) -> dict[str, Array]:
        """The numbers of a phase function, by the name of its arguments; of a table, those of the description."""
        head, phase = f"{self.name}.phase.", self.layer.phase
        described = {name: getattr(phase, name) for name in type(phase).model_fields}
        given = {key.removeprefix(head): value for key, value in self.values.items() if key.startswith(head)}
        return {**described, **given}
