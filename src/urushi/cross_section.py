"""A stack drawn as a cross-section: shapes in pixels, y down, for whoever draws them; and as SVG for a notebook.

Surfaces are as rough as their facets (the slopes of the profile have the deviation `alpha`), media have the colour
that white light is left with after crossing them once and a particle for so much scattering, metals and paints have
the colour they reflect at normal incidence. Heights are not to scale: a deeper medium is drawn higher, and no layer
so low that its label would not fit. The same stack gives the same drawing.
"""

from __future__ import annotations

import html
import math
import random
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from urushi.stack import Stack, Texture, in_words

WIDTH = 710.0
LEFT, RIGHT, LABELS = 14.0, 300.0, 326.0
LINE = 16.0
"""Height of a line of text; text is set at 12.5 pixels."""
SIZE = 12.5
WRAP = 52
MOST = 15
"""Layers drawn; of a higher stack, those in the middle are left out, and the drawing says so."""
FACET, HIGHEST = 6.0, 10.0
"""Width of a facet, and how far a surface may leave its mean."""
SLANT = math.radians(38.0)
UNKNOWN = (0.6, 0.6, 0.6)
"""Linear colour of what an image holds."""

INK, CLEAR, LIGHT = "#222222", "#eaf1f6", "#c77700"

Point = tuple[float, float]
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Shape:
    """One thing to draw, later ones over earlier ones.

    Attributes:
        kind: "area", "line", "arrow", "dots" or "text".
        points: corners, ends, centres, or the left end of the text's middle line.
        colour: #rrggbb.
        width: of lines, radius of dots, size of text.
        text: what the text says.
        bold: whether it is bold.
        dashed: whether the line is.
    """

    kind: str
    points: tuple[Point, ...]
    colour: str
    width: float = 1.0
    text: str = ""
    bold: bool = False
    dashed: bool = False


@dataclass
class Drawing:
    """Shapes within `width` by `height` pixels."""

    width: float
    height: float
    shapes: list[Shape] = field(default_factory=list)

    def svg(self) -> str:
        """As one SVG element that needs nothing else."""
        body = "".join(_element(shape) for shape in self.shapes)
        size = f'width="{self.width:g}" height="{self.height:g}" viewBox="0 0 {self.width:g} {self.height:g}"'
        font = "font-family=\"'DejaVu Sans',Verdana,sans-serif\""
        head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {font}>'
        return f'{head}<rect width="100%" height="100%" fill="#ffffff"/>{body}</svg>'


@dataclass
class _Band:
    """What lies between two surfaces; `label` is empty for what the description has no layer for."""

    kind: str  # "outside", "clear", "medium", "base", "gap"
    index: float
    label: list[str] = field(default_factory=list)
    layer: Any = None
    top: float = 0.0
    bottom: float = 0.0


@dataclass
class _Surface:
    """Between two bands; without a layer it is a boundary that light does not notice."""

    label: list[str] = field(default_factory=list)
    alpha: float = 0.0
    layer: Any = None


def as_html(stack: Stack) -> str:
    """Name, description and cross-section, for a notebook."""
    name = html.escape(stack.name or "unnamed stack")
    text = f"<p style='margin:0.2em 0'>{html.escape(stack.description)}</p>" if stack.description else ""
    return f"<div><strong>{name}</strong>{text}{draw(stack).svg()}</div>"


def draw(stack: Stack) -> Drawing:
    """The cross-section, with a label for every layer."""
    bands, surfaces = _taken_apart(stack)
    _place(bands, surfaces)
    bottom = bands[-1].bottom
    drawing = Drawing(WIDTH, bottom)
    profiles: list[tuple[Point, ...]] = [((LEFT, 0.0), (RIGHT, 0.0))]
    profiles += [_profile(surface, bands[k].bottom, k) for k, surface in enumerate(surfaces)]
    profiles.append(((LEFT, bottom), (RIGHT, bottom)))
    for k, band in enumerate(bands):
        drawing.shapes += _filled(band, profiles[k], profiles[k + 1], k)
    for surface, profile in zip(surfaces, profiles[1:-1], strict=True):
        width = 1.4 if surface.layer is not None else 0.8
        drawing.shapes.append(Shape("line", profile, INK, width, dashed=surface.layer is None))
    drawing.shapes += _light(bands)
    for band in bands:
        drawing.shapes += _label(band.label, (band.top + band.bottom) / 2, leader=band.kind != "outside")
    for band, surface in zip(bands, surfaces, strict=False):
        drawing.shapes += _label(surface.label, band.bottom)
    return drawing


