"""What a clear coat does to the colour under it: light that cannot get out meets the colour again, and again."""

from __future__ import annotations

import numpy as np
from gallery import coated, directions, fresnel, inside, labelled, run, style, titled
from matplotlib.patches import Rectangle

import urushi as ur
from urushi.plot.colour import code

INDEX, COLOUR = 1.5, np.array([0.80, 0.45, 0.12])
FACE, BACK = float(fresnel(1, INDEX)), inside(INDEX)[1]


def plastic(rho: float, nonlinear: bool) -> float:
    """Hemispherical reflectance at 0° of Mitsuba's smooth `plastic` without its highlight, by quadrature of `eval`."""
    import mitsuba as mi  # after `urushi` has found an LLVM

    mi.set_variant("scalar_rgb")
    base = {"type": "rgb", "value": [float(rho)] * 3}
    scene = {"type": "plastic", "int_ior": INDEX, "nonlinear": nonlinear, "diffuse_reflectance": base}
    bsdf, found, si = mi.load_dict(scene), 0.0, mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0, 0, 1)
    for x, weight in zip(*np.polynomial.legendre.leggauss(32), strict=True):
        wo = mi.Vector3f(np.sqrt(1 - (0.5 * (x + 1)) ** 2), 0, 0.5 * (x + 1))
        found += np.pi * weight * bsdf.eval(mi.BSDFContext(), si, wo)[0]
    return found


def draw(quick: bool) -> style.Figure:
    rho = np.linspace(0, 1, 5 if quick else 21)
    stacks = [ur.Stack(layers=[ur.Dielectric(ior=INDEX), ur.Diffuse(reflectance=x)]) for x in rho]
    layered = np.array([ur.solve(s, "adding").reflectance(directions(0))[0, 0] for s in stacks]) - FACE
    linear, nonlinear = (np.array([plastic(x, how) for x in rho]) for how in (False, True))
    figure = style.figure(9, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    left.plot(rho, rho, label="diffuse + specular lobe", color=style.FAINT, ls=style.DASHES[4])
    left.plot(rho, linear, label="plastic, nonlinear = false", color=style.VERMILION, ls=style.DASHES[1])
    left.plot(rho, nonlinear, label="plastic, nonlinear = true", color=style.GREEN)
    left.plot(rho, layered, "o", mfc="white", color=style.BLUE, label="Urushi: coat over diffuse")
    labelled(left, "under a smooth coat of index 1.5", "albedo", "reflected at 0°, without the highlight")
    raised = COLOUR / (1 - FACE) / (1 - BACK + COLOUR / (1 - FACE) * BACK)  # what gives COLOUR under the coat
    bases = {"no coat": COLOUR, "albedo as it was": COLOUR, "albedo raised": raised}
    for row, (name, base) in enumerate(bases.items()):
        seen = base if row == 0 else coated(base, INDEX)
        right.add_patch(Rectangle((0, -row), 1, 0.9, color=code(seen)))
        albedo, shown = (", ".join(f"{x:.2f}" for x in values) for values in (base, seen))
        right.text(1.06, 0.45 - row, f"{name}\nalbedo {albedo}\nseen {shown}", va="center")
    right.set(xlim=(0, 2.3), ylim=(-2.1, 1), title="the same colour under the coat")
    right.axis("off")
    near, far = np.abs(layered - nonlinear).max(), np.abs(layered - linear).max()
    text = f"Colour shift: Mitsuba's nonlinear plastic is within {near:.0e} of Urushi, the linear one off by {far:.2f}"
    half = (1 - 0.8 * BACK) / (2 - 0.8 * BACK)  # of what 0.8 shows, 0.4 does
    below = f"Halve an albedo of 0.8, and {half:.0%} of its light is left, not 50%: coats darken and saturate"
    return titled(figure, text, below)


if __name__ == "__main__":
    run(draw)
