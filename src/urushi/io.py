"""Material files: reading and writing stacks as YAML or JSON, and the presets that come with the package."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

from urushi.description.base import Data, shown
from urushi.description.parameter import Texture
from urushi.description.reading import Node, line_of, parse
from urushi.description.schema import VERSION, file_schema
from urushi.description.writing import json_text, yaml_text
from urushi.errors import MaterialError, close
from urushi.stack import Stack

_FORMS = {".yaml": "yaml", ".yml": "yaml", ".json": "json"}
_PRESETS = Path(__file__).parent / "materials"
_LARGEST = 1_000_000
"""Bytes that a material file may have."""


def load(source: str | os.PathLike[str]) -> Stack:
    """Read a stack from a material file or from the presets.

    Args:
        source: path of a ``.yaml``, ``.yml`` or ``.json`` file, or ``"preset:NAME"`` with a name from `presets`.

    Returns:
        The stack. Paths of textures are absolute: in the file they are relative to its folder.

    Raises:
        MaterialError: the file cannot be read, is not a valid description, or names a texture that cannot be read.
            It says the file, the place in it, what was found and what is allowed.
    """
    try:
        text = os.fspath(source)
    except TypeError:
        raise MaterialError(
            f"found {shown(source)}; allowed: the path of a material file, or 'preset:NAME'"
        ) from None
    if isinstance(text, str) and text.startswith("preset:"):
        name = text.removeprefix("preset:")
        if name not in presets():
            raise MaterialError(
                f"unknown preset; {close(name, presets())}allowed: {', '.join(presets())}",
                where=f"preset:{name}",
            )
        path = _PRESETS / f"{name}.yaml"
    else:
        path = Path(os.fsdecode(text))
    try:
        return loads(_read(path), _form(path), folder=path.absolute().parent)
    except MaterialError as error:
        raise MaterialError(error.problem, where=error.where or "the file", file=_printable(path)) from None


def loads(text: str, form: str = "yaml", *, folder: str | os.PathLike[str] | None = None) -> Stack:
    """Read a stack from text.

    Args:
        text: a whole material file.
        form: "yaml" or "json".
        folder: where relative paths of textures begin (the working directory if None).

    Returns:
        The stack.

    Raises:
        MaterialError: not a valid description.
    """
    if form not in _FORMS.values():
        raise MaterialError(f"found the format {shown(form)}; allowed: 'yaml' or 'json'")
    root = parse(text, form)
    try:
        stack = _stack(root, Path.cwd() if folder is None else Path(folder).absolute())
        for name, value in stack.parameters().items():
            if isinstance(value, Texture):
                _check_readable(value, name)
    except MaterialError as error:
        line = line_of(root, error.where) if error.where else 0
        problem = f"{error.problem} (line {line})" if line else error.problem
        raise MaterialError(problem, where=error.where or "the file") from None
    return stack


def _stack(root: Node, folder: Path) -> Stack:
    data = root.data
    if not isinstance(data, dict):
        found = "an empty file" if data is None else f"a {type(data).__name__} at the top"
        raise MaterialError(
            f"found {found}; allowed: a mapping with the keys urushi, {', '.join(Stack.model_fields)}"
        )
    if "urushi" not in data:
        near = close(next(iter(data), ""), ["urushi"])
        raise MaterialError(f"missing; {near}allowed: the version of the format, {VERSION}", where="urushi")
    version = data["urushi"]
    if isinstance(version, bool) or not isinstance(version, int) or version != VERSION:
        raise MaterialError(
            f"found version {shown(version)} of the format; allowed: {VERSION}, the one that this Urushi reads",
            where="urushi",
        )
    rest = {key: value for key, value in data.items() if key != "urushi"}
    return Stack.model_validate(_anchored(rest, folder))


def _anchored(data: Data, folder: Path) -> Data:
    """The data with every texture's path made absolute from ``folder``."""
    if isinstance(data, list):
        return [_anchored(item, folder) for item in data]
    if not isinstance(data, dict):
        return data
    file = data.get("texture")
    if isinstance(file, str) and file:
        return {**data, "texture": os.path.join(folder, file)}
    return {key: _anchored(value, folder) for key, value in data.items()}


