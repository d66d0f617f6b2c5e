"""The house: which way imports point, what importing the package costs, how long a file may be, and what must
not stand in one."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import urushi

PACKAGE = Path(urushi.__file__).parent
ROOT = PACKAGE.parent.parent

# A package may import those further down this list, and itself; on one line they are siblings, apart. Figures stand
# above the adapters since one of them is rendered.
LEVELS = [
    {"cli"},
    {"comparison"},
    {"plot"},
    {"adapters", "checks"},
    {"solvers"},
    {"interfaces", "media"},
    {"optics"},
]
# The description and the small modules beside it compute nothing, and everyone may import them; they
# themselves may look at the bottom level only (the names of the materials whose indices are known).
COMMON = {
    "__init__",
    "cross_section",
    "description",
    "errors",
    "io",
    "llvm",
    "materials",
    "notebook",
    "stack",
}
# The module that Mitsuba's entry point names is one of the adapters.
ALIAS = {"mitsuba": "adapters"}
# Who may import what, of the libraries that are heavy or that belong in one place.
PLACES = {"typer": {"cli"}, "rich": {"cli"}, "matplotlib": {"plot"}}
LONGEST = 400


def level(package: str) -> int | None:
    """The package's place in the order of imports; None for the common ones."""
    package = ALIAS.get(package, package)
    return next((i for i, names in enumerate(LEVELS) if package in names), None)


def imports(source: str, module: str) -> Iterator[str]:
    """The absolute names of what a module imports, also inside its functions and for type checking."""
    package = module if source.startswith("# package") else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = ".".join(parts[: len(parts) - node.level + 1]) if node.level else ""
            name = ".".join(part for part in (base, node.module or "") if part)
            yield from (f"{name}.{alias.name}" for alias in node.names)


def modules() -> Iterator[tuple[str, str]]:
    """(dotted name, source) of every module of the package."""
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        source = path.read_text("utf-8")
        if parts[-1] == "__init__":
            parts, source = parts[:-1], "# package\n" + source
        yield ".".join(parts), source


def faults(module: str, source: str) -> list[str]:
    """What a module imports against the rules, one sentence each."""
    mine = [*module.split("."), "__init__"][1]
    found = []
    for name in imports(source, module):
        parts = name.split(".")
        home = PLACES.get(parts[0])
        if home and mine not in home:
            found.append(f"{module} imports {parts[0]}, which only {' and '.join(sorted(home))} may")
        if parts[0] != "urushi" or len(parts) < 2 or (mine == "__init__" and module == "urushi"):
            continue
        theirs = parts[1]
        up, down = level(mine), level(theirs)
        same = ALIAS.get(theirs, theirs) == ALIAS.get(mine, mine)
        if down is not None and not same and down <= (len(LEVELS) - 2 if up is None else up):
            found.append(f"{module} imports urushi.{theirs}: imports point the other way")
        if mine == theirs == "solvers" and len(module.split(".")) > 2 and len(parts) > 2:
            one, other = module.split(".")[2], parts[2]
            if (
                one != other
                and (PACKAGE / "solvers" / one).is_dir()
                and (PACKAGE / "solvers" / other).is_dir()
            ):
                found.append(f"{module} imports urushi.solvers.{other}: solvers are siblings")
    return found


@pytest.mark.parametrize(("module", "source"), [pytest.param(*found, id=found[0]) for found in modules()])
def test_imports_point_one_way(module, source):
    assert faults(module, source) == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("urushi.optics.fresnel", "from urushi.solvers import walk"),
        ("urushi.interfaces.conductor", "import urushi.media.homogeneous"),
        ("urushi.solvers.walk.inner", "from ...checks import energy"),
        ("urushi.stack", "from urushi import solvers"),
        ("urushi.adapters.picture", "import rich"),
        ("urushi.checks.energy", "def f():\n    import matplotlib.pyplot"),
        ("urushi.adapters.scene", "from urushi.plot import polar"),
        ("urushi.checks.energy", "from urushi.adapters.scene import scene"),
        ("urushi.checks.energy", "import urushi.mitsuba"),
    ],
)
def test_an_import_the_wrong_way_is_noticed(module, line):
    assert len(faults(module, line)) == 1


