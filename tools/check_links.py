"""Check the links in the documentation: every relative link in README.md, CONTRIBUTING.md, CHANGELOG.md
and docs/**/*.md must name a file in the repository, and every #anchor a heading of the file it points to.

Links to other sites are not followed: a check that needs the network fails for reasons of its own.
Exit status 1 and one line for each broken link.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
CODE = re.compile(r"^(```|~~~).*?^\1[ \t]*$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """The #anchors of a Markdown page's headings, formed as GitHub forms them."""
    text = re.sub(r"^(```|~~~).*?^\1[ \t]*$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    found: set[str] = set()
    for heading in HEADING.findall(text):
        plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number = 0
        while (name := f"{slug}-{number}" if number else slug) in found:
            number += 1
        found.add(name)
    return found


def broken(page: Path) -> list[str]:
    """One sentence for each broken link of a Markdown page."""
    faults = []
    for target in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        if re.match(r"[a-z][a-z0-9+.-]*:", target, re.IGNORECASE):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists():
            faults.append(f"{os.path.relpath(page, ROOT)}: no such file: {target}")
        elif anchor and file.suffix == ".md" and anchor.lower() not in anchors(file):
            faults.append(f"{os.path.relpath(page, ROOT)}: no such heading: {target}")
    return faults


def main() -> int:
    """Check every page; returns the exit status."""
    pages = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    pages += sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
    pages = [page for page in pages if page.exists()]
    faults = [fault for page in pages for fault in broken(page)]
    print("\n".join(faults) if faults else f"{len(pages)} pages: every link leads somewhere")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
