"""A medium that varies with depth, as data."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar

from urushi.description.base import Data, Description, Registered, Rule, inside, shown
from urushi.description.layers import LAYERS, Layer
from urushi.description.parameter import Parameter, Texture, finite, plain
from urushi.description.phases import PHASES, Isotropic, Phase
from urushi.errors import MaterialError

LEAST, MOST = 2, 64
"""How many depths may have values."""


class Profile(Rule):
    """Numbers from 0 to 1, one for each of the depths that have values; or one for all."""

    least, most = LEAST, MOST
    meaning = (
        "single-scattering albedo, from top to bottom, linear in between; one number: everywhere the same"
    )

    def read(self, value: Any) -> float | tuple[float, ...]:
        """The numbers."""
        value = plain(value)
        if not isinstance(value, list | tuple):
            return self._bounded(finite(value, self))
        if not self.least <= len(value) <= self.most:
            raise self.refuse(value, f"which has {len(value)} values")
        return tuple(self._bounded(finite(item, self, f"[{i}]"), f"[{i}]") for i, item in enumerate(value))

    def _bounded(self, number: float, where: str | None = None) -> float:
        if not 0 <= number <= 1:
            raise self.refuse(number, where=where)
        return number

    def allowed(self) -> str:
        """In words."""
        return f"a number from 0 to 1 or a list of {self.least} to {self.most} such numbers"

    def schema(self) -> dict[str, Any]:
        """A number, or an array of them."""
        number = {"type": "number", "minimum": 0, "maximum": 1}
        many = {"type": "array", "items": number, "minItems": self.least, "maxItems": self.most}
        return {"anyOf": [number, many]}

    def data(self, value: Any, folder: Any) -> Data:
        """A number or a list."""
        return list(value) if isinstance(value, tuple) else value


class Phases(Registered):
    """A phase function, or one for each of the depths that have values."""

    def read(self, value: Any) -> Any:
        """One, or a tuple."""
        if not isinstance(value, list | tuple):
            return super().read(value)
        if not LEAST <= len(value) <= MOST:
            raise self.refuse(value, f"which has {len(value)} of them")
        found = []
        for i, item in enumerate(value):
            try:
                phase = super().read(item)
                self._check_plain(phase)
            except MaterialError as error:
                raise inside(error, f"[{i}]") from None
            found.append(phase)
        return tuple(found)

    @staticmethod
    def _check_plain(phase: Description) -> None:
        for name in type(phase).model_fields:
            if isinstance(getattr(phase, name), Texture):
                raise MaterialError(
                    f"found {shown(getattr(phase, name))}; allowed in a list of phase functions: a number",
                    where=name,
                )

    def allowed(self) -> str:
        """In words."""
        return f"{super().allowed()}, or a list of {LEAST} to {MOST} of them"

    def schema(self) -> dict[str, Any]:
        """One, or an array of them."""
        one = super().schema()
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": LEAST, "maxItems": MOST}]}

    def data(self, value: Any, folder: Any) -> Data:
        """One, or a list."""
        if isinstance(value, tuple):
            return [super(Phases, self).data(phase, folder) for phase in value]
        return super().data(value, folder)


class Heights(Rule):
    """Shares of the optical depth, ascending from 0 to 1."""

    nearest: ClassVar[float] = 1e-6
    meaning = "where these values are, as shares of the optical depth from the top (none: at equal steps)"

    def read(self, value: Any) -> tuple[float, ...]:
        """The numbers."""
        value = plain(value)
        if not isinstance(value, list | tuple):
            raise self.refuse(value)
        if not LEAST <= len(value) <= MOST:
            raise self.refuse(value, f"which has {len(value)} values")
        numbers = tuple(finite(item, self, f"[{i}]") for i, item in enumerate(value))
        for i, (above, below) in enumerate(pairwise(numbers), 1):
            if below - above < self.nearest:
                raise self.refuse(below, f"after {above:g}", where=f"[{i}]")
        for i, end in ((0, 0.0), (len(numbers) - 1, 1.0)):
            if numbers[i] != end:
                raise self.refuse(numbers[i], where=f"[{i}]")
        return numbers

    def allowed(self) -> str:
        """In words."""
        return (
            f"a list of {LEAST} to {MOST} numbers from 0 to 1, the first 0, the last 1, each at least {self.nearest:g} "
            "above the one before"
        )

    def schema(self) -> dict[str, Any]:
        """An array of numbers."""
        number = {"type": "number", "minimum": 0, "maximum": 1}
        return {"type": "array", "items": number, "minItems": LEAST, "maxItems": MOST}

    def data(self, value: Any, folder: Any) -> Data:
        """A list."""
        return list(value)


class GradedMedium(Layer):
    """A plane-parallel medium that varies with depth, without any interface of its own.

    At some depths it is described; in between, what it scatters into any direction (albedo times phase function) is
    linear in the optical depth, as where two kinds of particles settle at different rates.

    Args:
        depth: optical depth of all of it along the normal, 0 to 100, one number.
        albedo: single-scattering albedo at these depths, 2 to 64 numbers from 0 to 1 from the top to the bottom; one
            number if it is everywhere the same.
        phase: phase function at these depths, a list of as many; one if it is everywhere the same.
        at: the depths, as shares of `depth` ascending from 0 (the top) to 1 (the bottom); None for equal steps.

    Raises:
        MaterialError: a value is not allowed, lists of different lengths, or nothing that varies.

    Example:
        >>> GradedMedium(depth=2, albedo=[0.95, 0.6, 0.9])
        GradedMedium(depth=2.0, albedo=(0.95, 0.6, 0.9))
        >>> GradedMedium(depth=2, albedo=0.9, phase=["isotropic", "rayleigh", "rayleigh"], at=[0, 0.1, 1])
        GradedMedium(depth=2.0, albedo=0.9, phase=(Isotropic(), Rayleigh(), Rayleigh()), at=(0.0, 0.1, 1.0))
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
    albedo: Annotated[float | tuple[float, ...], Profile()]
    phase: Annotated[
        Phase | tuple[Phase, ...],
        Phases(
            PHASES, "phase function", meaning="how the medium scatters into directions, from top to bottom"
        ),
    ] = Isotropic()
    at: Annotated[tuple[float, ...] | None, Heights()] = None

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Something varies, and there are as many of everything."""
        lists = {name: values[name] for name in ("albedo", "phase", "at") if isinstance(values[name], tuple)}
        if not lists.keys() & {"albedo", "phase"}:
            raise MaterialError(
                f"found {shown(values['albedo'])} and one phase function, which vary nowhere: that is a medium; "
                f"allowed: {cls.rules()['albedo'].allowed()}, a list for it or for phase",
                where="albedo",
            )
        (first, given), *others = lists.items()
        for name, other in others:
            if len(other) != len(given):
                raise MaterialError(
                    f"found {len(other)} values, where {first} has {len(given)}; allowed: as many", where=name
                )

    @property
    def optical_depth(self) -> float:
        """The same as `depth`."""
        return self.depth

    @property
    def heights(self) -> tuple[float, ...]:
        """(K,) where it is described: shares of the optical depth, from 0 (the top) to 1."""
        if self.at is not None:
            return self.at
        many = self.albedo if isinstance(self.albedo, tuple) else self.phase
        assert isinstance(many, tuple)
        return tuple(k / (len(many) - 1) for k in range(len(many)))

    @property
    def scatterers(self) -> list[tuple[Phase, tuple[float, ...]]]:
        """Each different phase function, and what it scatters at `heights`: its albedo, 0 where another one is."""
        count = len(self.heights)
        albedos = self.albedo if isinstance(self.albedo, tuple) else (self.albedo,) * count
        phases = self.phase if isinstance(self.phase, tuple) else (self.phase,) * count
        different: list[Phase] = []
        for phase in phases:
            if phase not in different:
                different.append(phase)
        return [
            (one, tuple(a if phase == one else 0.0 for a, phase in zip(albedos, phases, strict=True)))
            for one in different
        ]

    @property
    def mean_albedos(self) -> list[float]:
        """That of each of the `scatterers`, averaged over the optical depth."""
        thick = [below - above for above, below in pairwise(self.heights)]
        return [
            sum(0.5 * (a + b) * d for (a, b), d in zip(pairwise(albedos), thick, strict=True))
            for _, albedos in self.scatterers
        ]

    @property
    def mean_albedo(self) -> float:
        """The albedo, averaged over the optical depth."""
        return min(sum(self.mean_albedos), 1.0)  # no more, by rounding

    @property
    def shares(self) -> list[float]:
        """What each of the `scatterers` has of all that is scattered; equal shares of nothing."""
        means = self.mean_albedos
        whole = sum(means)
        return [mean / whole if whole else 1 / len(means) for mean in means]


LAYERS[GradedMedium.kind] = GradedMedium
