"""Figures: a material, or several, or several methods, as pictures one can print.

    import urushi as ur

    ur.plot.polar(["preset:enamel", "preset:plastic"], theta=45)             # overlaid
    ur.plot.polar("preset:enamel", method=["walk", "lobes"])                 # with bands where there is noise
    ur.plot.save(ur.plot.albedo("preset:skin"), "skin.svg")

Every function takes one material or a list of them (a `Stack`, a path, ``preset:NAME``, or a solved `BSDF`, which is
taken as it is), solves what is not solved by `method`, and returns a matplotlib figure.

    polar        the lobe in the plane of incidence, reflected and transmitted, linear and logarithmic
    hemisphere   the lobe on the hemisphere, as an image of each side
    lobe3d       the lobe in space
    slice        colours over half and difference angle, as in Disney's BRDF Explorer
    albedo       where the light goes, against the angle
    patches      colours under daylight, against the angle
    section      the stack as a cross-section
    sphere       a rendered sphere

A figure is a file with one function; `style` is how all of them look, `subjects` turns what was given into solved
materials. This is the only package that imports matplotlib (the extra ``plot``), and it keeps nothing: no `pyplot`,
no settings changed.
"""

from __future__ import annotations

from urushi.errors import UrushiError

try:
    import matplotlib  # noqa: F401
except ImportError as error:
    raise UrushiError(
        "figures need matplotlib, which is not installed; get it with: pip install 'urushi[plot]', or pip install "
        f"matplotlib ({error})"
    ) from error

from .albedo import albedo
from .hemisphere import hemisphere
from .lobe3d import lobe3d
from .patches import patches
from .polar import polar
from .section import section
from .slice import slice
from .sphere import sphere
from .style import save

__all__ = ["albedo", "hemisphere", "lobe3d", "patches", "polar", "save", "section", "slice", "sphere"]
