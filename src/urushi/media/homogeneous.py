"""A homogeneous, absorbing and scattering slab.

A position is `t`: 0 at the top of the slab, 1 at its bottom. Optical depths are along the normal, so a path under the
cosine mu sees depth / mu.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..optics.exponential import decay, minus_log
from ..optics.phase import PHASE_FUNCTIONS
from ..optics.vectors import Array, Vector, at_least, at_most, channels, total

#: mean cosines up to which a phase function counts as flat: nowhere more than 6 times its mean
FLAT = 0.5

#: the smallest cosine told from 0
GRAZING = 1e-9


def inverse_cosine(cos: Array) -> Array:
    """1 / |cos|, finite at grazing angles."""
    return dr.rcp(at_least(dr.abs(cos), GRAZING))


def entry_height(w: Vector) -> Array:
    """Where light that travels along w enters a slab: 0 from the top, 1 from the bottom."""
    return dr.select(w.z < 0, 0 * w.z, 1 + 0 * w.z)


@dataclass
class Flight:
    """One sampled crossing of (a part of) a slab.

    Attributes:
        collided: mask of the lanes that meet a particle before the boundary.
        t: where they do; on every lane, a fair place of a collision.
        weight: throughput of what was chosen, the single-scattering albedo included.
        scattered: what all collisions on the way carry together, divided by the density of `t`.
    """

    collided: Any
    t: Array
    weight: Array
    scattered: Array


class BoundMedium:
    """A slab with its numbers.

    Args:
        depth: optical depth; a number or a colour, one or one per lane, >= 0.
        albedo: single-scattering albedo in [0, 1]; likewise.
        phase: a bound phase function of `optics.phase`.
        scatters: False where the albedo is known to be 0 everywhere, which spares the work.
    """

    #: exp(-x); whoever wants derivatives puts Dr.Jit's own in its place
    decay: Any = staticmethod(decay)

    def __init__(self, depth: Array, albedo: Array, phase: Any, scatters: bool = True) -> None:
        self.depth = depth
        self.inv_depth = 1 / at_least(depth, 1e-20)
        self.albedo = albedo
        self.phase = phase
        self.scatters = scatters

    @classmethod
    def bind(cls, given: Any) -> BoundMedium:
        """The medium of a described layer (`interfaces.given.Given`)."""
        explicit = f"{given.name}.depth" in given.values
        depth = given["depth"] if explicit else given["thickness"] * given["sigma_t"]
        phase = bound_phase(given.layer.phase.kind, given.phase_parameters(), given.known("phase.g"))
        return cls(depth, given["albedo"], phase, scatters=not given.is_zero("albedo"))

    def phase_at(self, _t: Array) -> Any:
        """The phase function of collisions at a position."""
        return self.phase

    def absorbed(self, gone: Array, _flight: Flight) -> Array:
        """What a flight, on which the share `gone` collides, leaves in the medium."""
        return (1 - self.albedo) * gone

    def transmittance(self, distance: Array, inv_cos: Array) -> Array:
        """What is left after the part `distance` of the thickness, under the cosine 1 / `inv_cos`."""
        return self.decay(self.depth * (distance * inv_cos))

    def fly(self, t: Array, w: Vector, throughput: Array, u1: Array, u2: Array, u3: Array) -> Flight:
        """Choose between crossing to the boundary ahead and a collision on the way.

        The choice is made in proportion to what each would carry, so an absorber only ever attenuates, and the weight
        never exceeds what the slab lets live: theory (walk.4). With coloured depths one channel, picked by what it
        carries, places the collision, and the weight divides by the mixture of all channels.

        Args:
            t: where the flight starts.
            w: its propagation direction.
            throughput: what the path carries, to weigh the channels against one another.
            u1, u2, u3: numbers in [0, 1): crossing or collision, where, by which channel.
        """
        down = w.z < 0
        ahead = dr.select(down, 1 - t, t)
        cos = at_least(dr.abs(w.z), GRAZING)
        depth = self.depth * (ahead * dr.rcp(cos))
        passed = self.decay(depth)
        lost = _one_minus_exp(depth, passed)
        hit = self.albedo * lost
        grey = not channels(depth) and not channels(hit)
        carried, carried_hit = (
            (passed, hit) if grey else (total(throughput * passed), total(throughput * hit))
        )
        collided = u1 * (carried + carried_hit) > carried
        if not channels(depth):
            distance = _invert(depth, lost, u2, self.inv_depth * cos, ahead)
            scattered = hit
        else:
            chances = throughput * hit
            chances = chances / at_least(total(chances), 1e-30)
            chosen, lost_there, inv = 0 * u3, 0 * u3, 0 * u3
            below = 0 * u3
            for c in range(channels(depth)):
                here = u3 >= below
                chosen = dr.select(here, depth[c], chosen)
                lost_there = dr.select(here, lost[c], lost_there)
                inv = dr.select(here, self.inv_depth[c], inv)
                below = below + chances[c]
            distance = _invert(chosen, lost_there, u2, inv * cos, ahead)
            # Densities along the flight: each channel's own exponential, truncated at the boundary.
            density = depth * self.decay(depth * (distance / at_least(ahead, 1e-30)))
            mixture = total(chances * density / at_least(lost, 1e-30))
            # Where nothing can collide that is still there, neither can anything else.
            scattered = dr.select(mixture > 1e-30, self.albedo * density / at_least(mixture, 1e-30), 0)
        if grey:
            weight = passed + hit
        else:
            both = carried + carried_hit
            chosen_share = dr.select(collided, carried_hit, carried)
            weight = dr.select(collided, scattered, passed) * (both / at_least(chosen_share, 1e-30))
        return Flight(
            collided, at_most(at_least(dr.select(down, t + distance, t - distance), 0), 1), weight, scattered
        )


def bound_phase(kind: str, numbers: Mapping[str, Any], known_g: float | None) -> Any:
    """A phase function of `optics.phase`, told to be flat where its mean cosine is known to be small."""
    phase = PHASE_FUNCTIONS[kind](**numbers)
    phase.flat = phase.flat or (known_g is not None and abs(known_g) <= FLAT)
    return phase


def _one_minus_exp(depth: Array, passed: Array) -> Array:
    """1 - exp(-depth), by its series where the difference would cancel."""
    return dr.select(depth < 1e-2, depth * (1 - 0.5 * depth * (1 - depth / 3)), 1 - passed)


def _invert(depth: Array, lost: Array, u: Array, scale: Array, ahead: Array) -> Array:
    """The distance at which an exponential truncated after `ahead` has the cumulative probability u.

    Args:
        depth: optical depth of the flight; lost: 1 - exp(-depth).
        scale: distance of optical depth 1.
    """
    exact = minus_log(at_least(1 - u * lost, 1e-30)) * scale
    return dr.select(depth < 1e-2, ahead * u * (1 - 0.5 * depth * (1 - u)), at_most(exact, ahead))
