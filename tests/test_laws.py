"""Every law over every model: all checks on all presets, and on stacks at the ends of what is allowed."""

from __future__ import annotations

import faulthandler
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi import checks
from urushi.solvers import BSDF

pytestmark = needs_llvm

#: what stands in for the textures of a preset
INSTEAD = {"varnished-wood": {"layer_0.alpha": 0.12, "layer_2.reflectance": (0.4, 0.25, 0.1)}}


def hg(g: float) -> ur.HenyeyGreenstein:
    return ur.HenyeyGreenstein(g=g)


COAT = ur.Dielectric(ior=1.5, alpha=0.1)
WHITE, BLACK, GREY = (ur.Diffuse(reflectance=r) for r in (1.0, 0.0, 0.5))
FOG = ur.Medium(depth=1.0, albedo=0.9, phase=hg(0.5))
GOLD = ur.Conductor(material="Au", alpha=0.2)

#: at the ends of the range, one thing at a time
EXTREMES: dict[str, list[Any]] = {
    "as sharp as can be": [ur.Dielectric(ior=1.5, alpha=1e-4), GREY],
    "as rough as can be": [ur.Dielectric(ior=1.5, alpha=1.0), GREY],
    "rough beckmann, separable": [
        ur.Dielectric(ior=1.5, alpha=0.6, distribution="beckmann", masking="separable"),
        GREY,
    ],
    "smooth coat": [ur.Dielectric(ior=1.5), GREY],
    "smooth coat on smooth metal": [ur.Dielectric(ior=1.5), ur.Conductor(material="Cu", alpha=0)],
    "high index": [ur.Dielectric(ior=3.0, alpha=0.3), GREY],
    "equal indices": [ur.Dielectric(ior=1.0, alpha=0.3), GREY],
    "nearly equal indices": [ur.Dielectric(ior=1.003, alpha=0.3), GREY],
    "one rough interface": [ur.Dielectric(ior=1.5, alpha=0.4)],
    "one smooth interface": [ur.Dielectric(ior=2.0)],
    "one metal": [ur.Conductor(material="Al", alpha=0.5, masking="separable")],
    "white base": [COAT, WHITE],
    "black base": [COAT, BLACK],
    "albedo 1": [COAT, ur.Medium(depth=2.0, albedo=1.0, phase=hg(0.3)), WHITE],
    "albedo 0": [COAT, ur.Medium(depth=(0.1, 1.0, 3.0), albedo=0.0), GREY],
    "a zero channel": [COAT, ur.Medium(depth=(0.0, 0.5, 2.0), albedo=(0.0, 0.5, 1.0), phase=hg(0.5)), GREY],
    "depth 0": [COAT, ur.Medium(depth=0.0, albedo=0.9), GREY],
    "depth 1e-6": [ur.Dielectric(ior=1.5), ur.Medium(depth=1e-6, albedo=0.9), ur.Dielectric(ior=1.0)],
    "depth 1000": [COAT, ur.Medium(depth=1000.0, albedo=0.9)],
    "forward peak": [
        ur.Dielectric(ior=1.4, alpha=0.2),
        ur.Medium(depth=5.0, albedo=0.95, phase=hg(0.99)),
        GREY,
    ],
    "backward peak": [
        ur.Dielectric(ior=1.4),
        ur.Medium(depth=2.0, albedo=0.95, phase=hg(-0.99)),
        ur.Dielectric(ior=1.0),
    ],
    "rayleigh slab alone": [ur.Medium(depth=1.5, albedo=0.95, phase=ur.Rayleigh())],
    "begins with a medium": [FOG, ur.Dielectric(ior=1.5, alpha=0.2), GREY],
    "ends with a medium": [ur.Dielectric(ior=1.5, alpha=0.2), FOG],
    "five interfaces": [
        ur.Dielectric(ior=1.3, alpha=0.05),
        ur.Dielectric(ior=1.6, alpha=0.2),
        FOG,
        ur.Dielectric(ior=1.2),
        ur.Dielectric(ior=1.5, alpha=0.1),
        ur.Dielectric(ior=1.0, alpha=0.3),
    ],
    "brushed": [
        ur.Dielectric(ior=1.5, alpha=(0.3, 0.03), rotation=30),
        ur.Conductor(material="Al", alpha=(0.05, 0.5)),
    ],
    "smooth in the middle": [ur.Dielectric(ior=1.3, alpha=0.2), ur.Dielectric(ior=1.6), FOG, GOLD],
    "three smooth plates": [ur.Dielectric(ior=1.5), ur.Dielectric(ior=2.0), ur.Dielectric(ior=1.33)],
}
#: light in glass, that meets air: the ratio of the indices is below 1
FROM_GLASS: dict[str, list[Any]] = {
    "rough, to air": [ur.Dielectric(ior=1.0, alpha=0.2)],
    "smooth, to air and glass again": [ur.Dielectric(ior=1.0), ur.Dielectric(ior=1.5)],
    "rough, over a base in air": [ur.Dielectric(ior=1.0, alpha=0.1), GREY],
}


