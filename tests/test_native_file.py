"""Files of solved stacks: what comes back, how small they are, and that damaged or hostile ones end in an error."""

from __future__ import annotations

import io
import json
import os
import stat
import tracemalloc
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import urushi as ur
from native_files import array, rebuilt, reheaded
from urushi.adapters import native
from urushi.adapters.native import file as native_file
from urushi.adapters.native.packing import pack, shapes, unpack
from urushi.errors import MaterialError, UrushiError
from urushi.solvers.adding.spectrum import Spectrum
from urushi.solvers.adding.whole import apart

pytestmark = pytest.mark.skipif(
    not pytest.importorskip("drjit").has_backend(pytest.importorskip("drjit").JitBackend.LLVM),
    reason="no LLVM",
)

OPAQUE = ur.Stack(
    name="enamel",
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.3),
        ur.Medium(depth=0.5, albedo=[0.95, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.5)),
        ur.Conductor(material="Au", alpha=0.4),
    ],
)
OPEN = ur.Stack(
    name="frosted",
    layers=[
        ur.Medium(depth=0.7, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.4)),
        ur.Dielectric(ior=1.3, alpha=0.4),
    ],
)
SMOOTH = ur.Stack(name="glass", layers=[ur.Dielectric(ior=1.5)])
#: diagnostics of what is made anew from the operators that were loaded
LOOKED_UP = ("most_negative", "azimuthal_error", "azimuthal_terms", "table_bytes")
#: its own mirror image, with light scattered once that needs no storing
FOG = ur.Stack(layers=[ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.5))])
STACKS = {"opaque": OPAQUE, "open": OPEN, "smooth": SMOOTH, "fog": FOG}


@pytest.fixture(scope="module")
def solved():
    return {name: ur.solve(stack, "adding", nodes=10) for name, stack in STACKS.items()}


@pytest.fixture
def saved(solved, tmp_path):
    def saved(name, **options):
        path = tmp_path / f"{name}.urushi.npz"
        native.save(solved[name], path, **options)
        return path

    return saved


def directions(rng, n, both):
    w = rng.normal(size=(n, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    return w if both else w * [1, 1, 1] + np.where(w[:, 2:] < 0, -2 * w * [0, 0, 1], 0)


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("error", [1e-3, 1e-5])
def test_what_is_saved_comes_back(solved, saved, rng, name, error):
    """Values to the stated error of the peak, energies and delta parts to single precision, description and all."""
    one, other = solved[name], native.load(saved(name, error=error))
    assert other.stack == one.stack
    assert other.diagnostics == one.diagnostics | {
        "file_error": error,
        **{k: other.diagnostics[k] for k in LOOKED_UP},
    }
    wi, wo = (directions(rng, 1000, name != "opaque") for _ in range(2))
    value, expected = one.eval(wi, wo, with_error=True)
    scale = expected / max(one.diagnostics["estimated_error"], 1e-300)
    # Both look up series in azimuth that are short to an error of their own.
    allowed = error + 2 * one.diagnostics["azimuthal_error"]
    assert (np.abs(other.eval(wi, wo) - value) <= allowed * scale + 1e-12).all()
    assert np.abs(other.reflectance(wi) - one.reflectance(wi)).max() < 1e-6
    assert np.abs(other.transmittance(wi) - one.transmittance(wi)).max() < 1e-6
    sides = [(True, True)] if name == "opaque" else [(a, b) for a in (True, False) for b in (True, False)]
    for order in range(one.matrices.orders):
        for side in sides:
            a, b = one.matrices.operator(order, *side), other.matrices.operator(order, *side)
            assert np.abs(a - b).max() < error
    sample = other.sample(wi, rng.random((1000, 3)))
    ok = ~sample.delta & (sample.pdf > 0)
    ratio = other.eval(wi, sample.wo)[ok] / other.pdf(wi, sample.wo)[ok][:, None]
    assert np.allclose(sample.weight[ok], ratio, rtol=1e-4, atol=1e-7)


def test_what_need_not_be_stored_is_not(solved, saved):
    """A slab is seen alike from both sides, and its description has what is scattered once in it."""
    header, _ = pack(solved["fog"].solution, 1e-4)
    assert header["mirror"] and header["once"] == []
    assert list(header["parts"]) == ["above to above", "above to below"]
    with zipfile.ZipFile(saved("fog")) as archive:
        written = json.loads(np.load(archive.open("header.npy")).tobytes())
    assert written["once"] == list(header["parts"]) and written["terms"].keys() == {"1"}
    with pytest.raises(MaterialError, match="scattered once"):
        unpack(*pack(solved["fog"].solution, 1e-4, native_file._known(Spectrum.of(FOG))), {})
    assert not pack(solved["open"].solution, 1e-4)[0]["mirror"]


def test_slabs_are_five_times_smaller_than_layerlabs(tmp_path):
    """At 1e-3, solution and file together: layerlab's file of the first has 11184 bytes, of the second 74 kB."""
    for g, size in ((0.5, 11184), (0.8, 74000)):
        stack = ur.Stack(
            name=f"slab g {g}", layers=[ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=g))]
        )
        bsdf = ur.solve(stack, "adding")
        assert 5 * native.save(bsdf, tmp_path / "slab.urushi.npz") <= size
        loaded = native.load(tmp_path / "slab.urushi.npz")
        told = loaded.diagnostics["estimated_error"] + loaded.diagnostics["file_error"]
        best = ur.solve(stack, "adding", accuracy=1e-5)
        assert apart(stack, loaded.solution, best.solution) < told <= 1e-3


