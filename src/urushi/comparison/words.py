"""Numbers as people read them, and a report as a table of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .report import Report, Row

#: heads of the table, with what they mean
COLUMNS = {
    "method": "",
    "error": "rms over directions and colours, relative to the peak for the same incident light",
    "uncertain": "what of that the reference and the noise of the answer itself may account for",
    "misplaced": "share of the light that leaves in other directions than it should, or not at all, at the worst angle",
    "largest": "the largest error in one direction, relative to the peak",
    "reflects": "the largest error of reflectance",
    "transmits": "the largest error of transmittance",
    "build": "time to solve",
    "eval": "time of one evaluation, all threads together; of the walk, of one sample",
    "walk's noise": "noise of the walk (rms, relative to the peak) after the time of one evaluation",
    "walks to match": "samples after which the walk's noise is as small as this error",
    "noise of 1 ms": "relative noise of the reflectance after a millisecond of sampling, at 30°",
    "on disk": "what has to be kept, beside the program",
}


def cells(row: Row) -> list[str]:
    """A row of the table, in the order of `COLUMNS`."""
    error = row.error
    if error is None:
        return [row.name, "cannot", *[""] * (len(COLUMNS) - 2)]
    return [
        row.name,
        percent(error.rms),
        percent(error.rms_uncertainty),
        percent(error.misplaced),
        percent(error.largest),
        plain(error.reflectance),
        plain(error.transmittance),
        seconds(row.build),
        nanoseconds(row.eval_ns),
        percent(row.walk_noise),
        walks(row.match),
        percent(row.render_noise),
        size(row.bytes),
    ]


def percent(value: float | None) -> str:
    """A share, to two digits; what is too small or too large to matter as such."""
    if value is None:
        return "-"
    if 0 < value < 1e-5 or value > 10:
        return "< 0.001 %" if value < 1 else "> 1000 %"
    return f"{100 * value:.2g} %" if 100 * value < 99.5 else f"{100 * value:.0f} %"


def walks(value: float | None) -> str:
    """How many walks."""
    if value is None:
        return "-"
    return "< 1" if value < 1 else f"{value:,.0f}" if value < 1e6 else f"{value:.2g}".replace("e+0", "e")


def plain(value: float | None) -> str:
    """A number, to two digits."""
    if value is None:
        return "-"
    return "< 0.00001" if 0 < value < 1e-5 else f"{value:.2g}"


def seconds(value: float | None) -> str:
    """A duration."""
    if value is None:
        return "-"
    return f"{1e3 * value:.2g} ms" if value < 0.1 else f"{value:.2g} s" if value < 10 else f"{value:.0f} s"


def nanoseconds(value: float | None) -> str:
    """The time of one evaluation."""
    if value is None:
        return "-"
    return f"{value:.3g} ns" if value < 1e3 else f"{value / 1e3:.3g} µs"


def size(value: int | None) -> str:
    """Bytes on disk."""
    if value is None:
        return "-"
    return (
        f"{value} B" if value < 1000 else f"{value / 1e3:.3g} kB" if value < 1e6 else f"{value / 1e6:.3g} MB"
    )


def text(report: Report) -> str:
    """The report for a terminal that knows no colours."""
    table = [list(COLUMNS), *(cells(row) for row in report.rows)]
    width = [max(len(row[i]) for row in table) for i in range(len(COLUMNS))]
    lines = [f"{report.name}, against {report.reference}"]
    for row in table:
        first, *rest = row
        lines.append(
            "  ".join([first.ljust(width[0]), *(c.rjust(w) for c, w in zip(rest, width[1:], strict=True))])
        )
    lines += [
        f"{row.name} cannot do this: {'; '.join(row.cannot)}" for row in report.rows if row.error is None
    ]
    return "\n".join([*(line.rstrip() for line in lines), report.verdict])
