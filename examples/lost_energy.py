"""What rough surfaces lose when light meets one facet only, and what scattering between the facets gives back."""

from __future__ import annotations

import numpy as np
from gallery import directions, run, style, titled

import urushi as ur

KINDS = {"one facet only": False, "compensated": "compensated", "walk among facets": "walk"}
COLOURS = {"red": style.VERMILION, "green": style.GREEN, "blue": style.BLUE}
ANGLES = {"0°": style.BLACK, "75°": style.PURPLE}


def material(what: str, alpha: float, again: object) -> ur.Stack:
    """A mirror, gold, or a white base under a coat; `again` is its `multiple_scattering`."""
    rough = {"alpha": alpha, "multiple_scattering": again}
    if what == "coat over white":
        return ur.Stack(layers=[ur.Dielectric(ior=1.5, **rough), ur.Diffuse(reflectance=1.0)])
    metal = {"material": "Au"} if what == "gold" else {"eta": 0.0, "k": 1.0}
    return ur.Stack(layers=[ur.Conductor(**metal, **rough)])


def draw(quick: bool) -> style.Figure:
    alphas, missing = np.linspace(0.1, 1.0, 3 if quick else 10), {}
    figure = style.figure(9.5, 4.2)
    panels = figure.subplots(1, 3, sharey=True)
    for axes, what in zip(panels, ("mirror", "coat over white", "gold"), strict=True):
        for again, dash in zip(KINDS.values(), style.DASHES, strict=False):
            stacks = [material(what, alpha, again) for alpha in alphas]
            solved = [ur.solve(stack, "walk", samples=1 << (9 if quick else 14)) for stack in stacks]
            shown = np.array([bsdf.reflectance(directions([0, 75])) for bsdf in solved])
            missing[what, again] = 1 - shown[-1, 0, 0]
            for j, (word, colour) in enumerate((COLOURS if what == "gold" else ANGLES).items()):
                values = shown[:, 0, j] if what == "gold" else shown[:, j, 0]
                axes.plot(alphas, values, color=colour, ls=dash)
                if not again:
                    axes.text(1.02, values[-1], word, color=colour, va="center")
        axes.set(xlabel="roughness alpha (GGX)", title=what + (", at 0°" if what == "gold" else ""))
    for name, dash in zip(KINDS, style.DASHES, strict=False):
        panels[0].plot([], [], color=style.FAINT, ls=dash, label=name)
    panels[0].set(ylabel="reflected share of the light", ylim=(0, 1.05))
    panels[0].legend(loc="lower left")
    once, coat = missing["mirror", False], missing["coat over white", False]
    other = max(abs(part) for (what, again), part in missing.items() if again and what != "gold")
    text = f"One facet only loses {once:.0%} of a mirror's light at alpha 1 and 0°, and {coat:.0%} over white"
    return titled(figure, text, f"With light that meets several facets, at most {other:.1%} is missing there")


if __name__ == "__main__":
    run(draw)
