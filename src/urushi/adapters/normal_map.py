"""Normal maps seen from afar: the mean and the spread of their slopes over a footprint (LEAN, Olano & Baker 2010).

A pixel that covers many texels sees a surface whose normal is their mean, and whose roughness is larger by what their
normals differ. Slopes, the x and y of a normal of z = 1, have moments that average linearly, texel by texel, so they
can be filtered beforehand like any image; normals and roughness cannot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from urushi.errors import UrushiError

Floats = npt.NDArray[np.float64]

#: a texel's normal is not allowed to be steeper than this slope
STEEPEST = 1e3


@dataclass(frozen=True)
class Slopes:
    """Moments of slopes.

    Attributes:
        mean: (..., 2) mean of the slopes (x, y) of the normal (x, y, 1).
        second: (..., 3) means of x x, y y and x y.
    """

    mean: Floats
    second: Floats

    @classmethod
    def of(cls, image: npt.ArrayLike, strength: float = 1.0) -> Slopes:
        """Of a normal map.

        Args:
            image: (H, W, 3) in 0..1, standing for -1..1, y up as in Mitsuba's `normalmap`.
            strength: factor on all slopes.

        Raises:
            UrushiError: another shape, or a normal that does not point upwards.
        """
        array = np.asarray(image, np.float64)
        if array.ndim != 3 or array.shape[2] < 3:
            raise UrushiError(f"normal map: found shape {array.shape}; allowed: (height, width, 3)")
        normal = 2 * array[..., :3] - 1
        flat = np.abs(normal[..., :2]).max(axis=-1) > STEEPEST * normal[..., 2]
        if flat.any() or not np.isfinite(normal).all():
            row, column = np.argwhere(flat | ~np.isfinite(normal).all(axis=-1))[0]
            raise UrushiError(
                f"normal map[{row}, {column}]: found the normal {normal[row, column].round(4).tolist()}; "
                f"allowed: slopes up to {STEEPEST:g}"
            )
        x, y = (strength * normal[..., i] / normal[..., 2] for i in (0, 1))
        return cls(np.stack([x, y], axis=-1), np.stack([x * x, y * y, x * y], axis=-1))

    def variance(self) -> Floats:
        """(..., 3) variances along x and y, and the covariance."""
        x, y = self.mean[..., 0], self.mean[..., 1]
        found = self.second - np.stack([x * x, y * y, x * y], axis=-1)
        # What rounding leaves must still be the matrix of some slopes.
        found[..., :2] = np.maximum(found[..., :2], 0)
        limit = np.sqrt(found[..., 0] * found[..., 1])
        found[..., 2] = np.clip(found[..., 2], -limit, limit)
        return found

    def normal(self) -> Floats:
        """(..., 3) unit vectors of the mean slope."""
        vector = np.concatenate([self.mean, np.ones_like(self.mean[..., :1])], axis=-1)
        return vector / np.linalg.norm(vector, axis=-1, keepdims=True)

    def seen(self, footprint: float) -> Slopes:
        """The same image averaged over a footprint: a Gaussian as wide as a square of that side, repeated at the edges.

        Args:
            footprint: side in texture coordinates, where the image is 1 wide and 1 high.
        """
        rows, columns = (np.fft.fftfreq(n, 1 / n) for n in self.mean.shape[:2])
        # Frequencies in cycles per image: the variance of a square of side f is f^2 / 12.
        square = rows[:, None] ** 2 + columns[None, :] ** 2
        pass_on = np.exp(-2 * np.pi**2 * square * footprint**2 / 12)[..., None]

        def blurred(image: Floats) -> Floats:
            return np.fft.ifft2(np.fft.fft2(image, axes=(0, 1)) * pass_on, axes=(0, 1)).real

        return Slopes(blurred(self.mean), blurred(self.second))

    def levels(self) -> list[Slopes]:
        """The mip map: every level averages squares of four texels of the one before, down to a single texel."""
        found = [self]
        while max(found[-1].mean.shape[:2]) > 1:
            found.append(Slopes(_halved(found[-1].mean), _halved(found[-1].second)))
        return found


def _halved(image: Floats) -> Floats:
    """Means of squares of four; of pairs where the image is one texel wide; an odd last row joins the one before."""
    for axis in (0, 1):
        n = image.shape[axis]
        if n == 1:
            continue
        starts = np.arange(0, n - n % 2, 2)
        count = np.diff([*starts, n])
        shape = [1] * image.ndim
        shape[axis] = len(starts)
        image = np.add.reduceat(image, starts, axis=axis) / count.reshape(shape)
    return image
