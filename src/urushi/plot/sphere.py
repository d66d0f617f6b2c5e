"""A rendered sphere of each material, by Mitsuba, in the built-in scene."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from urushi import llvm
from urushi.adapters.scene import LIGHTS, SHAPES
from urushi.errors import UrushiError
from urushi.io import save
from urushi.solvers import SOLVERS
from urushi.stack import Stack

from . import style
from .subjects import stacks

MOST = 12
VARIANT = "llvm_ad_rgb"


@style.styled
def sphere(
    materials: Any,
    *,
    method: str | Sequence[str] = "walk",
    labels: Sequence[str] | None = None,
    shape: str = "sphere",
    light: str = "studio",
    spp: int = 64,
    size: int = 256,
    seed: int = 0,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> style.Figure:
    """A sphere of each material, by each method, rendered with the plugin `layered`.

    Args:
        materials: one to twelve pictures in all: `Stack`, path, ``preset:NAME``, or solved `BSDF`, whose description
            is rendered. Textures show.
        method: one or several of "walk", "adding", "lobes".
        labels: names of the pictures.
        shape: "sphere", "ball" or "bowl" (`urushi.adapters.scene`).
        light: "studio", "sky" or "constant".
        spp: samples per pixel, at least 1.
        size: width and height of a picture in pixels, 16 to 2048.
        seed: where random numbers start.
        advance: called with the samples per pixel done so far and all of them, of all pictures.

    Raises:
        UrushiError: nothing or too much to draw, a value out of range, or what Mitsuba refuses.
    """
    if spp < 1 or not 16 <= size <= 2048:
        raise UrushiError(f"spp, size: found {spp}, {size}; allowed: spp of 1 or more, size of 16 to 2048")
    methods = [method] if isinstance(method, str) else list(method)
    if not methods or any(name not in (*SOLVERS, "auto") for name in methods):
        raise UrushiError(f"method: found {method!r}; allowed: {', '.join((*SOLVERS, 'auto'))}")
    if shape not in SHAPES or light not in LIGHTS:
        raise UrushiError(
            f"shape, light: found {shape!r}, {light!r}; allowed: {', '.join(SHAPES)}; {', '.join(LIGHTS)}"
        )
    shown = [(stack, name, way) for stack, name in stacks(materials) for way in methods]
    if len(shown) > MOST:
        raise UrushiError(f"materials: found {len(shown)} to draw; allowed: at most {MOST} in one figure")
    names = [f"{name}, {way}" if len(methods) > 1 else name for _, name, way in shown]
    if labels is not None:
        if isinstance(labels, str) or len(labels) != len(shown):
            raise UrushiError(
                f"labels: found {labels!r}; allowed: a list of {len(shown)}, one for each picture"
            )
        names = [str(label) for label in labels]
    pictures = []
    for i, (stack, _, way) in enumerate(shown):

        def done(part: int, whole: int, before: int = i) -> None:
            advance(before * spp + part, len(shown) * spp)

        pictures.append(_picture(stack, way, shape, light, spp, size, seed, done))
    columns = min(len(shown), 4)
    rows = -(-len(shown) // columns)
    figure = style.figure(2.5 * columns + 0.1, 2.72 * rows + 0.1)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for axes, image, name in zip(grid.flat, pictures, names, strict=False):
        axes.imshow(image, interpolation="antialiased")
        axes.set_title(name)
    return figure


def _picture(
    stack: Stack, method: str, shape: str, light: str, spp: int, size: int, seed: int, advance: Any
) -> np.ndarray:
    """(size, size, 3) 8-bit sRGB, tone-mapped."""
    llvm.ensure()
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant(VARIANT)
    import urushi.mitsuba  # noqa: F401 (registers the plugin)
    from urushi.adapters import picture
    from urushi.adapters.scene import scene
    from urushi.adapters.scene_file import said

    picture.enough_threads()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "material.yaml")
        save(stack, file)
        bsdf = {"type": "layered", "filename": str(file), "method": method}
        try:
            loaded = mi.load_dict(scene(bsdf, size=(size, size), light=light, shape=shape))
        except RuntimeError as error:
            raise UrushiError(said(error)) from error
    return picture.tonemap(picture.render(loaded, spp, seed, advance))
