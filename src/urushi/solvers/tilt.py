"""Middle directions in a stack whose interfaces have normals of their own: where the centre of every lobe points.

A single ray is followed down through the stack, is mirrored at one interface, and comes back up through those above;
each bends it about its own normal. What is reflected back and forth before it leaves goes elsewhere, and is not here.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from ..interfaces import Interface
from ..interfaces.tilted import Tilted
from ..optics.vectors import Array, Vector, at_least, mirror, reflect, refract
from .bound import BoundStack
from .smooth import snell

#: lowest cosine of an axis: two directions at the horizon have no half-way vector
LOWEST = 1e-4


@dataclass
class Ways:
    """What light from one side meets and where it goes.

    Attributes:
        axes: by interface, the direction that the macroscopic surface would have to be seen from to mirror light to
            where this interface sends it; z > 0.
        through: likewise of what gets through (z > 0; the lobe lies on the other side); None below an opaque base.
        cosines: by interface, the cosine of incidence to its own normal.
    """

    axes: list[Vector]
    through: Vector | None
    cosines: list[Array]


def ways(stack: BoundStack, wi: Vector, above: bool) -> Ways:
    """Follow the middle of the light from wi, on the side `above` (the sign of wi.z is not looked at)."""
    last = len(stack.interfaces) - 1
    order = list(range(last + 1)) if above else list(range(last, -1, -1))
    w = type(wi)(wi.x, wi.y, at_least(dr.abs(wi.z), 1e-6))
    axes: dict[int, Vector] = {}
    cosines: dict[int, Array] = {}
    passed: list[int] = []
    for k in order:
        interface = stack.interfaces[k]
        cosines[k] = _normal(interface, w, above)[1]
        up = _mirrored(interface, w, above)
        for j in reversed(passed):
            up = mirror(crossed(stack.interfaces[j], mirror(-up), not above))
        axes[k] = _axis(up)
        if interface.opaque:
            return Ways([axes[i] for i in range(last + 1)], None, [cosines[i] for i in range(last + 1)])
        w = -crossed(interface, w, above)
        passed.append(k)
    down = -w
    numbers = range(last + 1)
    return Ways([axes[i] for i in numbers], _axis(down), [cosines[i] for i in numbers])


def _axis(o: Vector) -> Vector:
    return dr.normalize(type(o)(-o.x, -o.y, at_least(dr.abs(o.z), LOWEST)))


def _normal(interface: Interface, w: Vector, above: bool) -> tuple[Vector, Array]:
    """`w` in the frame of the interface's normal, and its cosine."""
    met = interface.met(w, above) if isinstance(interface, Tilted) else w
    return met, at_least(met.z, 1e-6)


def _outwards(interface: Interface, raw: Vector, above: bool, through: bool) -> Vector:
    """From the frame of the normal to that of the surface, folded to the right side."""
    o = interface.leave(raw, above) if isinstance(interface, Tilted) else raw
    z = dr.abs(o.z)
    return type(o)(o.x, o.y, -z if through else z)


def _mirrored(interface: Interface, w: Vector, above: bool) -> Vector:
    met, _ = _normal(interface, w, above)
    return _outwards(interface, reflect(met, type(w)(0, 0, 1)), above, False)


def crossed(interface: Interface, w: Vector, above: bool) -> Vector:
    """Snell's direction beyond, away from the surface (z < 0); along the interface where all is reflected."""
    met, cos = _normal(interface, w, above)
    eta = interface.ratio(above)
    raw = refract(met, type(w)(0, 0, 1), cos, snell(met, 1 / eta), 1 / eta)
    return dr.normalize(_outwards(interface, raw, above, True))
