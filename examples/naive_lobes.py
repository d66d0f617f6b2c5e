"""Adding the lobe of a coat to the lobe of what lies under it, and what layers really do."""

from __future__ import annotations

import numpy as np
from gallery import directions, run, style, titled

import urushi as ur

COAT, BASE, ANGLE = ur.Dielectric(ior=1.5, alpha=0.15), ur.Conductor(material="Au", alpha=0.15), 45
DASHES, COLOURS = (*style.DASHES[1:3], "-"), (style.VERMILION, style.GREEN, style.BLUE)


def draw(quick: bool) -> style.Figure:
    coat, base = (ur.solve(ur.Stack(layers=[layer]), "adding") for layer in (COAT, BASE))
    stack = ur.Stack(layers=[COAT, BASE])
    layered = ur.solve(stack, "adding", accuracy=1e-2 if quick else 3e-3)
    walk = ur.solve(stack, "walk", samples=1 << (9 if quick else 14))
    exits, degrees = np.linspace(-89, 89, 179), np.linspace(0, 85, 6 if quick else 30)
    wi, wo, all_wi = directions(-ANGLE), directions(exits), directions(degrees)
    figure = style.figure(9.5, 4.2)
    lobe, energy = figure.subplots(1, 2)
    # --- the lobe of light from one angle
    top, low = (bsdf.eval(wi, wo)[:, 0] for bsdf in (coat, base))
    value, error = (x[:, 0] for x in walk.eval(np.repeat(wi, 18, 0), wo[4::10], with_error=True))
    curves = {"coat + base": top + low, "coat + T × base": top + coat.transmittance(wi)[0, 0] * low}
    curves["layered: adding"] = layered.eval(wi, wo)[:, 0]
    for (name, values), dash, colour in zip(curves.items(), DASHES, COLOURS, strict=True):
        lobe.plot(exits, values, ls=dash, color=colour, label=name)
    lobe.errorbar(exits[4::10], value, 2 * error, fmt=".", color=style.INK, label="layered: walk ± 2 errors")
    lobe.set(xlabel="exit angle in the plane of incidence (degrees)", ylabel="f cos θ, red (1/sr)")
    lobe.set_title(f"light from {ANGLE}°; T is what passes the coat")
    lobe.legend(loc="upper left")
    # --- all that is reflected
    top, low, real = (bsdf.reflectance(all_wi)[:, 0] for bsdf in (coat, base, layered))
    weighted = top + coat.transmittance(all_wi)[:, 0] * low
    for values, dash, colour in zip((top + low, weighted, real), DASHES, COLOURS, strict=True):
        energy.plot(degrees, values, ls=dash, color=colour)
    energy.axhline(1, color=style.INK, lw=0.8)
    energy.text(0, 1.01, "all the light there is", va="bottom")
    energy.set(
        xlabel="angle of incidence (degrees)", ylabel="reflected share of the light, red", ylim=(0, None)
    )
    peak = curves["layered: adding"].max() / curves["coat + base"].max()
    text = f"Lobes added up reflect up to {(top + low).max():.0%} of the light, in a lobe {1 / peak:.1f} times too high"
    below = f"With the coat's T it is still up to {np.max(weighted - real):.2f} too much: light crosses a coat twice"
    return titled(figure, text, below)


if __name__ == "__main__":
    run(draw)
