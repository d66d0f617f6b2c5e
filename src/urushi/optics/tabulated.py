"""Evaluating and sampling a `Series` in Dr.Jit: any float type of a vectorised backend, and plain floats.

Azimuths come as cosine and sine, and each order by one rotation from the last: the error grows with the order, where
that of Chebyshev's recurrence grows with its square. The sums are symbolic loops, as long as the longest series of a
lane; derivatives with respect to directions are not followed through them.
"""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np

from .series import Series
from .spline import chords, weights
from .vectors import Array, Vector, at_least, at_most

#: steps of Newton's method and bisection that invert a series, at most
_STEPS = 30
#: squared sine (of one angle, or of two multiplied) below which a direction has no azimuth
_UPRIGHT = 1e-30


class Tabulated:
    """A `Series` as arrays of one Dr.Jit backend.

    Args:
        series: the tables.
        number: type of one number per lane: a Dr.Jit float array, or `float`.

    Attributes:
        size, channels: how many nodes and channels there are.
        lit: (2, 2) whether light from below and from above (first index) leaves below and above (second).
    """

    def __new__(cls, series: Series, number: type) -> Tabulated:
        return super().__new__(_Scalar if number is float else cls)

    def __init__(self, series: Series, number: Any) -> None:
        self.number = number
        self.size, self.channels = len(series.nodes), series.channels
        sides = [series.flux[:, sign * series.nodes > 0].any(axis=(1, 2)) for sign in (-1, 1)]
        self.lit = np.stack(sides)[:, ::-1]
        # Channels side by side, in a width that one gather fetches.
        self.stride = 4 if series.channels == 3 else series.channels
        rows = np.pad(series.coefficients, ((0, 0), (0, self.stride - series.channels)))
        width, left, right = chords(series.nodes)
        floats = {
            "nodes": series.nodes,
            "width": width,
            "left": left,
            "right": right,
            "rows": rows,
            "lift": series.lift,
            "mean": series.mean,
            "cdf": series.cdf,
            "up": series.flux[0],
            "down": series.flux[1],
        }
        self._store(floats, {"offsets": series.offsets, "counts": series.counts})

    # --- what a backend does ---------------------------------------------------------------------------------------

    def _store(self, floats: dict[str, np.ndarray], wholes: dict[str, np.ndarray]) -> None:
        module = sys.modules[self.number.__module__]
        self.whole: Any = module.UInt
        double = dr.type_v(self.number) == dr.VarType.Float64
        self.four: Any = module.Array4f64 if double else module.Array4f
        self.exact = 1e-13 if double else 1e-6
        kind = np.float64 if double else np.float32
        self.tables = {name: self.number(np.ascontiguousarray(a.ravel(), kind)) for name, a in floats.items()}
        self.tables |= {
            name: self.whole(np.ascontiguousarray(a.ravel(), np.uint32)) for name, a in wholes.items()
        }
        dr.eval(self.tables)

    def _take(self, name: str, index: Array, active: Any = True) -> Array:
        kind = self.whole if name in ("offsets", "counts") else self.number
        return dr.gather(kind, self.tables[name], self.whole(index), active)

    def _row(self, index: Array, active: Any) -> list[Array]:
        """All channels of one order of a series."""
        if self.stride == 4:
            four = dr.gather(self.four, self.tables["rows"], index, active)
            return [four[c] for c in range(self.channels)]
        return [self._take("rows", index * self.stride + c, active) for c in range(self.channels)]

    def _last(self, name: str, start: Array, value: Array) -> Array:
        """The last of the first size - 1 entries after `start` that is at most `value`; the first if none is."""
        past = dr.binary_search(1, self.size - 1, lambda k: self._take(name, start + self.whole(k)) <= value)
        return self.whole(past) - 1

    def _clip(self, index: Array, step: int) -> Array:
        """The index of a neighbour, not beyond the ends."""
        if step < 0:
            return dr.select(index > 0, index - 1, index)
        return dr.minimum(index + step, self.size - 1)

    def _sums(
        self,
        pairs: list[Array],
        shares: list[Array],
        azimuth: tuple[Array, Array, Any],
        active: Any,
        wide: bool,
    ) -> list[Array]:
        """Sum over pairs of nodes, by their shares, of the series at an azimuth; all channels, or the first."""
        channels = self.channels if wide else 1
        cos, sin, upright = azimuth
        offsets = [self._take("offsets", p, active) for p in pairs]
        counts = [
            dr.select(active & (w != 0), self._take("counts", p, active), 0)
            for p, w in zip(pairs, shares, strict=True)
        ]
        counts = [dr.select(upright & (count > 1), 1, count) for count in counts]
        longest = counts[0]
        for count in counts[1:]:
            longest = dr.maximum(longest, count)
        zero = dr.zeros(self.number, dr.width(cos, longest))

        def body(k: Array, c: Array, s: Array, *sums: Array) -> tuple[Array, ...]:
            found = [self.number(0)] * channels
            for offset, count, share in zip(offsets, counts, shares, strict=True):
                on = k < count
                values = (
                    self._row(offset + k, on)
                    if wide
                    else [self._take("rows", (offset + k) * self.stride, on)]
                )
                found = [dr.fma(share, v, f) for v, f in zip(values, found, strict=True)]
            sums = tuple(dr.fma(c, f, total) for f, total in zip(found, sums, strict=True))
            return k + 1, dr.fma(c, cos, -s * sin), dr.fma(s, cos, c * sin), *sums

        state = (self.whole(zero), zero + 1, +zero, *(+zero for _ in range(channels)))
        state = dr.while_loop(state, lambda k, *_: k < longest, body, label="fourier series")
        return list(state[3:])

    def _inverted(self, pair: Array, share: Array, upright: Any, active: Any) -> tuple[Array, Array]:
        """Cosine and sine of the azimuth in [0, pi] below which `share` of a lifted series (or its mean) lies."""
        offset, count = self._take("offsets", pair, active), self._take("counts", pair, active)
        mean = self._take("mean", pair, active)
        lift = self._take("lift", pair, active)
        count = dr.select(active, dr.select(upright & (count > 1), 1, count), 0)
        target = share * dr.pi * mean
        close = self.exact * dr.pi * mean

        def body(step: Array, phi: Array, low: Array, high: Array) -> tuple[Array, ...]:
            sin, cos = dr.sincos(phi)

            def more(k: Array, c: Array, s: Array, value: Array, slope: Array) -> tuple[Array, ...]:
                a = self._take("rows", (offset + k) * self.stride, k < count)
                part = dr.select(k == 0, phi, s / at_least(self.number(k), 1))
                turned = dr.fma(c, cos, -s * sin), dr.fma(s, cos, c * sin)
                return k + 1, *turned, dr.fma(a, part, value), dr.fma(a, c, slope)

            zero = dr.zeros(self.number, dr.width(phi, count))
            inner = (self.whole(zero), zero + 1, +zero, lift * phi - target, lift + zero)
            *_, value, slope = dr.while_loop(inner, lambda k, *_: k < count, more, label="fourier integral")
            over = value > 0
            low, high = dr.select(over, low, phi), dr.select(over, phi, high)
            next_phi = phi - value / dr.select(slope > 0, slope, 1)
            fine = (slope > 0) & (next_phi > low) & (next_phi < high)
            done = dr.abs(value) <= close
            moved = dr.select(fine, next_phi, 0.5 * (low + high))
            return dr.select(done, _STEPS, step + 1), dr.select(done, phi, moved), low, high

        zero = dr.zeros(self.number, dr.width(share, count))
        state = (self.whole(zero), share * dr.pi + zero, +zero, zero + dr.pi)
        _, phi, *_ = dr.while_loop(
            state, lambda step, *_: active & (step < _STEPS), body, label="fourier inversion"
        )
        sin, cos = dr.sincos(phi)
        return cos, sin

    # --- the BSDF ----------------------------------------------------------------------------------------------------

    def eval(self, wi: Vector, wo: Vector, active: Any = True) -> list[Array]:
        """f |cos theta_o| without eta^2, channel by channel, as the splines have it: it may be negative."""
        with dr.suspend_grad():
            (i, t, seen), (o, s, known) = self._interval(wi.z), self._interval(-wo.z)
            across = [self._clip(i, step) * self.size for step in (-1, 0, 1, 2)]
            along = [self._clip(o, step) for step in (-1, 0, 1, 2)]
            w_i, w_o = (self._weights(*place) for place in ((i, t), (o, s)))
            pairs = [a + b for a in across for b in along]
            shares = [a * b for a in w_i for b in w_o]
            return self._sums(pairs, shares, _azimuth(wi, wo), active & seen & known, True)

    def pdf(self, wi: Vector, wo: Vector, active: Any = True) -> Array:
        """Density of `sample` per solid angle."""
        with dr.suspend_grad():
            (i, t, seen), (o, s, known) = self._interval(wi.z), self._interval(-wo.z)
            rows, w_i = [i * self.size, (i + 1) * self.size], [1 - t, t]
            whole = sum(
                w * self._take("cdf", row + self.size - 1, active) for row, w in zip(rows, w_i, strict=True)
            )
            pairs = [row + o + step for row in rows for step in (0, 1)]
            shares = [w * v for w in w_i for v in (1 - s, s)]
            lift = sum(
                share * self._take("lift", pair, active) for share, pair in zip(shares, pairs, strict=True)
            )
            (value,) = self._sums(pairs, shares, _azimuth(wi, wo), active, False)
            inside = active & seen & known & (whole > 0)
            return dr.select(inside, at_least(value + lift, 0) / (2 * dr.pi * at_least(whole, 1e-30)), 0)

    def sample(self, wi: Vector, u: tuple[Array, Array, Array], active: Any = True) -> tuple[Vector, Any]:
        """A direction from three numbers in [0, 1), and a mask of the lanes that have one.

        The incident node is chosen by its share of the light, the cosine by inverting a piecewise linear density, the
        outgoing node by its share there, and the azimuth by inverting the series of that pair.
        """
        with dr.suspend_grad():
            first, second, third = u
            i, t, seen = self._interval(wi.z)
            ends = [self._take("cdf", (i + step) * self.size + self.size - 1, active) for step in (0, 1)]
            light = (1 - t) * ends[0], t * ends[1]
            total = light[0] + light[1]
            active = active & seen & (total > 0)
            chance = light[0] / at_least(total, 1e-30)
            other = first >= chance
            first = dr.select(
                other, (first - chance) / at_least(1 - chance, 1e-30), first / at_least(chance, 1e-30)
            )
            row = dr.select(other, i + 1, i) * self.size
            end = dr.select(other, ends[1], ends[0])
            target = at_most(second, 1 - 2 * self.exact / 10) * end
            k = self._last("cdf", row, target)
            a, b = self._take("mean", row + k, active), self._take("mean", row + k + 1, active)
            width = self._take("width", k, active)
            rest = (target - self._take("cdf", row + k, active)) / at_least(width, 1e-30)
            # a x + (b - a) x^2 / 2 = rest, in the form that divides by no difference
            x = 2 * rest / at_least(a + dr.sqrt(at_least(a * a + 2 * (b - a) * rest, 0)), 1e-30)
            x = at_most(at_least(x, 0), 1)
            mu = self._take("nodes", k, active) + width * x
            near = a * (1 - x) / at_least(a * (1 - x) + b * x, 1e-30)
            pair = row + dr.select(first < near, k, k + 1)
            turn = 2 * third - 1
            upright = wi.x * wi.x + wi.y * wi.y < _UPRIGHT
            cos, sin = self._inverted(pair, dr.abs(turn), upright, active)
            sin = dr.select(turn < 0, -sin, sin)
            wo = _turned(wi, -mu, cos, sin)
            return wo, active & (wo.z != 0)

    def flux(self, wi: Vector, active: Any = True) -> tuple[list[Array], list[Array]]:
        """Energy that leaves above and below, channel by channel."""
        with dr.suspend_grad():
            i, t, seen = self._interval(wi.z)
            active = active & seen
            rows = [self._clip(i, step) for step in (-1, 0, 1, 2)]
            shares = self._weights(i, t)
            up, down = (
                [
                    sum(
                        w * self._take(side, row * self.channels + c, active)
                        for w, row in zip(shares, rows, strict=True)
                    )
                    for c in range(self.channels)
                ]
                for side in ("up", "down")
            )
            return up, down

    def _interval(self, x: Array) -> tuple[Array, Array, Any]:
        """The interval of nodes around a cosine, where in it, and whether there is something: not on the horizon, and
        not beyond the first and last node."""
        x = at_most(at_least(x, -1), 1)
        i = self._last("nodes", 0, x)
        t = (x - self._take("nodes", i)) / self._take("width", i)
        return i, at_most(at_least(t, 0), 1), (x != 0) & (t >= 0) & (t <= 1)

    def _weights(self, i: Array, t: Array) -> tuple[Array, ...]:
        return weights(t, self._take("left", i), self._take("right", i))


