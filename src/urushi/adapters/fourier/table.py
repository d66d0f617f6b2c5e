"""What a Fourier ``.bsdf`` file holds, in memory: checked once, then trusted.

Nodes are cosines of directions of *propagation*, z down (layerlab): light from above arrives with a positive one, and
what is reflected leaves with a negative one. The first index of every table is the incident node, the second the
outgoing one. A series at (i, o) is

    sum over k of a_k cos(k phi) = f |mu_o|        (no eta^2: the flux that leaves, per unit of flux that arrives)

with phi = 0 in the plane of incidence, on the far side (mirror direction, straight on).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from urushi.errors import MaterialError

#: bits of `flags`
BSDF = 1
EXTRAPOLATED = 2

#: the type of every number in a file
FLOAT, WHOLE = np.dtype("<f4"), np.dtype("<u4")
#: what a header field can hold
LARGEST = 2**32 - 1
_MOST = float(np.finfo(FLOAT).max)


@dataclass(frozen=True)
class FourierTable:
    """A BSDF in splines over two cosines and Fourier series in azimuth. See the module docstring for conventions.

    Attributes:
        nodes: (N,) ascending cosines in [-1, 1]; two equal ones part what lies beside, as at 0.
        cdf: (N, N, B) [i, o, basis] integral over mu_o from the first node to node o of the spline through a_0 of the
            first channel.
        offsets: (N, N) [i, o] where a series begins in `coefficients`.
        counts: (N, N) how many orders it has; 0 where nothing is scattered.
        coefficients: (M,) channel by channel, in it basis by basis, in it order by order.
        channels: 1, or 3: Y, R and B (`docs/fourier-file.md`).
        bases: how many BSDFs lie in the file, the corners of a grid of parameters; the last parameter runs fastest.
        max_order: an upper bound of `counts`; files have the largest.
        positions: the values along each parameter of that grid, ascending.
        flags: `BSDF`, and `EXTRAPOLATED` where the series are three numbers of another meaning, which are kept, not
            evaluated.
        eta: index below over index above; layerlab always writes 1.
        alpha: roughness above and below, for information.
        metadata: bytes at the end of the file.
        unused: the last 8 bytes of the header.

    Raises:
        MaterialError: arrays that do not fit together, or values that no BSDF has; says which and what is allowed.
    """

    nodes: np.ndarray
    cdf: np.ndarray
    offsets: np.ndarray
    counts: np.ndarray
    coefficients: np.ndarray
    channels: int = 1
    bases: int = 1
    max_order: int = 0
    positions: tuple[np.ndarray, ...] = ()
    flags: int = BSDF
    eta: float = 1.0
    alpha: tuple[float, float] = (0.0, 0.0)
    metadata: bytes = b""
    unused: bytes = bytes(8)

    def __post_init__(self) -> None:
        for name, kind in (
            ("nodes", FLOAT),
            ("cdf", FLOAT),
            ("offsets", WHOLE),
            ("counts", WHOLE),
            ("coefficients", FLOAT),
        ):
            object.__setattr__(self, name, _frozen(getattr(self, name), kind, name))
        positions = tuple(_frozen(p, FLOAT, f"positions[{i}]") for i, p in enumerate(self.positions))
        object.__setattr__(self, "positions", positions)
        self._check_header()
        self._check_parameters()
        self._check_nodes()
        self._check_series()

    @property
    def extrapolated(self) -> bool:
        return bool(self.flags & EXTRAPOLATED)

    def series(self, incident: int, outgoing: int, channel: int = 0, basis: int = 0) -> np.ndarray:
        """(count,) coefficients a_k of one pair of nodes."""
        count = int(self.counts[incident, outgoing])
        start = int(self.offsets[incident, outgoing]) + (channel * self.bases + basis) * count
        return self.coefficients[start : start + count]

    def _check_header(self) -> None:
        if self.flags & ~(BSDF | EXTRAPOLATED) or not self.flags & BSDF:
            raise _wrong("flags", self.flags, "1 (a BSDF), or 3 (one that is extrapolated)")
        if self.channels not in (1, 3):
            raise _wrong("channels", self.channels, "1 or 3")
        if not 0 <= self.max_order <= LARGEST:
            raise _wrong("max_order", self.max_order, f"0 to {LARGEST}")
        if not 0 < self.eta <= _MOST:
            raise _wrong("eta", self.eta, "a positive number")
        if len(self.alpha) != 2 or not all(abs(a) <= _MOST for a in self.alpha):
            raise _wrong("alpha", self.alpha, "two finite numbers")
        if len(self.unused) != 8:
            raise _wrong("unused", f"{len(self.unused)} bytes", "8")
        if len(self.metadata) > LARGEST:
            raise _wrong("metadata", f"{len(self.metadata)} bytes", f"at most {LARGEST}")

    def _check_parameters(self) -> None:
        for i, p in enumerate(self.positions):
            if p.ndim != 1 or not len(p) or not np.isfinite(p).all() or not (np.diff(p) > 0).all():
                raise _wrong(f"positions[{i}]", np.ravel(p)[:8].tolist(), "ascending finite numbers")
        expected = math.prod(len(p) for p in self.positions)
        if self.bases != expected:
            raise _wrong("bases", self.bases, f"{expected}, the corners of the grid of parameters")

    def _check_nodes(self) -> None:
        nodes = self.nodes
        if nodes.ndim != 1 or len(nodes) < 2:
            raise _wrong("nodes", f"the shape {nodes.shape}", "at least two cosines")
        bad = ~(np.abs(nodes) <= 1)  # what is not a number too
        if bad.any():
            raise _wrong(f"nodes[{np.argmax(bad)}]", nodes[np.argmax(bad)], "cosines from -1 to 1")
        steps = np.diff(nodes)
        bad = steps < 0
        bad[1:] |= (steps[1:] == 0) & (steps[:-1] == 0)
        bad[[0, -1]] |= steps[[0, -1]] == 0
        if bad.any():
            i = int(np.argmax(bad)) + 1
            raise _wrong(
                f"nodes[{i}]",
                nodes[i],
                "ascending cosines; no more than two equal ones, and none at the ends",
            )

    def _check_series(self) -> None:
        n = len(self.nodes)
        for name, shape in (("cdf", (n, n, self.bases)), ("offsets", (n, n)), ("counts", (n, n))):
            if getattr(self, name).shape != shape:
                raise _wrong(name, f"the shape {getattr(self, name).shape}", str(shape))
        for name in ("cdf", "coefficients"):
            bad = ~np.isfinite(getattr(self, name))
            if bad.any():
                place = ", ".join(map(str, np.unravel_index(int(np.argmax(bad)), bad.shape)))
                raise _wrong(f"{name}[{place}]", getattr(self, name)[bad][0], "finite numbers")
        if self.coefficients.ndim != 1 or len(self.coefficients) > LARGEST:
            raise _wrong("coefficients", f"the shape {self.coefficients.shape}", "one row")
        counts = self.counts.astype(np.int64)
        if counts.max() > self.max_order:
            raise self._at("counts", counts > self.max_order, f"at most max_order, {self.max_order}")
        each = self.channels * self.bases
        if int(counts.sum()) * each > len(self.coefficients):
            raise _wrong(
                "counts", f"{int(counts.sum()) * each} coefficients in all", f"{len(self.coefficients)}"
            )
        ends = self.offsets.astype(np.int64) + counts * each
        bad = (counts > 0) & (ends > len(self.coefficients))
        if bad.any():
            raise self._at("offsets", bad, f"series that end before {len(self.coefficients)}")

    def _at(self, name: str, bad: np.ndarray, allowed: str) -> MaterialError:
        i, o = np.unravel_index(int(np.argmax(bad)), bad.shape)
        return _wrong(f"{name}[{i}, {o}]", getattr(self, name)[i, o], allowed)


def _frozen(value: Any, kind: np.dtype, name: str) -> np.ndarray:
    try:
        array = np.asarray(value)
        if kind == WHOLE and array.size and (array.min() < 0 or array.max() > LARGEST):
            raise _wrong(name, f"{array.min()} to {array.max()}", f"0 to {LARGEST}")
        with np.errstate(over="ignore"):  # becomes infinite, which is refused below
            array = np.ascontiguousarray(array, dtype=kind)
        if array.flags.writeable:
            array = array.copy()
    except (TypeError, ValueError) as error:
        raise _wrong(name, f"a {type(value).__name__}", "numbers") from error
    array.flags.writeable = False
    return array


def _wrong(where: str, found: Any, allowed: str) -> MaterialError:
    return MaterialError(f"found {found}; allowed: {allowed}", where=where)