@pytest.mark.parametrize("accuracy", [0.5, 1e-6, 1e-9])
def test_its_own_default_error_is_one_that_it_takes(tmp_path, accuracy):
    """However small the accuracy: no file knows better than single precision, and it says so."""
    bsdf = ur.solve(ur.Stack(layers=[ur.Medium(depth=0.1, albedo=0.5)]), "adding", nodes=6, accuracy=accuracy)
    native.save(bsdf, tmp_path / "x.urushi.npz")
    error = native.load(tmp_path / "x.urushi.npz").diagnostics["file_error"]
    assert (
        error == native.spare(bsdf)
        and max(0.1 * accuracy, 1e-7) * 0.999 <= error <= max(0.5 * accuracy, 1e-7) * 1.001
    )


@pytest.mark.parametrize(("known", "left"), [(1e-4, 5e-4), (6e-4, 4e-4), (9.8e-4, 1e-4)])
def test_a_file_takes_what_the_solution_left_and_no_more_than_half(known: float, left: float) -> None:
    """Of the accuracy of 1e-3; but a tenth of it at least."""
    solution = SimpleNamespace(diagnostics={"accuracy": 1e-3, "estimated_error": known})
    assert native.spare(SimpleNamespace(solution=solution)) == pytest.approx(left, rel=0.05)


def test_a_smaller_error_takes_a_larger_file(saved):
    sizes = [os.path.getsize(saved("opaque", error=error)) for error in (1e-2, 1e-4, 1e-6)]
    assert sizes[0] < sizes[1] < sizes[2]


def test_saving_and_loading_again_changes_nothing_more(saved, tmp_path):
    first = saved("open")
    again = tmp_path / "again.urushi.npz"
    bsdf = native.load(first)
    bsdf.solution.diagnostics.pop("file_error")
    native.save(bsdf, again)
    one, other = native.load(first), native.load(again)
    for order in range(one.matrices.orders):
        assert np.allclose(one.matrices.operator(order), other.matrices.operator(order), atol=1e-6)


