"""Measure everything and write the tables: `make bench`, or `python benchmarks/run.py --quick`.

A full run takes some minutes and writes `benchmarks/README.md` and `benchmarks/results.json`; a quick one takes about
one, prints its tables and writes nothing unless told where. Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import datetime
import json
import platform
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

from urushi import llvm

HERE = Path(__file__).resolve().parent
PARTS = ("start", "evaluation", "noise", "complete", "adding", "memory", "pictures", "lobes")
INTRODUCTION = """# Benchmarks

Written by `make bench`; the same numbers are in [results.json](results.json). What each measures is in the file of its
name beside this page. A *yardstick* is one evaluation of Mitsuba's built-in `roughplastic` (alpha 0.1), measured in the
same process, in turn with what it is compared with: two machines differ in nanoseconds, less so in yardsticks.

The cases and the figures of pbrt-v4 are in [cases.py](cases.py). They were measured on another machine (a Xeon at
2.5 GHz), on which pbrt takes 1222, 1204 and 2103 ns for one evaluation, or 90, 89 and 156 yardsticks. pbrt evaluates
one pair of directions at a time, Urushi an array of them.
"""


def machine() -> dict[str, Any]:
    """What the numbers were measured on and with."""
    import drjit as dr
    import mitsuba as mi

    return {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "processor": _processor(),
        "threads": dr.thread_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "variant": mi.variant(),
        "LLVM": ".".join(map(str, llvm.ensure().version)),
        "Python": platform.python_version(),
        **{name: metadata.version(name) for name in ("urushi", "mitsuba", "drjit", "numpy")},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        found: dict[str, str] = {}
        for line in lines:
            key, _, value = line.partition(":")
            found.setdefault(key.strip(), value.strip())
        return f"{found['model name']} (family {found['cpu family']}, model {found['model']})"
    except (OSError, KeyError):
        return platform.processor() or "unknown"


def page(results: dict[str, Any]) -> str:
    """The results as Markdown."""
    import importlib

    on = ", ".join(f"{key} {value}" for key, value in results["machine"].items())
    lines = [INTRODUCTION, f"Measured on: {on}.", ""]
    if note := results.get("note"):
        lines += [note, ""]
    for name in PARTS:
        if name in results:
            part = importlib.import_module(name)
            more = (results.get("efficiency"),) if name == "noise" else ()
            lines += [f"## {part.TITLE}", "", *part.table(results[name], *more), ""]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write or print; the exit status."""
    parser = argparse.ArgumentParser(description="Measure Urushi and write the benchmark tables.")
    parser.add_argument("--quick", action="store_true", help="small sizes: a look, not a result")
    parser.add_argument(
        "--only", choices=PARTS, action="append", help="measure this one (again); may be repeated"
    )
    parser.add_argument(
        "--note", help="a sentence for the page: what a reader should know of this run; '' for none"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder for README.md and results.json")
    options = parser.parse_args(arguments)
    parts = options.only or PARTS
    whole = not options.quick and not options.only
    folder = options.output or (HERE if whole else None)

    llvm.ensure()
    import importlib

    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    results: dict[str, Any] = {}
    if options.only and folder and (folder / "results.json").exists():
        results = json.loads((folder / "results.json").read_text("utf-8"))  # the other parts stay as they are
    results["machine"] = machine()
    if options.note is not None:
        results["note"] = options.note
    for name in parts:
        start = time.perf_counter()
        results[name] = importlib.import_module(name).measure(options.quick)
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    if {"noise", "evaluation"} <= results.keys():
        import noise

        results["efficiency"] = noise.gains(results["noise"], results["evaluation"])
    text = page(results)
    if folder is None:
        print(text)
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "README.md").write_text(text, "utf-8")
    (folder / "results.json").write_text(json.dumps(results, indent=2) + "\n", "utf-8")
    print(f"wrote {folder / 'README.md'} and {folder / 'results.json'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
