"""Write the picture on top of the README: some of the presets in the built-in scene, side by side.

    python tools/make_gallery.py                    about ten minutes on two cores
    python tools/make_gallery.py --spp 32 -o a.png  a quick look

One cell is one render of `layered` in the built-in scene, tone-mapped as `urushi render` does it.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from urushi import llvm

ROOT = Path(__file__).resolve().parent.parent
CELLS = (
    ("urushi-black", "bowl"),
    ("urushi-red", "bowl"),
    ("enamel-on-gold", "ball"),
    ("car-paint", "ball"),
    ("varnished-wood", "ball"),
    ("brushed-metal-lacquer", "ball"),
    ("pearl", "ball"),
    ("enamel-on-copper", "ball"),
)
COLUMNS = 4
CELL = 320


def cell(preset: str, shape: str, spp: int) -> np.ndarray:
    """One linear picture (CELL, CELL, 3)."""
    import mitsuba as mi

    import urushi.mitsuba  # noqa: F401 (registers the plugin)
    from urushi.adapters import picture
    from urushi.adapters.scene import scene

    bsdf = {"type": "layered", "filename": f"preset:{preset}"}
    return picture.render(mi.load_dict(scene(bsdf, size=(CELL, CELL), shape=shape)), spp)


def main() -> int:
    """Render and write; the exit status."""
    parser = argparse.ArgumentParser(description="Render the gallery of the README.")
    parser.add_argument("--spp", type=int, default=256, help="samples per pixel")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "images" / "gallery.png")
    options = parser.parse_args()
    llvm.ensure()
    import mitsuba as mi
    from PIL import Image

    mi.set_variant("llvm_ad_rgb")
    from urushi.adapters.picture import tonemap

    rows: list[list[np.ndarray]] = []
    for index, (preset, shape) in enumerate(CELLS):
        start = time.perf_counter()
        if index % COLUMNS == 0:
            rows.append([])
        rows[-1].append(tonemap(cell(preset, shape, options.spp)))
        print(f"{preset}: {time.perf_counter() - start:.0f} s", flush=True)
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows], axis=0)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(sheet).save(options.output, optimize=True)
    print(f"wrote {options.output} ({options.output.stat().st_size / 1000:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
