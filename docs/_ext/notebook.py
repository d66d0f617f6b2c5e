"""Jupyter notebooks as pages: text as it is, code with the outputs that the file holds. Nothing is run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from typing import Any

from myst_parser.sphinx_ import Parser


def page(notebook: dict[str, Any]) -> str:
    """A notebook as a page in MyST."""
    parts: list[str] = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
        elif cell["cell_type"] == "code":
            parts.append(f"```python\n{source}\n```")
            parts.extend(shown for output in cell["outputs"] for shown in outputs(output))
    return "\n\n".join(parts) + "\n"


def outputs(output: dict[str, Any]) -> Iterator[str]:
    """One output, in the richest form that it has."""
    data = output.get("data", {"text/plain": output.get("text", "")})
    text = {kind: "".join(value) for kind, value in data.items()}
    if "image/png" in text:
        picture = text["image/png"].replace("\n", "")
        html = f'<img alt="what the cell shows" src="data:image/png;base64,{picture}">'
    elif "text/html" in text:
        html = text["text/html"]
    else:
        html = f"<pre>{escape(text['text/plain'])}</pre>"
    yield f'```{{raw}} html\n<div class="output">{html}</div>\n```'


class NotebookParser(Parser):  # type: ignore[misc]
    """For Sphinx: files that end in .ipynb."""

    supported = ("ipynb",)

    def parse(self, inputstring: str, document: Any) -> None:
        """Turn it into a page, and parse that."""
        super().parse(page(json.loads(inputstring)), document)


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_source_suffix(".ipynb", "ipynb")
    app.add_source_parser(NotebookParser)
    return {"parallel_read_safe": True}
