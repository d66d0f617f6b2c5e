"""Phase functions of a medium, as data. A new one is a class here and its name in the registry below."""

from __future__ import annotations

from typing import Annotated

from urushi.description.base import Description
from urushi.description.parameter import Parameter, Texture


class Isotropic(Description):
    """Scatters equally into all directions."""

    kind = "isotropic"


class HenyeyGreenstein(Description):
    """The Henyey-Greenstein phase function (Henyey and Greenstein 1941).

    Args:
        g: mean cosine of the scattering angle, from -0.999 (back) over 0 (isotropic) to 0.999 (forward).

    Raises:
        MaterialError: a value is not allowed.
    """

    kind = "henyey_greenstein"

    g: Annotated[
        float | Texture,
        Parameter(
            -0.999, 0.999, meaning="mean cosine of the scattering angle", why_one="one g serves every colour"
        ),
    ]


class Rayleigh(Description):
    """Unpolarised Rayleigh scattering, 3/4 (1 + cos²): particles far smaller than the wavelength."""

    kind = "rayleigh"


Phase = Isotropic | HenyeyGreenstein | Rayleigh

PHASES: dict[str, type[Description]] = {
    phase.kind: phase for phase in (Isotropic, HenyeyGreenstein, Rayleigh)
}
"""Every phase function, by its name in material files."""
