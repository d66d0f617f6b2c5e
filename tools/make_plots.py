"""Draw the pictures of docs/plots.md: `python tools/make_plots.py [NAME...]`, all of them without a name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import urushi as ur

FOLDER = Path(__file__).parent.parent / "docs" / "images" / "plots"
DPI = 100

RUBY, SKIN, PLASTIC = "preset:enamel-on-gold", "preset:skin", "preset:plastic"
FROSTED, MILKY, PAINT = "preset:frosted-glass", "preset:milky-glass", "preset:car-paint"

PICTURES: dict[str, Callable[[], Any]] = {
    "polar": lambda: ur.plot.polar([FROSTED, MILKY], theta=30, samples=8192),
    "hemisphere": lambda: ur.plot.hemisphere("preset:brushed-metal-lacquer", theta=30, samples=1024),
    "lobe3d": lambda: ur.plot.lobe3d([RUBY, FROSTED], theta=40, samples=2048),
    "slice": lambda: ur.plot.slice([PLASTIC, RUBY, SKIN], samples=512),
    "albedo": lambda: ur.plot.albedo(SKIN, samples=8192),
    "albedo-curves": lambda: ur.plot.albedo([MILKY, PAINT, "preset:brushed-metal-lacquer"]),
    "patches": lambda: ur.plot.patches([RUBY, SKIN, PAINT, PLASTIC, "preset:urushi-red"]),
    "section": lambda: ur.plot.section([RUBY, SKIN]),
    "sphere": lambda: ur.plot.sphere([RUBY, "preset:varnished-wood", PAINT], spp=512),
}


def main(names: list[str]) -> None:
    """Draw the pictures of these names."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or PICTURES:
        ur.plot.save(PICTURES[name](), FOLDER / f"{name}.png", dpi=DPI)
        print(f"wrote {name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