class _Scalar(Tabulated):
    """The same for plain floats, with numpy's sums: Dr.Jit has no gathers there, and Python's loops are slow."""

    def _store(self, floats: dict[str, np.ndarray], wholes: dict[str, np.ndarray]) -> None:
        self.exact = 1e-13
        self.whole = int
        self.tables = {name: np.ascontiguousarray(a.ravel()) for name, a in (floats | wholes).items()}

    def _take(self, name: str, index: Array, active: Any = True) -> Array:
        return self.tables[name][index].item() if active else 0

    def _last(self, name: str, start: Array, value: Array) -> Array:
        part = self.tables[name][start + 1 : start + self.size - 1]
        return int(np.searchsorted(part, value, side="right"))

    def _clip(self, index: Array, step: int) -> Array:
        return min(max(index + step, 0), self.size - 1)

    def _part(self, pair: int, channels: int) -> np.ndarray:
        """(count, channels) the series of a pair of nodes."""
        start, count = self.tables["offsets"][pair], self.tables["counts"][pair]
        return self.tables["rows"].reshape(-1, self.stride)[start : start + count, :channels]

    def _sums(
        self,
        pairs: list[Array],
        shares: list[Array],
        azimuth: tuple[Array, Array, Any],
        active: Any,
        wide: bool,
    ) -> list[Array]:
        channels = self.channels if wide else 1
        sums = np.zeros(channels)
        cos, sin, upright = azimuth
        if active:
            parts = [
                (share, self._part(pair, channels))
                for pair, share in zip(pairs, shares, strict=True)
                if share != 0
            ]
            parts = [(share, part[: 1 if upright else None]) for share, part in parts]
            waves = np.cos(np.arange(max((len(p) for _, p in parts), default=0)) * np.arctan2(sin, cos))
            for share, part in parts:
                sums += share * (waves[: len(part)] @ part)
        return sums.tolist()

    def _inverted(self, pair: Array, share: Array, upright: Any, active: Any) -> tuple[Array, Array]:
        if not active:
            return 1.0, 0.0
        a = self._part(pair, 1)[: 1 if upright else None, 0]
        mean, lift = self.tables["mean"][pair], self.tables["lift"][pair]
        k = np.arange(1, len(a))
        a0 = (a[0] if len(a) else 0) + lift
        low, high, phi = 0.0, np.pi, share * np.pi
        for _ in range(_STEPS):
            value = a0 * phi + (a[1:] / k) @ np.sin(k * phi) - share * np.pi * mean
            slope = a0 + a[1:] @ np.cos(k * phi)
            if abs(value) <= self.exact * np.pi * mean:
                break
            low, high = (low, phi) if value > 0 else (phi, high)
            moved = phi - value / slope if slope > 0 else low
            phi = moved if low < moved < high else 0.5 * (low + high)
        return float(np.cos(phi)), float(np.sin(phi))


def _azimuth(wi: Vector, wo: Vector) -> tuple[Array, Array, Any]:
    """Cosine and sine of the azimuth of wo, counted from the mirror direction of wi, and whether it has none.

    Where one direction is vertical, the value is the mean over azimuth: that of order 0.
    """
    x = -(wi.x * wo.x + wi.y * wo.y)
    y = wi.y * wo.x - wi.x * wo.y
    size = x * x + y * y
    scale = dr.rsqrt(at_least(size, 1e-30))
    upright = size < _UPRIGHT
    return dr.select(upright, 1.0, x * scale), dr.select(upright, 0.0, y * scale), upright


def _turned(wi: Vector, z: Array, cos: Array, sin: Array) -> Vector:
    """The direction of this z and of this azimuth from the mirror direction of wi."""
    size = wi.x * wi.x + wi.y * wi.y
    scale = dr.rsqrt(at_least(size, 1e-30))
    upright = size < _UPRIGHT
    x, y = dr.select(upright, -1.0, -wi.x * scale), dr.select(upright, 0.0, -wi.y * scale)
    r = dr.sqrt(at_least((1 - z) * (1 + z), 0))
    return type(wi)(r * (cos * x - sin * y), r * (sin * x + cos * y), z)
