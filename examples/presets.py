"""Some of the materials that come along, in the built-in scene: the picture on top of the README."""

from __future__ import annotations

from gallery import mitsuba, photograph, run, show, style, titled

from urushi.adapters.scene import scene

SHAPES = {
    "urushi-black": "bowl",
    "urushi-red": "bowl",
    "enamel-on-gold": "ball",
    "car-paint": "ball",
    "varnished-wood": "ball",
    "brushed-metal-lacquer": "ball",
    "pearl": "ball",
    "enamel-on-copper": "ball",
}


def draw(quick: bool) -> style.Figure:
    mitsuba()
    figure = style.figure(9.2, 5.3)
    for axes, (name, shape) in zip(figure.subplots(2, 4).flat, SHAPES.items(), strict=True):
        bsdf = {"type": "layered", "filename": f"preset:{name}"}
        made = scene(bsdf, size=(40, 40) if quick else (320, 320), shape=shape)
        show(axes, photograph(made, 4 if quick else 256), name)
    return titled(figure, f"{len(SHAPES)} of the presets, rendered with the plugin layered")


if __name__ == "__main__":
    run(draw)