def test_a_mirror_image_that_is_none_is_refused(solved):
    """Reciprocity is used to halve the file: operators without it are not bent into shape."""
    solution = solved["opaque"].solution
    part = solution.parts[True, True]
    block = part.blocks[0]
    values = np.array(block.values)
    values[:, 0, 2, 5] *= 1.01
    wrong = replace(part, blocks=[replace(block, values=values), *part.blocks[1:]])
    with pytest.raises(MaterialError, match="mirror image"):
        pack(replace(solution, parts={(True, True): wrong}), 1e-5)


@pytest.mark.parametrize("name", STACKS)
def test_shapes_are_those_of_the_arrays(solved, name):
    header, arrays = pack(solved[name].solution, 1e-4)
    assert shapes(header) == {key: array.shape for key, array in arrays.items()}
    assert set(unpack(header, arrays, {}).parts) == set(solved[name].solution.parts)


# --- places and files ------------------------------------------------------------------------------------------------


def test_what_is_too_faint_for_single_precision_is_dark(tmp_path):
    thick = ur.solve(ur.Stack(layers=[ur.Medium(depth=200.0, albedo=0.5)]), "adding", nodes=10)
    native.save(thick, tmp_path / "thick.urushi.npz")
    found = native.load(tmp_path / "thick.urushi.npz")
    wi = np.array([[0.6, 0.0, 0.8]])
    assert np.allclose(found.reflectance(wi), thick.reflectance(wi), atol=1e-6)
    assert 0 < thick.transmittance(wi).min() < 1e-35 and found.transmittance(wi).max() < 1e-35


def test_the_wrong_place_or_thing_is_refused(solved, tmp_path):
    for path, match in (
        (tmp_path / "x.npz", "ending"),
        (tmp_path / "no" / "x.urushi.npz", "cannot be written"),
        (5, "path"),
    ):
        with pytest.raises(MaterialError, match=match):
            native.save(solved["smooth"], path)
    with pytest.raises(MaterialError, match="solve"):
        native.save(SMOOTH, tmp_path / "x.urushi.npz")
    with pytest.raises(MaterialError, match="error"):
        native.save(solved["smooth"], tmp_path / "x.urushi.npz", error=0.5)
    (tmp_path / "x.urushi.npz").mkdir()
    for path in (tmp_path / "none.urushi.npz", tmp_path / "x.urushi.npz", 5):
        with pytest.raises(MaterialError):
            native.load(path)
    assert list(tmp_path.iterdir()) == [tmp_path / "x.urushi.npz"]


