"""A medium whose albedo varies with depth, as data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from urushi.description.base import Data, Registered, Rule
from urushi.description.layers import LAYERS, Layer
from urushi.description.parameter import Parameter, finite, plain
from urushi.description.phases import PHASES, Isotropic, Phase


class Profile(Rule):
    """Numbers from 0 to 1 at equal steps of the optical depth."""

    least: ClassVar[int] = 2
    most: ClassVar[int] = 64
    meaning = (
        "single-scattering albedo at equal steps of the optical depth from top to bottom, linear in between"
    )

    def read(self, value: Any) -> tuple[float, ...]:
        """The numbers."""
        value = plain(value)
        if not isinstance(value, list | tuple):
            raise self.refuse(value, "which varies nowhere: that is a medium" if _is_number(value) else "")
        if not self.least <= len(value) <= self.most:
            raise self.refuse(value, f"which has {len(value)} values")
        numbers = tuple(finite(item, self, f"[{i}]") for i, item in enumerate(value))
        for i, number in enumerate(numbers):
            if not 0 <= number <= 1:
                raise self.refuse(number, where=f"[{i}]")
        return numbers

    def allowed(self) -> str:
        """In words."""
        return f"a list of {self.least} to {self.most} numbers from 0 to 1"

    def schema(self) -> dict[str, Any]:
        """An array of numbers."""
        number = {"type": "number", "minimum": 0, "maximum": 1}
        return {"type": "array", "items": number, "minItems": self.least, "maxItems": self.most}

    def data(self, value: Any, folder: Any) -> Data:
        """A list."""
        return list(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


class GradedMedium(Layer):
    """A plane-parallel medium whose albedo varies with depth, without any interface of its own.

    Args:
        depth: optical depth of all of it along the normal, 0 to 100, one number.
        albedo: single-scattering albedo, 2 to 64 numbers from 0 to 1: the first at the top, the last at the bottom,
            the others at equal steps of the optical depth between them; it is linear from one to the next.
        phase: phase function, the same at every depth.

    Raises:
        MaterialError: a value is not allowed.

    Example:
        >>> GradedMedium(depth=2, albedo=[0.95, 0.6, 0.9])
        GradedMedium(depth=2.0, albedo=(0.95, 0.6, 0.9))
    """

    kind = "graded"
    is_medium = True

    @classmethod
    def called(cls) -> str:
        """The layer in a sentence."""
        return "a graded medium"

    depth: Annotated[
        float,
        Parameter(
            0.0,
            100.0,
            meaning="optical depth, along the normal",
            texture=False,
            why_one="one depth serves every colour, since the albedo is told by it",
        ),
    ]
    albedo: Annotated[tuple[float, ...], Profile()]
    phase: Annotated[
        Phase, Registered(PHASES, "phase function", meaning="how the medium scatters into directions")
    ] = Isotropic()

    @property
    def optical_depth(self) -> float:
        """The same as `depth`."""
        return self.depth

    @property
    def mean_albedo(self) -> float:
        """The albedo, averaged over the optical depth."""
        steps = list(self.steps())
        return sum(0.5 * (above + below) for above, below in steps) / len(steps)

    def steps(self) -> Iterator[tuple[float, float]]:
        """The albedo at the top and at the bottom of each step, from the top."""
        return zip(self.albedo[:-1], self.albedo[1:], strict=True)


LAYERS[GradedMedium.kind] = GradedMedium
