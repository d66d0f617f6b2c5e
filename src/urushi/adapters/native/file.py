"""From a solved stack to a ``.urushi.npz`` file and back. A file is checked before anything of it is believed."""

from __future__ import annotations

import io
import math
import os
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from urushi.errors import MaterialError, UrushiError
from urushi.io import dumps, loads, replace
from urushi.solvers.adding import build
from urushi.solvers.adding.channels import ChannelsBSDF
from urushi.solvers.adding.once import covers
from urushi.solvers.adding.result import AddingBSDF
from urushi.solvers.adding.solution import Block, Solution
from urushi.solvers.adding.solver import scattered_once
from urushi.solvers.adding.spectrum import Spectrum
from urushi.solvers.adding.through import met
from urushi.stack import Stack

from . import header as headers
from .packing import FREE, LEAST, MOST, Known, most_numbers, pack, shapes, unpack

ENDING = ".urushi.npz"
#: what is in the data one after another, and the type of its numbers
TYPES = {"delta": "<f4", "peaks": "<f4", "sums": "<i2", "values": "|u1"}
MEMBERS = ("header", "data")
#: numbers that each byte of a file may stand for; what packs better is stored as it is
DENSEST = 32
#: bytes of an array's own header, at most
_HEAD = 1 << 10


def save(bsdf: AddingBSDF | ChannelsBSDF, path: str | os.PathLike[str], *, error: float | None = None) -> int:
    """Write a solved stack, whole or not at all.

    Args:
        bsdf: what `solve(stack, "adding")` gave, of any number of channels.
        path: a name ending in ``.urushi.npz``; an existing file is replaced once the new one is complete.
        error: what the file may add to the error of the BSDF, relative to its peak for the same angle of incidence,
            1e-7 (no file in single precision knows better) to 0.1; by default what the solution left of the accuracy
            asked for, but a tenth of that at least, and half of it at most.

    Returns:
        The size in bytes.

    Raises:
        MaterialError: another ending, not a solved stack, or a place that cannot be written to.
    """
    name = _printable(path)
    try:
        if not isinstance(bsdf, AddingBSDF | ChannelsBSDF):
            raise MaterialError(f"found a {type(bsdf).__name__}; allowed: what solve(stack, 'adding') gives")
        if not name.lower().endswith(ENDING):
            raise MaterialError(f"found another ending; allowed: {ENDING}")
        content = packed(_described(bsdf), bsdf.solution, spare(bsdf) if error is None else error)
        replace(Path(os.path.realpath(os.fsdecode(path))), content)
    except MaterialError as fault:
        raise MaterialError(fault.problem, where=fault.where, file=name) from None
    except (OSError, ValueError) as fault:
        raise MaterialError(
            f"cannot be written: {getattr(fault, 'strerror', None) or fault}", file=name
        ) from None
    return len(content)


def spare(bsdf: AddingBSDF | ChannelsBSDF) -> float:
    """The error that `save` adds by default, relative to the peak of the BSDF for the same angle of incidence."""
    accuracy = float(bsdf.solution.diagnostics.get("accuracy", 1e-3))
    left = accuracy - float(bsdf.solution.diagnostics.get("estimated_error", accuracy))
    digits = f"{min(max(left, 0.1 * accuracy), 0.5 * accuracy, MOST):.9e}"
    return max(float(digits[:3] + digits[-4:]), LEAST)  # rounded down to two of them


def load(path: str | os.PathLike[str], **options: Any) -> AddingBSDF | ChannelsBSDF:
    """Read a solved stack.

    Args:
        path: a ``.urushi.npz`` file.
        **options: `backend`, `precision`, `mode`, `order`: see `AddingBSDF`.

    Returns:
        The BSDF, its description in `stack`, and its channels in `parameters` where they are not a colour's. Its
        diagnostics are those of the solver, and "file_error", what the file added to the error.

    Raises:
        MaterialError: no such file, another format or version, sizes that do not fit together, numbers that no BSDF
            has, or a description that is not that of the operators.
        UrushiError: an option out of range.
    """
    spectrum, solution = read(path)
    if spectrum.channels is None:
        return AddingBSDF(spectrum.stack, solution, **options)
    return ChannelsBSDF(spectrum, solution, **options)


