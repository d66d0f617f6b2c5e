"""Fourier files: the bytes that went in come out, and no file, however broken, does worse than a clear error."""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourier_files import COATED, SLAB, small
from urushi.adapters.fourier import FourierTable, evaluate, read_fourier, write_fourier
from urushi.adapters.fourier.file import packed, unpacked
from urushi.errors import MaterialError, UrushiError

TABLES = {
    "one": small(),
    "rgb": small(3),
    "parameter": small(3, (3,)),
    "grid": small(1, (2, 3), metadata=b'{"alpha": [0.1, 1]}', eta=1.5, alpha=(0.1, 0.2)),
}


def written(table: FourierTable, folder: Path) -> bytes:
    path = folder / "written.bsdf"
    write_fourier(table, path)
    return path.read_bytes()


@pytest.mark.parametrize("path", [SLAB, COATED], ids=["slab", "coated"])
def test_a_file_of_layerlab_is_written_as_it_was(tmp_path, path):
    assert written(read_fourier(path), tmp_path) == path.read_bytes()


@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_is_read(tmp_path, name):
    table = TABLES[name]
    content = written(table, tmp_path)
    found = read_fourier(tmp_path / "written.bsdf")
    assert written(found, tmp_path) == content
    for key in ("nodes", "cdf", "offsets", "counts", "coefficients"):
        np.testing.assert_array_equal(getattr(found, key), getattr(table, key), err_msg=key)
    assert [p.tolist() for p in found.positions] == [p.tolist() for p in table.positions]
    for key in ("channels", "bases", "max_order", "flags", "metadata"):
        assert getattr(found, key) == getattr(table, key), key
    np.testing.assert_allclose((found.eta, *found.alpha), (table.eta, *table.alpha), rtol=1e-7)


