"""A user's Mitsuba scene file with one of its materials exchanged.

The file is read by Mitsuba's own parser, so includes, defaults, references and relative paths mean what they
always mean; then the BSDF of the given id is replaced before anything is instantiated.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from urushi.errors import UrushiError


def said(error: RuntimeError) -> str:
    """What Mitsuba's error says; of one that a Python plugin raised, only what the plugin said."""
    text = str(error).strip()
    if "Traceback (most recent call last)" in text:
        return re.sub(r"^[\w.]+: ", "", text.splitlines()[-1])
    return re.sub(r"\[\w+\.cpp:\d+\] ", "", text)


class SceneFile:
    """A parsed scene, not yet instantiated. A Mitsuba variant must be set.

    Args:
        path: the XML file.

    Raises:
        UrushiError: the file cannot be parsed; the message is Mitsuba's.
    """

    def __init__(self, path: Path) -> None:
        import mitsuba as mi

        self.path = path
        self._config = mi.parser.ParserConfig(mi.variant())
        # Plugins written in Python cannot be instantiated on the parser's worker threads.
        self._config.parallel = False
        mi.file_resolver().prepend(str(path.resolve().parent))
        try:
            self._state = mi.parser.parse_file(self._config, str(path))
        except RuntimeError as error:
            raise UrushiError(f"{path} is not a scene that Mitsuba can read: {said(error)}") from None

    def materials(self) -> list[str]:
        """The ids of the BSDFs in the file, in its order; one without an id cannot be named."""
        return [node.props.id() for node in self._bsdfs() if node.props.id()]

    def replace(self, name: str, bsdf: dict[str, Any]) -> None:
        """Put `bsdf`, a flat Mitsuba dictionary, in the place of the BSDF of that id.

        Raises:
            KeyError: no BSDF has that id.
        """
        import mitsuba as mi

        for node in self._bsdfs():
            if node.props.id() == name:
                props = mi.Properties(bsdf["type"])
                props.set_id(name)
                for key, value in bsdf.items():
                    if key != "type":
                        props[key] = value
                node.props = props
                return
        raise KeyError(name)

    @property
    def is_scene(self) -> bool:
        """Whether the file is a scene, and not one BSDF alone."""
        import mitsuba as mi

        return bool(self._state.nodes[0].type == mi.ObjectType.Scene)

    def alone(self, name: str) -> Any:
        """The BSDF of that id, without the rest of the scene; the file is spent then.

        Raises:
            KeyError: no BSDF has that id.
            UrushiError: Mitsuba cannot build it.
        """
        import mitsuba as mi

        for node in self._bsdfs():
            if node.props.id() == name:
                root = self._state.nodes[0]
                root.type, root.props = mi.ObjectType.BSDF, node.props
                return self.instantiate()
        raise KeyError(name)

    def resize(self, width: int, height: int) -> None:
        """Give every film of the scene this size in pixels; a crop window, which would not fit, is dropped."""
        import mitsuba as mi

        for node in self._state.nodes:
            if node.type == mi.ObjectType.Film:
                for key in [key for key in node.props.keys() if key.startswith("crop_")]:  # noqa: SIM118
                    del node.props[key]
                node.props["width"], node.props["height"] = width, height

    def instantiate(self) -> Any:
        """The scene.

        Raises:
            UrushiError: a plugin or a file that the scene names is missing or wrong; the message is Mitsuba's.
        """
        import mitsuba as mi

        mi.parser.transform_all(self._config, self._state)
        try:
            loaded = mi.parser.instantiate(self._config, self._state)
        except RuntimeError as error:
            raise UrushiError(f"{self.path}: {said(error)}") from None
        return loaded[0] if isinstance(loaded, list) else loaded

    def _bsdfs(self) -> list[Any]:
        import mitsuba as mi

        return [node for node in self._state.nodes if node.type == mi.ObjectType.BSDF]
