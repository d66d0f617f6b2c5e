"""Draw docs/images/normal-filtering.png: a ball of lacquer so far away that each pixel holds its whole normal map.

Left the truth, the walk at every texel of the map for every pixel; in the middle lobes, once for each pixel, with the
mean and the variance of the map's slopes; on the right lobes with the mean slope alone.

    python tools/make_normal_filtering.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import urushi as ur
from urushi.adapters.normal_map import Slopes
from urushi.adapters.picture import write

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "normal-filtering.png"
LACQUER = ur.Stack(
    layers=[
        ur.Dielectric(ior=1.5, alpha=0.05),
        ur.Medium(depth=(0.1, 0.9, 1.2), albedo=0.0),
        ur.Conductor(material="Al", alpha=0.15),
    ]
)
SIDE, SEED = 144, 1
LIGHTS = ((0.5, 0.6, 0.6), 2.0), ((-0.7, 0.1, 0.7), 0.7)


def ripples(size: int = 48) -> Slopes:
    """Waves that run across x mostly, as a brush leaves them; slopes of about 0.15 and 0.06."""
    rng = np.random.default_rng(SEED)
    y, x = np.meshgrid(*[np.arange(size) * 2 * np.pi / size] * 2, indexing="ij")
    slope = np.zeros((size, size, 2))
    for _ in range(40):
        k, phase = (rng.integers(-9, 10), rng.integers(-3, 4)), rng.uniform(0, 2 * np.pi)
        slope += 0.0055 * np.array(k) * np.cos(k[0] * x + k[1] * y + phase)[..., None]
    normal = np.concatenate([slope, np.ones((size, size, 1))], axis=-1)
    return Slopes.of(0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def ball() -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Which pixels show it, and there the directions to the eye and to the lights in the frame of the surface."""
    y, x = np.meshgrid(*[(np.arange(SIDE) + 0.5) / SIDE * 2.1 - 1.05] * 2, indexing="ij")
    shown = x**2 + y**2 < 0.995
    n = np.stack([x[shown], -y[shown], np.sqrt(1 - x[shown] ** 2 - y[shown] ** 2)], axis=-1)
    s = np.stack([n[:, 2], 0 * n[:, 2], -n[:, 0]], axis=-1)
    s /= np.linalg.norm(s, axis=-1, keepdims=True)
    frame = np.stack([s, np.cross(n, s), n], axis=1)
    lights = [frame @ (np.array(d) / np.linalg.norm(d)) for d, _ in LIGHTS]
    return shown, frame @ np.array([0.0, 0.0, 1.0]), lights


def seen(method: str, normal: np.ndarray, variance: np.ndarray, **options: int) -> np.ndarray:
    """(pixels, 3) light of the ball, the mean over normals (texels, 3) of the surface of the lacquer."""
    _, wi, lights = ball()
    texels, batch, rng = len(normal), min(len(normal), 32), np.random.default_rng(SEED)
    total, many = np.zeros((len(wi), 3)), [np.tile(w, (batch, 1)) for w in (wi, *lights)]
    for first in range(0, texels, batch):
        here = np.repeat(normal[first : first + batch], len(wi), axis=0)
        given = {"layer_0.normal": here}
        given |= {"layer_0.slope_variance": variance} if variance.any() else {}
        bsdf = ur.solve(LACQUER, method, parameters=given, **options)
        for wo, (_, power) in zip(many[1:], LIGHTS, strict=True):
            # The walk's random numbers are a function of the directions: a little noise, or all texels have the same.
            near = wo + 1e-3 * rng.normal(size=wo.shape)
            near /= np.linalg.norm(near, axis=-1, keepdims=True)
            value = bsdf.eval(many[0], near) * (near[:, 2:] > 0)
            total += power / texels * value.reshape(batch, -1, 3).sum(axis=0)
    return total


def main() -> None:
    slopes = ripples()
    mean = Slopes(slopes.mean.mean(axis=(0, 1)), slopes.second.mean(axis=(0, 1)))
    one, none = mean.normal()[None], np.zeros(3)
    truth = seen("walk", slopes.normal().reshape(-1, 3), none, samples=1)
    panels = [truth, seen("lobes", one, mean.variance()), seen("lobes", one, none)]
    print("variance of slopes", mean.variance().round(4))
    walked = seen("walk", one, mean.variance(), samples=256)
    names = "lobes, filtered", "lobes, not filtered", "the walk, filtered"
    for name, panel in zip(names, [*panels[1:], walked], strict=True):
        error = np.sqrt(np.mean((panel - truth) ** 2) / np.mean(truth**2))
        print(f"{name}: relative RMSE {error:.3f}, mean {panel.mean() / truth.mean():.3f} of the truth")
    shown, picture = ball()[0], np.full((SIDE, 3 * SIDE, 3), 0.0)
    for i, panel in enumerate(panels):
        picture[:, i * SIDE : (i + 1) * SIDE][shown] = panel
    write(picture, IMAGE)


if __name__ == "__main__":
    main()
