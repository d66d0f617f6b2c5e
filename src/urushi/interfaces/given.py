"""A described layer with its numbers: what an interface or a medium is bound from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr

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

    def known_alpha(self) -> tuple[float, ...] | None:
        """The roughness, along one axis or two, if it is known and no normal map adds to it."""
        known = self.known("alpha")
        if known is None or f"{self.name}.slope_variance" in self.values:
            return None
        return tuple(known) if isinstance(known, (tuple, list)) else (known,)

    def widened(self) -> tuple[Array, Array, Array] | None:
        """Roughness along two axes and the angle of the first, with what a normal map adds to it.

        A normal map too fine to be seen spreads slopes by its variance: alpha^2 / 2 is that of Beckmann's facets, so
        twice the variance adds to alpha^2 (Olano & Baker 2010; theory (lobes.14)); so it does here for either
        distribution. Such an interface is rough everywhere, 1e-4 at least. None where nothing is added.
        """
        if f"{self.name}.slope_variance" not in self.values or self.is_zero("slope_variance"):
            return None
        alpha, (xx, yy, xy) = self["alpha"], (self["slope_variance"][i] for i in range(3))
        x, y = alpha if isinstance(alpha, (tuple, list)) else (alpha, alpha)
        sin, cos = dr.sincos(self["rotation"] * (dr.pi / 180))
        a, b = x * x, y * y
        xx = a * cos * cos + b * sin * sin + 2 * xx
        yy = a * sin * sin + b * cos * cos + 2 * yy
        xy = (a - b) * sin * cos + 2 * xy
        mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        length = dr.sqrt(half * half + xy * xy + 1e-20)
        # Where both axes are alike any will do, and the angle must not depend on rounding.
        angle = 0.5 * dr.atan2(xy, half + dr.select(length > 1e-9, 0.0, 1.0))
        return dr.sqrt(mean + length), dr.sqrt(at_least(mean - length, 0)), angle * (180 / dr.pi)

    def isotropic(self) -> bool:
        """Whether the roughness is certainly the same in all directions."""
        return not isinstance(self["alpha"], (tuple, list)) and self.widened() is None

    def facets(self) -> tuple[Microfacets | None, Any]:
        """Microfacets (None when smooth everywhere) and the mask of smooth lanes (True or False where certain)."""
        wide = self.widened()
        if wide is not None:
            x, y, _ = wide
            masking = getattr(self.layer, "masking", "correlated")
            wide_x, wide_y = at_least(x, SMALLEST), at_least(y, SMALLEST)
            return Microfacets(wide_x, wide_y, self.layer.distribution, masking), False
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
        wide = self.widened()
        if wide is not None:
            return Frame(wide[2])
        isotropic = not isinstance(self["alpha"], (tuple, list))
        return Frame(0.0 if isotropic or self.is_zero("rotation") else self["rotation"])

    def phase_parameters(self) -> dict[str, Array]:
        """The numbers of a phase function, by the name of its arguments; of a table, those of the description."""
        head, phase = f"{self.name}.phase.", self.layer.phase
        described = {name: getattr(phase, name) for name in type(phase).model_fields}
        given = {key.removeprefix(head): value for key, value in self.values.items() if key.startswith(head)}
        return {**described, **given}
