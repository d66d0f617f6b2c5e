"""A BSDF from wherever it may come: what `urushi check` and `urushi compare --with` are given.

    answer('{"type": "principled", "roughness": 0.3}')    a Mitsuba BSDF, as JSON; or as a dictionary, or an instance
    answer("scene.xml", "wall")                           the BSDF of that id in a Mitsuba file, .xml or .json
    answer("coat.bsdf"), answer("coat.urushi.npz")        a Fourier file, a solved stack

In JSON, a list of three numbers stands for a colour, where Mitsuba wants ``{"type": "rgb", "value": [...]}``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from urushi.errors import UrushiError
from urushi.solvers import BSDF

from .mitsuba.contender import MitsubaBSDF, mitsuba
from .native.file import ENDING
from .scene_file import SceneFile, said

#: endings of files that `answer` reads besides those of solved stacks
FILES = (".xml", ".json", ".bsdf")


def answer(what: Any, bsdf: str | None = None, **options: Any) -> BSDF:
    """The BSDF that `what` names.

    Args:
        what: see the module docstring; a `urushi.solvers.BSDF` is given back as it is.
        bsdf: the id of a BSDF in a file of several.
        **options: of `MitsubaBSDF`, where it is one.

    Raises:
        UrushiError: no such file or BSDF, or what Mitsuba says against it.
        MaterialError: a file that is damaged.
    """
    if isinstance(what, BSDF):
        return what
    text = os.fspath(what) if isinstance(what, (str, os.PathLike)) else None
    if text is not None and text.lstrip().startswith("{"):
        what, text = _json(text, "the JSON that was given"), None
    if text is None:
        if bsdf is not None:
            raise UrushiError(f"bsdf: found {bsdf!r}; allowed with a file of several BSDFs only")
        mi = mitsuba()
        if isinstance(what, dict):
            name = options.pop("name", str(what.get("type", "")))
            return MitsubaBSDF(_built(mi, what), name=name, **options)
        return MitsubaBSDF(what, **options)
    return _file(Path(text), bsdf, options)


def is_answer(text: str) -> bool:
    """Whether a word of the command line is for `answer`, and no material."""
    lower = text.lower()
    if text.lstrip().startswith("{") or lower.endswith((".xml", ".bsdf", ENDING)):
        return True
    if lower.endswith(".json") and Path(text).is_file():
        content = _json(Path(text).read_text("utf-8"), text)
        return isinstance(content, dict) and "type" in content and "urushi" not in content
    return False


def _file(path: Path, bsdf: str | None, options: dict[str, Any]) -> BSDF:
    lower = path.name.lower()
    if not lower.endswith((*FILES, ENDING)):
        raise UrushiError(f"found {str(path)!r}; allowed: a file ending in {', '.join((*FILES, ENDING))}")
    if not path.is_file():
        raise UrushiError(f"there is no file {str(path)!r}")
    if lower.endswith(".xml"):
        mi = mitsuba()
        found = _of_scene(path, bsdf)
        return MitsubaBSDF(found, **{"name": bsdf or path.stem} | options)
    if bsdf is not None and lower.endswith(".json"):
        content = _json(path.read_text("utf-8"), str(path))
        inner = content.get(bsdf) if isinstance(content, dict) else None
        if not isinstance(inner, dict):
            names = [key for key, value in content.items() if isinstance(value, dict)]
            raise UrushiError(f"{path} has no BSDF {bsdf!r}; it has: {', '.join(names) or 'none'}")
        return answer(inner, **{"name": bsdf} | options)
    if bsdf is not None:
        raise UrushiError(f"bsdf: found {bsdf!r}; {path} is one BSDF, without a name")
    if lower.endswith(".json"):
        return answer(_json(path.read_text("utf-8"), str(path)), **{"name": path.stem} | options)
    if lower.endswith(ENDING):
        from .native import load

        return load(path)
    mi = mitsuba()
    found = _built(mi, {"type": "fourier", "filename": str(path.resolve())})
    return MitsubaBSDF(found, **{"name": path.name} | options)


def _of_scene(path: Path, name: str | None) -> Any:
    """The BSDF of an id in a Mitsuba XML file, nothing else of which is built."""
    import urushi.mitsuba  # noqa: F401 (a file may name Urushi's own plugins)

    file = SceneFile(path)
    names = file.materials()
    if name is None and len(names) == 1:
        name = names[0]
    if name is None and not file.is_scene:
        return file.instantiate()
    if name is None or name not in names:
        asked = (
            f"{path} has no BSDF {name!r}" if name is not None else f"{path} has more than one BSDF, or none"
        )
        raise UrushiError(f"{asked}; say one of: {', '.join(names) or '(none has an id)'}")
    return file.alone(name)


def _built(mi: Any, description: dict[str, Any]) -> Any:
    import urushi.mitsuba  # noqa: F401

    try:
        loaded = mi.load_dict(_spelt(description), parallel=False)
    except (RuntimeError, TypeError, ValueError) as error:
        text = said(error) if isinstance(error, RuntimeError) else str(error)
        raise UrushiError(f"Mitsuba refuses {_short(description)}: {text}") from None
    if not isinstance(loaded, mi.BSDF):
        raise UrushiError(f"found {_short(description)}, a {type(loaded).__name__}; allowed: a BSDF")
    return loaded


def _spelt(value: Any) -> Any:
    """A description with its colours as Mitsuba wants them."""
    if isinstance(value, dict):
        plain = value.get("type") in ("rgb", "srgb", "spectrum")
        return {key: item if plain else _spelt(item) for key, item in value.items()}
    if (
        isinstance(value, (list, tuple))
        and len(value) == 3
        and all(isinstance(v, (int, float)) for v in value)
    ):
        return {"type": "rgb", "value": [float(v) for v in value]}
    return value


def _json(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise UrushiError(f"{where} is no JSON: {error}") from None


def _short(value: dict[str, Any]) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) < 120 else text[:117] + "..."