# ------------------------------------------------------------------------------------------- layout


def _taken_apart(stack: Stack) -> tuple[list[_Band], list[_Surface]]:
    """Bands from the top down, and the surfaces between them: one fewer."""
    count = len(stack.layers)
    shown = set(range(count)) if count <= MOST else {*range(MOST // 2), *range(count - MOST // 2, count)}
    index = stack.exterior
    bands, surfaces = [_Band("outside", index, [_outside(index, "above")])], []
    waiting: _Surface | None = None
    for i, layer in enumerate(stack.layers):
        if i not in shown:
            index = _number(getattr(layer, "ior", index), index)
            if i == MOST // 2:
                surfaces.append(waiting or _Surface())
                bands.append(_Band("gap", index, [f"{count - len(shown)} layers more, not drawn"]))
                waiting = None
            continue
        if waiting and not layer.is_medium:  # a clear layer between two surfaces
            surfaces.append(waiting)
            bands.append(_Band("clear", index))
            waiting = None
        if layer.is_medium:
            surfaces.append(waiting or _Surface())
            bands.append(_Band("medium", index, _said(i, layer), layer))
            waiting = None
        elif layer.opaque:
            surfaces.append(_Surface([], _slope(layer), layer))
            bands.append(_Band("base", index, _said(i, layer), layer))
        else:
            index = _number(getattr(layer, "ior", index), index)
            waiting = _Surface(_said(i, layer), _slope(layer), layer)
    if not stack.layers[-1].opaque:
        surfaces.append(waiting or _Surface())
        bands.append(_Band("outside", index, [_outside(index, "below")]))
    return bands, surfaces


def _place(bands: list[_Band], surfaces: list[_Surface]) -> None:
    """Heights such that every label has room where its layer is."""
    labels = [0, *(len(surface.label) for surface in surfaces), 0]
    y = 0.0
    for k, band in enumerate(bands):
        above, below = labels[k], labels[k + 1]
        room = LINE * (above + below) / 2 + 8.0
        if band.label:  # which stands in the middle, and on each side of it half of the surface's label
            room = LINE * (len(band.label) + max(above, below)) + 14.0
        band.top, band.bottom = y, y + max(_height(band), room)
        y = band.bottom


def _height(band: _Band) -> float:
    if band.kind == "medium":
        depth = sum(_three(_depth(band.layer), 1.0)) / 3
        return 36.0 + 30.0 * math.log10(1.0 + 3.0 * depth)
    return {"outside": 66.0, "clear": 34.0, "base": 54.0, "gap": 44.0}[band.kind]


def _said(i: int, layer: Any) -> list[str]:
    """The lines of a layer's label; the first is its heading."""
    surface = not layer.is_medium
    how = (", rough" if _slope(layer) > 0 else ", smooth") if surface and layer.kind != "diffuse" else ""
    return [f"{i}  {layer.kind.replace('_', ' ')}{how}", *textwrap.wrap(in_words(layer), WRAP)]


def _outside(index: float, where: str) -> str:
    return f"{'air' if index == 1.0 else f'index {index:g}'} {where}"


# ------------------------------------------------------------------------------------------- drawing


def _profile(surface: _Surface, y: float, seed: int) -> tuple[Point, ...]:
    """The line of a surface, from left to right: facets of random slopes that stay near the mean."""
    if surface.alpha <= 0:
        return ((LEFT, y), (RIGHT, y))
    dice = random.Random(seed)
    count = round((RIGHT - LEFT) / FACET)
    height, points = 0.0, [(LEFT, y)]
    for i in range(1, count + 1):
        step = FACET * surface.alpha * dice.gauss(0.0, 1.0)
        if abs(height + step) > HIGHEST:
            step = -step
        height = max(-HIGHEST, min(HIGHEST, height + step))
        points.append((LEFT + (RIGHT - LEFT) * i / count, y + height))
    return tuple(points)


def _filled(band: _Band, upper: tuple[Point, ...], lower: tuple[Point, ...], seed: int) -> list[Shape]:
    if band.kind in ("outside", "clear"):
        fill = "#ffffff" if band.index == 1.0 else CLEAR
    elif band.kind == "gap":
        middle = ((LEFT + RIGHT) / 2 - 4, (band.top + band.bottom) / 2)
        return [Shape("area", (*upper, *lower[::-1]), "#f4f4f4"), Shape("text", (middle,), INK, 16, "⋮")]
    else:
        fill = _code(_tint(band.layer) if band.kind == "medium" else _reflected(band))
    shapes = [Shape("area", (*upper, *lower[::-1]), fill)]
    if band.kind == "medium" and (count := particles(band.layer)):
        dice = random.Random(1000 + seed)
        top, bottom = max(y for _, y in upper) + 5, min(y for _, y in lower) - 5
        dots = tuple((dice.uniform(LEFT + 5, RIGHT - 5), dice.uniform(top, bottom)) for _ in range(count))
        shapes.append(Shape("dots", dots, "#ffffff" if _dark(fill) else "#4a4a4a", 1.7))
    return shapes


def particles(medium: Any) -> int:
    """How many particles a medium is drawn with: more with its scattering optical depth, at most 160."""
    depth, albedo = _three(_depth(medium), 1.0), _albedo(medium)
    scattering = sum(d * a for d, a in zip(depth, albedo, strict=True)) / 3
    return math.ceil(160 * (1 - math.exp(-scattering / 2))) if scattering > 0 else 0


def _light(bands: list[_Band]) -> list[Shape]:
    """Light that comes in, what a mirror would send back, and the way straight on, bent by Snell's law."""
    x, y = LEFT + 74.0, bands[0].bottom
    reach = min(54.0, y - 6)
    back = ((x, y), (x + math.tan(SLANT) * 0.75 * reach, y - 0.75 * reach))
    way = [(x - math.tan(SLANT) * reach, y - reach), (x, y)]
    for band in bands[1:]:
        sine = math.sin(SLANT) * bands[0].index / band.index
        if band.kind in ("base", "gap") or sine >= 1:
            break
        height = (band.bottom - band.top) if band is not bands[-1] else 0.75 * (band.bottom - band.top)
        across = math.tan(math.asin(sine)) * height
        if x + across > RIGHT - 6:  # out of the picture
            height, across = height * (RIGHT - 6 - x) / across, RIGHT - 6 - x
            way.append((x + across, band.top + height))
            break
        x += across
        way.append((x, band.top + height))
    return [Shape("arrow", back, LIGHT, 1.2), Shape("arrow", tuple(way), LIGHT, 2.2)]


def _label(lines: Sequence[str], y: float, leader: bool = True) -> list[Shape]:
    if not lines:
        return []
    shapes = []
    if leader:
        shapes.append(Shape("line", ((RIGHT + 4, y), (LABELS - 6, y)), "#8a8a8a", 0.8))
    for i, text in enumerate(lines):
        at = (LABELS, y + LINE * (i - (len(lines) - 1) / 2))
        bold = i == 0 and len(lines) > 1
        shapes.append(Shape("text", (at,), INK if bold or not leader else "#444444", SIZE, text, bold))
    return shapes


# ------------------------------------------------------------------------------------------- colours


def _tint(medium: Any) -> Colour:
    """What white light is left with after crossing the medium once; scattered light counts as left."""
    depth, albedo = _three(_depth(medium), 1.0), _albedo(medium)
    r, g, b = (math.exp(-d * (1 - a)) for d, a in zip(depth, albedo, strict=True))
    return r, g, b


def _reflected(band: _Band) -> Colour:
    """What a base reflects at normal incidence (Fresnel), or diffusely."""
    layer = band.layer
    if layer.kind != "conductor":
        return _three(getattr(layer, "reflectance", UNKNOWN), UNKNOWN[0])
    if layer.material is not None:
        from urushi.optics.ior import conductor_rgb  # here, so that `import urushi` reads no table

        eta, k = conductor_rgb(layer.material)
    else:
        eta, k = _three(layer.eta, 1.0), _three(layer.k, 3.0)
    n = band.index
    r, g, b = (((e - n) ** 2 + q * q) / ((e + n) ** 2 + q * q) for e, q in zip(eta, k, strict=True))
    return r, g, b


def _code(linear: Colour) -> str:
    """#rrggbb of linear sRGB."""
    encoded = (12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055 for x in linear)
    return "#" + "".join(f"{round(255 * min(max(x, 0.0), 1.0)):02x}" for x in encoded)


def _dark(code: str) -> bool:
    r, g, b = (int(code[i : i + 2], 16) for i in (1, 3, 5))
    return 0.3 * r + 0.59 * g + 0.11 * b < 140


def _slope(layer: Any) -> float:
    """Roughness along x; that of an image is drawn as 0.2."""
    alpha = getattr(layer, "alpha", 0.0)
    alpha = alpha[0] if isinstance(alpha, tuple) else alpha
    return _number(alpha, 0.2)


def _depth(medium: Any) -> Any:
    if medium.depth is not None:
        return medium.depth
    both = zip(_three(medium.thickness, 1.0), _three(medium.sigma_t, 1.0), strict=True)
    return tuple(thickness * sigma for thickness, sigma in both)


def _albedo(medium: Any) -> Colour:
    """That of a graded medium is its mean."""
    return _three(getattr(medium, "mean_albedo", medium.albedo), 0.5)


def _number(value: Any, unknown: float) -> float:
    """A number, or `unknown` for what an image holds."""
    return unknown if isinstance(value, Texture) else float(value)


def _three(value: Any, unknown: float) -> Colour:
    if isinstance(value, tuple):
        r, g, b = value
        return r, g, b
    return (_number(value, unknown),) * 3


# ------------------------------------------------------------------------------------------- SVG


def _element(shape: Shape) -> str:
    flat = " ".join(f"{x:.1f},{y:.1f}" for x, y in shape.points)
    stroke = f'fill="none" stroke="{shape.colour}" stroke-width="{shape.width:g}" stroke-linejoin="round"'
    if shape.kind == "area":
        return f'<polygon points="{flat}" fill="{shape.colour}"/>'
    if shape.kind == "dots":
        dot = f'r="{shape.width:g}" fill="{shape.colour}" fill-opacity="0.7"'
        return "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" {dot}/>' for x, y in shape.points)
    if shape.kind == "text":
        ((x, y),) = shape.points
        weight = ' font-weight="bold"' if shape.bold else ""
        place = f'x="{x:.1f}" y="{y + 0.35 * shape.width:.1f}" font-size="{shape.width:g}"'
        return f'<text {place} fill="{shape.colour}"{weight}>{html.escape(shape.text)}</text>'
    if shape.kind == "line":
        dashes = ' stroke-dasharray="5 4"' if shape.dashed else ""
        return f'<polyline points="{flat}" {stroke}{dashes}/>'
    *_, (x0, y0), (x1, y1) = shape.points
    length = math.hypot(x1 - x0, y1 - y0) or 1.0
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    tips = [
        (x1, y1),
        (x1 - 9 * ux + 4 * uy, y1 - 9 * uy - 4 * ux),
        (x1 - 9 * ux - 4 * uy, y1 - 9 * uy + 4 * ux),
    ]
    head = " ".join(f"{x:.1f},{y:.1f}" for x, y in tips)
    return f'<polyline points="{flat}" {stroke}/><polygon points="{head}" fill="{shape.colour}"/>'
