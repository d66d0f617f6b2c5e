"""How far lobes are from the truth, held by the walk: reflectances and widths. The bounds are what was measured."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm

pytestmark = needs_llvm

GOLD = {"eta": 0.2, "k": 3.9}
THETA = np.radians([0.0, 30, 45, 60, 75])
WI = np.stack([np.sin(THETA), 0 * THETA, np.cos(THETA)], axis=1)


def _coat(alpha: float, *more: object, ior: float = 1.5) -> ur.Stack:
    return ur.Stack(layers=[ur.Dielectric(ior=ior, alpha=alpha), *more])


def _metal(alpha: float) -> ur.Conductor:
    return ur.Conductor(**GOLD, alpha=alpha)


SCATTERING = ur.Medium(depth=1.0, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.5))
ABSORBING = ur.Medium(depth=0.5, albedo=0.0)

# stack, the largest difference of the reflectance up to 45 degrees, and up to 75
CASES = {
    "smooth coat on metal .1": (_coat(0.0, _metal(0.1)), 0.01, 0.01),
    "coat .1 on metal .1": (_coat(0.1, _metal(0.1)), 0.025, 0.04),
    "coat .1 on metal .3": (_coat(0.1, _metal(0.3)), 0.025, 0.025),
    "coat .3 on metal .3": (_coat(0.3, _metal(0.3)), 0.025, 0.025),
    "coat .5 on metal .5": (_coat(0.5, _metal(0.5)), 0.015, 0.02),
    "coat .8 on metal .8": (_coat(0.8, _metal(0.8)), 0.02, 0.03),
    "coat .1 on diffuse": (_coat(0.1, ur.Diffuse(0.8)), 0.01, 0.01),
    "coat .8 on diffuse": (_coat(0.8, ur.Diffuse(0.8)), 0.01, 0.01),
    "coat .1 on scattering on diffuse": (_coat(0.1, SCATTERING, ur.Diffuse(0.5)), 0.01, 0.01),
    "coat .5 on scattering on diffuse": (_coat(0.5, SCATTERING, ur.Diffuse(0.5)), 0.01, 0.02),
    "coat .1 on absorbing on metal .2": (_coat(0.1, ABSORBING, _metal(0.2)), 0.02, 0.02),
    "three, .3": (_coat(0.3, ur.Dielectric(ior=2.0, alpha=0.3), _metal(0.3)), 0.025, 0.03),
    "three, .1": (_coat(0.1, ur.Dielectric(ior=2.0, alpha=0.1), _metal(0.1)), 0.06, 0.08),
}


def _walk(stack: ur.Stack, samples: int = 1 << 13) -> tuple[np.ndarray, np.ndarray]:
    found, error = ur.solve(stack, "walk", samples=samples).reflectance(WI, with_error=True)
    return found[:, 0], error[:, 0]


QUICK = (
    "smooth coat on metal .1",
    "coat .1 on diffuse",
    "coat .3 on metal .3",
    "coat .1 on scattering on diffuse",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES]
)
def test_reflectance(name: str) -> None:
    stack, near, far = CASES[name]
    truth, error = _walk(stack)
    found = ur.solve(stack, "lobes").reflectance(WI)[:, 0]
    limit = np.where(THETA < 0.8, near, far) + 4 * error
    assert np.all(np.abs(found - truth) < limit), np.round(found - truth, 4)


def _median(stack: ur.Stack, method: str, wi: np.ndarray, **options: object) -> float:
    """Median tangent of the angle of half-way vectors, of all light but the outermost interface's own lobe."""
    r = np.concatenate([np.linspace(0, 0.02, 6)[1:] - 0.002, np.geomspace(0.02, 3, 60)])
    phi = np.linspace(0, 2 * np.pi, 24, endpoint=False) + 0.1
    slope, turn = np.meshgrid(r, phi, indexing="ij")
    h = np.stack([slope * np.cos(turn), slope * np.sin(turn), np.ones_like(slope)], axis=-1).reshape(-1, 3)
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    cos = h @ wi
    wo = 2 * cos[:, None] * h - wi
    seen = (wo[:, 2] > 1e-3) & (cos > 0)
    wo = np.where(seen[:, None], wo, [0, 0, 1.0])
    alone = ur.solve(ur.Stack(layers=stack.layers[:1]), "walk", samples=1).eval(wi, wo)[:, 0]
    value = ur.solve(stack, method, **options).eval(wi, wo)[:, 0] - alone
    density = np.where(seen, 4 * value * cos * h[:, 2] ** 3, 0).reshape(slope.shape).mean(axis=1) * r
    below = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(r))])
    return float(np.interp(0.5 * below[-1], below, r))


@pytest.mark.slow
@pytest.mark.parametrize("theta", [1.0, 30.0])
@pytest.mark.parametrize(
    "layers",
    [
        (ur.Dielectric(ior=1.5, alpha=0.1), _metal(0.05)),
        (ur.Dielectric(ior=1.5, alpha=0.05), _metal(0.2)),
        (ur.Dielectric(ior=1.5, alpha=0.2), _metal(0.02)),
        (ur.Dielectric(ior=1.5, alpha=0.1), _metal(0.3)),
        (ur.Dielectric(ior=1.5, alpha=0.05), ur.Dielectric(ior=2.0, alpha=0.1), _metal(0.02)),
        (ur.Dielectric(ior=1.5, alpha=0.2), ur.Dielectric(ior=2.0, alpha=0.05), _metal(0.02)),
        (ur.Dielectric(ior=1.3, alpha=0.02), ur.Dielectric(ior=2.2, alpha=0.25), _metal(0.02)),
    ],
    ids=lambda layers: " ".join(str(layer.alpha) for layer in layers),
)
def test_width(layers: tuple, theta: float) -> None:
    """Within 10 % up to alpha 0.3 and 30 degrees; with three interfaces nearer than the published form."""
    stack = ur.Stack(layers=layers)
    wi = np.array([np.sin(np.radians(theta)), 0, np.cos(np.radians(theta))])
    truth = _median(stack, "walk", wi, samples=2048)
    ours, published = (_median(stack, "lobes", wi, published=way) for way in (False, True))
    assert ours == pytest.approx(truth, rel=0.1)
    if len(layers) > 2:
        assert abs(ours - truth) < 0.5 * abs(published - truth)
