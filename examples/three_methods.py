"""Lobes, walk and adding on the families of materials of Jakob et al. 2014 and Belcour 2018: how far lobes is off."""

from __future__ import annotations

import numpy as np
from gallery import directions, run, style, titled

import urushi as ur

COAT, GOLD, ANGLE = ur.Dielectric(ior=1.5, alpha=0.1), ur.Conductor(material="Au", alpha=0.3), 45
FOG = ur.Medium(depth=0.5, albedo=[0.95, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.5))
GLASS = [ur.Dielectric(ior=1.5, alpha=0.3), ur.Dielectric(ior=1.0, alpha=0.3)]
FAMILIES = {
    "coat over diffuse": [COAT, ur.Diffuse(reflectance=0.5)],
    "coat over metal": [COAT, GOLD],
    "coat, medium, metal": [COAT, FOG, GOLD],
    "two coats over metal": [COAT, ur.Dielectric(ior=1.8, alpha=0.2), GOLD],
    "frosted glass, reflected": GLASS,
    "frosted glass, transmitted": GLASS,
}


def draw(quick: bool) -> style.Figure:
    figure, exits = style.figure(10, 6.4), np.linspace(-89, 89, 179)
    dots, degrees = np.arange(4, 179, 10), np.array([0, 30, 45, 60, 75])
    wi, all_wi, energy, shape, noise = directions(-ANGLE), directions(degrees), [], [], []
    for axes, (name, layers) in zip(figure.subplots(2, 3).flat, FAMILIES.items(), strict=True):
        stack, through = ur.Stack(layers=layers), "transmitted" in name
        wo = directions(exits) * ([1, 1, -1] if through else 1)
        adding = ur.solve(stack, "adding", accuracy=1e-2 if quick else 1e-3)
        lobes = ur.solve(stack, "lobes")
        walk = ur.solve(stack, "walk", samples=1 << (9 if quick else 14))
        exact, close = (bsdf.eval(wi, wo)[:, 0] for bsdf in (adding, lobes))
        value, error = (x[:, 0] for x in walk.eval(np.repeat(wi, len(dots), 0), wo[dots], with_error=True))
        flux = [(b.transmittance if through else b.reflectance)(all_wi)[:, 0] for b in (adding, lobes)]
        energy.append(np.abs(flux[1] - flux[0]).max())
        shape.append(np.abs(close - exact).sum() / exact.sum())
        noise.append(np.abs(value - exact[dots]) / np.maximum(error, 2e-3 * exact.max()))
        axes.plot(exits, exact, color=style.BLUE, label="adding")
        axes.plot(exits, close, color=style.VERMILION, ls=style.DASHES[1], label="lobes")
        axes.errorbar(exits[dots], value, 2 * error, fmt=".", color=style.INK, label="walk ± 2 errors")
        axes.set(title=f"{name}\nlobes off: energy {energy[-1]:.1g}, curve {shape[-1]:.0%}", ylim=(0, None))
        axes.set(xlabel="exit angle (degrees)", ylabel="f cos θ, red (1/sr)")
    figure.axes[0].legend(loc="upper left")
    typical = np.sqrt(np.mean(np.square(noise)))
    text = f"Lobes: energy within {max(energy):.1g} of adding, curves off by {min(shape):.0%} to {max(shape):.0%}"
    text += f"; the walk is off adding by {typical:.1f} of its errors"
    below = f"Light from {ANGLE}°. Energy: reflected or transmitted, the worst of 0 to 75°. Curve: area between the two"
    return titled(figure, text, below)


if __name__ == "__main__":
    run(draw)
