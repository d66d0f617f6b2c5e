"""Render a Mitsuba scene pass by pass, and write pictures so that no half-written file is ever seen."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

FORMATS = (".png", ".exr")
LANES = 1 << 22
"""Samples that one pass traces at once, which bounds its memory to a few hundred megabytes."""
PASSES = 24
"""Passes a render is cut into, about, where that many are possible: enough to say how long it will take."""
SHOULDER = 0.75
"""Values up to here are shown as they are; highlights above are rolled off towards white."""

Image = npt.NDArray[np.float32]


def enough_threads() -> None:
    """Give Dr.Jit a second thread where it has only one, as on a machine with a single core.

    Mitsuba reads and writes OpenEXR files on Dr.Jit's threads while the calling one waits: with a single
    thread it waits for ever (Mitsuba 3.9.1).
    """
    import drjit as dr

    if dr.thread_count() < 2:
        dr.set_thread_count(2)


def render(
    scene: Any, spp: int, seed: int = 0, advance: Callable[[int, int], None] = lambda done, total: None
) -> Image:
    """Render `scene` in passes of a few samples per pixel.

    Args:
        scene: a Mitsuba scene.
        spp: samples per pixel in all, at least 1.
        seed: where the random numbers start; the same seed gives the same picture, up to rounding.
        advance: called after each pass with the samples per pixel done so far, and `spp`.

    Returns:
        The mean, linear: (height, width, channels).
    """
    import mitsuba as mi

    width, height = scene.sensors()[0].film().crop_size()
    step = min(max(1, LANES // (int(width) * int(height))), -(-spp // PASSES))
    total: npt.NDArray[np.float64] | None = None
    for index, start in enumerate(range(0, spp, step)):
        count = min(step, spp - start)
        # Far-apart seeds: the passes of seed 0 and of seed 1 must have none in common.
        image = mi.render(scene, spp=count, seed=(seed * 1_000_003 + index) % 2**32)
        part = np.array(image, dtype=np.float64) * count
        total = part if total is None else total + part
        advance(start + count, spp)
    assert total is not None
    return (total / spp).astype(np.float32)


def invalid(image: Image) -> int:
    """How many pixels of a picture (h, w, c) are infinite or not a number."""
    return int(np.sum(~np.all(np.isfinite(image), axis=-1)))


def tonemap(image: Image) -> npt.NDArray[np.uint8]:
    """Linear (h, w, c) to 8-bit sRGB: exact up to `SHOULDER`, above it highlights roll off to 1.

    What is not a number becomes black; `invalid` counts it.
    """
    x = np.nan_to_num(np.maximum(image[..., :3], 0.0), nan=0.0, posinf=1e6)
    room = 1.0 - SHOULDER
    x = np.where(x > SHOULDER, 1.0 - room * np.exp(-(np.maximum(x, SHOULDER) - SHOULDER) / room), x)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055)
    return (np.clip(curve, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def write(image: Image, path: Path, notes: dict[str, str] | None = None) -> None:
    """Write a linear picture (h, w, c): `.exr` as it is, in 32-bit floats; `.png` tone-mapped, 8-bit sRGB.

    The file appears complete or not at all: it is written beside its final place and then moved there.

    Args:
        image: linear radiance.
        path: where to; the folder must exist.
        notes: what to record in the file's header, such as the material and the seed.

    Raises:
        OSError: the folder cannot be written to.
    """
    import mitsuba as mi

    if path.suffix.lower() == ".exr":
        enough_threads()
        bitmap = mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32))
    else:
        pixels = tonemap(image)
        bitmap = mi.Bitmap(pixels if pixels.shape[2] == 3 else pixels[..., :1])
    for key, value in (notes or {}).items():
        bitmap.metadata()[key] = value
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix.lower(), dir=path.parent)
    os.close(handle)
    try:
        bitmap.write(name)
        os.chmod(name, 0o666 & ~_umask())  # a temporary file is private; a result is an ordinary file
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
