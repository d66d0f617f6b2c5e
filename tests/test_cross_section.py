"""The cross-section says what the stack is: every layer, its roughness, colour and particles."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

import urushi as ur
from urushi.cross_section import LIGHT, MOST, draw, particles

COAT = ur.Dielectric(ior=1.5)


def shapes(stack, kind):
    return [shape for shape in draw(stack).shapes if shape.kind == kind]


def texts(stack):
    return [shape.text for shape in shapes(stack, "text")]


@pytest.mark.parametrize("name", ur.presets())
def test_every_layer_of_every_preset_has_a_label_inside_the_picture(name):
    stack = ur.load(f"preset:{name}")
    drawing = draw(stack)
    said = " ".join(texts(stack))
    for i, layer in enumerate(stack.layers):
        assert f"{i}  {layer.kind}" in said
    assert ("air below" in said) == (not stack.layers[-1].opaque)
    for shape in drawing.shapes:
        for x, y in shape.points:
            assert -1e-6 <= x <= drawing.width and -1e-6 <= y <= drawing.height
    assert drawing == draw(stack)  # nothing left to chance


def test_roughness_is_the_slope_of_the_profile():
    found = []
    for alpha in (0.0, 0.1, 0.2):
        stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=alpha), ur.Diffuse(reflectance=0.5)])
        x, y = np.array(shapes(stack, "line")[0].points).T
        found.append(np.std(np.diff(y) / np.diff(x)))
    assert found[0] == 0
    assert found[1] == pytest.approx(0.1, rel=0.35) and found[2] == pytest.approx(2 * found[1], rel=0.2)


def test_colours_are_those_of_the_material():
    gold = ur.Stack(layers=[ur.Conductor(material="Au")])
    base = shapes(gold, "area")[-1].colour
    r, g, b = (int(base[i : i + 2], 16) for i in (1, 3, 5))
    assert r > 240 and 200 < g < 235 and b < 160
    white = ur.Stack(layers=[ur.Diffuse(reflectance=(1.0, 0.5, 0.0))])
    assert shapes(white, "area")[-1].colour == "#ffbc00"
    dye = ur.Stack(layers=[ur.Medium(depth=(0.0, math.log(2), 50.0), albedo=0.0), ur.Diffuse(reflectance=1)])
    assert shapes(dye, "area")[1].colour == "#ffbc00"  # half of green is left, and nothing of blue


def test_particles_stand_for_scattering():
    counts = [particles(ur.Medium(depth=depth, albedo=0.5)) for depth in (0.0, 0.1, 1.0, 100.0)]
    assert counts[0] == 0 and counts == sorted(counts) and counts[3] == 160
    assert particles(ur.Medium(depth=3.0, albedo=0.0)) == 0
    assert particles(ur.Medium(thickness=0.5, sigma_t=2.0, albedo=0.5)) == counts[2]
    stack = ur.Stack(layers=[COAT, ur.Medium(depth=1.0, albedo=0.5), ur.Diffuse(reflectance=0.5)])
    (dots,) = shapes(stack, "dots")
    assert len(dots.points) == counts[2]


def test_the_arrow_is_bent_by_snell():
    slab = ur.Stack(layers=[COAT, ur.Dielectric(ior=1.0)])
    _, way = shapes(slab, "arrow")
    steps = np.diff(np.array(way.points), axis=0)
    sines = steps[:, 0] / np.linalg.norm(steps, axis=1)
    np.testing.assert_allclose(sines[0], 1.5 * sines[1])
    np.testing.assert_allclose(sines[0], sines[2])
    trapped = ur.Stack(
        exterior=1.8, layers=[ur.Dielectric(ior=1.0)]
    )  # total reflection: it ends at the surface
    assert len(shapes(trapped, "arrow")[1].points) == 2
    assert way.colour == LIGHT


def test_of_a_high_stack_the_middle_is_left_out_and_said():
    plates = ur.Stack(layers=[ur.Dielectric(ior=1.5 - 0.5 * (k % 2)) for k in range(40)])
    said = texts(plates)
    assert f"{40 - 2 * (MOST // 2)} layers more, not drawn" in said
    assert sum("dielectric" in text for text in said) == 2 * (MOST // 2)
    fits = ur.Stack(layers=plates.layers[:MOST])
    assert sum("dielectric" in text for text in texts(fits)) == MOST


def test_an_image_is_named_and_grey():
    wood = ur.load("preset:varnished-wood")
    assert any("wood-albedo.png" in text for text in texts(wood))
    base = shapes(wood, "area")[-1].colour
    assert base[1:3] == base[3:5] == base[5:7]


def test_the_svg_is_whole_and_says_no_markup_of_the_user():
    image = ur.Texture(file="a<u>b.png")
    stack = ur.Stack(name="<b>&", description="a & <i>", layers=[COAT, ur.Diffuse(reflectance=image)])
    page = stack._repr_html_()
    assert "<b>" not in page and "&lt;b&gt;&amp;" in page and "<i>" not in page and "<u>" not in page
    svg = re.search("<svg.*</svg>", page)[0]
    root = ElementTree.fromstring(svg)
    assert float(root.get("height")) == pytest.approx(draw(stack).height, rel=1e-4)
    kinds = {element.tag.rpartition("}")[2] for element in root}
    assert kinds == {"rect", "polygon", "polyline", "text"}
