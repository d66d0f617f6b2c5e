"""The materials that come with the package."""

from __future__ import annotations

from pathlib import Path

import pytest

import urushi as ur
from urushi.io import dumps, loads

FOLDER = Path(ur.__file__).parent / "materials"


def test_there_are_many_and_sorted() -> None:
    names = ur.presets()
    assert len(names) >= 14
    assert names == sorted(path.stem for path in FOLDER.glob("*.yaml"))
    assert {"enamel", "urushi-black", "car-paint", "frosted-glass", "varnished-wood", "thin-slab"} <= set(
        names
    )


@pytest.mark.parametrize("name", ur.presets())
def test_every_preset_loads_says_what_it_is_and_round_trips(name: str) -> None:
    stack = ur.load(f"preset:{name}")
    assert stack.name and stack.description
    assert loads(dumps(stack, folder=FOLDER), folder=FOLDER) == stack
    text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    comments = [line for line in text.splitlines() if line.startswith("#")]
    assert len(comments) >= 2, "the source of every number stands in comments"


def test_enamel_is_the_example_of_the_documentation() -> None:
    assert ur.load("preset:enamel") == ur.Stack(
        name="enamel on gold",
        description=ur.load("preset:enamel").description,
        layers=[
            ur.Dielectric(ior=1.5, alpha=0.1),
            ur.Medium(depth=0.5, albedo=[0.95, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.5)),
            ur.Conductor(material="Au", alpha=0.2),
        ],
    )


def test_wet_and_dry_stone_are_the_same_stone() -> None:
    wet, dry = ur.load("preset:wet-stone"), ur.load("preset:dry-stone")
    assert wet.layers[-1] == dry.layers[-1]
    assert wet.layers[0].ior == 1.333


def test_the_presets_show_what_a_description_can_say() -> None:
    stacks = [ur.load(f"preset:{name}") for name in ur.presets()]
    layers = [layer for stack in stacks for layer in stack.layers]
    assert {layer.kind for layer in layers} == {"dielectric", "conductor", "diffuse", "medium"}
    assert any(not stack.layers[-1].opaque for stack in stacks)
    assert any(isinstance(value, ur.Texture) for stack in stacks for value in stack.parameters().values())
    assert any(isinstance(layer.alpha, tuple) for layer in layers if layer.kind == "conductor")
    assert any(layer.thickness is not None for layer in layers if layer.kind == "medium")


def test_textures_are_small() -> None:
    images = list((FOLDER / "textures").glob("*.png"))
    assert images and all(path.stat().st_size < 150_000 for path in images)