@pytest.fixture(autouse=True)
def watch() -> Iterator[None]:
    """A lane that never ends would hang the suite: say where, and stop."""
    faulthandler.dump_traceback_later(300, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


#: where single paths carry so much that the error of a mean is not known from a few thousand of them: light that is
#: sent back and back again in the same narrow peak, behind smooth boundaries that no connection sees through
HEAVY = {"backward peak": {"reciprocity", "agreement"}}


def holds(stack: ur.Stack, **options: Any) -> None:
    without = HEAVY.get(stack.name, set())

    @cache
    def answers(samples: int) -> BSDF:
        return ur.solve(stack, "walk", samples=samples, **options)

    reports = [check(answers, True) for name, check in checks.CHECKS.items() if name not in without]
    assert [f"{report.name}: {report.text}" for report in reports if not report.passed] == []


@pytest.mark.parametrize("name", ur.presets())
def test_presets(name: str) -> None:
    options = {"parameters": INSTEAD[name]} if name in INSTEAD else {}
    holds(ur.load(f"preset:{name}"), **options)


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes(name: str) -> None:
    holds(ur.Stack(name=name, layers=EXTREMES[name]))


@pytest.mark.parametrize("name", FROM_GLASS)
def test_from_glass(name: str) -> None:
    holds(ur.Stack(name=name, layers=FROM_GLASS[name], exterior=1.5))


def test_in_double_precision() -> None:
    holds(
        ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3), FOG, ur.Dielectric(ior=1.0)]), precision="double"
    )


def test_many_values_for_one_stack() -> None:
    """One value per lane, smooth and rough, matched and not, thin and deep in one batch: energy and finiteness."""
    n, rng = 20000, np.random.default_rng(4)
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1), FOG, ur.Dielectric(ior=1.2, alpha=0.3), GREY])
    parameters = {
        "layer_0.ior": rng.choice([1.0, 1.00005, 1.2, 2.0], n),
        "layer_0.alpha": rng.choice([0, 1e-4, 0.1, 1.0], (n, 1)) * np.ones(2),
        "layer_1.depth": rng.choice([0, 1e-6, 1.0, 50.0], (n, 3)),
        "layer_1.albedo": rng.choice([0, 0.5, 1.0], (n, 3)),
        "layer_1.phase.g": rng.uniform(-0.99, 0.99, n),
        "layer_2.alpha": rng.choice([0, 0.2], n),
        "layer_3.reflectance": rng.choice([0, 1.0], (n, 3)),
    }
    bsdf = ur.solve(stack, "walk", samples=16, parameters=parameters)
    z = np.concatenate([rng.choice([1.0, 0.5, 1e-4, 1e-7, 0.0], n)])
    wi = np.stack([np.sqrt(1 - z**2), 0 * z, z], axis=1)
    wo = np.roll(wi, 1, axis=0) * rng.choice([-1, 1], (n, 1)) * (1, 1, 0) + np.roll(wi, 1, axis=0) * (0, 0, 1)
    value, error = bsdf.reflectance(wi, with_error=True)
    assert np.isfinite(value).all() and (value >= 0).all()
    assert value.mean() <= 1 + 5 * np.sqrt(np.mean(error**2) / n)
    for found in (bsdf.eval(wi, wo), bsdf.pdf(wi, wo), bsdf.sample(wi, rng.random((n, 3))).weight):
        assert np.isfinite(found).all() and (found >= 0).all()


@pytest.mark.parametrize("method", ["walk", "adding", "lobes"])
def test_an_interface_without_contrast_is_not_there(method: str) -> None:
    """One of nearly the index above it bends no light: neither there nor further down."""
    below = [ur.Medium(depth=1.0, albedo=0.9), ur.Dielectric(ior=1.5), ur.Diffuse(reflectance=0.5)]
    wi = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.998, 0.0, 0.0632]])
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    options = {"adding": {"nodes": 12}}.get(method, {})
    bare = ur.solve(ur.Stack(layers=below), method, **options).reflectance(wi)
    for index in (1.00009, 1.0000001):
        coated = ur.Stack(layers=[ur.Dielectric(ior=index, alpha=0.1), *below])
        np.testing.assert_array_equal(ur.solve(coated, method, **options).reflectance(wi), bare)
