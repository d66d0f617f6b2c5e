"""A density of directions learned from samples, to integrate values against: as many samples in each of its boxes."""

from __future__ import annotations

import numpy as np


class Leaves:
    """Boxes of (1 - |cos|, azimuth) on each side of the surface, halved at the median of the samples in turn.

    Every direction has a density, so that a mean of value / density is the whole integral whatever the samples were.

    Args:
        o: sampled directions (N, 3).
        centre: azimuth that lies in the middle of the boxes.
        each: samples left in a box, at least.
    """

    def __init__(self, o: np.ndarray, centre: float, each: int = 32) -> None:
        self.centre = centre
        self.share = float(np.clip(np.mean(o[:, 2] > 0), 0.02, 0.98))
        self.sides = [self._halved(self._plane(o[o[:, 2] * side > 0]), each) for side in (1, -1)]

    def _plane(self, o: np.ndarray) -> np.ndarray:
        r_sq = o[:, 0] ** 2 + o[:, 1] ** 2
        phi = np.arctan2(o[:, 1], o[:, 0]) - self.centre
        # 1 - cos without cancellation: some lobes are narrower than the square root of single precision.
        return np.stack([r_sq / (1 + np.abs(o[:, 2])), (phi + np.pi) % (2 * np.pi) - np.pi], axis=1)

    @staticmethod
    def _halved(points: np.ndarray, each: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Lowest and highest corners of the boxes (K, 2), and where each level cuts."""
        depth = max(int(np.log2(max(len(points) / each, 1))), 0)
        points = points[: len(points) >> depth << depth][None]
        low, high, cuts = np.array([[0.0, -np.pi]]), np.array([[1.0, np.pi]]), []
        for level in range(depth):
            axis, half = level % 2, points.shape[1] // 2
            order = np.argsort(points[:, :, axis], axis=1)
            points = np.take_along_axis(points, order[:, :, None], axis=1)
            cut = 0.5 * (points[:, half - 1, axis] + points[:, half, axis])
            low, high = np.repeat(low, 2, axis=0), np.repeat(high, 2, axis=0)
            high[0::2, axis], low[1::2, axis] = cut, cut
            cuts.append(cut)
            points = points.reshape(-1, half, 2)
        return low, high, cuts

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Directions (n, 3)."""
        up, o = rng.random(n) < self.share, np.empty((n, 3))
        for mine, side, (low, high, _) in zip((up, ~up), (1, -1), self.sides, strict=True):
            box = rng.integers(len(low), size=int(mine.sum()))
            x = low[box] + (high - low)[box] * rng.random((len(box), 2))
            r, phi = np.sqrt(x[:, 0] * (2 - x[:, 0])), x[:, 1] + self.centre
            o[mine] = np.stack([r * np.cos(phi), r * np.sin(phi), side * (1 - x[:, 0])], axis=1)
        return o

    def density(self, o: np.ndarray) -> np.ndarray:
        """Per solid angle, (N,)."""
        pdf = np.empty(len(o))
        for side, share, (low, high, cuts) in zip(
            (1, -1), (self.share, 1 - self.share), self.sides, strict=True
        ):
            mine = o[:, 2] * side > 0
            x, box = self._plane(o[mine]), np.zeros(int(mine.sum()), int)
            for level, cut in enumerate(cuts):
                box = 2 * box + (x[:, level % 2] > cut[box])
            pdf[mine] = share / len(low) / np.prod((high - low)[box], axis=1)
        return pdf
