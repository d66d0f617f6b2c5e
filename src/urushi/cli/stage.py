"""The scene that `urushi render` shows a material in; a Mitsuba variant must be set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from urushi.cli.common import WrongUsage
from urushi.errors import UrushiError


def builtin(bsdf: dict[str, Any], size: tuple[int, int], light: str, shape: str) -> Any:
    """The built-in scene with the material `bsdf`, instantiated.

    Raises:
        UrushiError: Mitsuba, or the material's plugin, refuses.
    """
    import mitsuba as mi

    from urushi.adapters.scene import scene
    from urushi.adapters.scene_file import said

    try:
        return mi.load_dict(scene(bsdf, size=size, light=light, shape=shape))
    except RuntimeError as error:
        raise UrushiError(said(error)) from error


def from_file(path: Path, name: str | None, bsdf: dict[str, Any], size: tuple[int, int] | None) -> Any:
    """The user's scene with the BSDF called `name` exchanged for `bsdf`, instantiated.

    Raises:
        WrongUsage: the scene has no BSDF of that name; the message lists those it has.
        UrushiError: the scene cannot be read or built.
    """
    from urushi.adapters.scene_file import SceneFile

    file = SceneFile(path)
    if name not in (ids := file.materials()):
        asked = "--material is needed with --scene" if name is None else f"the scene has no BSDF {name!r}"
        raise WrongUsage(f"{asked}; {path} has {', '.join(ids) or 'none with an id'}")
    file.replace(name, bsdf)
    if size is not None:
        file.resize(*size)
    return file.instantiate()
