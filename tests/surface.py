"""Questions to an interface, numpy in and out, and the laws that any interface keeps."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np

from chi2 import SIGNIFICANCE, counted, p_value, rectangles, strata
from lanes import DOUBLE, SINGLE, Lanes, back, direction
from quadrature import sphere
from urushi.interfaces import Interface
from urushi.interfaces.base import Part


@dataclass(frozen=True)
class Events:
    """Sampled events; see `urushi.interfaces.Scatter`."""

    o: np.ndarray
    weight: np.ndarray
    pdf: np.ndarray
    through: np.ndarray


def spread(w: np.ndarray, n: int) -> np.ndarray:
    """One direction for n lanes."""
    return np.ascontiguousarray(np.broadcast_to(w, (n, 3)))


def evaluate(
    lanes: Lanes, interface: Interface, w: np.ndarray, o: np.ndarray, above: bool = True, part: Part = "both"
) -> tuple[np.ndarray, np.ndarray]:
    """Flux density and pdf for all lanes, reflected or transmitted as the sign of o.z says."""
    n = max(len(w), len(o))
    w, o = spread(w, n) if len(w) == 1 else w, spread(o, n) if len(o) == 1 else o
    one, other = lanes.vectors(w), lanes.vectors(o)
    both = interface.reflect(one, other, above, part), interface.transmit(one, other, above, part)
    dr.eval(both)  # one kernel for all of it
    reflected, transmitted = ([back(x) for x in found] for found in both)
    chosen = []
    for r, t in zip(reflected, transmitted, strict=True):
        r, t = (x[:, None] if x.ndim == 1 else x for x in (r, t))
        value = np.where(o[:, 2:] > 0, 0 if part == "transmit" else r, 0 if part == "reflect" else t)
        chosen.append(value[:, 0] if value.shape[1] == 1 else value)
    return chosen[0], chosen[1]


def sample(
    lanes: Lanes, interface: Interface, w: np.ndarray, u: np.ndarray, above: bool = True, part: Part = "both"
) -> Events:
    """Events for numbers u (N, 3)."""
    n = len(u)
    numbers = (lanes(u[:, 0]), lanes(u[:, 1]), lanes(u[:, 2]))
    event = interface.sample(lanes.vectors(spread(w, n) if w.shape != (n, 3) else w), numbers, above, part)
    dr.eval(event.o, event.weight, event.pdf, event.through)
    through = np.broadcast_to(np.array(event.through, bool), n)
    weight = back(event.weight)
    return Events(back(event.o), weight, np.broadcast_to(back(event.pdf), n), through)


def numbers(rng: np.random.Generator, side: int) -> np.ndarray:
    """Three numbers per lane, the last two stratified."""
    u = strata(rng, side)
    return np.column_stack([SINGLE.rounded(rng.random(len(u)) * (1 - 2.0**-23)), u])


def check_weights(
    lanes: Lanes, interface: Interface, w: np.ndarray, u: np.ndarray, above: bool, part: Part, rtol: float
) -> None:
    """weight = value / pdf in the sampled direction, and the density is the one evaluated."""
    found = sample(lanes, interface, w, u, above, part)
    colourless = found.weight if found.weight.ndim == 1 else found.weight.max(axis=1)
    alive = colourless > 0
    assert np.mean(alive) > 0.02
    assert np.all(np.where(found.through, found.o[:, 2] < 0, found.o[:, 2] > 0)[alive])
    value, pdf = evaluate(lanes, interface, w, found.o, above, part)
    pdf_there = found.pdf if found.weight.ndim == 1 else found.pdf[:, None]
    # A facet seen edge on, and a direction in the surface, leave no digits to compare.
    sure = alive & (np.abs(found.o[:, 2]) > 1e-3)
    assert np.allclose(pdf[sure], found.pdf[sure], rtol=rtol)
    assert np.allclose(value[sure], (found.weight * pdf_there)[sure], rtol=rtol)


def check_samples(
    single: Interface, double: Interface, w: np.ndarray, rng: np.random.Generator, above: bool, part: Part
) -> None:
    """Chi² of samples in single precision against the density in double precision; void samples count as a cell."""
    u = numbers(rng, 400)
    found = sample(SINGLE, single, w, u, above, part)
    colourless = found.weight if found.weight.ndim == 1 else found.weight.max(axis=1)
    void = ~np.where(found.through, found.o[:, 2] < 0, found.o[:, 2] > 0) | (colourless <= 0)
    theta, phi = (0.0, np.pi, 24), (-np.pi, np.pi, 36)

    def density(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return evaluate(DOUBLE, double, w[None], direction(np.cos(theta), phi), above, part)[1] * np.sin(
            theta
        )

    expected = rectangles(density, theta, phi, 20 if part == "reflect" else 30)
    assert expected.sum() < 1 + 1e-3
    o = found.o[~void]
    counts = counted(np.arccos(np.clip(o[:, 2], -1, 1)), np.arctan2(o[:, 1], o[:, 0]), theta, phi)
    assert np.isclose(counts.sum() / len(u), expected.sum(), atol=3e-3)
    nowhere = max(0.0, 1 - expected.sum())
    expected = np.append(expected, nowhere) * len(u)
    assert p_value(np.append(counts, void.sum()), expected * len(u) / expected.sum()) > SIGNIFICANCE


def albedo(interface: Interface, w: np.ndarray, above: bool = True, part: Part = "both") -> np.ndarray:
    """Directional-hemispherical reflectance plus transmittance, by quadrature in double precision."""
    total = 0.0
    for low, high in ((-1.0, 0.0), (0.0, 1.0)):
        o, weight = sphere(160, 256, low, high)
        total = total + evaluate(DOUBLE, interface, w[None], o, above, part)[0].T @ weight
    return np.asarray(total)
