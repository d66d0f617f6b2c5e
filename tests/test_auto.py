"""`method="auto"`: what it takes, that it says why, and that the reasons are the right ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi import solvers
from urushi.errors import UnsupportedStack, UrushiError

COAT = ur.Dielectric(ior=1.5, alpha=0.1)
GREY = ur.Diffuse(reflectance=0.5)
PLASTIC = ur.Stack(layers=[COAT, GREY])
BRUSHED = ur.Stack(layers=[COAT, ur.Conductor(material="Al", alpha=(0.05, 0.3))])
PILE = ur.Stack(layers=[COAT, *[ur.Dielectric(ior=i) for i in (1.3, 1.5, 1.3, 1.5)], GREY])
SHARP = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Conductor(material="Au", alpha=0.001)])
SHARP_COAT = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.001), GREY])
WALKED = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.4, multiple_scattering="walk"), GREY])
WOOD = ur.load("preset:varnished-wood")
VALUES = {"layer_0.alpha": 0.12, "layer_2.reflectance": (0.4, 0.25, 0.1)}


def choose(stack: ur.Stack, **options: Any) -> solvers.auto.Choice:
    return solvers.choose(stack, solvers.SOLVERS, options)


@pytest.mark.parametrize(
    ("stack", "options", "method", "reason"),
    [
        pytest.param(PLASTIC, {}, "adding", "", id="plain"),
        pytest.param(SHARP_COAT, {}, "adding", "", id="a sharp coat has a closed form"),
        pytest.param(PLASTIC, {"samples": 9}, "walk", "no option 'samples'", id="an option of the walk"),
        pytest.param(PLASTIC, {"symmetric": True}, "lobes", "no option 'symmetric'", id="an option of lobes"),
        pytest.param(PILE, {"accuracy": 1e-2}, "adding", "", id="an option of adding, on a slow stack"),
        pytest.param(BRUSHED, {}, "walk", "anisotropic", id="anisotropic"),
        pytest.param(PILE, {}, "walk", "6 interfaces", id="many interfaces"),
        pytest.param(SHARP, {}, "walk", "narrowest lobe", id="a sharp base"),
        pytest.param(WALKED, {}, "walk", "multiple_scattering", id="a noisy interface"),
        pytest.param(WOOD, {}, "walk", "is a texture", id="textures"),
        pytest.param(WOOD, {"parameters": VALUES}, "adding", "", id="textures with values"),
        pytest.param(
            PLASTIC, {"parameters": {"layer_0.alpha": np.full(9, 0.1)}}, "walk", "one per evaluation", id="lanes"
        ),
        pytest.param(
            PLASTIC, {"parameters": {"layer_1.reflectance": [0.1, 0.2, 0.3]}}, "adding", "", id="one colour"
        ),
        pytest.param(
            PLASTIC, {"parameters": {"layer_0.alpha": 0.0005}}, "adding", "", id="a value that changes nothing"
        ),
        pytest.param(SHARP, {"parameters": {"layer_1.alpha": 0.2}}, "adding", "", id="a value that mends it"),
    ],
)  # fmt: skip
def test_choice_and_reason(stack: ur.Stack, options: dict[str, Any], method: str, reason: str) -> None:
    choice = choose(stack, **options)
    assert choice.method == method
    assert choice.why.startswith(f"{method}: ")
    assert method not in choice.ruled_out
    if reason:
        assert any(reason in said for said in choice.ruled_out["adding"])
        assert choice.ruled_out["adding"][0] in choice.why


def test_presets_are_as_the_page_says() -> None:
    """The table in docs/compare.md: two presets are for the walk by their kind, and one by its size."""
    walked = {name for name in ur.presets() if choose(ur.load(f"preset:{name}")).method == "walk"}
    assert {"brushed-metal-lacquer", "varnished-wood", "pearl"} <= walked
    assert {"enamel-on-gold", "plastic", "car-paint", "frosted-glass", "skin"}.isdisjoint(walked)


@needs_llvm
def test_the_answer_says_why_and_is_that_of_the_method() -> None:
    wi = [[0.6, 0.0, 0.8]]
    found = ur.solve(PLASTIC)
    assert found.diagnostics["method"] == found.diagnostics["auto"]["method"] == "adding"
    assert "lobes" in found.diagnostics["auto"]["ruled_out"]
    assert np.array_equal(found.reflectance(wi), ur.solve(PLASTIC, "adding").reflectance(wi))
    assert ur.solve(PLASTIC, samples=4).diagnostics["auto"]["method"] == "walk"
    alpha = __import__("drjit").llvm.ad.Float(0.1)
    found = ur.solve(PLASTIC, parameters={"layer_0.alpha": alpha})
    assert "derivatives" in found.diagnostics["auto"]["why"]
    assert "auto" not in ur.solve(PLASTIC, "walk").diagnostics


def test_a_misspelt_option_and_options_that_exclude_one_another() -> None:
    with pytest.raises(UrushiError, match=r"sampels.*did you mean 'samples'"):
        ur.solve(PLASTIC, sampels=3)
    with pytest.raises(
        UnsupportedStack, match=r"walk: it has no option 'accuracy'.*adding: it has no option 'samples'"
    ):
        ur.solve(PLASTIC, samples=3, accuracy=1e-2)


def test_a_method_that_cannot_names_those_that_can() -> None:
    with pytest.raises(UnsupportedStack, match="methods that can: walk, lobes"):
        ur.solve(BRUSHED, "adding")
