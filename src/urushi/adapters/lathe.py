"""The shapes of the built-in scene, turned on a lathe: a profile, revolved about the z axis.

Everything is computed with numpy when it is needed and handed to Mitsuba as a binary PLY file in a temporary
folder that is removed when the process ends. Lengths are scene units (the ball has radius 1); the texture
coordinate u runs once around the axis, v along the profile by arc length, both in [0, 1]: the tangent dp/du
of every shape follows the turning marks, which is where a brushed finish runs.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Mesh = tuple[Floats, Floats, Floats, npt.NDArray[np.int32]]
"""Positions (m, 3), unit normals (m, 3), texture coordinates (m, 2) and triangles (t, 3)."""

SHAPES = ("ball", "bowl", "sphere")


def _smooth_min(a: Floats, b: Floats, k: float) -> Floats:
    """The smaller of the two, with the crease between them rounded over a width `k` (Quilez's quadratic)."""
    h = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.minimum(a, b) - 0.25 * k * h * h


def _spline(points: list[tuple[float, float]], count: int) -> Floats:
    """A smooth curve (count, 2) through `points` (r, z): centripetal Catmull-Rom."""
    from scipy.interpolate import CubicSpline

    knots = np.asarray(points, float)
    steps = np.sqrt(np.linalg.norm(np.diff(knots, axis=0), axis=1))
    at = np.concatenate([[0.0], np.cumsum(steps)])
    return CubicSpline(at, knots, bc_type="natural")(np.linspace(0.0, at[-1], count))


def ball(count: int = 640) -> Floats:
    """A sphere of radius 1 with a shallow dish at the upper pole and a groove around it: (count, 2) of (r, z)."""
    theta = np.linspace(0.0, np.pi, count)
    # The dish: the sphere of radius 1.25 about (0, 1.98), met along the direction theta from the centre.
    height, radius = 1.98, 1.25
    along = height * np.cos(theta)
    under_root = along**2 - height**2 + radius**2
    dish = np.where((along > 0.0) & (under_root > 0.0), along - np.sqrt(np.maximum(under_root, 0.0)), 2.0)
    distance = _smooth_min(np.ones_like(theta), dish, 0.03)
    # The groove: flat-bottomed, with edges rounded over about one degree.
    across = np.abs(theta - np.radians(78.0)) / np.radians(4.0)
    distance -= 0.06 / (1.0 + np.exp((across - 1.0) * 14.0))
    return np.stack([distance * np.sin(theta), distance * np.cos(theta)], axis=1)


def sphere(count: int = 256) -> Floats:
    """A sphere of radius 1: (count, 2) of (r, z)."""
    theta = np.linspace(0.0, np.pi, count)
    return np.stack([np.sin(theta), np.cos(theta)], axis=1)


def bowl(count: int = 640) -> Floats:
    """A soup bowl with a lip and a foot ring, as they are lacquered: (count, 2) of (r, z), z from 0 up."""
    inner = [(0.0, 0.30), (0.40, 0.335), (0.80, 0.53), (1.04, 0.86), (1.115, 1.20)]
    lip = [(1.14, 1.235), (1.17, 1.20)]
    outer = [(1.10, 0.84), (0.86, 0.45), (0.60, 0.255), (0.535, 0.20)]
    foot = [(0.535, 0.10), (0.555, 0.02), (0.53, 0.0), (0.50, 0.02), (0.47, 0.12), (0.40, 0.15), (0.0, 0.15)]
    curve = _spline(inner + lip + outer + foot, count)
    curve[:, 0] = np.maximum(curve[:, 0], 0.0)
    return curve


def stand(count: int = 320) -> Floats:
    """The turned ring that the ball rests in: (count, 2) of (r, z), z from 0 up."""
    points = [(0.0, 0.06), (0.36, 0.07), (0.47, 0.20), (0.50, 0.235), (0.53, 0.21)]
    points += [(0.56, 0.12), (0.68, 0.055), (0.73, 0.03), (0.72, 0.0), (0.60, -0.01)]
    curve = _spline(points, count)
    curve[:, 0] = np.maximum(curve[:, 0], 0.0)
    return curve


def sweep(depth: float = 7.0, front: float = 14.0, rise: float = 16.0, radius: float = 4.0) -> Floats:
    """The backdrop's profile (n, 2) of (y, z): a floor from y=-front, bending up at y=depth into a wall."""
    bend = np.linspace(0.0, 0.5 * np.pi, 64)
    curve = np.stack([depth + radius * np.sin(bend), radius * (1.0 - np.cos(bend))], axis=1)
    return np.concatenate([[[-front, 0.0]], curve, [[depth + radius, radius + rise]]])


def revolve(profile: Floats, segments: int = 320) -> Mesh:
    """Turn a profile (n, 2) of (r, z) about the z axis; its left side, walking along it, is outside."""
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    v = np.concatenate([[0.0], np.cumsum(steps)])
    tangent = np.gradient(profile, v, axis=0)
    # On the axis the profile is even in r: it crosses the axis at a right angle.
    tangent[profile[:, 0] < 1e-9] *= [1.0, 0.0]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u = np.linspace(0.0, 1.0, segments + 1)
    # The seam, where u jumps from 1 to 0, is at +y: the built-in camera looks from the other side.
    cos, sin = -np.sin(2.0 * np.pi * u), np.cos(2.0 * np.pi * u)

    def around(curve: Floats) -> Floats:
        r, z = curve[:, :1], curve[:, 1:]
        return np.stack([r * cos, r * sin, z + 0.0 * cos], axis=-1).reshape(-1, 3)

    uv = np.stack(np.broadcast_arrays(u, 1.0 - v[:, None] / v[-1]), axis=-1).reshape(-1, 2)
    return around(profile), around(normal), uv, _grid(len(profile), segments + 1)


def extrude(profile: Floats, half_width: float, unit: float) -> Mesh:
    """Draw a profile (n, 2) of (y, z) along x; texture coordinates are the unrolled sheet over `unit`."""
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    v = np.concatenate([[0.0], np.cumsum(steps)]) + profile[0, 0]
    tangent = np.gradient(profile, v, axis=0)
    x = np.array([-half_width, half_width])
    y, z = (np.repeat(profile[:, i], 2) for i in (0, 1))
    position = np.stack([np.tile(x, len(profile)), y, z], axis=1)
    normal = np.repeat(np.stack([0 * v, -tangent[:, 1], tangent[:, 0]], axis=1), 2, axis=0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    uv = np.stack([np.tile(x, len(profile)), np.repeat(v, 2)], axis=1) / unit + 0.5
    return position, normal, uv, _grid(len(profile), 2)[:, ::-1]


def _grid(rows: int, columns: int) -> npt.NDArray[np.int32]:
    """Two triangles for each cell of a grid of vertices."""
    at = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def write_ply(path: Path, position: Floats, normal: Floats, uv: Floats, faces: npt.NDArray[np.int32]) -> None:
    """Write a binary PLY file with normals and texture coordinates."""
    vertices = np.concatenate([position, normal, uv], axis=1).astype("<f4")
    triangles = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", 3)])
    triangles["n"], triangles["i"] = 3, faces
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{names}"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(head.encode("ascii") + vertices.tobytes() + triangles.tobytes())


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="urushi-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def ply(name: str) -> str:
    """The PLY file of a shape ("ball", "bowl", "sphere", "stand") or stage ("sweep", "floor")."""
    path = _folder() / f"{name}.ply"
    if name in ("sweep", "floor"):
        profile = sweep() if name == "sweep" else np.array([[-400.0, 0.0], [0.0, 0.0], [400.0, 0.0]])
        write_ply(path, *extrude(profile, half_width=24.0 if name == "sweep" else 400.0, unit=12.0))
    else:
        profiles = {"ball": ball, "bowl": bowl, "sphere": sphere, "stand": stand}
        write_ply(path, *revolve(profiles[name]()))
    return str(path)