def test_a_file_is_replaced_whole(solved, tmp_path, monkeypatch):
    path = tmp_path / "x.urushi.npz"
    native.save(solved["smooth"], path)
    before, mode = path.read_bytes(), stat.S_IMODE(path.stat().st_mode)

    def fails(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(MaterialError, match="No space"):
        patch.setattr(os, "replace", fails)
        native.save(solved["opaque"], path)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == [path.name]
    native.save(solved["opaque"], path)
    assert path.read_bytes() != before and stat.S_IMODE(path.stat().st_mode) == mode


def test_the_same_solution_makes_the_same_bytes(saved, tmp_path):
    assert saved("open").read_bytes() == saved("open").read_bytes()


HEADERS = {
    "urushi solved stack": 1,
    "mirror": True,
    "terms": {"1": 10**9},
    "once": ["above to below"],
    "colours": 10**9,
    "planes": 7,
    "closed_form": "magic",
    "error": float("nan"),
    "indices": [1.0, 1e300],
    "panels": [[1.0, 4000], [1.3, 10]],
    "forward": {"1": 2.0},
    "deltas": {"above to above": 10**12},
    "parts": lambda parts: {"above to above": {"blocks": [[0, 10**15, 0]], "rest": []}},
    "diagnostics": [],
    "stack": {"urushi": 1, "layers": []},
}


@pytest.mark.parametrize("key", HEADERS)
def test_a_header_that_no_stack_has_is_refused(saved, key):
    with pytest.raises(UrushiError) as caught:
        native.load(reheaded(saved("open"), **{key: HEADERS[key]}))
    assert "open.urushi.npz" in str(caught.value)


def test_few_bytes_do_not_ask_for_many_numbers(saved):
    """No plane of integers at all, or nothing but what the description tells, of a thousand nodes and orders."""
    sizes = {"planes": 0, "panels": [[1.0, 500], [1.3, 400]], "deltas": {}}
    blocks = {"blocks": [[0, 1 << 14, 0]], "rest": []}
    parts = dict.fromkeys(["above to above", "above to below", "below to below"], blocks)
    with pytest.raises(MaterialError, match=r"operators of \d+ numbers in a file of \d+ bytes"):
        native.load(reheaded(saved("open"), parts=parts, **sizes))
    parts = {name: {"blocks": [], "rest": [[0, 1 << 14, 0]]} for name in parts}
    with pytest.raises(MaterialError, match=r"operators of \d+ numbers in a file of \d+ bytes"):
        native.load(reheaded(saved("open"), parts=parts, once=["above to above"], **sizes))


def test_the_description_of_another_stack_is_refused(saved):
    other = json.loads(ur.io.dumps(SMOOTH, "json"))
    with pytest.raises(MaterialError, match="description"):
        native.load(reheaded(saved("open"), stack=other))
    thin = json.loads(ur.io.dumps(OPEN, "json"))
    thin["layers"][1]["dielectric"]["ior"] = 1.31
    with pytest.raises(MaterialError, match="description"):
        native.load(reheaded(saved("open"), stack=thin))


@pytest.mark.parametrize(
    ("member", "content"),
    [
        ("data.npy", array([0.5, 0.7], "<f4")),
        ("data.npy", array([1, 2], "|u1")),
        (
            "data.npy",
            b"\x93NUMPY\x01\x00\x76\x00{'descr': '|O', 'fortran_order': False, 'shape': (9,)}"
            + b" " * 60
            + b"\n",
        ),
        ("data.npy", b"not an array"),
        ("data.npy", None),
    ],
)
def test_members_that_do_not_fit_are_refused(saved, member, content):
    with pytest.raises(MaterialError):
        native.load(rebuilt(saved("open"), lambda name, old: content if name == member else old))


def test_a_value_that_is_no_number_is_refused(saved):
    def change(name, content):
        values = np.array(np.load(io.BytesIO(content)))
        if name == "data.npy":
            values[12:16] = np.frombuffer(np.float32(np.inf).tobytes(), np.uint8)
        return array(values)

    with pytest.raises(MaterialError, match="not finite"):
        native.load(rebuilt(saved("open"), change))


def test_a_bomb_is_refused_before_it_is_unpacked(saved):
    """A hundred megabytes of zeros in a hundred kilobytes, with a header that wants them."""
    path = saved("opaque")
    bomb = rebuilt(path, lambda name, old: array(np.zeros(1 << 27, np.uint8)) if name == "data.npy" else old)
    tracemalloc.start()
    try:
        with pytest.raises(MaterialError, match="times as many"):
            native.load(bomb)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_damaged_files_end_in_an_error(saved, rng, tmp_path, monkeypatch):
    """A thousand files with bytes changed, cut off or put in; also past the checksums, which catch most of it."""
    content = saved("open").read_bytes()
    path = tmp_path / "bad.urushi.npz"
    caught = 0
    for k in range(1200):
        if k == 600:
            monkeypatch.setattr(zipfile.ZipExtFile, "_update_crc", lambda self, data: None)
        bad = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(bad)))
            what = rng.integers(4)
            if what == 0:
                del bad[at:]
                break
            if what == 1:
                bad[at] ^= 1 << int(rng.integers(8))
            elif what == 2:
                bad[at : at + 4] = rng.bytes(4)
            else:
                bad[at:at] = rng.bytes(int(rng.integers(1, 9)))
        path.write_bytes(bytes(bad))
        try:
            native_file.read(path)
        except UrushiError:
            caught += 1
    assert caught > 1000
