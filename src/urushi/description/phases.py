"""Phase functions of a medium, as data. A new one is a class here and its name in the registry below."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from urushi.description.base import Data, Description, Rule
from urushi.description.parameter import Parameter, Texture, finite, plain


class Isotropic(Description):
    """Scatters equally into all directions."""

    kind = "isotropic"


class HenyeyGreenstein(Description):
    """The Henyey-Greenstein phase function (Henyey and Greenstein 1941).

    Args:
        g: mean cosine of the scattering angle, from -0.999 (back) over 0 (isotropic) to 0.999 (forward).

    Raises:
        MaterialError: a value is not allowed.
    """

    kind = "henyey_greenstein"

    g: Annotated[
        float | Texture,
        Parameter(
            -0.999, 0.999, meaning="mean cosine of the scattering angle", why_one="one g serves every colour"
        ),
    ]


class Rayleigh(Description):
    """Unpolarised Rayleigh scattering, 3/4 (1 + cos²): particles far smaller than the wavelength."""

    kind = "rayleigh"


class Curve(Rule):
    """Numbers of 0 or more at equal steps, not all 0."""

    least: ClassVar[int] = 2
    most: ClassVar[int] = 4096

    def __init__(self, meaning: str) -> None:
        self.meaning = meaning

    def read(self, value: Any) -> tuple[float, ...]:
        """The numbers."""
        value = plain(value)
        if not isinstance(value, list | tuple):
            raise self.refuse(value)
        if not self.least <= len(value) <= self.most:
            raise self.refuse(value, f"which has {len(value)} values")
        numbers = tuple(finite(item, self, f"[{i}]") for i, item in enumerate(value))
        for i, number in enumerate(numbers):
            if not 0 <= number <= 1e12:
                raise self.refuse(number, where=f"[{i}]")
        if max(numbers) < 1e-12:
            raise self.refuse(value, "none of which is above 1e-12")
        return numbers

    def allowed(self) -> str:
        """In words."""
        return f"a list of {self.least} to {self.most} numbers from 0 to 1e+12, one of them at least 1e-12"

    def schema(self) -> dict[str, Any]:
        """An array of numbers."""
        number = {"type": "number", "minimum": 0, "maximum": 1e12}
        return {"type": "array", "items": number, "minItems": self.least, "maxItems": self.most}

    def data(self, value: Any, folder: Any) -> Data:
        """A list."""
        return list(value)


class Tabulated(Description):
    """A phase function by its values at equal steps of the scattering angle.

    Between the angles it is linear in their cosine. Only ratios count: it is scaled such that all directions together
    make 1.

    Args:
        values: at scattering angles from 0 (straight on) to 180 degrees, at least 2.

    Raises:
        MaterialError: a value is not allowed.
    """

    kind = "tabulated"

    values: Annotated[
        tuple[float, ...],
        Curve(
            "values at equal steps of the scattering angle from 0 (straight on) to 180 degrees, in any unit"
        ),
    ]


Phase = Isotropic | HenyeyGreenstein | Rayleigh | Tabulated

PHASES: dict[str, type[Description]] = {
    phase.kind: phase for phase in (Isotropic, HenyeyGreenstein, Rayleigh, Tabulated)
}
"""Every phase function, by its name in material files."""
