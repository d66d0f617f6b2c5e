"""Sphinx builds the site from these pages: `make docs`. What is unusual here is said where it is done."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "src"), str(HERE / "_ext")]

import urushi  # noqa: E402
from urushi import llvm  # noqa: E402

llvm.prepare()  # autodoc imports modules that import Dr.Jit, which takes the first LLVM that it finds

project = "Urushi"
author = copyright = "The Urushi authors"
version = release = urushi.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "notebook"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_ext", "data"]
suppress_warnings = ["myst.header"]
nitpicky = True
# The pages of others are not linked to, and of two attributes in one line napoleon takes the first for a type.
nitpick_ignore_regex = [("py:class", r"(numpy|collections|urushi\.comparison)\..*|[a-z_]+")]

autodoc_typehints = "none"
autodoc_member_order = "bysource"
smartquotes_action = "D"  # dashes; quotes are as they are typed
autodoc_preserve_defaults = True
# Docstrings are plain text: one backtick is code, as in the source.
default_role = "code"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"Urushi {version}"
html_static_path = ["_static"]
html_css_files = ["urushi.css"]
html_math_renderer = "mathml"
html_copy_source = html_show_sourcelink = False

#: pages of the repository that are pages of the site under another name
ELSEWHERE = {
    "../README.md#known-limitations": "limitations.md",
    "../README.md": "index.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
    "../benchmarks/README.md": "benchmarks.md",
}


def lead_home(app: Any, name: str, source: list[str]) -> None:
    """Links that leave the folder, right for who reads the repository, lead to the pages made of those files."""
    for there, here in ELSEWHERE.items():
        up = "../" * name.count("/")
        source[0] = source[0].replace(f"]({up}{there}", f"]({up}{here}")


def plain(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are written for reading in the source: a bar is the absolute value, not markup."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", plain)
    app.connect("source-read", lead_home)
