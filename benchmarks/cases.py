"""The three stacks that are measured, and what pbrt-v4 needs for the same.

pbrt's figures: `LayeredBxDF` of pbrt-v4, commit 5f7a6068, GCC 12 -O3 -march=native, one core of a Xeon at 2.5 GHz
with AVX-512. Its case (a) has an absorbing slab of depth 0.01 between coat and base, since it cannot do without one;
ours has nothing there. Nanoseconds of two machines do not compare; yardsticks do (see `clock`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Case:
    """One stack and its goal.

    Attributes:
        label: one letter, as in the tables.
        words: what it is.
        goal: yardsticks that one evaluation may take.
        pbrt_ns, pbrt_yardsticks: cost of one f() call of pbrt.
        pbrt_noise: relative standard deviation of one f() call, in the order of `ROWS`.
    """

    label: str
    words: str
    goal: float
    pbrt_ns: float
    pbrt_yardsticks: float
    pbrt_noise: tuple[float, ...]

    def stack(self) -> Any:
        """The description."""
        import urushi as ur

        coat = ur.Dielectric(ior=1.5, alpha=0.1)
        base = ur.Diffuse(reflectance=0.5)
        if self.label == "b":
            medium = ur.Medium(depth=0.5, albedo=0.7, phase=ur.HenyeyGreenstein(g=0.5))
            return ur.Stack(name=self.words, layers=[coat, medium, base])
        if self.label == "c":
            base = ur.Conductor(eta=0.2, k=3.9, alpha=0.2)
        return ur.Stack(name=self.words, layers=[coat, base])


CASES = (
    Case("a", "coat over diffuse 0.5", 7, 1222, 90, (0.105, 0.082, 0.49, 0.55, 0.57, 0.96)),
    Case("b", "coat, medium, diffuse 0.5", 12, 1204, 89, (0.105, 0.081, 0.73, 0.87, 0.78, 1.30)),
    Case("c", "coat over rough metal", 12, 2103, 156, (0.236, 0.244, 0.76, 3.5, 1.27, 4.1)),
)

ROWS = ((0, 0, 0), (30, 30, 180), (30, 30, 0), (60, 60, 0), (75, 30, 180), (85, 5, 90))
"""(theta_i, theta_o, phi) in degrees; phi = 180 is the side of the mirror direction."""
