"""`urushi render`: a picture of a material, in the built-in scene or in one of the user's."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any, Literal

import typer

from urushi.cli import backend, common, progress, stage
from urushi.cli.common import WrongUsage

SPP = 128
SIZE = (512, 512)


def command(
    material: str = typer.Argument(..., help=common.MATERIAL),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="A .png (tone-mapped) or .exr (linear) file; else out/NAME.png."
    ),
    method: str = typer.Option(
        "walk", "--method", "-m", help="How the stack is solved: walk, adding, lobes, or auto."
    ),
    scene: Path | None = typer.Option(None, help="A Mitsuba scene file; else the built-in scene."),
    name: str | None = typer.Option(
        None, "--material", help="With --scene: the id of the BSDF that the material replaces."
    ),
    spp: int | None = typer.Option(None, help="Samples per pixel; else 128, or what the scene file says."),
    size: str | None = typer.Option(None, help="Pixels, as 640x480 or 512; else 512, or the scene file's."),
    light: Literal["studio", "sky", "constant"] | None = typer.Option(
        None, help="Light of the built-in scene; else studio."
    ),
    shape: Literal["ball", "bowl", "sphere"] | None = typer.Option(
        None, help="Object in the built-in scene; else ball."
    ),
    samples: int | None = typer.Option(None, help="With --method walk: walks per evaluation."),
    accuracy: float | None = typer.Option(
        None, help="With --method adding: error allowed, relative to the peak of the BSDF; else 1e-3."
    ),
    nodes: int | None = typer.Option(
        None, help="With --method adding: a fixed number of directions instead, whatever the error."
    ),
    orders: int | None = typer.Option(
        None, help="With --method adding: a fixed number of azimuthal orders instead."
    ),
    media: str | None = typer.Option(
        None, help="With --method adding: how media are solved, ordinates (the usual), doubling, or riccati."
    ),
    seed: int = typer.Option(0, help="Where the random numbers start; the same seed, the same picture."),
    variant: str | None = typer.Option(None, help="Mitsuba variant; else llvm_ad_rgb."),
) -> None:
    """Render a picture of a material."""
    start = time.perf_counter()
    if spp is not None and spp < 1:
        raise WrongUsage(f"--spp is {spp}; allowed: 1 or more")
    common.known_method(method)
    if samples is not None and (samples < 1 or method != "walk"):
        raise WrongUsage(
            f"--samples is {samples} with --method {method}; allowed: 1 or more, with --method walk"
        )
    options = common.adding_options(method, accuracy, nodes, orders, media)
    if not 0 <= seed < 2**32:
        raise WrongUsage(f"--seed is {seed}; allowed: 0 to {2**32 - 1}")
    pixels = _pixels(size)
    if scene is None and name is not None:
        raise WrongUsage("--material names a BSDF of a scene file; give that with --scene")
    if scene is not None and (light or shape):
        raise WrongUsage("--light and --shape belong to the built-in scene; they mean nothing with --scene")
    if scene is not None and not scene.is_file():
        raise WrongUsage(f"there is no scene file {str(scene)!r}")
    stack = common.load(material)
    common.has_media(media, stack)
    title = Path(material.removeprefix("preset:")).stem
    path = common.writable(output or Path("out", f"{title}.png"), (".png", ".exr"))
    backend.use(variant)

    from urushi.adapters import picture

    bsdf = _bsdf(material, method, samples) | options
    with progress.bar(f"rendering {stack.name or title}") as advance:
        if scene is None:
            loaded = stage.builtin(bsdf, pixels or SIZE, light or "studio", shape or "ball")
        else:
            loaded = stage.from_file(scene, name, bsdf, pixels)
        total = spp or (SPP if scene is None else int(loaded.sensors()[0].sampler().sample_count()))
        image = picture.render(loaded, total, seed, advance)
    if bad := picture.invalid(image):
        common.warn(f"{bad} pixels are infinite or not a number")
    notes = {"material": material, "method": method, "spp": str(total), "seed": str(seed)}
    picture.write(image, path, {f"urushi.{key}": value for key, value in notes.items()})
    height, width = image.shape[:2]
    typer.echo(f"wrote {path}  ({width}x{height}, {total} spp, {time.perf_counter() - start:.1f} s)")


def _bsdf(material: str, method: str, samples: int | None) -> dict[str, Any]:
    """The material as Mitsuba's plugin `layered` takes it."""
    import urushi.mitsuba  # noqa: F401 (registers the plugin)

    filename = material if material.startswith("preset:") else os.path.abspath(material)
    bsdf: dict[str, Any] = {"type": "layered", "filename": filename, "method": method}
    return bsdf if samples is None else {**bsdf, "samples": samples}


def _pixels(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if (
        not width.isdecimal()
        or not (height or width).isdecimal()
        or not (int(width) and int(height or width))
    ):
        raise WrongUsage(f"--size is {text!r}; allowed: a number of pixels, or WIDTHxHEIGHT")
    return int(width), int(height or width)
