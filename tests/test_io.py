"""Material files: exact round trips, what is refused and where, whole writes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings

import urushi as ur
from strategies import IMAGE, stacks
from urushi.description.reading import MOST
from urushi.io import dumps, loads

ENAMEL = """\
urushi: 1
name: enamel on gold
layers:
  - dielectric: {ior: 1.5, alpha: 0.1}
  - medium: {depth: 0.5, albedo: [0.95, 0.6, 0.2], phase: {henyey_greenstein: {g: 0.5}}}
  - conductor: {material: Au, alpha: 0.2}
"""


@pytest.fixture
def enamel() -> ur.Stack:
    return loads(ENAMEL)


def write(folder: Path, content: str | bytes, name: str = "m.yaml") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def layer(text: str) -> str:
    return f"urushi: 1\nlayers:\n  - {text}\n"


@settings(max_examples=200)
@given(stacks(textured=True, text=True))
def test_round_trips_are_exact(stack: ur.Stack) -> None:
    for folder in (None, IMAGE.parent, "/"):
        for form in ("yaml", "json"):
            assert loads(dumps(stack, form, folder=folder), form, folder=folder) == stack


@settings(max_examples=100)
@given(stacks(textured=True, text=True))
def test_other_yaml_readers_read_the_same(stack: ur.Stack) -> None:
    assert yaml.safe_load(dumps(stack)) == json.loads(dumps(stack, "json"))


@pytest.mark.parametrize("extension", ["yaml", "yml", "json", "YAML"])
def test_save_and_load(tmp_path: Path, enamel: ur.Stack, extension: str) -> None:
    path = tmp_path / f"enamel.{extension}"
    ur.save(enamel, path)
    assert ur.load(path) == ur.load(str(path)) == enamel
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_yaml_is_written_as_people_write_it(enamel: ur.Stack) -> None:
    assert dumps(enamel) == ENAMEL


def test_yaml_reads_what_people_write() -> None:
    block = """\
    # a comment
    urushi: 1
    description: >
      folded
      text
    layers:
      - dielectric
      - dielectric:
          ior: 1.5
          alpha: 1e-3   # a number in YAML 1.2 and JSON, if not in YAML 1.1
          multiple_scattering: false
      - medium: {depth: +.5, albedo: 1, phase: rayleigh}
      - diffuse:
    """
    stack = loads(block)
    assert stack.layers[1].alpha == 1e-3
    assert stack.layers[2] == ur.Medium(depth=0.5, albedo=1, phase=ur.Rayleigh())
    assert (stack.layers[0], stack.layers[3]) == (ur.Dielectric(), ur.Diffuse())
    assert loads("\ufeff" + ENAMEL) == loads(ENAMEL)


def test_mirror_and_words_that_yaml_1_1_would_not_read_as_text() -> None:
    assert loads(layer("conductor: {material: none}")).layers[0].material == "none"
    for name in (
        "no",
        "yes",
        "null",
        "1e-4",
        "2020-01-01",
        "12",
        "~",
        "a: b",
        "# c",
        "'",
        '"',
        "\\",
        " x",
        "é \U0001f600",
    ):
        stack = ur.Stack(name=name, layers=[ur.Diffuse()])
        assert loads(dumps(stack)).name == name
        assert yaml.safe_load(dumps(stack))["name"] == name


@pytest.mark.parametrize(
    ("content", "where", "words"),
    [
        ("", "the file", "an empty file"),
        ("# only a comment\n", "the file", "an empty file"),
        ("- 1\n", "the file", "a list at the top"),
        ("enamel", "the file", "a str at the top"),
        ("name: x\nlayers: [diffuse]", "urushi", "missing"),
        ("urushi: 2\nlayers: [diffuse]", "urushi", "found version 2"),
        ("urushi: true\nlayers: [diffuse]", "urushi", "found version True"),
        ("urushi: 1.0\nlayers: [diffuse]", "urushi", "found version 1.0"),
        ("urushi: 1\nlayer: [diffuse]", "layer", "did you mean 'layers'?"),
        ("urushi: 1\nlayers:", "layers", "found nothing"),
        ("urushi: 1\nlayers: {diffuse: {}}", "layers", "a list of 1 to"),
        ("urushi: 1\n1: x\nlayers: [diffuse]", "1", "unknown key '1'"),
        ("urushi: 1\n[a, b]: x\n", "line 2", "as a key"),
        ("urushi: 1\nname: 2020-01-01\nlayers: [diffuse]\nexterior: 2020-01-01", "exterior", "(text); allowed"),
        (layer("dielectric: {ior: .nan}"), "layers[0].dielectric.ior", "finite"),
        (layer("dielectric: {ior: 1e999}"), "layers[0].ior", "not finite"),
        (layer("dielectric: {ior: " + "9" * 5000 + "}"), "layers[0].ior", "not finite"),
        (layer("dielectric: {ior: 1.5, ior: 1.6}"), "layers[0].dielectric.ior", "(line 3)"),
        (layer("dielectric: {ior: !!python/object:os.system 1}"), "layers[0].dielectric.ior", "no tags"),
        (layer("dielectric: {ior: &a 1.5, alpha: *a}"), "layers[0].dielectric.ior", "anchor &a"),
        (layer("medium: {depth: 1, albedo: 2}"), "layers[0].albedo", "(line 3)"),
        (layer("medium:\n      depth: 1\n      albedo: 0.5\n      phase:\n        henyey_greenstein:\n          g: 7"),
         "layers[0].phase.g", "(line 8)"),
        (layer("diffuse: {reflectance: {texture: gone.png}}"), "layers[0].reflectance", "no file"),
        (layer("diffuse: {reflectance: {texture: gone.png, scales: 1}}"), "layers[0].reflectance.scales", "mean"),
        (layer("diffuse: {reflectance: {texture: .}}"), "layers[0].reflectance", "no file"),
        (layer("diffuse: {reflectance: 0.5"), "line 4, column 1", "not valid YAML"),
        ("urushi: 1\n\tname: x\n", "line 2, column 1", "not valid YAML"),
        ("urushi: 1\n---\nurushi: 1\n", "line 2", "second document"),
        ("a" * 1_000_001, "the file", "more than 1000000 bytes"),
        ("[" * 900_000, "[0][0][0][0]", "nested deeper"),
        ("? " * 400_000, "line 1", "as a key"),
        ("a: [" + "1," * 100_000 + "]", "a[19998]", "more than 20000 values"),
        (b"urushi: 1\nname: \xff\n", "line 2", "byte 0xff"),
        (b"\x00\x01\x02", "line 1, column 1", "U+0000"),
        (b"\x89PNG\r\n\x1a\n", "line 1", "byte 0x89"),
        (ENAMEL.encode("utf-16"), "line 1", "not UTF-8"),
        ('urushi: 1\nname: "\\UFFFFFFFF"\n', "the file", "not valid YAML"),
        ('urushi: 1\nname: "\\uD800"\nlayers: [diffuse]\n', "name", "surrogate"),
    ],
)  # fmt: skip
def test_bad_yaml_is_refused_with_file_and_place(
    tmp_path: Path, content: str | bytes, where: str, words: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(ur.MaterialError) as caught:
        ur.load(path)
    assert caught.value.file == str(path)
    assert caught.value.where is not None and caught.value.where.startswith(where)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}: {caught.value.where}: ")


@pytest.mark.parametrize(
    ("content", "where", "words"),
    [
        ("", "line 1, column 1", "not valid JSON"),
        ('{"urushi": 1,}', "line 1", "not valid JSON"),
        ('{"urushi": 1, "urushi": 1}', "urushi", "twice"),
        ('{"urushi": 1, "exterior": NaN, "layers": ["diffuse"]}', "exterior", "finite"),
        ('{"urushi": 1, "exterior": -Infinity, "layers": ["diffuse"]}', "exterior", "finite"),
        ('{"urushi": 1, "exterior": 1e999, "layers": ["diffuse"]}', "exterior", "not finite"),
        ('{"urushi": 1, "exterior": ' + "9" * 5000 + ', "layers": ["diffuse"]}', "exterior", "not finite"),
        ("[" * 100_000, "the file", "nested deeper"),
        ("[" * 100 + "]" * 100, "[0][0]", "nested deeper"),
        ("[" + "1," * MOST + "1]", "[", "more than 20000 values"),
        (
            '{"urushi": 1, "layers": [{"diffuse": {"reflectance": true}}]}',
            "layers[0].reflectance",
            "truth value",
        ),
    ],
)
def test_bad_json_is_refused_with_file_and_place(
    tmp_path: Path, content: str, where: str, words: str
) -> None:
    path = write(tmp_path, content, "m.json")
    with pytest.raises(ur.MaterialError) as caught:
        ur.load(path)
    assert caught.value.file == str(path)
    assert caught.value.where is not None and caught.value.where.startswith(where)
    assert words in str(caught.value)


def test_paths_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    for source, words in (
        (tmp_path / "gone.yaml", "no such file"),
        (tmp_path / "enamel.yaml", "did you mean 'preset:enamel'?"),
        (tmp_path / "folder.yaml", "no regular file"),
        (tmp_path / "m.txt", "'.txt' (text); allowed: .yaml, .yml, .json"),
        ("a\0b.yaml", "null characters"),
        ("", "found the extension"),
        ("x" * 5000 + ".yaml", "cannot be read"),
        (3, "found 3; allowed: the path"),
        (None, "found nothing"),
        ("preset:enamle", "did you mean 'enamel'"),
    ):
        with pytest.raises(ur.MaterialError) as caught:
            ur.load(source)  # type: ignore[arg-type]
        assert words in str(caught.value)


def test_textures_are_found_from_the_file_and_written_relative_to_it(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "a" / "images").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "images" / "w.png").write_bytes(b"png")
    text = layer("diffuse: {reflectance: {texture: images/w.png, scale: 0.5}}")
    stack = ur.load(write(tmp_path / "a", text))
    texture = stack.layers[0].reflectance
    assert texture.path == tmp_path / "a" / "images" / "w.png" and texture.raw is False
    ur.save(stack, tmp_path / "b" / "m.yaml")
    assert "{texture: ../a/images/w.png, scale: 0.5}" in (tmp_path / "b" / "m.yaml").read_text()
    assert ur.load(tmp_path / "b" / "m.yaml") == stack
    monkeypatch.chdir(tmp_path / "a")
    assert repr(stack.layers[0]) == "Diffuse(reflectance=Texture(file='images/w.png', scale=0.5))"
    assert ur.load("m.yaml") == stack
    assert ur.Diffuse(ur.Texture("images/w.png", 0.5)) == stack.layers[0]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root reads and writes everything")
def test_files_without_permission(tmp_path: Path, enamel: ur.Stack) -> None:
    path = write(tmp_path, ENAMEL)
    path.chmod(0)
    with pytest.raises(ur.MaterialError, match="Permission denied"):
        ur.load(path)
    tmp_path.chmod(0o500)
    with pytest.raises(ur.MaterialError, match="Permission denied"):
        ur.save(enamel, path)


def test_a_failed_write_leaves_the_old_file_whole(tmp_path: Path, enamel: ur.Stack, monkeypatch) -> None:
    path = write(tmp_path, "old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for function in ("fsync", "replace", "chmod"):
        with monkeypatch.context() as patch:
            patch.setattr(os, function, full)
            with pytest.raises(ur.MaterialError, match="No space left on device"):
                ur.save(enamel, path)
        assert path.read_text() == "old"
        assert [entry.name for entry in tmp_path.iterdir()] == ["m.yaml"]


def test_save_refuses(tmp_path: Path, enamel: ur.Stack) -> None:
    (tmp_path / "folder.yaml").mkdir()
    for stack, path, words in (
        (enamel, tmp_path / "m.txt", "allowed: .yaml, .yml, .json"),
        (enamel, tmp_path / "gone" / "m.yaml", "No such file"),
        (enamel, tmp_path / "folder.yaml", "is a folder"),
        (enamel, "a\0b.yaml", "cannot be written"),
        (enamel, 3, "the path of a material file"),
        ("stack", tmp_path / "m.yaml", "allowed: a Stack"),
    ):
        with pytest.raises(ur.MaterialError, match=words):
            ur.save(stack, path)  # type: ignore[arg-type]
    with pytest.raises(ur.MaterialError, match="'yaml' or 'json'"):
        dumps(enamel, "toml")
    with pytest.raises(ur.MaterialError, match="'yaml' or 'json'"):
        loads(ENAMEL, "toml")


@pytest.mark.skipif(os.name != "posix", reason="modes and links of POSIX")
def test_save_keeps_mode_and_link(tmp_path: Path, enamel: ur.Stack) -> None:
    path = write(tmp_path, "old")
    path.chmod(0o640)
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    ur.save(enamel, link)
    assert link.is_symlink() and ur.load(path) == enamel
    assert path.stat().st_mode & 0o777 == 0o640


def test_schema_describes_the_files() -> None:
    schema = ur.schema()
    json.dumps(schema, allow_nan=False)
    assert schema["required"] == ["urushi", "layers"]
    layers = {
        kind: body
        for option in schema["$defs"]["layer"]["anyOf"][1:]
        for kind, body in option["properties"].items()
    }
    assert set(layers) == {"dielectric", "conductor", "diffuse", "medium", "graded"}
    assert layers["dielectric"]["properties"]["ior"]["anyOf"][0] == {
        "type": "number",
        "minimum": 1.0,
        "maximum": 5.0,
    }
    assert layers["medium"]["required"] == ["albedo"]
    assert layers["medium"]["oneOf"] == [{"required": ["depth"]}, {"required": ["thickness", "sigma_t"]}]
    assert all("description" in entry for body in layers.values() for entry in body["properties"].values())


@settings(max_examples=100)
@given(stacks(textured=True, text=True))
def test_schema_accepts_what_is_written(stack: ur.Stack) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator(ur.schema()).validate(json.loads(dumps(stack, "json")))


def test_schema_refuses() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(ur.schema())
    jsonschema.Draft202012Validator.check_schema(ur.schema())
    good = {"urushi": 1, "layers": ["dielectric", {"conductor": {"material": "Au"}}]}
    assert validator.is_valid(good)
    for bad in (
        {"layers": ["diffuse"]},
        {"urushi": 2, "layers": ["diffuse"]},
        {"urushi": 1, "layers": []},
        {"urushi": 1, "layers": ["medium"]},
        {"urushi": 1, "layers": [{"conductor": {"material": "gold"}}]},
        {"urushi": 1, "layers": [{"conductor": {"material": "Au", "eta": 1, "k": 1}}]},
        {"urushi": 1, "layers": [{"dielectric": {"ior": 0.5}}]},
        {"urushi": 1, "layers": [{"dielectric": {"iorr": 1.5}}]},
        {"urushi": 1, "layers": [{"dielectric": {"alpha": 5e-5}}]},
    ):
        assert not validator.is_valid(bad), bad