def read(path: str | os.PathLike[str]) -> tuple[Spectrum, Solution]:
    """The description and the operators in a file; raises as `load` does."""
    name = _printable(path)
    try:
        with open(os.fsdecode(path), "rb", opener=_opened) as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise MaterialError(f"is no regular file; allowed: a {ENDING} file")
            return _read(stream, status.st_size)
    except UrushiError as fault:
        problem, where = getattr(fault, "problem", str(fault)), getattr(fault, "where", None)
        raise MaterialError(problem, where=where, file=name) from None
    except zipfile.BadZipFile as fault:
        raise MaterialError(f"is damaged, or no {ENDING} file: {fault}", file=name) from None
    except (
        OSError,
        ValueError,
        EOFError,
        NotImplementedError,
        RuntimeError,
        zlib.error,
        OverflowError,
    ) as fault:
        raise MaterialError(
            f"cannot be read: {getattr(fault, 'strerror', None) or fault}", file=name
        ) from None


def packed(stack: Stack | Spectrum, solution: Solution, error: float) -> bytes:
    """The whole file as bytes; see `save`."""
    spectrum = stack if isinstance(stack, Spectrum) else Spectrum.of(stack)
    found, arrays = pack(solution, error, _known(spectrum))
    if spectrum.channels is not None:
        if spectrum.channels > headers.MOST_CHANNELS:
            raise MaterialError(
                f"found {spectrum.channels} channels; allowed: at most {headers.MOST_CHANNELS} in a file"
            )
        found["channels"] = {name: values.tolist() for name, values in spectrum.parameters.items()}
    text = headers.text(found, dumps(spectrum.stack, "json"), solution.diagnostics)
    data = b"".join(np.ascontiguousarray(arrays[name], kind).tobytes() for name, kind in TYPES.items())
    members = {"header": np.frombuffer(text, np.uint8), "data": np.frombuffer(data, np.uint8)}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in members.items():
            with io.BytesIO() as plain:
                np.lib.format.write_array(plain, array, version=(1, 0), allow_pickle=False)
                content = plain.getvalue()
            small = len(zlib.compress(content, 9)) * DENSEST >= len(content)
            # A fixed date: the same solution makes the same file.
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED if small else zipfile.ZIP_STORED
            archive.writestr(entry, content, compresslevel=9)
    return stream.getvalue()


def _described(bsdf: AddingBSDF | ChannelsBSDF) -> Spectrum:
    return bsdf.spectrum if isinstance(bsdf, ChannelsBSDF) else Spectrum.of(bsdf.stack)


def _read(stream: Any, size: int) -> tuple[Spectrum, Solution]:
    with zipfile.ZipFile(stream) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        wanted = [f"{name}.npy" for name in MEMBERS]
        if sorted(entries) != sorted(wanted) or len(archive.infolist()) != len(wanted):
            raise MaterialError(f"found the members {sorted(entries)[:9]}; allowed: {', '.join(wanted)}")
        for name, entry in entries.items():
            if entry.compress_type not in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED) or entry.flag_bits & 1:
                raise MaterialError("found another compression, or a password; allowed: deflate", where=name)
            if entry.file_size > DENSEST * size + _HEAD:
                raise MaterialError(
                    f"found {entry.file_size} bytes in a file of {size}; allowed: {DENSEST} times as many",
                    where=name,
                )
        text = _array(archive, entries["header.npy"], "|u1", None).tobytes()
        header, description, diagnostics = headers.parsed(text, size)
        expected = shapes(header)
        if (count := most_numbers(header)) > max(FREE, headers.PER_BYTE * size):
            raise MaterialError(
                f"found operators of {count} numbers in a file of {size} bytes; allowed: no more than such a file has",
                where="parts",
            )
        sizes = {name: math.prod(expected[name]) * np.dtype(kind).itemsize for name, kind in TYPES.items()}
        data = _array(archive, entries["data.npy"], "|u1", (sum(sizes.values()),)).tobytes()
    arrays, start = {}, 0
    for name, kind in TYPES.items():
        arrays[name] = np.frombuffer(data, kind, math.prod(expected[name]), start).reshape(expected[name])
        start += sizes[name]
    for name in ("delta", "peaks"):
        if not np.isfinite(arrays[name]).all():
            raise MaterialError("found a value that is not finite; allowed: numbers", where=name)
    spectrum = Spectrum.of(loads(description, "json"), header.get("channels"))
    _check_stack(spectrum, header)
    diagnostics = {**diagnostics, "file_error": header["error"]}
    return spectrum, unpack(header, arrays, diagnostics, _known(spectrum))


