"""From a Fourier ``.bsdf`` file to a `FourierTable` and back, to the last bit."""

from __future__ import annotations

import os
import stat
import struct
from pathlib import Path
from typing import Any

import numpy as np

from urushi.errors import MaterialError
from urushi.io import replace

from .table import FLOAT, LARGEST, WHOLE, FourierTable

#: identifier, version, flags, nodes, coefficients, longest series, channels, bases, bytes of metadata, parameters,
#: values of parameters, eta, alpha above, alpha below, unused
_HEADER = struct.Struct("<7sB9I3f8s")
_IDENTIFIER, _VERSION = b"SCATFUN", 1


def read_fourier(path: str | os.PathLike[str]) -> FourierTable:
    """Read a Fourier ``.bsdf`` file.

    Args:
        path: the file. Its size is held against what its header says before anything else is read.

    Returns:
        What it holds; nothing is evaluated or changed.

    Raises:
        MaterialError: no such file, another format or version, a size that differs from what the header says, or
            numbers that no BSDF has.
    """
    name = _printable(path)
    try:
        with open(os.fsdecode(path), "rb", opener=_opened) as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise MaterialError("is no regular file; allowed: a Fourier .bsdf file")
            return unpacked(stream, os.fstat(stream.fileno()).st_size)
    except MaterialError as error:
        raise MaterialError(error.problem, where=error.where, file=name) from None
    except (OSError, ValueError, TypeError) as error:
        problem = getattr(error, "strerror", None) or str(error)
        raise MaterialError(f"cannot be read: {problem}", file=name) from None


def write_fourier(table: FourierTable, path: str | os.PathLike[str]) -> None:
    """Write a Fourier ``.bsdf`` file, whole or not at all.

    Args:
        table: what to write.
        path: an existing file is replaced once the new one is complete.

    Raises:
        MaterialError: not a table, or a place that cannot be written to.
    """
    if not isinstance(table, FourierTable):
        raise MaterialError(f"found a {type(table).__name__}; allowed: a FourierTable")
    name = _printable(path)
    try:
        replace(Path(os.path.realpath(os.fsdecode(path))), packed(table))
    except MaterialError as error:
        raise MaterialError(error.problem, where=error.where, file=name) from None
    except (OSError, ValueError, TypeError) as error:
        problem = getattr(error, "strerror", None) or str(error)
        raise MaterialError(f"cannot be written: {problem}", file=name) from None


def _opened(path: str, flags: int) -> int:
    # A named pipe without a writer would be waited for without end.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def unpacked(stream: Any, size: int) -> FourierTable:
    """The table in a stream of this many bytes; what a header promises beyond them is not asked for."""
    head = stream.read(_HEADER.size)
    if len(head) >= 8 and (head[:7], head[7]) != (_IDENTIFIER, _VERSION):
        found = f"{head[:7]!r}, version {head[7]}"
        raise MaterialError(f"found {found}; allowed: {_IDENTIFIER!r}, version {_VERSION}", where="header")
    if len(head) < _HEADER.size:
        raise MaterialError(f"found {len(head)} bytes; allowed: at least {_HEADER.size}", where="header")
    fields = _HEADER.unpack(head)
    flags, n, coefficients, longest, channels, bases, metadata, parameters, values = fields[2:11]
    sizes = {
        "nodes": n,
        "parameter sample counts": parameters,
        "parameter sample positions": values,
        "cdf": n * n * bases,
        "offset table": 2 * n * n,
        "coefficients": coefficients,
    }
    expected = _HEADER.size + 4 * sum(sizes.values()) + metadata  # Python's integers do not overflow
    if size != expected:
        said = ", ".join(f"{count} {name}" for name, count in sizes.items())
        raise MaterialError(
            f"found {size} bytes; allowed: {expected}, as the header says ({said}, {metadata} bytes of metadata)",
            where="size",
        )
    body = stream.read(size - _HEADER.size)
    if len(body) != size - _HEADER.size:
        raise MaterialError("cannot be read: the file changed its size meanwhile", where="size")
    parts, start = {}, 0
    for name, count in sizes.items():
        kind = WHOLE if name in ("parameter sample counts", "offset table") else FLOAT
        parts[name] = np.frombuffer(body, kind, count, start)
        start += 4 * count
    grid = _split(parts["parameter sample counts"], parts["parameter sample positions"], bases)
    table = parts["offset table"].reshape(n, n, 2)
    return FourierTable(
        nodes=parts["nodes"],
        cdf=parts["cdf"].reshape(n, n, bases),
        offsets=table[..., 0],
        counts=table[..., 1],
        coefficients=parts["coefficients"],
        channels=channels,
        bases=bases,
        max_order=longest,
        positions=grid,
        flags=flags,
        eta=fields[11],
        alpha=(fields[12], fields[13]),
        metadata=body[start:],
        unused=fields[14],
    )


def _split(counts: np.ndarray, positions: np.ndarray, bases: int) -> tuple[np.ndarray, ...]:
    lengths = [int(count) for count in counts]
    corners = 1
    for length in lengths:
        corners = min(corners * length, LARGEST + 1)  # a hostile file's would have a million digits
    if sum(lengths) != len(positions) or 0 in lengths or corners != bases:
        raise MaterialError(
            f"found {lengths[:8]}, {len(positions)} positions and {bases} bases; allowed: counts from 1 that add up to "
            "the positions and multiply to the bases",
            where="parameter sample counts",
        )
    return tuple(np.split(positions, np.cumsum(lengths)[:-1])) if lengths else ()


def packed(table: FourierTable) -> bytes:
    """The whole file as bytes."""
    n = len(table.nodes)
    head = _HEADER.pack(
        _IDENTIFIER,
        _VERSION,
        table.flags,
        n,
        len(table.coefficients),
        table.max_order,
        table.channels,
        table.bases,
        len(table.metadata),
        len(table.positions),
        sum(map(len, table.positions)),
        table.eta,
        *table.alpha,
        table.unused,
    )
    offsets = np.stack([table.offsets, table.counts], axis=-1)
    lengths = np.array([len(p) for p in table.positions], WHOLE)
    arrays = [table.nodes, lengths, *table.positions, table.cdf, offsets, table.coefficients]
    return b"".join([head, *(np.ascontiguousarray(a).tobytes() for a in arrays), table.metadata])


def _printable(path: Any) -> str:
    try:
        return os.fsdecode(path).encode("utf-8", "backslashreplace").decode()
    except TypeError:
        raise MaterialError(f"found {path!r}; allowed: the path of a Fourier .bsdf file") from None
