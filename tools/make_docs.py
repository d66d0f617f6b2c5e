"""Write the tables of the documentation that the code knows better: parameters, metals, presets, measurements.

A page marks where a table belongs, and the text between the marks is replaced:

    <!-- table: dielectric -->
    <!-- end -->

    python tools/make_docs.py           write
    python tools/make_docs.py --check   exit status 1 if a page is not current
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import measured
import urushi as ur
from urushi import stack as description
from urushi.optics.ior import conductor_names

ROOT = Path(__file__).resolve().parent.parent
MARK = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def parameters(kind: str) -> str:
    """Everything that may be said about one piece of a material: its parameters and its choices."""
    piece = {"stack": description.Stack, "texture": ur.Texture, **description.LAYERS, **description.PHASES}[
        kind
    ]
    known = {row["name"]: row for row in description.parameter_table()}
    lines = ["| name | what | allowed | default |", "|---|---|---|---|"]
    for name, rule in piece.rules().items():
        field, row = piece.model_fields[name], known.get(f"{kind}.{name}")
        default = "required" if field.is_required() else _said(field.default)
        if row and row["source"] and default not in ("", "required"):
            default += f" ({row['source']})"
        unit = f", in {row['unit']}" if row and row["unit"] else ""
        shown = "texture" if (kind, name) == ("texture", "file") else name
        lines.append(f"| `{shown}` | {rule.meaning}{unit} | {rule.allowed()} | {default} |")
    return "\n".join(lines) + "\n"


def _said(default: object) -> str:
    if default is None or default == "":
        return ""
    if isinstance(default, bool):
        return str(default).lower()
    return f"{default:g}" if isinstance(default, float) else getattr(type(default), "kind", str(default))


def metals() -> str:
    """The names that `material` knows."""
    return ", ".join(f"`{name}`" for name in conductor_names()) + "\n"


def presets() -> str:
    """The materials that come with the package."""
    lines = ["| preset | what it is |", "|---|---|"]
    for name in ur.presets():
        lines.append(f"| `{name}` | {' '.join(ur.load(f'preset:{name}').description.split())} |")
    return "\n".join(lines) + "\n"


def pages() -> list[Path]:
    """Every page that may have a table."""
    docs = ROOT / "docs"
    return [ROOT / "README.md", *(path for path in sorted(docs.rglob("*.md")) if "_build" not in path.parts)]


def current(text: str) -> str:
    """A page with its tables as they should be."""
    whole = {"metals": metals, "presets": presets, **measured.TABLES}

    def table(match: re.Match[str]) -> str:
        name = match[2]
        return match[1] + (whole[name]() if name in whole else parameters(name)) + match[3]

    return MARK.sub(table, text)


def main(arguments: list[str]) -> int:
    """Write, or check; the exit status."""
    stale = []
    for page in pages():
        text = page.read_text("utf-8")
        if (new := current(text)) != text:
            stale.append(page.name)
            if "--check" not in arguments:
                page.write_text(new, "utf-8")
    for name in stale:
        print(f"{name} {'is not current' if '--check' in arguments else 'written'}")
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
