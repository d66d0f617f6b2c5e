"""Which method when: error against time, for 100 000 evaluations of one material, from nothing to the values."""

from __future__ import annotations

import time

import numpy as np
from gallery import labelled, run, style, titled

import urushi as ur

GIVEN = {"walk": [{"samples": 4**k} for k in range(6)]}
GIVEN |= {"adding": [{"accuracy": x} for x in (0.1, 0.01, 0.001, 0.0001)], "lobes": [{}]}
LOOKS = {"walk": (style.BLUE, "o-"), "adding": (style.VERMILION, "s--"), "lobes": (style.GREEN, "D")}
LABELS = {"walk": "walk, by samples", "adding": "adding, by accuracy", "lobes": "lobes"}
MATERIALS = {"coat over diffuse": "preset:plastic", "coat, medium, gold": "preset:enamel"}


def pairs(count: int) -> np.ndarray:
    """(2, count, 3) directions that come and go, evenly over the projected hemisphere."""
    u = np.random.default_rng(1).random((2, count, 2))
    r, phi = np.sqrt(0.98 * u[..., 0]), 2 * np.pi * u[..., 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - r**2)], axis=-1)


def timed(stack: ur.Stack, method: str, given: dict[str, float], w: np.ndarray, truth: np.ndarray) -> list:
    """Processor seconds to solve and evaluate (what is compiled once for all is not counted), and the error."""
    ur.solve(stack, method, **given).eval(*(w[:, :2] if method == "walk" else w))
    spent: list[float] = []
    while len(spent) < 5 and sum(spent) < 1:  # the least of what is short
        start = time.process_time()
        values = ur.solve(stack, method, **given).eval(*w)
        spent.append(time.process_time() - start)
    return [min(spent), np.linalg.norm(values - truth) / np.linalg.norm(truth)]


def draw(quick: bool) -> style.Figure:
    figure, said, w = style.figure(10, 4.6), [], pairs(1000 if quick else 100_000)
    for axes, (name, preset) in zip(figure.subplots(1, 2, sharey=True), MATERIALS.items(), strict=True):
        stack, found = ur.load(preset), {}
        truth = ur.solve(stack, "adding", accuracy=1e-3 if quick else 1e-5).eval(*w)
        for method, (colour, look) in LOOKS.items():
            options = GIVEN[method][: 2 if quick else 9]
            found[method] = np.array([timed(stack, method, given, w, truth) for given in options]).T
            axes.loglog(*found[method], look, color=colour, mfc="white", label=LABELS[method])
            for given, at in zip(options, found[method].T, strict=True):
                x, y, side = (-6, -11, "right") if given == {"accuracy": 0.01} else (5, 4, "left")
                text = " ".join(map(str, given.values()))
                axes.annotate(text, at, (x, y), textcoords="offset points", color=colour, ha=side)
        walk = found["walk"][0, -1] * (found["walk"][1, -1] / 0.01) ** 2
        said += [found["adding"][0, np.argmax(found["adding"][1] <= 0.01)], walk, found["lobes"][1, 0]]
        labelled(axes, name, "processor seconds: solving, and all values", "error (rms, of the rms value)")
    text = "Within 1%: adding in {0:.2g} s and {3:.2g} s, the walk in {1:.2g} s and {4:.2g} s"
    text += "; lobes is off by {2:.1%} and {5:.1%}"
    below = f"{w.shape[1]:,} pairs of directions; a renderer asks once for each ray: there one sample is best"
    return titled(figure, text.format(*said), below)


if __name__ == "__main__":
    run(draw)
