"""How many nodes rough interfaces ask for, and where.

The matrices of an interface act well on few nodes whatever its roughness (`columns`). But what the stack as a whole
sends out has lobes that the nodes must hold, except for those with a closed form (the outermost interface's own, and
in a stack that transmits whatever meets one rough interface only): reflection by the interfaces behind it, wider by
the way in and out, and light that passes two rough interfaces, or one of them twice, off a mirror.
A lobe of half-width w takes about 1.3 log(1 / accuracy) / w nodes between the normal and the horizon (measured:
coats of 0.02 and 0.1 on metals of 0.05 and 0.2, at 1e-2 to 1e-4 of the peak).

What passes is narrow near the normal alone: an interface turns light by its slope times eta cos_o - cos_i, which
grows with the angle. So half as many nodes do where they are closer together there by `SQUEEZE` (`basis.Panel`;
measured: sheets of index 1.5 and roughness 0.05 and 0.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: nodes for what has no narrow lobe, and where all is smooth; nodes per unit of log(1 / accuracy) / width; and what
#: panels of total reflection need of the first one's number: where light outside gets there, and where none does, of
#: sheets, before a base, and with a smooth interface to reflect it
FEWEST, SMOOTH, DENSITY, BEYOND, WITHIN = 18, 15, 1.3, 0.6, (0.4, 0.55, 0.8)
#: nodes closer together towards the normal by this factor; the density that lobes then take; and the fewest nodes that
#: are worth it: wider lobes leave more to what grazes
SQUEEZE, SQUEEZED, WORTH = 0.4, 0.74, 45


def narrowest(
    alphas: Sequence[float | None], indices: Sequence[float], opaque: bool, through: bool = False
) -> float | None:
    """Half-width, in radians, of the narrowest lobe that a stack sends out and that has no closed form.

    Args:
        alphas: roughness of every interface from the top, 0 where smooth, None where it has no lobe (a diffuse base).
        indices: of every region from the top; one more than interfaces unless opaque.
        opaque: whether the last interface lets nothing through.
        through: whether light that meets one rough interface only has a closed form, behind smooth ones too.

    Returns:
        None where nothing is narrow, or all narrow lobes are deltas.
    """
    found = [width for width in _lobes(alphas, indices, opaque, through) if width is not None]
    return min(found, default=None)


def _lobes(
    alphas: Sequence[float | None], indices: Sequence[float], opaque: bool, through: bool
) -> tuple[float | None, float | None]:
    """Half-widths of the narrowest lobe that a rough interface reflects, and of light that only passes rough ones."""
    ways = [list(range(len(alphas)))]
    if through and not opaque:
        ways.append(ways[0][::-1])
    reflected, passed = [], []
    for way in ways:
        spread = 0.0  # variance that the way to interface k adds
        for k in way:
            alpha = alphas[k]
            before, after = (k, k + 1) if way is ways[0] else (k + 1, k)
            last = max(before, after) >= len(indices)
            if k != way[0] and alpha is not None:
                if alpha > 0 and not (through and spread == 0):
                    reflected.append(np.sqrt((2 * alpha) ** 2 + 2 * spread))
                if alpha == 0 and (last or indices[before] != indices[after]):
                    passed.append(np.sqrt(2 * spread))
            if not last and alpha is not None:
                spread += (alpha * (1 - indices[before] / indices[after])) ** 2
        rough = sum(alpha is None or alpha > 0 for alpha in alphas)
        if not opaque and len(alphas) > 1 and (rough > 1 or not through):
            passed.append(np.sqrt(spread))
    return (
        min((float(width) for width in reflected if width > 0), default=None),
        min((float(width) for width in passed if width > 0), default=None),
    )


def plan(
    alphas: Sequence[float | None],
    indices: Sequence[float],
    opaque: bool,
    accuracy: float,
    through: bool = False,
) -> tuple[list[int], float]:
    """Nodes per panel for this accuracy, relative to the peak, and the `squeeze` of the first panel.

    Args:
        alphas, indices, opaque, through: as for `narrowest`; every different index has one panel.
        accuracy: in (0, 1).
    """
    reflected, passed = _lobes(alphas, indices, opaque, through)
    fewest = FEWEST if any(alpha is None or alpha > 0 for alpha in alphas) else SMOOTH
    digits = np.log(1 / accuracy)
    wanted = fewest if reflected is None else max(fewest, DENSITY * digits / reflected)
    panels = np.unique(np.round(np.asarray(indices, float), 9))
    squeezed = 0.0 if passed is None else SQUEEZED * digits / passed
    if not through or squeezed < max(WORTH, wanted):
        if passed is not None:
            wanted = max(wanted, DENSITY * digits / passed)
        return _counts(wanted, [BEYOND * wanted] * (len(panels) - 1)), 1.0
    outside = indices[0] if opaque else max(indices[0], indices[-1])
    rough = [alpha for alpha in alphas if alpha is not None and alpha > 0]
    mirror = any(
        alpha == 0 and k + 1 < len(indices) and indices[k] != indices[k + 1] for k, alpha in enumerate(alphas)
    )
    within = WITHIN[2 if mirror else int(opaque)] * max(wanted, DENSITY * digits / (2 * min(rough)))
    others = [BEYOND * squeezed if index <= outside * (1 + 1e-9) else within for index in panels[1:]]
    return _counts(squeezed, others), SQUEEZE


def _counts(first: float, others: Sequence[float]) -> list[int]:
    return [int(np.ceil(first)), *(max(int(np.ceil(n)), 8) for n in others)]
