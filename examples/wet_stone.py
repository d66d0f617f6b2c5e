"""Why wet stone is darker: a film of water on top, water in the pores, and both (Jensen, Legakis & Dorsey 1999)."""

from __future__ import annotations

import numpy as np
from gallery import coated, directions, evenly, fresnel, inside, labelled, run, style, titled

import urushi as ur
from urushi.plot.colour import code

WATER, DRY, WET, SAND = 1.333, 0.3, 0.9, (0.46, 0.35, 0.23)  # DRY, WET: mean cosine of scattering by grains
ROWS = {"dry": (DRY, 0, "o-", style.FAINT), "film on top": (DRY, 1, "o--", style.BLUE)}
ROWS |= {"water inside": (WET, 0, "o", style.GREEN), "both": (WET, 1, "o-.", style.VERMILION)}


def thick(albedo: np.ndarray, g: float) -> np.ndarray:
    """Van de Hulst's (1980) fit: what an endless medium reflects of light that comes evenly from everywhere."""
    s = np.sqrt((1 - albedo) / (1 - albedo * g))
    return np.asarray((1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s))


def grains(albedo: np.ndarray, g: float, films: int, accuracy: float) -> np.ndarray:
    """The same by adding, for many albedos at once, perhaps under a film whose own reflection is left out."""
    medium = ur.Medium(depth=3000.0, albedo=0.5, phase=ur.HenyeyGreenstein(g=g))
    stack = ur.Stack(layers=[*[ur.Dielectric(ior=WATER)] * films, medium, ur.Diffuse(reflectance=0.0)])
    given = {f"layer_{films}.albedo": albedo}
    return evenly(ur.solve(stack, "adding", accuracy=accuracy, parameters=given)) - films * inside(WATER)[0]


def draw(quick: bool) -> style.Figure:
    figure, accuracy = style.figure(10, 4.2), 1e-2 if quick else 1e-3
    film, pores, colours = figure.subplots(1, 3, width_ratios=(1, 1, 0.5))
    fine, rho = 1 - np.logspace(-6, 0, 2000), np.linspace(0, 1, 5 if quick else 11)
    line = thick(fine, DRY)  # the dry reflectance that these albedos make
    stack = ur.Stack(layers=[ur.Dielectric(ior=WATER), ur.Diffuse(reflectance=0.5)])
    solved = ur.solve(stack, "adding", parameters={"layer_1.reflectance": rho})
    dots = solved.reflectance(directions(0))[0] - fresnel(1, WATER)
    film.plot(line, coated(line, WATER), color=style.BLUE, label="Lekner & Dorf 1988")
    film.plot(rho, dots, "o", mfc="white", color=style.BLUE, label="adding", clip_on=False)
    off, kept = [np.abs(dots - coated(rho, WATER)).max()], []
    pores.plot(line, thick(fine, WET), color=style.GREEN, label="van de Hulst 1980")
    albedo = np.interp(dry := np.concatenate([rho[1:-1], SAND]), line[::-1], fine[::-1])
    for row, (name, (g, films, look, colour)) in enumerate(ROWS.items()):
        seen = grains(albedo, g, films, accuracy)
        off.append(0.0 if films else np.abs(thick(albedo, g) - seen).max())
        kept.append(np.mean(seen[-3:]) / np.mean(SAND))
        pores.plot(dry[:-3], seen[:-3], look, color=colour, mfc="white", label=f"{name}, adding")
        colours.plot(0, -row, "s", ms=44, color=code(seen[-3:]))
        colours.text(0.5, -row, f"{name}\n{kept[-1]:.0%} of dry", va="center")
    colours.set(xlim=(-0.5, 1.8), ylim=(-3.6, 0.6), title="buff sandstone")
    colours.axis("off")
    for axes, title in ((film, "film on a diffuse base, at 0°"), (pores, "thick grains, diffuse light")):
        axes.plot(line, line, color=style.FAINT, lw=0.8)
        labelled(axes, title, "reflectance dry", "wet, without the highlight", xlim=(0, 1), ylim=(0, 1))
    text = f"Wet stone: a film leaves {kept[1]:.0%} of what sandstone reflects, water inside {kept[2]:.0%}"
    return titled(figure, text, f"Closed forms and adding differ by at most {max(off):.0e}")


if __name__ == "__main__":
    run(draw)
