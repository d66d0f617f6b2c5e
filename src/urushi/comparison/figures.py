"""The pictures of the page that need the solved stacks: drawn by `urushi.plot`, kept as data in the page."""

from __future__ import annotations

import base64
import io
from typing import Any

from urushi.errors import UrushiError
from urushi.solvers import BSDF, solve
from urushi.stack import Stack

#: degrees of the incident light in the pictures of lobes
THETAS = (30.0, 60.0)
#: curves that a reader can tell apart
MOST = 5
SAMPLES = 2048


def draw(stack: Stack, bsdfs: dict[str, BSDF]) -> dict[str, str]:
    """Title -> an ``<img>`` element, or a sentence that says why there is none."""
    try:
        from urushi import plot
    except UrushiError as error:
        return {"No pictures": f"<p>{error}</p>"}
    found = {"The stack": _image(plot.section(stack), "the stack as a cross-section")}
    shown = dict(bsdfs)
    if "adding" in shown:  # the same, without noise
        shown.pop("walk", None)
    elif "walk" in shown:  # smooth enough to be looked at
        shown["walk"] = solve(stack, "walk", samples=SAMPLES)
    names = list(shown)[:MOST]
    for theta in THETAS:
        title = f"Lobes for light at {theta:g}°"
        try:
            figure = plot.polar([shown[name] for name in names], theta=theta, labels=names)
        except UrushiError as error:  # nothing to draw: all black
            found[title] = f"<p>{error}</p>"
            continue
        found[title] = _image(figure, f"polar curves of {', '.join(names)} for light at {theta:g} degrees")
    return found


def _image(figure: Any, words: str) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=130)
    data = base64.b64encode(content.getvalue()).decode()
    return f'<img alt="{words}" src="data:image/png;base64,{data}">'
