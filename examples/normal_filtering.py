"""A ball so far away that every pixel holds a whole normal map: all its texels, or one filtered evaluation."""

from __future__ import annotations

import numpy as np
from gallery import run, show, style, titled

import urushi as ur
from urushi.adapters.picture import tonemap

TINT, BASE = ur.Medium(depth=(0.1, 0.9, 1.2), albedo=0.0), ur.Conductor(material="Al", alpha=0.15)
LACQUER = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.05), TINT, BASE])
LIGHTS = np.array([[0.5, 0.6, 0.6], [-0.7, 0.1, 0.7]]), (3.0, 1.0)
KINDS = "walk, every texel", "walk, filtered", "lobes, filtered", "lobes, unfiltered"


def ripples(size: int) -> np.ndarray:
    """(texels, 3) normals of waves that run across x mostly, as a brush leaves them: slopes of 0.15 and 0.06."""
    rng, slopes = np.random.default_rng(1), np.zeros((size, size, 2))
    v, u = np.meshgrid(*[np.arange(size) / size] * 2, indexing="ij")
    for _ in range(40):
        k = np.array([rng.integers(-9, 10), rng.integers(-3, 4)])
        slopes += 0.0055 * k * np.cos(2 * np.pi * (k[0] * u + k[1] * v + rng.random()))[..., None]
    return np.pad(slopes.reshape(-1, 2), ((0, 0), (0, 1)), constant_values=1)


def ball(side: int, method: str, normals: np.ndarray, variance: np.ndarray, **more: int) -> np.ndarray:
    """(side, side, 3) a ball, NaN around it: the mean over the normals (texels, 3) of its lacquer."""
    x, y = np.meshgrid(*[((np.arange(side) + 0.5) / side - 0.5) * 2.04] * 2)
    image, shown, rng = np.full((side, side, 3), np.nan), x**2 + y**2 < 0.998, np.random.default_rng(1)
    n = np.stack([x, -y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[shown]
    u = np.stack([n[:, 2], 0 * n[:, 2], -n[:, 0]], axis=-1) / np.hypot(n[:, 2], n[:, 0])[:, None]
    frame, image[shown] = np.stack([u, np.cross(n, u), n], axis=1), 0
    for some in np.array_split(normals, -(-len(normals) // 16)):
        given = {"layer_0.normal": np.repeat(some, len(n), axis=0), "layer_0.slope_variance": variance}
        bsdf, wi = ur.solve(LACQUER, method, parameters=given, **more), np.tile(frame[..., 2], (len(some), 1))
        for to, power in zip(*LIGHTS, strict=True):
            # The walk's random numbers come from the directions: without a little noise, all texels have the same.
            wo = np.tile(frame @ (to / np.linalg.norm(to)), (len(some), 1)) + 1e-3 * rng.normal(size=wi.shape)
            value = bsdf.eval(wi, wo / np.linalg.norm(wo, axis=1, keepdims=True)) * (wo[:, 2:] > 0)
            image[shown] += power / len(normals) * value.reshape(len(some), -1, 3).sum(axis=0)
    return image


def draw(quick: bool) -> style.Figure:
    side, normals, figure = 40 if quick else 350, ripples(16 if quick else 24), style.figure(10, 3.3)
    variance, images, errors = np.cov(normals[:, :2].T, bias=True)[[0, 1, 0], [0, 1, 1]], [], []
    for axes, name in zip(figure.subplots(1, 4), KINDS, strict=True):
        method, here = name.split(",")[0], normals if "every" in name else normals.mean(axis=0)[None]
        samples = {"samples": max(1, (32 if quick else 256) // len(here))} if method == "walk" else {}
        images.append(ball(side, method, here, variance * name.endswith(" filtered"), **samples))
        errors.append(np.sqrt(np.nanmean((images[-1] - images[0]) ** 2) / np.nanmean(images[0] ** 2)))
        image = np.where(np.isnan(images[-1]), 255, tonemap(images[-1])).astype(np.uint8)
        show(axes, image, f"{name}: {errors[-1]:.0%} off" if errors[-1] else f"{name} ({len(here)})")
    text = f"Filtered to mean and variance, a normal map is {errors[1]:.0%} off by the walk, {errors[2]:.0%} by lobes"
    return titled(figure, text, f"Filtered to the mean alone it is {errors[3]:.0%} off (relative RMSE)")


if __name__ == "__main__":
    run(draw)