def _known(spectrum: Spectrum) -> Known:
    """What the description says of the operators (see `packing`)."""
    from urushi import llvm

    llvm.ensure()
    bound = spectrum.bind(build.bind_numbers).whole
    phases = build.phase_functions(spectrum.stacks[0])

    def known(
        solution: Solution, side: tuple[bool, bool], blocks: list[tuple[range, int]]
    ) -> list[Block] | None:
        region = 1 if side[0] else len(bound.interfaces) - 1
        sides = all(above or not bound.opaque for above in side)
        behind = solution.closed_form == "single, through" and met(bound, *side) is not None
        if not (sides and covers(bound, *side) and region in solution.terms) or behind:
            return None
        return scattered_once(bound, phases, solution, side, blocks)

    return known


def _array(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo, kind: str, shape: tuple[int, ...] | None
) -> np.ndarray:
    """A member, whose own header has to be that of an array of this kind; no shape for any of one axis."""
    with archive.open(entry) as member:
        head = member.read(10)
        length = int.from_bytes(head[8:10], "little")
        said = member.read(length) if length <= _HEAD else b""
        size = entry.file_size - 10 - length
        if shape is None:
            shape = (max(size, 0) // np.dtype(kind).itemsize,)
        count = math.prod(shape)
        # Never given to numpy's own reader, which runs what it finds there through Python's parser.
        wanted = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
        if (
            head[:8] != b"\x93NUMPY\x01\x00"
            or said.strip() != wanted
            or size != count * np.dtype(kind).itemsize
        ):
            raise MaterialError(
                f"found {size} bytes under the header {said[:90].strip()!r}; allowed: {wanted!r}",
                where=entry.filename,
            )
        body = member.read()
    if len(body) != size:
        raise MaterialError(f"ends after {len(body)} bytes; allowed: {size}", where=entry.filename)
    return np.frombuffer(body, kind).reshape(shape)


def _check_stack(spectrum: Spectrum, header: dict[str, Any]) -> None:
    """The description has the indices, colours and sides of the operators."""
    from urushi import llvm

    llvm.ensure()
    if ("channels" in header) != (spectrum.channels is not None):
        raise MaterialError(
            "found no other channels than a colour's; allowed: none of them", where="channels"
        )
    every = spectrum.bind(build.bind_numbers)
    bound, colours = every.whole, every.channels
    indices = build.indices(bound)
    found = len(header["indices"]), header["colours"], "above to below" not in header["parts"]
    allowed = len(indices), colours, bound.opaque
    if found != allowed or not np.allclose(header["indices"], indices, rtol=1e-9, atol=0):
        raise MaterialError(
            f"found operators of {found[0]} regions and {found[1]} channels; allowed: those of the description, of "
            f"indices {', '.join(f'{n:g}' for n in indices)} and {colours} channels",
            where="header",
        )


def _opened(path: str, flags: int) -> int:
    # A named pipe without a writer would be waited for without end.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _printable(path: Any) -> str:
    try:
        return os.fsdecode(path).encode("utf-8", "backslashreplace").decode()
    except TypeError:
        raise MaterialError(f"found {path!r}; allowed: the path of a {ENDING} file") from None
