"""Run a notebook, and keep in it what its cells show: docs/tutorial.ipynb.

    python tools/run_notebook.py [NOTEBOOK]

A stand-in for Jupyter that needs nothing else: cells run in order in one namespace; what they print and what their last
line is worth becomes their output, as a picture where it can show itself as one.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

TUTORIAL = Path(__file__).resolve().parent.parent / "docs" / "tutorial.ipynb"


def run(notebook: dict[str, Any]) -> dict[str, Any]:
    """The notebook with fresh outputs. What a cell raises goes through, with the cell's number in a note."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    count = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            cell["execution_count"] = count
            cell["outputs"] = shown("".join(cell["source"]), f"cell {count}", namespace)
    return notebook


def shown(source: str, name: str, namespace: dict[str, Any]) -> list[dict[str, Any]]:
    """What one cell shows."""
    tree = ast.parse(source, name)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, name, "exec", dont_inherit=True), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), name, "eval", dont_inherit=True), namespace)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines(printed.getvalue())})
    if value is not None:
        outputs.append({"output_type": "display_data", "metadata": {}, "data": forms(value)})
    return outputs


def forms(value: Any) -> dict[str, Any]:
    """A value as text, and as a picture or markup where it offers that."""
    found: dict[str, Any] = {"text/plain": lines(repr(value))}
    picture = getattr(value, "_repr_png_", lambda: None)()
    markup = getattr(value, "_repr_html_", lambda: None)()
    if picture is not None:
        found["image/png"] = base64.b64encode(picture).decode("ascii")
    elif markup is not None:
        found["text/html"] = lines(markup)
    return found


def lines(text: str) -> list[str]:
    """As notebooks keep text."""
    return text.splitlines(keepends=True)


def main(arguments: list[str]) -> None:
    """Run one, and write it back."""
    path = Path(arguments[0]) if arguments else TUTORIAL
    notebook = run(json.loads(path.read_text("utf-8")))
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
