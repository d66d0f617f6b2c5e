"""How the widths of lobes add up through a stack (Belcour 2018, section 4; the series in its equations 38, 49 to 51).

All widths are those of the roughness of a mirror that would reflect as wide a lobe at the mean direction of their
region. A projected lobe of GGX has radii in proportion to alpha cos; a flat boundary stretches projected directions
by the index ratio n = n_below / n_above. So a roughness that goes up through a boundary is multiplied by

    j = n cos_below / cos_above

and one that goes down by 1 / j (theory (lobes.5)); `Scale.factor` says what that does to a width. The paper prints,
and its code computes, factors that are the inverse of these in three places; from three interfaces on this shows.
`published=True` does as the code does.
"""

from __future__ import annotations

from ...optics.vectors import Array, at_least
from .width import OURS, Scale, Width, plus


class Spread:
    """Widths of the part of a stack that has been gone through, from the top.

    Attributes:
        down: of light that arrives below.
        back: of light from below that is reflected back down.
        up: of light from below that gets out, without its own; `out` is the factor of its own.
    """

    def __init__(self, scale: Scale = OURS, published: bool = False) -> None:
        self.scale, self.published = scale, published
        self.down: Width = 0.0
        self.back: Width = 0.0
        self.up: Width = 0.0
        self.out: Array = 1.0
        self._in: Array = 1.0

    def lobe(self, reflected: Width, rounds: Array) -> Width:
        """The lobe that the next interface sends out of the stack.

        Args:
            reflected: what the interface adds on reflection.
            rounds: mean number of round trips between it and the stack above.
        """
        return plus(self.up, plus(self.down, reflected, plus(reflected, self.back) * rounds) * self.out)

    def cross(
        self,
        reflected: Width,
        down: Width,
        up: Width,
        j: Array,
        rounds: Array,
        own: Array,
        inner: Array,
    ) -> None:
        """Go through the next layer.

        Args:
            reflected, down, up: what it adds on reflection, and on the way down and up through it.
            j: the factor of the roughness of what goes up through it.
            rounds: as for `lobe`.
            own, inner: energy that comes back from below by its own reflection, and from what lies above.
        """
        j = self.scale.factor(j)
        step = j if self.published else 1 / j
        bounce = plus(reflected, self.back) * rounds
        inside = plus(down, plus(up, self.back, bounce) * step)
        share = 1 / at_least(own + inner, 1e-12)
        self.back = plus(reflected * (own * share), inside * (inner * share))
        self.down = plus(self.down * step, down, bounce * step)
        self.up = plus(self.up, plus(up, bounce) * (self._in if self.published else self.out))
        self.out = self.out * j
        self._in = self._in / j
