"""Formulas as MathML, made while building: no script, no font and no network when reading.

Labels are names like `adding.3` (chapter, number), and are shown as they are, beside the equation and in references
to it, so that a docstring that cites "theory (adding.3)" can be followed by eye.
"""

from __future__ import annotations

import html
import re
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.domains.math import MathDomain
from sphinx.util import logging

LOG = logging.getLogger(__name__)
MATHML = "http://www.w3.org/1998/Math/MathML"
#: those of HTML that XML does not have
ENTITY = re.compile(r"&(?!lt;|gt;|amp;)\w+;")
#: R'_1: a letter or a bracket, primes, and what may stand below
PRIMED = re.compile(r"(\\[A-Za-z]+|[A-Za-z)])('+)(?:_(\{[^}]*\}|\w))?")


class Equations(MathDomain):
    """Sphinx's equations, referred to by their label."""

    def resolve_xref(self, env: Any, docname: str, builder: Any, typ: str, target: str, *rest: Any) -> Any:
        """The reference with its text replaced."""
        found = super().resolve_xref(env, docname, builder, typ, target, *rest)
        if isinstance(found, nodes.reference):
            found.children = []
            found += nodes.Text(f"({target})")
        return found


def raised(found: re.Match[str]) -> str:
    """Primes as superscripts, which docutils would put beside the letter, and an index below the prime."""
    below = f"_{found[3]}" if found[3] else ""
    return f"{found[1]}{below}^{{" + r"\prime " * len(found[2]) + "}"


def joined(mathml: str) -> str:
    """Primes as part of the name they follow: only fonts for formulas have one that may be raised once more."""
    ElementTree.register_namespace("", MATHML)
    tree = ElementTree.fromstring(ENTITY.sub(lambda found: html.unescape(found[0]), mathml))
    for element in tree.iter():
        tag = element.tag.rpartition("}")[2]
        if tag not in ("msup", "msubsup"):
            continue
        primes = "".join(element[-1].itertext()).replace("\n", "").replace(" ", "")
        if set(primes) != {"\N{PRIME}"}:
            continue
        name = element[0]
        name.text = (name.text or "") + primes
        if name.tag.endswith("}mi"):
            name.set("class", "primed")
        element.remove(element[-1])
        element.tag = f"{{{MATHML}}}" + ("mrow" if tag == "msup" else "msub")
    return ElementTree.tostring(tree, encoding="unicode")


def converted(node: Any, block: bool) -> str:
    """MathML of a formula; one that cannot be read is a warning, which ends the build."""
    try:
        return joined(str(tex2mathml(PRIMED.sub(raised, node.astext()), as_block=block)))
    except MathError as error:
        LOG.warning("formula %s: %s", node.astext(), error, location=node)
        return f"<code>{node.astext()}</code>"


def inline(writer: Any, node: Any) -> None:
    """A formula in a sentence."""
    writer.body.append(converted(node, False))
    raise nodes.SkipNode


def display(writer: Any, node: Any) -> None:
    """A formula on a line of its own, with its label."""
    writer.body.append('<div class="math notranslate">')
    writer.body.append(converted(node, True))
    if label := node.get("label"):
        writer.body.append(f'<a class="number" href="#equation-{nodes.make_id(label)}">({label})</a>')
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_domain(Equations, override=True)
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