def test_every_field_stands_where_the_definition_says(tmp_path):
    """`docs/fourier-file.md`, byte by byte, without the reader's own layout."""
    table = small(3, (2, 3), metadata=b"about", eta=1.25, alpha=(0.5, 0.75))
    content = written(table, tmp_path)
    n, b = len(table.nodes), 6
    assert content[:8] == b"SCATFUN\x01"
    whole = struct.unpack("<9I", content[8:44])
    assert whole == (1, n, len(table.coefficients), table.max_order, 3, b, 5, 2, 5)
    assert struct.unpack("<3f", content[44:56]) == (1.25, 0.5, 0.75)
    assert content[56:64] == bytes(8)
    assert struct.unpack(f"<{n}f", content[64 : 64 + 4 * n]) == tuple(table.nodes)
    at = 64 + 4 * n
    assert struct.unpack("<2I5f", content[at : at + 28]) == (2, 3, *(v for p in table.positions for v in p))
    at += 28
    i, o = 5, 2  # from above, reflected
    (cdf,) = struct.unpack_from("<f", content, at + 4 * (i * n * b + o * b + 4))
    assert cdf == table.cdf[i, o, 4]
    at += 4 * n * n * b
    offset, count = struct.unpack_from("<2I", content, at + 8 * (o + i * n))
    assert (offset, count) == (table.offsets[i, o], table.counts[i, o]) and count > 1
    at += 8 * n * n
    series = struct.unpack_from(f"<{count}f", content, at + 4 * (offset + (2 * b + 4) * count))
    assert series == tuple(table.series(i, o, 2, 4))
    assert content[at + 4 * len(table.coefficients) :] == b"about"


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "old.bsdf"
    write_fourier(TABLES["one"], path)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MaterialError, match=r"old\.bsdf: cannot be written: No space"):
        write_fourier(TABLES["rgb"], path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["old.bsdf"]


def field(number: int, value: int) -> tuple[int, bytes]:
    """A header field: flags, nodes, coefficients, longest, channels, bases, metadata, parameters, values."""
    return 8 + 4 * number, struct.pack("<I", value)


N = 8  # nodes of the file below
BODY = 64 + 4 * N
OFFSETS = BODY + 4 * N * N
FAULTS = {
    "empty": (slice(0, 0), None, "header: found 0 bytes"),
    "cut in the header": (slice(0, 40), None, "header: found 40 bytes"),
    "cut after it": (slice(0, 64), None, "size: found 64 bytes"),
    "cut at the end": (slice(0, -1), None, "size: found"),
    "another format": (slice(None), (0, b"RGLTENS"), "header: found b'RGLTENS'"),
    "another version": (slice(None), (7, b"\2"), "version 2"),
    "flags": (slice(None), field(0, 5), "flags: found 5"),
    "no bsdf": (slice(None), field(0, 0), "flags: found 0"),
    "many nodes": (slice(None), field(1, 2**32 - 1), "size: found"),
    "many coefficients": (slice(None), field(2, 2**32 - 1), "size: found"),
    "few orders": (slice(None), field(3, 1), r"counts\[\d, \d\]: found \d; allowed: at most max_order, 1"),
    "two channels": (slice(None), field(4, 2), "channels: found 2"),
    "three channels of one": (slice(None), field(4, 3), "counts: found"),
    "many bases": (slice(None), field(5, 2**32 - 1), "size: found"),
    "much metadata": (slice(None), field(6, 2**32 - 1), "size: found"),
    "a node that is no number": (slice(None), (68, struct.pack("<f", np.nan)), r"nodes\[1\]: found nan"),
    "a node beyond 1": (slice(None), (64, struct.pack("<f", -1.5)), r"nodes\[0\]: found -1.5"),
    "nodes that fall": (slice(None), (68, struct.pack("<f", 0.5)), r"nodes\[2\]: found"),
    "three equal nodes": (slice(None), (64 + 4 * 5, struct.pack("<f", 0)), r"nodes\[5\]: found 0.0"),
    "equal nodes at the end": (slice(None), (64 + 4 * 6, struct.pack("<f", 1)), r"nodes\[7\]: found 1.0"),
    "cdf": (slice(None), (BODY + 4 * (N + 2), struct.pack("<f", np.inf)), r"cdf\[1, 2, 0\]: found inf"),
    "offset": (slice(None), (OFFSETS, struct.pack("<I", 10**6)), r"offsets\[0, 0\]: found 1000000"),
    "offset one too far": (
        slice(None),
        (OFFSETS, struct.pack("<I", len(TABLES["one"].coefficients) - int(TABLES["one"].counts[0, 0]) + 1)),
        r"offsets\[0, 0\]: found",
    ),
    "offset that overflows": (
        slice(None),
        (OFFSETS, struct.pack("<I", 2**32 - 1)),
        r"offsets\[0, 0\]: found 4294",
    ),
    "count": (slice(None), (OFFSETS + 4, struct.pack("<I", 2**32 - 1)), r"counts\[0, 0\]: found 4294967295"),
    "coefficient": (slice(None), (OFFSETS + 8 * N * N, struct.pack("<f", np.nan)), r"coefficients\[0\]"),
    "eta": (slice(None), (44, struct.pack("<f", np.nan)), "eta: found nan"),
    "alpha": (slice(None), (48, struct.pack("<f", np.inf)), "alpha: found"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_file_is_refused_with_its_name_and_the_place(tmp_path, fault):
    part, change, message = FAULTS[fault]
    content = bytearray(written(TABLES["one"], tmp_path))
    if change:
        content[change[0] : change[0] + len(change[1])] = change[1]
    path = tmp_path / "broken.bsdf"
    path.write_bytes(content[part])
    with pytest.raises(MaterialError, match=message) as caught:
        read_fourier(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("counts", "values", "bases"), [((2,), 3, 3), ((3, 0), 3, 0), ((2, 2), 4, 3), ((2,) * 40, 80, 4)]
)
def test_a_grid_of_parameters_that_does_not_fit(tmp_path, counts, values, bases):
    """Sizes that agree with the length of the file, and not with one another."""
    n = 2
    head = struct.pack(
        "<7sB9I3f8s", b"SCATFUN", 1, 1, n, 0, 0, 1, bases, 0, len(counts), values, 1, 0, 0, bytes(8)
    )
    body = struct.pack(f"<{n}f{len(counts)}I", -1, 1, *counts) + bytes(4 * values)
    path = tmp_path / "grid.bsdf"
    path.write_bytes(head + body + bytes(4 * n * n * bases + 8 * n * n))
    with pytest.raises(MaterialError, match="parameter sample counts: found"):
        read_fourier(path)


def test_what_is_no_file(tmp_path):
    with pytest.raises(MaterialError, match="No such file"):
        read_fourier(tmp_path / "none.bsdf")
    with pytest.raises(MaterialError, match=r"cannot be read|no regular file"):
        read_fourier(tmp_path)
    with pytest.raises(MaterialError, match="is a folder"):
        write_fourier(TABLES["one"], tmp_path)
    with pytest.raises(MaterialError, match="null"):
        read_fourier("a\0b")
    with pytest.raises(MaterialError, match="found None"):
        read_fourier(None)  # type: ignore[arg-type]
    with pytest.raises(MaterialError, match="found a dict"):
        write_fourier({}, tmp_path / "x.bsdf")  # type: ignore[arg-type]
    if hasattr(os, "mkfifo"):  # nobody writes to it: waiting for someone would never end
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(MaterialError, match="no regular file"):
            read_fourier(tmp_path / "pipe")


def test_a_table_that_does_not_fit_together():
    table = TABLES["grid"]
    for name, value, message in (
        ("nodes", table.nodes[:-1], "cdf: found the shape"),
        ("nodes", np.array([0.5]), "nodes: found the shape"),
        ("nodes", "abc", "nodes: found a str"),
        ("counts", -table.counts.astype(int), "counts: found -4"),
        ("bases", 2, "bases: found 2; allowed: 6"),
        ("positions", (np.array([1.0, 0.0]), table.positions[1]), r"positions\[0\]"),
        ("max_order", -1, "max_order"),
        ("unused", b"", "unused"),
        ("alpha", (1e60, 0), "alpha"),
    ):
        with pytest.raises(MaterialError, match=message):
            replace(table, **{name: value})


def mutants(content: bytes, rng: np.random.Generator, n: int) -> list[bytes]:
    """Files with bits turned over, pieces cut out, and fields set to extremes."""
    extremes = [0, 1, 2, 3, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]
    extremes += [0x7F800000, 0xFF800000, 0x7FC00000, 0x3F800000, 0x40000000, 0x10000, 46341, 65536]
    found = []
    for _ in range(n):
        changed = bytearray(content)
        for _ in range(int(rng.integers(1, 4))):
            kind, limit = rng.integers(5), int(rng.choice([64, len(content)]))
            if kind == 0:
                changed = changed[: int(rng.integers(len(changed) + 1))]
            elif kind == 1 and changed:
                at = int(rng.integers(min(limit, len(changed))))
                changed[at] ^= 1 << int(rng.integers(8))
            elif kind == 2:
                at = 4 * int(rng.integers(2, limit // 4))
                changed[at : at + 4] = struct.pack("<I", int(rng.choice(extremes)))
            elif kind == 3:
                at = int(rng.integers(len(changed) + 1))
                del changed[at : at + int(rng.integers(1, 40))]
            else:
                at = 4 * int(rng.integers(16, len(content) // 4))
                changed[at : at + 4] = struct.pack("<I", int(rng.integers(2**32)))
        found.append(bytes(changed))
    return found


def test_no_broken_file_does_worse_than_an_error(tmp_path, rng):
    """Whatever is accepted is written as it was, and can be evaluated; nothing takes memory that the file lacks."""
    wi, wo = np.array([[0.6, 0.0, 0.8]]), np.array([[-0.6, 0.0, 0.8], [0.0, 0.6, -0.8]])
    accepted = refused = 0
    tracemalloc.start()
    try:
        for name in TABLES:
            content = written(TABLES[name], tmp_path)
            for changed in mutants(content, rng, 600):
                tracemalloc.reset_peak()
                try:
                    table = unpacked(io.BytesIO(changed), len(changed))
                except UrushiError as error:
                    assert "found" in str(error) and "allowed" in str(error)
                    refused += 1
                    continue
                finally:
                    assert tracemalloc.get_traced_memory()[1] < 5_000_000
                accepted += 1
                assert packed(table) == changed
                if table.bases == 1 and not table.extrapolated:
                    with np.errstate(over="ignore", invalid="ignore"):
                        evaluate(table, wi, wo)
    finally:
        tracemalloc.stop()
    assert accepted > 200 and refused > 1000
