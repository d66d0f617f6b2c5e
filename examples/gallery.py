"""What the scripts beside this one share: Fresnel's equations, directions, renders, and how a script is called."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import urushi as ur
from urushi.plot import style


def fresnel(cos: np.ndarray | float, index: float) -> np.ndarray:
    """Reflectance of a smooth interface for unpolarised light; `index` is that beyond over that before."""
    cos = np.asarray(cos, float)
    beyond = np.sqrt(np.maximum(1 - (1 - cos**2) / index**2, 0))
    s, p = (cos - index * beyond) / (cos + index * beyond), (index * cos - beyond) / (index * cos + beyond)
    return np.asarray(0.5 * (s**2 + p**2))


def inside(index: float) -> tuple[float, float]:
    """Mean reflectance for light that comes evenly, from outside and from inside (total reflection included)."""
    x, weight = np.polynomial.legendre.leggauss(400)
    cos = 0.5 * (x + 1)
    outer = float(weight @ (fresnel(cos, index) * cos))
    return outer, 1 - (1 - outer) / index**2


def coated(rho: np.ndarray, index: float) -> np.ndarray:
    """What a diffuse base shows at 0° under a smooth coat, without the coat's own reflection (Lekner & Dorf 1988)."""
    back = inside(index)[1]
    return (1 - fresnel(1, index)) * rho * (1 - back) / (1 - rho * back)


def directions(degrees: np.ndarray | list[float] | float) -> np.ndarray:
    """(N, 3) unit vectors at these angles from the normal, in the plane of incidence."""
    theta = np.radians(np.atleast_1d(degrees))
    return np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)


def evenly(bsdf: Any) -> np.ndarray:
    """(C,) what is reflected of light that comes evenly from everywhere."""
    x, weight = np.polynomial.legendre.leggauss(12)
    cos = 0.5 * (x + 1)
    return np.asarray((weight * cos) @ bsdf.reflectance(directions(np.degrees(np.arccos(cos)))))


def plugin(stack: ur.Stack) -> Any:
    """The stack as a BSDF of Mitsuba, by the plugin `layered`."""
    mi = mitsuba()
    with tempfile.TemporaryDirectory() as folder:
        ur.save(stack, file := Path(folder, "material.yaml"))
        return mi.load_dict({"type": "layered", "filename": str(file)})


def normal_map(slope: np.ndarray, file: Path) -> ur.Texture:
    """A normal map of slopes (H, W, 2) along u and v (downwards, as rows go), written to a .png of 16 bits."""
    normal = np.stack([-slope[..., 0], slope[..., 1], np.ones(slope.shape[:2])], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    mitsuba().Bitmap(np.round(65535 * (0.5 + 0.5 * normal)).astype(np.uint16)).write(str(file))
    return ur.Texture(file=str(file))


def photograph(scene: dict[str, Any], spp: int) -> np.ndarray:
    """(H, W, 3) a picture of a Mitsuba scene, tone-mapped to 8-bit sRGB."""
    from urushi.adapters import picture

    return picture.tonemap(picture.render(mitsuba().load_dict(scene), spp))


def look_at(scene: dict[str, Any], origin: list[float], target: list[float], fov: float) -> None:
    """Turn the camera of a scene; its field of view is in degrees."""
    to_world = mitsuba().ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 0, 1])
    scene["sensor"] |= {"fov": fov, "to_world": to_world}


def show(axes: Any, image: np.ndarray, title: str = "") -> None:
    """A picture without ticks, and its title."""
    axes.imshow(image, interpolation="antialiased")
    axes.set(title=title)
    axes.axis("off")


def mitsuba() -> Any:
    """Mitsuba, its variant set and Urushi's plugins registered."""
    import mitsuba as mi  # after `urushi` has found an LLVM

    if mi.variant() is None or not mi.variant().startswith("llvm"):
        mi.set_variant("llvm_ad_rgb")
    import urushi.mitsuba  # noqa: F401 (registers the plugins)
    from urushi.adapters import picture

    picture.enough_threads()
    return mi


def labelled(axes: Any, title: str, x: str = "", y: str = "", **more: Any) -> None:
    """Title and labels, and a legend of what has a name."""
    axes.set(title=title, xlabel=x, ylabel=y, **more)
    if axes.get_legend_handles_labels()[1]:
        axes.legend()


def titled(figure: style.Figure, text: str, below: str = "") -> style.Figure:
    """The figure with a headline, and a line for what it means."""
    figure.suptitle(text + (f"\n{below}" if below else ""), x=0.01, ha="left")
    return figure


def run(draw: Callable[[bool], style.Figure]) -> None:
    """``python examples/NAME.py [-o out.png] [--quick]``: draw and save."""
    script = Path(sys.argv[0])
    options = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    options.add_argument("-o", "--output", default=f"{script.stem}.png", help="where the picture goes")
    options.add_argument("--quick", action="store_true", help="fewer points and samples")
    given = options.parse_args()
    style.save(style.styled(draw)(given.quick), given.output)
