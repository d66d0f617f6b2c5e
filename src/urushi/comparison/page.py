"""A report as one HTML page that needs nothing else: no network, no scripts; the numbers of the JSON lie in it."""

from __future__ import annotations

from html import escape

from . import svg
from .report import Report, Row, as_json
from .words import COLUMNS, cells, percent

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;max-width:70rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.7rem;margin:0}h2{font-size:1.15rem;margin:2rem 0 .4rem}
table{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums}
th,td{padding:.28rem .8rem;text-align:right;border-bottom:1px solid #ddd;white-space:nowrap;vertical-align:top}
th{font-weight:600}tbody th{text-align:left}
td.why{text-align:left;white-space:normal;color:#555;font-size:.85rem;min-width:18rem}
.scroll{overflow-x:auto}.verdict{background:#eef4f8;border-left:4px solid #0072B2;padding:.7rem 1rem;margin:1rem 0}
.verdict p{margin:.3rem 0}.muted{color:#555}pre{background:#f6f6f6;padding:.6rem .9rem;overflow-x:auto;font-size:.85rem}
.figures{display:flex;flex-wrap:wrap;gap:1.6rem 1.2rem}figure{margin:0;flex:1 1 30rem;max-width:34rem}
figure.wide{flex-basis:100%;max-width:56rem}
figcaption{font-size:.88rem;color:#444}img,svg{max-width:100%;height:auto}
svg text{font:12px system-ui,sans-serif;fill:#222}svg .mid{text-anchor:middle}svg .end{text-anchor:end}
svg .grid{stroke:#e3e3e3}svg .box{fill:#fff;stroke:#888}dt{font-weight:600}dd{margin:0 0 .4rem 1.2rem}
"""


def page(reports: list[Report]) -> str:
    """The whole page of one or several reports."""
    title = ", ".join(report.name for report in reports)
    data = as_json(reports).replace("<", "\\u003c")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}: methods compared</title><style>{STYLE}</style></head><body>"
        + "<hr>".join(fragment(report) for report in reports)
        + f'<script type="application/json" id="data">{data}</script></body></html>\n'
    )


def fragment(report: Report) -> str:
    """One report, without the frame of a page."""
    verdict = "".join(f"<p>{escape(part)}</p>" for part in _sentences(report.verdict))
    parts = [
        f"<h1>{escape(report.name)}</h1>",
        f'<p class="muted">{escape(report.description)}</p>' if report.description else "",
        f'<div class="verdict">{verdict}</div>',
        "<h2>The numbers</h2>",
        f"<p>Held against {escape(report.reference)}"
        + (f" ({percent(report.uncertainty)} of the peak, rms)." if report.uncertainty is not None else ".")
        + "</p>",
        _table(report),
        _cannot(report),
        '<div class="figures">',
        *(_figure(picture, title) for title, picture in _charts(report).items() if picture),
        *(_figure(picture, title, wide=True) for title, picture in report.figures.items()),
        "</div>",
        "<h2>What was compared</h2>",
        f"<pre>{escape(report.layers)}</pre><dl>",
        *(f"<dt>{escape(row.name)}</dt><dd>{escape(row.said or 'not solved')}</dd>" for row in report.rows),
        f'</dl><p><code>method="auto"</code> takes {escape(report.auto)}.</p>',
        f'<p class="muted">Times: {escape(report.machine)}. The comparison took {report.seconds:.0f} s.</p>',
    ]
    return "".join(parts)


def _sentences(text: str) -> list[str]:
    return [part if part.endswith(".") else part + "." for part in text.split(". ")]


def _table(report: Report) -> str:
    """A row for every quantity, with what it means; a column for every answer."""
    head = "".join(f"<th>{escape(row.name)}</th>" for row in report.rows)
    columns = list(zip(*(cells(row) for row in report.rows), strict=True))[1:]
    rows = "".join(
        f"<tr><th>{escape(name)}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in found)
        + f'<td class="why">{escape(meaning)}</td></tr>'
        for (name, meaning), found in zip(list(COLUMNS.items())[1:], columns, strict=True)
    )
    head = f"<thead><tr><th></th>{head}<th></th></tr></thead>"
    return f'<div class="scroll"><table>{head}<tbody>{rows}</tbody></table></div>'


def _cannot(report: Report) -> str:
    said = []
    for row in report.rows:
        if row.error is None:
            said.append(
                f"<li><b>{escape(row.name)}</b> cannot do this stack: {escape('; '.join(row.cannot))}</li>"
            )
        elif row.cannot:
            said.append(f"<li><b>{escape(row.name)}</b> can never do: {escape('; '.join(row.cannot))}</li>")
        if row.error is not None and row.error.where:
            said.append(
                f"<li><b>{escape(row.name)}</b> is furthest off ({percent(row.error.largest)} of the peak) for "
                f"{escape(row.error.where)}</li>"
            )
    return f"<ul>{''.join(said)}</ul>"


def _figure(picture: str, title: str, wide: bool = False) -> str:
    kind = ' class="wide"' if wide else ""
    return f"<figure{kind}>{picture}<figcaption>{escape(title)}</figcaption></figure>"


def _charts(report: Report) -> dict[str, str]:
    """Error against time, the error of reflectance and transmittance, and that of each angle."""
    able = [row for row in report.rows if row.error is not None]
    found = {
        "Error against the time of one evaluation; the dashed line is the noise of the walk with more and more "
        "samples (lower left is better)": svg.chart(
            _against_time(able),
            svg.Axis("time of one evaluation (ns)", log=True),
            svg.Axis("error, relative to the peak (rms)", log=True),
            "error against time for each method",
        ),
    }
    for what in ("reflectance", "transmittance"):
        known = [sum(flux.value) / len(flux.value) for flux in getattr(report, what)]
        if max(known) <= 0:
            continue
        found[f"Error of {what} (mean of the colours), by the angle of the light"] = svg.chart(
            [_flux(row, report, what, i) for i, row in enumerate(able)],
            svg.Axis("angle of the light from the normal (degrees; below the surface from 90)"),
            svg.Axis(f"error of {what}"),
            f"error of {what} for each method",
        )
    return found


def _against_time(rows: list[Row]) -> list[svg.Series]:
    series = [
        svg.Series(row.name, [row.eval_ns or 0.0], [row.error.rms or 0.0], line=False, slot=i)
        for i, row in enumerate(rows)
        if row.error is not None and row.name != "walk"
    ]
    walk = next((row for row in rows if row.name == "walk"), None)
    timed = next((row for row in rows if row.walk_noise and row.eval_ns), None)
    if walk is not None and walk.eval_ns and timed is not None and timed.walk_noise and timed.eval_ns:
        one = timed.walk_noise * (timed.eval_ns / walk.eval_ns) ** 0.5
        counts = [1.0, 10.0, 100.0, 1e3, 1e4]
        times, noise = [n * walk.eval_ns for n in counts], [one / n**0.5 for n in counts]
        series.append(svg.Series("walk", times, noise, dashed=True, slot=rows.index(walk)))
    return series


def _flux(row: Row, report: Report, what: str, slot: int) -> svg.Series:
    angles, off, error = [], [], []
    for flux, known in zip(getattr(row, what), getattr(report, what), strict=True):
        theta = float(flux.view.partition("°")[0])
        angles.append(180 - theta if "below" in flux.view else theta)
        off.append(sum(a - b for a, b in zip(flux.value, known.value, strict=True)) / len(flux.value))
        error.append(max(a**2 + b**2 for a, b in zip(flux.error, known.error, strict=True)) ** 0.5)
    order = sorted(range(len(angles)), key=lambda i: angles[i])
    return svg.Series(
        row.name, [angles[i] for i in order], [off[i] for i in order], [error[i] for i in order], slot=slot
    )
