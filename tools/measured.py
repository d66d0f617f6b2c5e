"""The tables of the documentation that hold measurements: of `benchmarks/run.py` and of `tools/make_validation.py`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def _benchmarks() -> dict[str, Any]:
    """What `benchmarks/run.py` measured last."""
    found: dict[str, Any] = json.loads((ROOT / "benchmarks" / "results.json").read_text("utf-8"))
    return found


def benchmarks() -> str:
    """What `benchmarks/run.py` measured last, in short."""
    found = _benchmarks()
    cost, gain = found["evaluation"]["cases"], found["efficiency"]
    lines = ["| what | measured | beside |", "|---|---|---|"]
    for label, what, goal, pbrt in (
        ("a", "a coat over diffuse", 7, 90),
        ("b", "the same with a medium between", 12, 89),
        ("c", "a coat over rough metal", 12, 156),
    ):
        lines.append(
            f"| one evaluation: {what} | {cost[label]['yardsticks']:.1f} yardsticks ({cost[label]['ns']:.0f} core-ns), "
            f"efficiency {gain[label]['by_yardsticks']:.0f} × | goal {goal}; pbrt-v4 {pbrt} |"
        )
    for name, one in found["pictures"]["cases"].items():
        lines.append(f"| a render of `{name}` | {one['ratio']:.2f} × the time | with `{one['against']}` |")
    start = found["start"]
    lines.append(
        f"| 4 million evaluations through numpy | {found['memory']['beyond']:.0f} MB beyond the inputs | goal 1000 |"
    )
    lines.append(f"| `import urushi` | {start['import']:.2f} s | |")
    lines.append(
        f"| `urushi render`, first pixels, nothing cached | {start['first_pass_cold']:.1f} s | goal 15 |"
    )
    machine = found["machine"]
    lines.append("")
    lines.append(f"On {machine['processor']}, {machine['threads']} threads, {machine['date']}.")
    if note := found.get("note"):
        lines.append(note)
    return "\n".join(lines) + "\n"


def methods() -> str:
    """What the methods cost and how far off they are, side by side."""
    found = _benchmarks()
    cost, solved = found["evaluation"]["cases"], found["adding"]["cases"]
    usual = {name: one for name, one in solved.items() if not name.startswith("sharp")}
    seconds, times = [[one[key] for one in usual.values()] for key in ("checked", "eval_ns")]
    sharp = next(one["checked"] for name, one in solved.items() if name.startswith("sharp"))
    far = {name: one["lobes"] for name, one in _validation()["presets"].items() if "lobes" in one}
    worst = max(far, key=lambda name: far[name])
    noise = found["noise"]["cases"]
    first = found["start"]["first_value"].values()
    lines = ["| | `walk` | `adding` | `lobes` |", "|---|---|---|---|"]
    lines.append(
        f"| error | noise only: a sample at 30° is off by {100 * noise['a']['noise'][1]:.0f} % (coated diffuse) to "
        f"{100 * noise['c']['noise'][1]:.0f} % (coated metal) | 1e-3 by default, 1e-6 if asked for | reflectance "
        f"within {_median(list(far.values())):.1g} on half the presets, {far[worst]:.1g} at worst (`{worst}`) |"
    )
    lines.append("| does it know its error? | yes: `with_error=True` | yes: `diagnostics` | no |")
    lines.append(
        f"| before the first value | nothing is solved | {min(seconds):.1g} to {max(seconds):.1f} s; sharp lobes "
        f"{sharp:.0f} s | {min(first):.1g} to {max(first):.1g} s |"
    )
    walk = ", ".join(
        f"{cost[case]['ns']:.0f} ns {what}"
        for case, what in (("a", "coated diffuse"), ("b", "with a medium"), ("c", "coated metal"))
    )
    lines.append(
        f"| a value | {walk} | {min(times) / 1000:.1f} to {max(times) / 1000:.1f} µs | as a few microfacet lobes |"
    )
    return "\n".join(lines) + "\n"


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


def renders() -> str:
    """How long a render takes, beside one with a plain material."""
    found = _benchmarks()
    lines = ["| preset | time of a render |", "|---|---|"]
    for name, one in found["pictures"]["cases"].items():
        lines.append(f"| `{name}` | {one['ratio']:.2f} × that with `{one['against']}` |")
    machine = found["machine"]
    lines += ["", f"On {machine['processor']}, {machine['threads']} threads, {machine['date']}."]
    return "\n".join(lines) + "\n"


def _validation() -> dict[str, Any]:
    """What `tools/make_validation.py` found last."""
    found: dict[str, Any] = json.loads((ROOT / "docs" / "data" / "validation.json").read_text("utf-8"))
    return found


def outside() -> str:
    """Every comparison with a source of truth from outside, by method."""
    found = _validation()
    lines = [
        "| source | quantity | values | its own error | walk: largest, rms of z, worst z | adding | lobes |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for source in found["sources"].values():
        methods = source["methods"]
        for quantity, walk in sorted(methods["walk"]["values"].items()):
            others = (methods[name]["values"].get(quantity) for name in ("adding", "lobes"))
            cells = [f"{one['largest']:.1g}" if one else "" for one in others]
            if methods["lobes"]["cannot"]:
                cells[1] += f" ({methods['lobes']['cannot']} cases refused)"
            lines.append(
                f"| {source['about']} | {quantity} | {walk['count']} | {_error(walk['known'])} "
                f"| {walk['largest']:.1g}, {walk['rms']:.2f}, {walk['worst']:.1f} | {' | '.join(cells)} |"
            )
    return "\n".join([*lines, "", _measured(found)]) + "\n"


def _error(value: float) -> str:
    return f"{value:.1g}" if value else "not told"


def _measured(found: dict[str, Any]) -> str:
    on = found["machine"]
    return (
        f"Measured on {on['processor']}, {on['threads']} threads, with Mitsuba {on['mitsuba']}, {on['date']}."
    )


def between() -> str:
    """The methods against one another, on every preset."""
    lines = ["| preset | walk | its standard error | lobes |", "|---|---:|---:|---:|"]
    for name, one in _validation()["presets"].items():
        if "walk" not in one:
            lines.append(f"| `{name}` | {one['cannot']} | | |")
            continue
        lobes = f"{one['lobes']:.3f}" if "lobes" in one else one["cannot"]
        lines.append(f"| `{name}` | {one['walk']:.4f} | {one['sigma']:.4f} | {lobes} |")
    return "\n".join(lines) + "\n"


#: name of the mark -> what makes the table
TABLES = {
    "benchmarks": benchmarks,
    "methods": methods,
    "renders": renders,
    "outside": outside,
    "between": between,
}
