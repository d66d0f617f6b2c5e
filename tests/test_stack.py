"""The description: what it accepts, what it refuses and in which words, repr, parameters, replace."""

from __future__ import annotations

import copy
import itertools
import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import urushi as ur
from strategies import stacks
from urushi.description.base import Description
from urushi.description.parameter import Parameter
from urushi.stack import LAYERS, PHASES, parameter_table

PIECES: list[type[Description]] = [ur.Stack, ur.Texture, *LAYERS.values(), *PHASES.values()]


@pytest.fixture
def enamel() -> ur.Stack:
    return ur.Stack(
        name="enamel on gold",
        layers=[
            ur.Dielectric(ior=1.5, alpha=0.1),
            ur.Medium(depth=0.5, albedo=[0.95, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.5)),
            ur.Conductor(material="Au", alpha=0.2),
        ],
    )


def refused(make: object, where: str | None, *words: str) -> None:
    with pytest.raises(ur.MaterialError) as caught:
        make()  # type: ignore[operator]
    assert caught.value.where == where
    for word in words:
        assert word in str(caught.value)


def test_import_is_light() -> None:
    code = (
        "import sys, urushi as ur; ur.Conductor(material='Au'); ur.load('preset:enamel'); "
        "print([m for m in ('drjit', 'mitsuba', 'matplotlib', 'numpy', 'scipy') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_values_by_position_and_numpy() -> None:
    assert ur.Dielectric(1.5, 0.1) == ur.Dielectric(ior=1.5, alpha=0.1)
    assert ur.HenyeyGreenstein(0.5) == ur.HenyeyGreenstein(g=0.5)
    layer = ur.Medium(
        depth=np.float32(0.5), albedo=np.array([0.5, 0.25, 0]), phase=ur.HenyeyGreenstein(np.array(0.5))
    )
    assert layer == ur.Medium(depth=0.5, albedo=(0.5, 0.25, 0.0), phase=ur.HenyeyGreenstein(0.5))
    assert isinstance(layer.depth, float) and type(layer.albedo[0]) is float
    assert type(ur.Dielectric(ior=2).ior) is float
    refused(lambda: ur.HenyeyGreenstein(0.5, 1), None, "found 2 values", "at most 1")
    refused(lambda: ur.Dielectric(1.5, ior=1.5), "ior", "by position and by name")


@pytest.mark.parametrize(
    ("make", "where", "words"),
    [
        (lambda: ur.Dielectric(ior=-1), "ior", ["-1.0", "from 1 to 5"]),
        (lambda: ur.Dielectric(ior=5.01), "ior", ["above 5"]),
        (lambda: ur.Dielectric(ior=[1.5, 1.5, 1.5]), "ior", ["refract into its own direction"]),
        (lambda: ur.Dielectric(ior=True), "ior", ["truth value"]),
        (lambda: ur.Dielectric(ior=np.bool_(True)), "ior", ["truth value"]),
        (lambda: ur.Dielectric(ior="1.5"), "ior", ["(text)"]),
        (lambda: ur.Dielectric(ior=None), "ior", ["found nothing"]),
        (lambda: ur.Dielectric(ior=1.5j), "ior", ["1.5j"]),
        (lambda: ur.Dielectric(ior=float("nan")), "ior", ["not finite"]),
        (lambda: ur.Dielectric(ior=np.inf), "ior", ["not finite"]),
        (lambda: ur.Dielectric(ior=10**400), "ior", ["too large"]),
        (lambda: ur.Dielectric(ior=10**5000), "ior", ["too large"]),
        (lambda: ur.Dielectric(alpha=5e-5), "alpha", ["0 (smooth) or a number from 0.0001 to 1"]),
        (lambda: ur.Dielectric(alpha=(0, 0.1)), "alpha", ["one axis only"]),
        (lambda: ur.Dielectric(alpha=(0.1, 2)), "alpha[1]", ["above 1"]),
        (lambda: ur.Dielectric(alpha=(0.1, 0.1, 0.1)), "alpha", ["3 values"]),
        (lambda: ur.Dielectric(alpa=0.1), "alpa", ["did you mean 'alpha'?", "ior, alpha, distribution"]),
        (lambda: ur.Dielectric(distribution="GGX"), "distribution", ["did you mean 'ggx'?", "'beckmann'"]),
        (lambda: ur.Dielectric(masking=None), "masking", ["'correlated' or 'separable'"]),
        (
            lambda: ur.Dielectric(multiple_scattering=True),
            "multiple_scattering",
            ["say which model", "False, 'walk'"],
        ),
        (lambda: ur.Dielectric(multiple_scattering=0), "multiple_scattering", ["found 0"]),
        (lambda: ur.Dielectric(normal=(0, 0, 0)), "normal", ["z is below"]),
        (lambda: ur.Dielectric(normal=(0, 0, 1.5)), "normal[2]", ["above 1"]),
        (lambda: ur.Dielectric(normal=0.5), "normal", ["three numbers"]),
        (lambda: ur.Dielectric(rotation=361), "rotation", ["from -360 to 360"]),
        (lambda: ur.Conductor(material="gold"), "material", ["'gold'", "conductor_names"]),
        (lambda: ur.Conductor(material="AU"), "material", ["did you mean 'Au'?"]),
        (lambda: ur.Conductor(alpha=0.1), "material", ["eta and k are missing", "a name such as Au"]),
        (lambda: ur.Conductor(eta=1.0), "k", ["k is missing"]),
        (lambda: ur.Conductor(k=1.0), "eta", ["eta is missing"]),
        (lambda: ur.Conductor(material="Au", k=1.0), "k", ["material 'Au' and k"]),
        (lambda: ur.Conductor(eta=0, k=0), "eta", ["both 0"]),
        (lambda: ur.Conductor(eta=(1, 0, 1), k=(1, 0, 1)), "eta", ["same channel"]),
        (lambda: ur.Conductor(eta=21, k=1), "eta", ["above 20"]),
        (lambda: ur.Conductor(eta=1, k=-1e-9), "k", ["below 0"]),
        (lambda: ur.Diffuse(reflectance=[0.1, 0.2, 1.1]), "reflectance[2]", ["1.1", "above 1"]),
        (lambda: ur.Diffuse(reflectance=[0.1, 0.2]), "reflectance", ["2 values"]),
        (lambda: ur.Diffuse(reflectance=np.zeros((3, 3))), "reflectance[0]", ["found [0.0"]),
        (lambda: ur.Diffuse(reflectance={"file": "a.png"}), "reflectance", ["a texture"]),
        (lambda: ur.Medium(depth=1), "albedo", ["missing from Medium"]),
        (lambda: ur.Medium(albedo=0.5), "depth", ["both thickness and sigma_t"]),
        (lambda: ur.Medium(depth=1, albedo=0.5, sigma_t=1), "sigma_t", ["found depth and sigma_t"]),
        (lambda: ur.Medium(thickness=1, albedo=0.5), "sigma_t", ["sigma_t is missing"]),
        (lambda: ur.Medium(thickness=0, sigma_t=1, albedo=0.5), "thickness", ["below 1e-12"]),
        (lambda: ur.Medium(thickness=1e6, sigma_t=1e6, albedo=0.5), "sigma_t", ["product", "1e+06"]),
        (lambda: ur.Medium(depth=1, albedo=0.5, phase="hg"), "phase", ["unknown phase function 'hg'"]),
        (
            lambda: ur.Medium(depth=1, albedo=0.5, phase={"henyey_greenstein": {"g": 1}}),
            "phase.g",
            ["above 0.999"],
        ),
        (
            lambda: ur.Medium(depth=1, albedo=0.5, phase={"henyey_greenstein": 0.5}),
            "phase",
            ["a mapping of g"],
        ),
        (lambda: ur.Texture(file=""), "file", ["path of an image"]),
        (lambda: ur.Texture(file="a\0b"), "file", ["path of an image"]),
        (lambda: ur.Texture(file="a.png", scale=np.nan), "scale", ["not finite"]),
        (lambda: ur.Texture(file="a.png", raw=1), "raw", ["False or True"]),
        (lambda: ur.Dielectric(alpha=ur.Texture("a.png", scale=-1)), "alpha.scale", ["negative"]),
        (lambda: ur.Stack(layers=[]), "layers", ["0 layers"]),
        (lambda: ur.Stack(layers=ur.Diffuse()), "layers", ["a list of 1 to"]),
        (lambda: ur.Stack(layers=[1.5]), "layers[0]", ["found 1.5", "dielectric, conductor"]),
        (lambda: ur.Stack(layers=["dielectrik"]), "layers[0]", ["did you mean 'dielectric'?"]),
        (lambda: ur.Stack(layers=[{"dielectric": {}, "medium": {}}]), "layers[0]", ["2 keys"]),
        (lambda: ur.Stack(layers=[{"dielectric": {"ior": 0}}]), "layers[0].ior", ["from 1 to 5"]),
        (lambda: ur.Stack(layers=[ur.Diffuse()], exterior=ur.Texture("a.png")), "exterior", ["from 1 to 5"]),
        (lambda: ur.Stack(layers=[ur.Diffuse()], name=3), "name", ["quotes"]),
        (lambda: ur.Stack(layers=[ur.Diffuse()], name="a\nb"), "name", ["several lines"]),
        (lambda: ur.Stack(layers=[ur.Diffuse()], name="\ud800"), "name", ["surrogate"]),
        (lambda: ur.Stack(name="x"), "layers", ["missing from Stack"]),
        (lambda: ur.Stack.model_validate("x"), None, ["a mapping of name, layers"]),
    ],
)
def test_refusals_name_place_value_and_what_is_allowed(make, where, words) -> None:
    refused(make, where, *words)


def test_only_the_last_layer_may_be_opaque() -> None:
    gold, coat, fog = ur.Conductor("Au"), ur.Dielectric(), ur.Medium(depth=1, albedo=1)
    refused(
        lambda: ur.Stack(layers=[coat, gold, fog]),
        "layers[1]",
        "layers[1]: a conductor is opaque, nothing can lie below it: remove layers[2] (a medium)",
    )
    refused(lambda: ur.Stack(layers=[gold, fog, coat]), "layers[0]", "remove layers[1] to layers[2]")
    refused(
        lambda: ur.Stack(layers=[coat, gold, ur.Diffuse()]), "layers[2]", "so is layers[1]", "one opaque base"
    )
    for layers in ([coat], [fog], [fog, fog], [gold], [fog, gold], [coat, fog], [coat, coat]):
        ur.Stack(layers=layers)


@settings(max_examples=150)
@given(stacks(textured=True, text=True))
def test_repr_evaluates_to_an_equal_stack(stack: ur.Stack) -> None:
    again = eval(repr(stack), {name: getattr(ur, name) for name in ur.__all__ if name != "solve"})
    assert again == stack
    assert hash(again) == hash(stack)
    assert pickle.loads(pickle.dumps(stack)) == stack == copy.deepcopy(stack)
    assert isinstance(stack.describe(), str)


def test_repr_is_readable(enamel: ur.Stack) -> None:
    assert repr(enamel) == (
        "Stack(\n    name='enamel on gold',\n    layers=[\n        Dielectric(ior=1.5, alpha=0.1),\n"
        "        Medium(depth=0.5, albedo=(0.95, 0.6, 0.2), phase=HenyeyGreenstein(g=0.5)),\n"
        "        Conductor(material='Au', alpha=0.2),\n    ],\n)"
    )


def test_describe_is_a_cross_section(enamel: ur.Stack) -> None:
    lines = enamel.describe().splitlines()
    assert lines[0] == "enamel on gold"
    assert [line.split()[0] for line in lines[1:]] == ["air", "0", "1", "2"]
    assert "albedo 0.95 0.6 0.2" in lines[3] and "g 0.5" in lines[3]
    assert ur.Stack(layers=[ur.Dielectric()]).describe().endswith("transmits")


def test_equality_is_by_value_and_type(enamel: ur.Stack) -> None:
    assert ur.Dielectric(ior=1.5) != ur.Dielectric(ior=1.5000000000000002)
    assert ur.Isotropic() != ur.Rayleigh()
    assert len({ur.Diffuse(), ur.Diffuse(0.5), ur.Diffuse(0.25)}) == 2
    assert ur.Texture("a.png") == ur.Texture("./b/../a.png")


def test_frozen(enamel: ur.Stack) -> None:
    refused(lambda: setattr(enamel, "name", "x"), "name", "frozen")
    refused(lambda: delattr(enamel, "name"), "name", "frozen")
    refused(lambda: enamel.layers[0].model_copy(update={"ior": 9}), "ior", "above 5")


def test_parameters(enamel: ur.Stack) -> None:
    assert enamel.parameters() == {
        "layer_0.ior": 1.5,
        "layer_0.alpha": 0.1,
        "layer_0.rotation": 0.0,
        "layer_1.depth": 0.5,
        "layer_1.albedo": (0.95, 0.6, 0.2),
        "layer_1.phase.g": 0.5,
        "layer_2.alpha": 0.2,
        "layer_2.rotation": 0.0,
    }
    slab = ur.Stack(
        layers=[ur.Medium(thickness=2, sigma_t=3, albedo=1), ur.Conductor(eta=1, k=2, normal=(0, 0, 1))]
    )
    assert list(slab.parameters()) == [
        "layer_0.albedo", "layer_0.thickness", "layer_0.sigma_t",
        "layer_1.eta", "layer_1.k", "layer_1.alpha", "layer_1.normal", "layer_1.rotation",
    ]  # fmt: skip


@settings(max_examples=80)
@given(stacks(textured=True), st.data())
def test_replacing_by_the_same_changes_nothing_and_by_another_changes_one(
    stack: ur.Stack, data: st.DataObject
) -> None:
    parameters = stack.parameters()
    assert stack.replace(parameters) == stack == stack.replace({})
    albedos = [name for name in parameters if name.endswith((".albedo", ".reflectance"))]
    if albedos:
        name = data.draw(st.sampled_from(albedos))
        changed = stack.replace({name: 0.123})
        assert changed.parameters() == {**parameters, name: 0.123}


def test_replace(enamel: ur.Stack) -> None:
    changed = enamel.replace({"layer_1.phase.g": -0.5, "layer_0.masking": "separable", "exterior": 1.33})
    assert (changed.layers[1].phase.g, changed.layers[0].masking, changed.exterior) == (
        -0.5,
        "separable",
        1.33,
    )
    copper = enamel.replace(
        {"layer_2.material": None, "layer_2.eta": (0.2, 0.9, 1.1), "layer_2.k": (3.9, 2.5, 2.1)}
    )
    assert copper.layers[2].eta == (0.2, 0.9, 1.1)
    refused(lambda: enamel.replace({"layer_0.alfa": 1}), "layer_0.alfa", "did you mean 'layer_0.alpha'")
    refused(lambda: enamel.replace({"layer_9.alpha": 1}), "layer_9.alpha", "unknown name")
    refused(lambda: enamel.replace({"layer_1.phase.g": 2}), "layers[1].phase.g", "above 0.999")
    refused(lambda: enamel.replace({"layer_2.eta": 1}), "layers[2].eta", "material, or eta and k")
    refused(
        lambda: enamel.replace({"layer_1.phase": "rayleigh", "layer_1.phase.g": 0}),
        "layers[1].phase",
        "one of them",
    )
    refused(lambda: enamel.replace([]), None, "a mapping")


def test_optical_depth() -> None:
    assert ur.Medium(depth=0.5, albedo=1).optical_depth == 0.5
    assert ur.Medium(thickness=2, sigma_t=(1, 2, 3), albedo=1).optical_depth == (2.0, 4.0, 6.0)
    map_ = ur.Texture("a.png", scale=2)
    assert ur.Medium(thickness=map_, sigma_t=3, albedo=1).optical_depth == ur.Texture(
        "a.png", scale=6, raw=True
    )
    both = ur.Medium(thickness=map_, sigma_t=(1, 2, 3), albedo=1)
    refused(lambda: both.optical_depth, "thickness", "one texture")


def test_textures_know_whether_they_are_colours() -> None:
    image = ur.Texture("a.png")
    assert image.raw is None
    assert ur.Diffuse(image).reflectance.raw is False
    assert ur.Medium(depth=image, albedo=image).albedo.raw is False
    assert ur.Medium(depth=image, albedo=image).depth.raw is True
    assert ur.Dielectric(alpha=image).alpha.raw is True
    assert ur.Diffuse(ur.Texture("a.png", raw=True)).reflectance.raw is True
    assert image.path.is_absolute()


def test_defaults_obey_their_own_rules() -> None:
    for piece in PIECES:
        for name, rule in piece.rules().items():
            field = piece.model_fields[name]
            if not field.is_required() and field.default is not None:
                assert rule.read(field.default) == field.default
            assert rule.meaning and rule.allowed()


def test_bounds_are_allowed_and_their_neighbours_are_not() -> None:
    checked = 0
    for piece in PIECES:
        for rule in piece.rules().values():
            if type(rule) is Parameter:
                for bound, step in itertools.product((rule.low, rule.high), (-1, 1)):
                    assert rule.read(bound) == bound
                    outside = np.nextafter(bound, step * np.inf)
                    if not rule.low <= outside <= rule.high:
                        with pytest.raises(ur.MaterialError):
                            rule.read(float(outside))
                        checked += 1
    assert checked >= 20


def test_parameter_table() -> None:
    table = {row["name"]: row for row in parameter_table()}
    assert table["dielectric.ior"]["default"] == 1.5 and table["dielectric.ior"]["high"] == 5.0
    assert table["medium.albedo"]["default"] is None
    assert table["dielectric.rotation"]["unit"] == "degree"
    assert all(row["meaning"] and row["low"] < row["high"] for row in table.values())
    assert all(row["source"] for row in table.values() if row["default"] is not None)


def test_public_names() -> None:
    assert set(ur.__all__) <= set(dir(ur))
    with pytest.raises(AttributeError):
        ur.nothing  # noqa: B018
