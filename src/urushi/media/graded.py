"""A slab whose albedo varies with depth, linear between equal steps of the optical depth.

It has its numbers only: light does not fly through it, it is solved whole (method adding).
"""

from __future__ import annotations

from typing import Any, NoReturn

from ..errors import UnsupportedStack
from ..optics.phase import PHASE_FUNCTIONS
from ..optics.vectors import Array
from .homogeneous import BoundMedium


class BoundGraded(BoundMedium):
    """A slab with its numbers; `albedo` is the mean over the optical depth.

    Args:
        depth: optical depth of all of it, >= 0.
        albedos: at equal steps of the optical depth, from the top, two or more.
        mean: of them over the optical depth.
        phase: a bound phase function of `optics.phase`.
    """

    def __init__(self, depth: Array, albedos: tuple[float, ...], mean: float, phase: Any) -> None:
        super().__init__(depth, mean, phase, scatters=any(albedos))
        self.albedos = albedos

    @classmethod
    def bind(cls, given: Any) -> BoundGraded:
        """The medium of a described layer (`interfaces.given.Given`)."""
        layer = given.layer
        phase = PHASE_FUNCTIONS[layer.phase.kind](**given.phase_parameters())
        return cls(given["depth"], layer.albedo, layer.mean_albedo, phase)

    def fly(self, *_given: Any) -> NoReturn:
        """Refuse: see the module docstring."""
        raise UnsupportedStack("walk", ["a graded medium cannot be flown through"], ["adding"])
