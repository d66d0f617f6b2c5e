"""The Mitsuba plugin under test: how it is loaded and asked for directions in its own frame, in any variant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import yaml

from lanes import direction, unit

RADIANCE, IMPORTANCE = "Radiance", "Importance"


def layered(mi: Any, **options: Any) -> Any:
    """The plugin `layered` with these options, in the current variant."""
    import urushi.mitsuba  # noqa: F401  (registers it)

    return mi.load_dict({"type": "layered", **options})


def context(mi: Any, mode: str = RADIANCE, **options: Any) -> Any:
    """A BSDF context; options are `type_mask` and `component`."""
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    for name, value in options.items():
        setattr(ctx, name, value)
    return ctx


def interaction(mi: Any, wi: np.ndarray, uv: Any = None, time: float = 0.0, wavelengths: Any = ()) -> Any:
    """Surface interactions for directions (N, 3), in a vectorised variant; uv (N, 2)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = vectors(mi, wi)
    si.time = mi.Float(time)
    if uv is not None:
        uv = np.broadcast_to(np.asarray(uv, np.float32), (len(wi), 2))
        si.uv = mi.Point2f(np.ascontiguousarray(uv.T))
    if len(wavelengths):
        si.wavelengths = type(si.wavelengths)(*wavelengths)
    return si


def vectors(mi: Any, w: np.ndarray) -> Any:
    return mi.Vector3f(np.ascontiguousarray(np.asarray(w, np.float32).T))


def rows(value: Any) -> np.ndarray:
    """Dr.Jit to numpy in double precision: (N,) or (N, channels)."""
    array = np.asarray(np.array(value), np.float64)
    return array.T if array.ndim == 2 else array


@dataclass(frozen=True)
class Asked:
    """Answers of a BSDF for directions (N, 3)."""

    mi: Any
    bsdf: Any
    si: Any
    ctx: Any

    @classmethod
    def of(cls, mi: Any, bsdf: Any, wi: np.ndarray, mode: str = RADIANCE, **options: Any) -> Asked:
        return cls(mi, bsdf, interaction(mi, wi, **options), context(mi, mode))

    def value(self, wo: np.ndarray) -> np.ndarray:
        return rows(self.bsdf.eval(self.ctx, self.si, vectors(self.mi, wo)))

    def density(self, wo: np.ndarray) -> np.ndarray:
        return rows(self.bsdf.pdf(self.ctx, self.si, vectors(self.mi, wo)))

    def sample(self, u: np.ndarray) -> tuple[Any, np.ndarray]:
        """Mitsuba's sample and the weights; u (N, 3), the first chooses what happens."""
        mi, u = self.mi, np.asarray(u, np.float32)
        point = mi.Point2f(np.ascontiguousarray(u[:, 1:].T))
        sample, weight = self.bsdf.sample(self.ctx, self.si, mi.Float(np.ascontiguousarray(u[:, 0])), point)
        return sample, rows(weight)


def everywhere(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random directions on both sides."""
    return unit(rng.normal(size=(n, 3)))


def above(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random directions above the surface."""
    w = everywhere(rng, n)
    w[:, 2] = np.abs(w[:, 2])
    return w


SIDE = 16
"""Width and height of the pictures below, in pixels."""


def scene(
    mi: Any, bsdf: Any, theta: float = 0.0, ball: bool = False, below: bool = False, **integrator: Any
) -> Any:
    """A plane that fills the image (or a ball in it), seen by parallel rays; light 1 from everywhere."""
    layered(mi, filename="preset:enamel")
    target = mi.ScalarPoint3f(0, 0, 0)
    origin = mi.ScalarPoint3f(*(5 * direction(np.cos(np.radians(theta)))))
    if below:
        origin.z = -origin.z
    transform = mi.ScalarTransform4f()
    camera = transform.look_at(origin, target, [0, 1, 0]) @ transform.scale([0.5, 0.5, 1])
    shape = (
        {"type": "sphere", "radius": 0.4}
        if ball
        else {"type": "rectangle", "to_world": transform.scale(1 if theta else 0.5)}
    )
    if theta:
        shape["to_world"] = transform.scale(20)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"} | integrator,
            "light": {"type": "constant"},
            "shape": shape | {"bsdf": bsdf},
            "camera": {
                "type": "orthographic",
                "to_world": camera,
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
        }
    )


def picture(mi: Any, bsdf: Any, spp: int = 256, seed: int = 0, **options: Any) -> np.ndarray:
    """(height, width, channels)."""
    return np.array(mi.render(scene(mi, bsdf, **options), spp=spp, seed=seed), dtype=np.float64)


def mean(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error of pixels of one expectation, by channel."""
    flat = pixels.reshape(-1, pixels.shape[-1])
    return flat.mean(axis=0), flat.std(axis=0) / np.sqrt(len(flat))


def stack_file(tmp_path, layers: list[str]) -> dict[str, str]:
    path = tmp_path / "stack.yaml"
    path.write_text("urushi: 1\nlayers:\n" + "".join(f"  - {layer}\n" for layer in layers))
    return {"type": "layered", "filename": str(path)}


def write(tmp_path: Any, **changes: Any) -> str:
    """A material file with every kind of number in it."""
    numbers = {
        "ior": 1.5,
        "alpha": 0.2,
        "depth": 0.7,
        "albedo": [0.8, 0.5, 0.3],
        "g": 0.4,
        "u": 0.1,
        "v": 0.3,
        "k": 3.0,
    }
    numbers.update(changes)
    stack = {
        "urushi": 1,
        "layers": [
            {"dielectric": {"ior": numbers["ior"], "alpha": numbers["alpha"]}},
            {
                "medium": {
                    "depth": numbers["depth"],
                    "albedo": numbers["albedo"],
                    "phase": {"henyey_greenstein": {"g": numbers["g"]}},
                }
            },
            {"conductor": {"eta": [0.2, 0.9, 1.4], "k": numbers["k"], "alpha": [numbers["u"], numbers["v"]]}},
        ],
    }
    path = tmp_path / "stack.yaml"
    path.write_text(yaml.safe_dump(stack))
    return str(path)


OTHER = {
    "ior": 1.3,
    "alpha": 0.35,
    "depth": 1.2,
    "albedo": [0.2, 0.6, 0.9],
    "g": 0.2,
    "u": 0.25,
    "v": 0.15,
    "k": 2.0,
}
"""Another value for every number of that file."""
