"""Write the textures of the preset `varnished-wood`: a procedural wood, its albedo and its roughness.

Tileable: every pattern is periodic in both directions. The numbers are chosen by eye.

    python tools/make_wood_texture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 256
EARLY = np.array([0.60, 0.42, 0.25])  # linear reflectance of early wood ...
LATE = np.array([0.30, 0.17, 0.08])  # ... of late wood
PORE = np.array([0.10, 0.055, 0.03])  # ... and of pores


def noise(rng: np.random.Generator, across: float, along: float) -> np.ndarray:
    """Periodic Gaussian noise of unit variance with the given correlation lengths in pixels (rows, columns)."""
    frequency = np.fft.fftfreq(SIZE)
    envelope = np.exp(
        -2 * np.pi**2 * ((across * frequency[:, None]) ** 2 + (along * frequency[None, :]) ** 2)
    )
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * envelope).real
    return field / field.std()


def wood() -> tuple[np.ndarray, np.ndarray]:
    """Linear albedo (SIZE, SIZE, 3) and roughness over the largest roughness (SIZE, SIZE), grain along x."""
    rng = np.random.default_rng(1)
    rows = np.arange(SIZE)[:, None] / SIZE
    ring = (9 * rows + 0.22 * noise(rng, 40, 90) + 0.03 * noise(rng, 3, 60)) % 1.0
    late = np.clip((ring - 0.55) / 0.4, 0, 1) ** 2 * np.clip((1 - ring) / 0.05, 0, 1)
    fibre = 1 + 0.07 * noise(rng, 0.6, 18)
    pores = np.clip(noise(rng, 0.7, 9) - 1.55 - 0.6 * (ring > 0.5), 0, 1)
    albedo = (EARLY + late[..., None] * (LATE - EARLY)) * fibre[..., None]
    albedo += np.minimum(1.4 * pores, 1)[..., None] * (PORE - albedo)
    roughness = 0.2 + 0.15 * late + 0.55 * np.minimum(1.4 * pores, 1)
    return np.clip(albedo, 0, 1), np.clip(roughness, 0.2, 1)


def encoded(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer function."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def main() -> None:
    """Write both images."""
    folder = Path(__file__).parents[1] / "src" / "urushi" / "materials" / "textures"
    folder.mkdir(parents=True, exist_ok=True)
    albedo, roughness = wood()
    for name, image in (("wood-albedo", encoded(albedo)), ("wood-roughness", roughness)):
        path = folder / f"{name}.png"
        Image.fromarray(np.round(255 * image).astype(np.uint8)).save(path, optimize=True)
        print(f"{path.stat().st_size} bytes -> {path}")


if __name__ == "__main__":
    main()
