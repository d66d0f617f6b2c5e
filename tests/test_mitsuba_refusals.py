"""What the plugin refuses, and that its last line says which layer, what was found, and what is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_plugin import layered
from urushi.errors import MaterialError, UnsupportedStack

COAT = {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0}
BASE = {"type": "diffuse"}
FOG = {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.5}
GOLD = {"filename": "preset:enamel-on-gold"}

CHILDREN = {
    "plastic": (
        {"layer_0": {"type": "plastic"}},
        "layer_0 (SmoothPlastic): cannot be read as a layer; allowed: dielectric",
    ),
    "twosided": (
        {"layer_0": COAT, "layer_1": {"type": "twosided", "one": BASE}},
        "layer_1 (TwoSidedBRDF): cannot be read",
    ),
    "thin dielectric": ({"layer_0": {"type": "thindielectric"}}, "layer_0 (ThinDielectric): cannot be read"),
    "a stack in a stack": (
        {"layer_0": {"type": "layered", **GOLD}},
        "layer_0 (BSDF): cannot be read as a layer",
    ),
    "tinted glass": (
        {"layer_0": COAT | {"specular_reflectance": 0.5}},
        "layer_0 (RoughDielectric): specular_reflectance other",
    ),
    "tinted inside": (
        {"layer_0": COAT | {"specular_transmittance": 0.5}, "layer_1": BASE},
        "layer_0 (RoughDielectric): specular_transmittance other than 1",
    ),
    "tinted metal": (
        {"layer_0": {"type": "conductor", "specular_reflectance": 0.9}},
        "layer_0 (SmoothConductor): specular_",
    ),
    "two at once": ({"layer_0": {"type": "plastic"}, "layer_1": {"type": "null"}}, "layer_0 (SmoothPlastic)"),
    "and the other": ({"layer_0": {"type": "plastic"}, "layer_1": {"type": "null"}}, "layer_1 (Null)"),
    "unknown phase": (
        {"layer_0": COAT, "layer_1": FOG | {"phase": {"type": "tabphase", "values": "1,1,1"}}},
        "layer_1 (HomogeneousMedium): phase function TabulatedPhaseFunction cannot be read; allowed: hg, iso",
    ),
    "a gap": ({"layer_0": COAT, "layer_2": BASE}, "found layers [0, 2]; allowed: 0, 1, 2, ... without gaps"),
    "no first": (
        {"layer_1": COAT, "layer_2": BASE},
        "found layers [1, 2]; allowed: 0, 1, 2, ... without gaps",
    ),
    "stray child": ({"layer_0": COAT, "coat": BASE}, "found a child 'coat'; allowed: layer_0, layer_1"),
    "leading zero": ({"layer_00": COAT}, "found a child 'layer_00'; allowed: layer_0, layer_1"),
    "opaque on top": (
        {"layer_0": BASE, "layer_1": COAT},
        "layers[0]: a diffuse base is opaque, nothing can lie below it",
    ),
    "brighter than white": (
        {"layer_0": BASE | {"reflectance": 1.5}},
        "layer_0.reflectance: found 1.5; allowed: values from 0 to 1",
    ),
    "thinner than air": (
        {"layer_0": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}},
        "layer_0.ior: found 0.66666",
    ),
    "too deep": (
        {"layer_0": COAT, "layer_1": FOG | {"scale": 1e9}},
        "layer_1.depth: found 1000000000.0, which is above 1e+06",
    ),
    "thick interface": (
        {"layer_0": COAT, "layer_1": BASE, "thickness_1": 2.0},
        "thickness_1 is given, but layer_1 is no medium",
    ),
    "thickness of nothing": (
        {"layer_0": COAT, "thickness_7": 2.0},
        "thickness_7 is given, but layer_7 is no medium",
    ),
    "negative thickness": (
        {"layer_0": COAT, "layer_1": FOG, "thickness_1": -2.0},
        "thickness_1: found -2.0; allowed: a number from 0",
    ),
    "thickness in words": (
        {"layer_0": COAT, "layer_1": FOG, "thickness_1": "thin"},
        "thickness_1: found 'thin'; allowed",
    ),
}

OPTIONS = {
    "both": (GOLD | {"layer_0": COAT}, "found filename and layer_0; allowed: a file, or nested layers"),
    "both, thickness": (
        GOLD | {"thickness_0": 1.0},
        "found filename and thickness_0; allowed: a file, or nested layers",
    ),
    "neither": ({}, "found no layers; allowed: filename, or layer_0"),
    "misspelt": (GOLD | {"sampels": 4}, "found 'sampels'; did you mean 'samples'? allowed: filename"),
    "unknown": (
        GOLD | {"alfa": 0.1},
        "found 'alfa'; allowed: filename, method, footprint, samples, seed, max_depth, accuracy, nodes, orders, "
        "media, corners, published, symmetric, layer_N, thickness_N",
    ),
    "no such method": (
        GOLD | {"method": "wlak"},
        "layered.method: found 'wlak'; did you mean 'walk'? allowed: walk, adding, lobes, auto",
    ),
    "no truth value": (
        GOLD | {"method": "lobes", "published": "yes"},
        "layered.published: found 'yes'; allowed: true or false",
    ),
    "method a number": (GOLD | {"method": 3}, "layered.method: found 3; allowed: walk, adding, lobes, auto"),
    "another method's option": (
        GOLD | {"method": "lobes", "samples": 4},
        "layered.samples: is no option of method 'lobes'; allowed: published, symmetric",
    ),
    "no samples": (GOLD | {"samples": 0}, "layered.samples: found 0; allowed: a whole number from 1 to"),
    "half a sample": (
        GOLD | {"samples": 1.5},
        "layered.samples: found 1.5; allowed: a whole number from 1 to",
    ),
    "samples in words": (
        GOLD | {"samples": "many"},
        "layered.samples: found 'many'; allowed: a whole number",
    ),
    "samples true": (GOLD | {"samples": True}, "layered.samples: found True; allowed: a whole number"),
    "seed below 0": (
        GOLD | {"seed": -1},
        "layered.seed: found -1; allowed: a whole number from 0 to 4294967295",
    ),
    "seed too large": (GOLD | {"seed": 2**32}, "layered.seed: found 4294967296; allowed"),
    "seed not a number": (GOLD | {"seed": float("nan")}, "layered.seed: found nan; allowed: a whole number"),
    "max_depth": (GOLD | {"max_depth": -2}, "layered.max_depth: found -2; allowed: a whole number from -1"),
    "no such file": ({"filename": "nowhere.yaml"}, "nowhere.yaml: the file: there is no such file"),
    "no such preset": ({"filename": "preset:enamel-on-gld"}, "unknown preset; did you mean 'enamel-on-gold'"),
    "filename a number": ({"filename": 3.0}, "layered.filename: found 3.0; allowed: a file, or preset:NAME"),
    "filename empty": ({"filename": ""}, "layered.filename: found ''; allowed: a file, or preset:NAME"),
    "in a file": ({"filename": "wrong.yaml"}, "wrong.yaml: layers[0].alfa: unknown key 'alfa'"),
}


def last_line(mi, description) -> str:
    with pytest.raises(RuntimeError) as caught:
        layered(mi, **description)
    return str(caught.value).strip().splitlines()[-1]


@pytest.mark.parametrize("name", CHILDREN | OPTIONS)
def test_a_refusal_says_what_and_where(mi, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.yaml").write_text("urushi: 1\nlayers:\n  - dielectric: {alfa: 0.1}\n")
    description, expected = (CHILDREN | OPTIONS)[name]
    line = last_line(mi, description)
    assert expected in line
    assert line.startswith(("MaterialError: ", "UnsupportedStack: ", "urushi.errors."))


def test_a_refusal_names_the_object(mi):
    assert "UnsupportedStack" in last_line(mi, {"id": "table", "layer_0": {"type": "plastic"}})
    assert "table.samples: found 0" in last_line(mi, GOLD | {"id": "table", "samples": 0})
    assert "table.layer_0.reflectance" in last_line(
        mi, {"id": "table", "layer_0": BASE | {"reflectance": 2.0}}
    )


@pytest.mark.parametrize("name", ["albedo", "sigma_t"])
def test_a_grid_is_no_layer(mi, name):
    """A medium that varies inside, whichever way Mitsuba spells it."""
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(np.full((2, 2, 2, 1), 0.5, np.float32))}
    assert "layer_1 (HeterogeneousMedium): only homogeneous media can be read" in last_line(
        mi, {"layer_0": COAT, "layer_1": {"type": "heterogeneous", "albedo": 0.5, "sigma_t": 1.0, name: grid}}
    )
    if name == "albedo":  # Mitsuba itself refuses a grid for the other
        line = last_line(mi, {"layer_0": COAT, "layer_1": FOG | {name: grid}})
        assert f"layer_1 (HomogeneousMedium): {name} varies inside the medium" in line


def test_the_errors_are_urushis(mi):
    """Seen from Python they are the classes of `urushi.errors`; Mitsuba makes a RuntimeError of each."""
    from urushi.adapters.mitsuba.nested import read_children

    layered(mi, **GOLD)
    plastic, coat = mi.load_dict({"type": "plastic"}), mi.load_dict(COAT)
    with pytest.raises(UnsupportedStack) as caught:
        read_children(mi, {"layer_0": plastic, "layer_1": plastic}, {}, "table")
    assert caught.value.method == "walk" and len(caught.value.reasons) == 2
    with pytest.raises(MaterialError) as refused:
        read_children(mi, {"layer_1": coat}, {}, "table")
    assert refused.value.where == "table"


@pytest.mark.parametrize("colour", ["bitmap", "checkerboard"])
def test_a_texture_above_one_is_refused(mi, colour):
    """Reflectances above 1 would feed a walk under a coat for ever; so would those of a material file's image."""
    image = mi.Bitmap(np.full((2, 2, 3), 1.25, np.float32))
    texture = {"bitmap": {"raw": True, "bitmap": image}, "checkerboard": {"color1": 1.25}}[colour]
    line = last_line(mi, {"layer_0": COAT, "layer_1": BASE | {"reflectance": {"type": colour, **texture}}})
    assert "layered.layer_1.reflectance: found 1.25; allowed: values from 0 to 1" in line


def test_an_image_above_one_in_a_file_is_refused(mi, tmp_path):
    """Its scale counts, too."""
    mi.Bitmap(np.full((2, 2, 3), 200, np.uint8)).write(str(tmp_path / "bright.png"))
    path = tmp_path / "bright.yaml"
    for scale, fine in ((1.2, True), (1.3, False)):
        path.write_text(
            "urushi: 1\nlayers:\n  - dielectric: {ior: 1.5}\n"
            f"  - diffuse: {{reflectance: {{texture: bright.png, raw: true, scale: {scale}}}}}\n"
        )
        if fine:
            layered(mi, filename=str(path))
        else:
            assert "layer_1.reflectance: found 1.0196" in last_line(mi, {"filename": str(path)})
