"""`urushi plot`: figures of materials, overlaid or side by side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from urushi.cli import backend, common, progress
from urushi.cli.common import WrongUsage
from urushi.errors import close

FORMATS = (".png", ".svg", ".pdf")

KINDS = {
    "polar": "the lobe in the plane of incidence",
    "hemisphere": "the lobe on the hemisphere, as an image",
    "lobe3d": "the lobe in space",
    "slice": "colours over half and difference angle",
    "albedo": "where the light goes, against the angle",
    "patches": "colours under daylight, against the angle",
    "section": "the stack as a cross-section",
    "sphere": "a rendered sphere",
}
"""Every figure of `urushi.plot`, in words."""

ONLY = {
    "theta": ("polar", "hemisphere", "lobe3d"),
    "phi": ("polar", "hemisphere", "lobe3d"),
    "channel": ("polar", "hemisphere", "lobe3d", "albedo"),
    "log": ("polar", "hemisphere", "lobe3d"),
    "ledger": ("albedo",),
    "samples": ("polar", "hemisphere", "lobe3d", "slice", "albedo", "patches"),
    "spp": ("sphere",),
    "method": tuple(kind for kind in KINDS if kind != "section"),
    "labels": tuple(kind for kind in KINDS if kind != "section"),
}
"""Options that mean something for some of the figures only."""

SOLVED = "A material file, preset:NAME, a solved file, or a Mitsuba BSDF (.xml, .json, .bsdf)."


def command(
    materials: list[str] = typer.Argument(..., metavar="MATERIAL...", help=SOLVED),
    kind: str = typer.Option("polar", "--kind", "-k", help=f"The figure: {', '.join(KINDS)}."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="A .png, .svg or .pdf file; else out/NAME-KIND.png."
    ),
    method: list[str] = typer.Option(
        [], "--method", "-m", help="walk (the default), adding, lobes or auto; may be given several times."
    ),
    theta: float | None = typer.Option(None, help="Degrees of the light from the normal; else 45."),
    phi: float | None = typer.Option(None, help="Degrees of the plane of incidence from x; else 0."),
    log: bool | None = typer.Option(
        None,
        "--log/--linear",
        help="A logarithmic scale, or a linear one; polar shows both if neither is said.",
    ),
    ledger: bool | None = typer.Option(
        None, "--ledger/--curves", help="With albedo: areas of every layer, or curves of all materials."
    ),
    channel: str | None = typer.Option(None, help="luminance (the default), red, green or blue."),
    samples: int | None = typer.Option(None, help="With the walk: walks per direction."),
    spp: int | None = typer.Option(None, help="With sphere: samples per pixel; else 64."),
    label: list[str] = typer.Option(
        [], "--label", help="A name for the legend; once for every material and method, in order."
    ),
    dpi: int = typer.Option(150, help="Pixels an inch, of a .png."),
) -> None:
    """Draw figures of one material or several."""
    if kind not in KINDS:
        raise WrongUsage(f"--kind is {kind!r}; {close(kind, KINDS)}allowed: {', '.join(KINDS)}")
    for name in method:
        common.known_method(name)
    if not 20 <= dpi <= 1200:
        raise WrongUsage(f"--dpi is {dpi}; allowed: 20 to 1200")
    if samples is not None and (samples < 2 or not (not method or "walk" in method)):
        raise WrongUsage(f"--samples is {samples}; allowed: 2 or more, with the walk among the methods")
    if spp is not None and spp < 1:
        raise WrongUsage(f"--spp is {spp}; allowed: 1 or more")
    if theta is not None and not 0 <= theta <= 89.5:
        raise WrongUsage(f"--theta is {theta:g}; allowed: 0 to 89.5")
    if channel not in (None, "luminance", "red", "green", "blue"):
        raise WrongUsage(f"--channel is {channel!r}; allowed: luminance, red, green, blue")
    options: dict[str, Any] = {"theta": theta, "phi": phi, "channel": channel, "log": log, "ledger": ledger}
    options |= {"samples": samples, "spp": spp, "method": method or None, "labels": label or None}
    options = {name: value for name, value in options.items() if value is not None}
    for name in options:
        if kind not in ONLY.get(name, KINDS):
            said = {"log": "--log/--linear", "ledger": "--ledger/--curves", "labels": "--label"}
            flag = said.get(name, f"--{name}")
            raise WrongUsage(f"{flag} means nothing with --kind {kind}; it is for {', '.join(ONLY[name])}")
    plain = not materials[0].lstrip().startswith("{")
    first = Path(materials[0].removeprefix("preset:")).name.split(".")[0] if plain else "bsdf"
    path = common.writable(output or Path("out", f"{first}-{kind}.png"), FORMATS)
    _matplotlib()
    given = [_material(text) for text in materials]
    from urushi import plot

    draw: Callable[..., Any] = getattr(plot, kind)
    with progress.bar(f"drawing {kind}") as advance:
        if kind == "sphere":
            backend.use(None)
            options["advance"] = advance
        figure = draw(given, **options)
    plot.save(figure, path, dpi=dpi)
    typer.echo(f"wrote {path}")


def _material(text: str) -> Any:
    """A description, or a BSDF that is solved already."""
    from urushi.adapters import answer

    if not text.startswith("preset:") and answer.is_answer(text):
        if not text.lstrip().startswith("{") and not Path(text).is_file():
            raise WrongUsage(f"there is no file {text!r}")
        backend.use(None)
        return answer.answer(text)
    return common.load(text)


def _matplotlib() -> None:
    """Say how to get matplotlib, before anything is solved."""
    import urushi.plot  # noqa: F401 (raises an error that says it)
