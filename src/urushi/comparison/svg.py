"""Small charts as SVG, for the page: points and lines on linear or logarithmic axes, nothing else needed.

Colours are those of Okabe and Ito (2008), which readers of any colour vision tell apart; shapes differ as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
WIDTH, HEIGHT = 560, 330
LEFT, RIGHT, TOP, BOTTOM = 66, 150, 14, 48


@dataclass(frozen=True)
class Series:
    """Points of one name: x, y, and half the length of an error bar (or none); joined by lines, or not.

    `slot` chooses colour and shape, so that one name looks the same in every chart.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    error: Sequence[float] | None = None
    line: bool = True
    dashed: bool = False
    slot: int = 0


@dataclass(frozen=True)
class Axis:
    """A label with its unit, and whether it is logarithmic."""

    label: str
    log: bool = False


def chart(series: Sequence[Series], across: Axis, up: Axis, title: str) -> str:
    """An SVG element; `title` is what a reader who cannot see it is told.

    Series without points are left out, and so is what a logarithmic axis has no place for: values of 0 or less.
    """
    kept = [_kept(one, across.log, up.log) for one in series]
    kept = [one for one in kept if len(one.x)]
    if not kept:
        return ""
    low_x, high_x, ticks_x = _range([x for one in kept for x in one.x], across.log)
    spread = [v for one in kept for v in _reach(one, up.log)]
    low_y, high_y, ticks_y = _range(spread, up.log)

    def px(x: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * _place(x, low_x, high_x, across.log)

    def py(y: float) -> float:
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * _place(y, low_y, high_y, up.log)

    parts = [
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - RIGHT}" height="{HEIGHT - TOP - BOTTOM}" class="box"/>'
    ]
    for tick in ticks_x:
        parts.append(
            f'<line x1="{px(tick):.1f}" x2="{px(tick):.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" class="grid"/>'
        )
        parts.append(f'<text x="{px(tick):.1f}" y="{HEIGHT - BOTTOM + 16}" class="mid">{_tick(tick)}</text>')
    for tick in ticks_y:
        parts.append(
            f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{py(tick):.1f}" y2="{py(tick):.1f}" class="grid"/>'
        )
        parts.append(f'<text x="{LEFT - 6}" y="{py(tick) + 4:.1f}" class="end">{_tick(tick)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 10}" class="mid">{escape(across.label)}</text>')
    y = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(f'<text x="14" y="{y}" class="mid" transform="rotate(-90 14 {y})">{escape(up.label)}</text>')
    for i, one in enumerate(kept):
        colour = COLOURS[one.slot % len(COLOURS)]
        points = [(px(x), py(y)) for x, y in zip(one.x, one.y, strict=True)]
        if one.line and len(points) > 1:
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            dash = ' stroke-dasharray="6 4"' if one.dashed else ""
            parts.append(
                f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.8"{dash}/>'
            )
        for (x, y), value, error in zip(points, one.y, one.error or [0.0] * len(points), strict=True):
            if error > 0 and not up.log:
                parts.append(
                    f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{py(value - error):.1f}" y2="{py(value + error):.1f}" '
                    f'stroke="{colour}" stroke-width="1.5"/>'
                )
            if not one.dashed:
                parts.append(_mark(one.slot, x, y, colour))
        row = TOP + 12 + 20 * i
        right = WIDTH - RIGHT + 16
        parts.append(
            f'<line x1="{right - 8}" x2="{right + 8}" y1="{row}" y2="{row}" stroke="{colour}" stroke-width="1.8"'
            + (' stroke-dasharray="6 4"/>' if one.dashed else "/>" if one.line else ' opacity="0"/>')
        )
        if not one.dashed:
            parts.append(_mark(one.slot, right, row, colour))
        parts.append(f'<text x="{right + 14}" y="{row + 4}">{escape(_short(one.name))}</text>')
    body = "".join(parts)
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title, quote=True)}">{body}</svg>'


def _kept(one: Series, log_x: bool, log_y: bool) -> Series:
    rows = [
        i
        for i, (x, y) in enumerate(zip(one.x, one.y, strict=True))
        if math.isfinite(x) and math.isfinite(y) and (x > 0 or not log_x) and (y > 0 or not log_y)
    ]
    error = [one.error[i] for i in rows] if one.error is not None else None
    return Series(
        one.name, [one.x[i] for i in rows], [one.y[i] for i in rows], error, one.line, one.dashed, one.slot
    )


def _reach(one: Series, log: bool) -> list[float]:
    if log or one.error is None:
        return list(one.y)
    return [v for y, e in zip(one.y, one.error, strict=True) for v in (y - e, y + e)]


def _range(values: Sequence[float], log: bool) -> tuple[float, float, list[float]]:
    """Ends of an axis and its ticks."""
    low, high = min(values), max(values)
    if log:
        first, last = math.floor(math.log10(low) - 0.05), math.ceil(math.log10(high) + 0.05)
        every = max(1, math.ceil((last - first) / 7))
        return 10.0**first, 10.0**last, [10.0**k for k in range(first, last + 1, every)]
    if high - low < 1e-12:
        low, high = low - 0.5e-3, high + 0.5e-3
    pad = 0.06 * (high - low)
    low, high = low - pad, high + pad
    step = 10.0 ** math.floor(math.log10((high - low) / 4))
    step = next(step * k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= 6)
    return low, high, [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _place(value: float, low: float, high: float, log: bool) -> float:
    if log:
        value, low, high = math.log10(value), math.log10(low), math.log10(high)
    return (value - low) / (high - low)


def _tick(value: float) -> str:
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}".replace("-", "−")
    mantissa, exponent = f"{value:.0e}".split("e")
    head = "" if mantissa == "1" else f"{mantissa}·".replace("-", "−")
    digits = str(int(exponent)).replace("-", "−")
    return f'{head}10<tspan dy="-5" font-size="9">{digits}</tspan>'


def _mark(slot: int, x: float, y: float, colour: str) -> str:
    shapes = (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="{colour}"/>',
        f'<rect x="{x - 4:.1f}" y="{y - 4:.1f}" width="8" height="8" fill="{colour}"/>',
        f'<path d="M{x:.1f},{y - 5.5:.1f} l5.5,10 h-11 z" fill="{colour}"/>',
        f'<path d="M{x:.1f},{y - 6:.1f} l6,6 l-6,6 l-6,-6 z" fill="{colour}"/>',
    )
    return shapes[slot % len(shapes)]


def _short(name: str) -> str:
    return name if len(name) <= 17 else name[:16] + "…"
