"""How many nodes rough interfaces ask for.

The matrices of an interface act well on few nodes whatever its roughness (`columns`). But what the stack as a whole
sends out has lobes that the nodes must hold, except for the outermost interface's own, which has a closed form: those
of the interfaces behind it, wider by the way in and out, and those of the light that goes through all of them.
A lobe of half-width w takes about 1.3 log(1 / accuracy) / w nodes between the normal and the horizon (measured:
coats of 0.02 and 0.1 on metals of 0.05 and 0.2, at 1e-2 to 1e-4 of the peak).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: nodes for what has no narrow lobe, and where all is smooth; nodes per unit of log(1 / accuracy) / width; and what
#: panels of total reflection need of the first one's number
FEWEST, SMOOTH, DENSITY, BEYOND = 18, 15, 1.3, 0.6


def narrowest(alphas: Sequence[float | None], indices: Sequence[float], opaque: bool) -> float | None:
    """Half-width, in radians, of the narrowest lobe that a stack sends out and that has no closed form.

    Args:
        alphas: roughness of every interface from the top, 0 where smooth, None where it has no lobe (a diffuse base).
        indices: of every region from the top; one more than interfaces unless opaque.
        opaque: whether the last interface lets nothing through.

    Returns:
        None where nothing is narrow, or all narrow lobes are deltas.
    """
    spread, widths = 0.0, []  # variance that one way to interface k adds
    for k, alpha in enumerate(alphas):
        if k > 0 and alpha is not None:
            widths.append(np.sqrt((2 * alpha) ** 2 + 2 * spread))
        if k + 1 < len(indices) and alpha is not None:
            spread += (alpha * (1 - indices[k] / indices[k + 1])) ** 2
    if not opaque and len(alphas) > 1:
        widths.append(np.sqrt(spread))
    rough = [float(width) for width in widths if width > 0]
    return min(rough, default=None)


def panel_counts(
    alphas: Sequence[float | None], indices: Sequence[float], opaque: bool, accuracy: float
) -> list[int]:
    """Nodes per panel for this accuracy, relative to the peak; one panel for every different index.

    Args:
        alphas, indices, opaque: as for `narrowest`.
        accuracy: in (0, 1).
    """
    width = narrowest(alphas, indices, opaque)
    fewest = FEWEST if any(alpha is None or alpha > 0 for alpha in alphas) else SMOOTH
    wanted = fewest if width is None else max(fewest, DENSITY * np.log(1 / accuracy) / width)
    panels = len(np.unique(np.round(np.asarray(indices, float), 9)))
    return [int(np.ceil(wanted)), *[max(int(np.ceil(BEYOND * wanted)), 8)] * (panels - 1)]