def test_every_package_has_its_place():
    """A new package of the house is added to the order, not forgotten by it."""
    names = {
        path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    known = set().union(*LEVELS) | COMMON | set(ALIAS) | {"adding"}
    assert names <= known, f"say in {Path(__file__).name} what these may import: {sorted(names - known)}"


def test_importing_the_package_is_light():
    heavy = ("drjit", "mitsuba", "matplotlib", "scipy", "typer", "rich")
    code = f"import sys, urushi; print([name for name in {heavy} if name in sys.modules])"
    environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


# ------------------------------------------------------------------------------------------- files


def files() -> list[Path]:
    """The text files of the repository: what git tracks or would track; else what lies there."""
    try:
        command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
        names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
            "\0"
        )
        found = [ROOT / name for name in names if name]
    except (OSError, subprocess.CalledProcessError):
        found = [path for top in ("src", "tests", "docs", "tools") for path in (ROOT / top).rglob("*")]
    binary = {".png", ".jpg", ".exr", ".npz", ".npy", ".gz", ".pyc", ".bsdf", ".ply", ".spd"}
    return [path for path in found if path.is_file() and path.suffix not in binary]


def test_no_file_is_too_long_or_called_utils():
    for path in files():
        if path.suffix == ".py":
            assert len(path.read_text("utf-8").splitlines()) <= LONGEST, f"{path} has over {LONGEST} lines"
            assert path.stem not in ("utils", "util", "helpers", "misc"), (
                f"{path}: name it after what it does"
            )


# Spelt so that this file does not contain what it looks for.
FORBIDDEN = {
    "a path of one machine": re.compile(r"(?<![\w./~-])/(?:wor[k]|home|roo[t]|Users|tm[p]|mn[t])/[\w.]"),
    "the address of a package registry": re.compile(
        r"pypi\.or[g]|pythonhosted\.or[g]|npmjs\.(?:com|or[g])|crates\.i[o]"
    ),
    "an index option": re.compile(r"--(?:extra-)?index-ur[l]"),
}


@pytest.mark.parametrize("what", FORBIDDEN)
def test_no_file_names(what):
    for path in files():
        match = FORBIDDEN[what].search(path.read_text("utf-8", errors="replace"))
        assert match is None, f"{path.relative_to(ROOT)} contains {what}: {match[0]}"


@pytest.mark.parametrize("what", FORBIDDEN)
def test_a_forbidden_word_is_noticed(what):
    examples = {
        "a path of one machine": 'open("/' + 'home/me/a.txt")',
        "the address of a package registry": "https://py" + "pi.org/simple",
        "an index option": "pip install --index-" + "url x",
    }
    assert FORBIDDEN[what].search(examples[what])


def test_versions_are_pinned_without_addresses():
    for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines():
        if line and not line.startswith("#"):
            assert re.fullmatch(r'[\w.-]+==[\w.]+(; python_version (>=|<) "\d\.\d+")?', line), line


def test_what_is_needed_is_pinned():
    """Every dependency of the package is among the pins (the names as the index normalises them)."""

    def plain(name: str) -> str:
        return re.sub(r"[-_.]+", "-", name).lower()

    pinned = {plain(line.split("==")[0]) for line in (ROOT / "constraints.txt").read_text().splitlines()}
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    needed = re.findall(r'^    "([A-Za-z][\w.-]*)>=', text, re.MULTILINE)
    assert len(needed) > 10
    assert {plain(name) for name in needed} <= pinned


def test_the_version_is_the_same_everywhere():
    assert f'version = "{urushi.__version__}"' in (ROOT / "pyproject.toml").read_text("utf-8")


def test_links_lead_somewhere_and_a_broken_one_is_noticed(tool, tmp_path):
    check_links = tool("check_links")
    assert check_links.main() == 0
    page = tmp_path / "page.md"
    page.write_text("# A `b` c\n[x](other.md) [y](#a-b-c) [z](#d) `[code](no.md)` [web](ftp://nowhere)\n")
    assert [fault.partition(": ")[2] for fault in check_links.broken(page)] == [
        "no such file: other.md",
        "no such heading: #d",
    ]