def _check_readable(texture: Texture, name: str) -> None:
    layer, _, field = name.partition(".")
    where = f"layers[{layer.removeprefix('layer_')}].{field}"
    try:
        if not texture.path.is_file():
            raise MaterialError(f"found texture {shown(texture.file)}, which is no file", where=where)
        with texture.path.open("rb"):
            pass
    except OSError as error:
        raise MaterialError(f"found texture {shown(texture.file)}: {error.strerror}", where=where) from None


def _printable(path: Path) -> str:
    """The path as text that any terminal can show."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def _form(path: Path) -> str:
    form = _FORMS.get(path.suffix.lower())
    if form is None:
        raise MaterialError(f"found the extension {shown(path.suffix)}; allowed: {', '.join(_FORMS)}")
    return form


def _read(path: Path) -> str:
    _form(path)
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise MaterialError("is no regular file; allowed: a material file")
        with path.open("rb") as stream:
            content = stream.read(_LARGEST + 1)
    except FileNotFoundError:
        hint = (
            f"did you mean 'preset:{path.stem}'?" if path.stem in presets() else "allowed: a file that exists"
        )
        raise MaterialError(f"there is no such file; {hint}") from None
    except OSError as error:
        raise MaterialError(f"cannot be read: {error.strerror}") from None
    except ValueError:
        raise MaterialError("is no path; allowed: a path without null characters") from None
    if len(content) > _LARGEST:
        raise MaterialError(
            f"has more than {_LARGEST} bytes; allowed: a material file, which has a few hundred"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise MaterialError(
            f"found byte 0x{content[error.start]:02x}, which is not UTF-8; allowed: UTF-8 text",
            where=f"line {line}",
        ) from None


def dumps(stack: Stack, form: str = "yaml", *, folder: str | os.PathLike[str] | None = None) -> str:
    """Write a stack as text; `loads` reads back an equal one.

    Args:
        stack: what to write.
        form: "yaml" or "json".
        folder: where relative paths of textures begin; None writes absolute paths.

    Returns:
        A whole material file.

    Raises:
        MaterialError: not a stack, or an unknown format.
    """
    if not isinstance(stack, Stack):
        raise MaterialError(f"found {shown(stack)}; allowed: a Stack")
    if form not in _FORMS.values():
        raise MaterialError(f"found the format {shown(form)}; allowed: 'yaml' or 'json'")
    data = stack.data(None if folder is None else Path(folder).absolute())
    keys = ("name", "description", "exterior", "layers")
    document = {"urushi": VERSION, **{key: data[key] for key in keys if key in data and data[key] != ""}}
    return json_text(document) if form == "json" else yaml_text(document)


def save(stack: Stack, path: str | os.PathLike[str]) -> None:
    """Write a stack to a material file, whole or not at all.

    Args:
        stack: what to write.
        path: a ``.yaml``, ``.yml`` or ``.json`` file; an existing one is replaced once the new one is complete.

    Raises:
        MaterialError: not a stack, another extension, or a folder that cannot be written to.
    """
    try:
        target = Path(os.fsdecode(path))
    except TypeError:
        raise MaterialError(f"found {shown(path)}; allowed: the path of a material file") from None
    try:
        real = Path(os.path.realpath(target))  # through a symbolic link, which stays
        # The textures' paths begin at the folder through which the file will be opened.
        text = dumps(stack, _form(target), folder=target.absolute().parent)
        replace(real, text.encode("utf-8"))
    except MaterialError as error:
        raise MaterialError(error.problem, where=error.where, file=_printable(target)) from None
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or str(error)
        raise MaterialError(f"cannot be written: {problem}", file=_printable(target)) from None


def replace(path: Path, content: bytes) -> None:
    """Put a file in the place of another, or in none: whole, or not at all.

    Raises:
        MaterialError: the path is a folder.
        OSError: it cannot be written.
    """
    if path.is_dir():
        raise MaterialError("is a folder; allowed: a file")
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(name, stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def _umask() -> int:
    """The process's mask, which can only be read by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def presets() -> list[str]:
    """Names of the materials that come with the package, sorted; ``load("preset:NAME")`` reads one."""
    return sorted(path.stem for path in _PRESETS.glob("*.yaml"))


def schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a material file, for editors and other tools."""
    return file_schema(Stack)
