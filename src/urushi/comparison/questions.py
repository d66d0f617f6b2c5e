"""What every method is asked: light from a few angles, and for each the directions where its lobe is and is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

#: degrees of the incident light from the normal, above; and below, where light gets there
ABOVE, BELOW = (0.0, 30.0, 60.0, 80.0), (30.0, 60.0)
#: directions spread evenly over a hemisphere, and rings around the mirror or the refracted direction: their radii in
#: degrees, and the directions on each
EVEN, RADII, AROUND = 48, (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0), 8
#: no direction is nearer to the horizon than this cosine: nothing reaches a camera from there
LEAST = 0.03


@dataclass(frozen=True)
class View:
    """Light from one direction.

    Attributes:
        theta: degrees from the normal, on its side.
        phi: degrees of azimuth.
        above: the side.
        wo: (K, 3) directions that are asked.
    """

    theta: float
    phi: float
    above: bool
    wo: np.ndarray

    @property
    def wi(self) -> np.ndarray:
        """(3,)."""
        t, p = np.radians(self.theta), np.radians(self.phi)
        up = 1.0 if self.above else -1.0
        return np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), up * np.cos(t)])

    def called(self) -> str:
        """In words."""
        turn = f", azimuth {self.phi:g}°" if self.phi else ""
        return f"{self.theta:g}°{turn}{'' if self.above else ' from below'}"


def views(stack: Any) -> list[View]:
    """The questions for a stack: from below only where it transmits, from two azimuths only where it has a grain."""
    brushed = any(
        isinstance(getattr(layer, "alpha", 0.0), tuple) or getattr(layer, "normal", None) is not None
        for layer in stack.layers
    )
    opaque = bool(stack.layers[-1].opaque)
    indices = [layer.ior for layer in stack.layers if layer.kind == "dielectric"]
    below = stack.exterior if opaque or not indices else float(indices[-1])
    found = []
    for phi in (20.0, 110.0) if brushed else (0.0,):
        for above, thetas in ((True, ABOVE), (False, () if opaque else BELOW)):
            for theta in thetas:
                ratio = stack.exterior / below if above else below / stack.exterior
                found.append(View(theta, phi, above, _leaving(theta, phi, above, opaque, ratio)))
    return found


def _leaving(theta: float, phi: float, above: bool, opaque: bool, ratio: float) -> np.ndarray:
    up = 1.0 if above else -1.0
    sides = [_hemisphere(theta, phi, up)]
    if not opaque:
        sine = min(ratio * np.sin(np.radians(theta)), 0.999)
        sides.append(_hemisphere(float(np.degrees(np.arcsin(sine))), phi, -up))
    return np.concatenate(sides)


def _hemisphere(theta: float, phi: float, up: float) -> np.ndarray:
    """Directions on one side: even ones, and rings around the one that continues light from azimuth phi."""
    k = np.arange(EVEN)
    cos = 1 - (k + 0.5) / EVEN * (1 - LEAST)
    turn = k * np.pi * (3 - np.sqrt(5))
    sin = np.sqrt(1 - cos**2)
    even = np.stack([sin * np.cos(turn), sin * np.sin(turn), cos], axis=1)
    t, p = np.radians(theta), np.radians(phi) + np.pi
    axis = np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    side = np.array([-np.sin(p), np.cos(p), 0.0])
    other = np.cross(axis, side)
    rings = [axis[None]]
    for radius in np.radians(RADII[1:]):
        a = 2 * np.pi * np.arange(AROUND)[:, None] / AROUND
        rings.append(np.cos(radius) * axis + np.sin(radius) * (np.cos(a) * side + np.sin(a) * other))
    every = np.concatenate([even, *rings])
    every = every[every[:, 2] > LEAST]
    return every * (1, 1, up)
