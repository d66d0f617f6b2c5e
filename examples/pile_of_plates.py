"""Stokes' pile of plates (1862): glass plates one on another, in closed form, by the adding algebra, and as stacks."""

from __future__ import annotations

import numpy as np
from gallery import directions, fresnel, run, style, titled

import urushi as ur
from urushi.adding import Slab, pile

ANGLES, INDEX, DEPTH, M = (0, 60, 75), 1.5, 0.03, np.arange(31)
TOP, DYE, BOTTOM = ur.Dielectric(ior=INDEX), ur.Medium(depth=DEPTH, albedo=0.0), ur.Dielectric(ior=1.0)


def stokes(degrees: float, depth: float = 0.0) -> np.ndarray:
    """Reflected, absorbed and transmitted by `M` plates: Fresnel, Beer's law in one plate, and then his closed form."""
    sin = np.sin(np.radians(degrees))
    face, passed = fresnel(np.sqrt(1 - sin**2), INDEX), np.exp(-depth / np.sqrt(1 - (sin / INDEX) ** 2))
    t = passed * (1 - face) ** 2 / (1 - (face * passed) ** 2)
    r = face * (1 + passed * t)
    if depth == 0:
        return np.array([M * r, 0 * M, 1 - r + 0 * M]) / (1 + (M - 1) * r)
    a, b = np.arccosh((1 + r**2 - t**2) / (2 * r)), np.arccosh((1 + t**2 - r**2) / (2 * t))
    whole = np.sinh(a + M * b)
    return np.array([np.sinh(M * b), whole - np.sinh(M * b) - np.sinh(a), np.sinh(a) + 0 * M]) / whole


def draw(quick: bool) -> style.Figure:
    figure = style.figure(9, 4)
    clear, tinted = figure.subplots(1, 2)
    exact, dyed, off, noise = np.array([stokes(angle) for angle in ANGLES]), stokes(0, DEPTH), 0.0, 0.0
    for i in range(3):
        look = {"color": style.LINES[i], "ls": style.DASHES[i]}
        added = np.array([pile(Slab(*exact[i, [0, 2, 0, 2], 1]), m).r_top for m in M[1:]])
        off = max(off, np.abs(added - exact[i, 0, 1:]).max())
        clear.plot(M, exact[i, 0], label=f"Stokes, {ANGLES[i]}°", **look)
        clear.plot(M[1:], added, ".", color=style.LINES[i], ms=4)
        tinted.plot(M, dyed[i], label=("reflected", "absorbed", "transmitted")[i], **look)
    for m in (1, 4) if quick else (1, 2, 4, 7, 12, 20, 30):
        walk = ur.solve(ur.Stack(layers=[TOP, BOTTOM] * m), "walk", samples=1 << (11 if quick else 15))
        value, error = (x[:, 0] for x in walk.reflectance(directions(ANGLES), with_error=True))
        noise = max(noise, (np.abs(value - exact[:, 0, m]) / error).max())
        clear.errorbar([m] * 3, value, 2 * error, fmt="none", ecolor=style.INK, capsize=3)
        found = ur.solve(ur.Stack(layers=[TOP, DYE, BOTTOM] * m), "adding").absorption(directions(0))
        three = [x[0, 0] for x in (found.reflected, found.absorbed.sum(axis=0), found.transmitted)]
        off = max(off, np.abs(three - dyed[:, m]).max())
        for i in range(3):
            tinted.plot(m, three[i], "o", color=style.LINES[i], mfc="white", ms=6)
    clear.set_title("reflected by clear glass (bars: ± 2 errors of the walk)")
    tinted.set_title(f"tinted glass, optical depth {DEPTH}, at 0° (circles: adding)")
    for axes in (clear, tinted):
        axes.set(xlabel="number of plates", ylabel="share of the light", ylim=(0, 1.02))
        axes.legend()
    return titled(figure, f"Plates: adding is off Stokes by {off:.0e}, the walk by {noise:.1f} of its errors")


if __name__ == "__main__":
    run(draw)
