"""Results are pickled, for other processes, and copied: they have the same values there."""

from __future__ import annotations

import copy
import functools
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urushi as ur
from conftest import LLVM
from lanes import needs_llvm
from urushi.solvers import BSDF

if LLVM is not None:
    import drjit as dr
    from drjit.llvm.ad import Array3f, Float

pytestmark = needs_llvm

COAT, GOLD = ur.Dielectric(ior=1.5, alpha=0.2), ur.Conductor(material="Au", alpha=0.3)
HAZE = ur.Medium(depth=0.5, albedo=(0.9, 0.5, 0.1), phase=ur.HenyeyGreenstein(g=0.6))
SHARP = ur.Medium(depth=0.5, albedo=0.9, phase=ur.HenyeyGreenstein(g=0.9))
GRADED = ur.GradedMedium(depth=1.0, albedo=(0.9, 0.2), phase=ur.HenyeyGreenstein(g=0.3))
COUNT = 3


def _lanes() -> Any:
    """A colour for each of three evaluations, in a Dr.Jit array."""
    return Array3f(Float(0.1, 0.4, 0.9), Float(0.2, 0.5, 0.8), Float(0.3, 0.6, 0.7))


MADE: dict[str, Callable[[], Any]] = {
    "walk": lambda: ur.solve(
        ur.Stack(layers=[COAT, HAZE, ur.Dielectric(ior=1.2, alpha=0.1)]),
        "walk",
        samples=4,
        seed=7,
        max_depth=9,
        mode="importance",
    ),
    "walk, lanes": lambda: ur.solve(
        ur.Stack(layers=[COAT, HAZE, GOLD]),
        "walk",
        samples=2,
        precision="double",
        parameters={"layer_0.alpha": Float(0.1, 0.2, 0.3), "layer_1.albedo": _lanes()},
    ),
    "lobes": lambda: ur.solve(ur.Stack(layers=[COAT, COAT]), "lobes", symmetric=True, mode="importance"),
    "lobes, lanes": lambda: ur.solve(
        ur.Stack(layers=[COAT, ur.Diffuse()]), "lobes", parameters={"layer_1.reflectance": _lanes()}
    ),
    "lobes, scalar": lambda: ur.solve(
        ur.Stack(layers=[COAT, GOLD]), "lobes", backend="scalar", published=True, precision="double"
    ),
    "adding": lambda: ur.solve(
        ur.Stack(layers=[COAT, HAZE, ur.Dielectric(ior=1.2)]), "adding", nodes=8, mode="importance"
    ),
    "adding, a peak": lambda: ur.solve(ur.Stack(layers=[SHARP]), "adding", accuracy=0.01, precision="single"),
    "adding, graded": lambda: ur.solve(ur.Stack(layers=[GRADED, ur.Diffuse()]), "adding", nodes=8),
    "adding, channels": lambda: ur.solve(
        ur.Stack(layers=[HAZE.model_copy(update={"albedo": 0.5})]),
        "adding",
        parameters={"layer_0.albedo": [0.1, 0.3, 0.5, 0.7, 0.9]},
        precision="single",
    ),
    "auto": lambda: ur.solve(ur.Stack(layers=[COAT, ur.Diffuse()]), nodes=8),
}


@functools.cache
def made(name: str) -> BSDF:
    return MADE[name]()


def _answers(bsdf: BSDF) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    wi, wo = (rng.normal(size=(COUNT, 3)) for _ in range(2))
    wi[:, 2] = np.abs(wi[:, 2])
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    sample = bsdf.sample(wi, rng.random((COUNT, 3)))
    fluxes = [bsdf.reflectance(wi), bsdf.transmittance(wi)]
    return [bsdf.eval(wi, wo), bsdf.pdf(wi, wo), sample.wo, sample.weight, sample.pdf, *fluxes]


@pytest.mark.parametrize("copied", [lambda b: pickle.loads(pickle.dumps(b)), copy.deepcopy, copy.copy])
@pytest.mark.parametrize("name", list(MADE))
def test_copies_have_the_same_values(name: str, copied: Callable[[Any], Any]) -> None:
    bsdf = made(name)
    other = copied(bsdf)
    assert type(other) is type(bsdf) and other is not bsdf
    assert other.stack == bsdf.stack
    assert dict(other.diagnostics) == dict(bsdf.diagnostics)
    for one, two in zip(_answers(bsdf), _answers(other), strict=True):
        np.testing.assert_array_equal(one, two)


READER = """
import pickle, sys
from urushi import llvm
prepare, early = llvm.prepare, []
llvm.prepare = lambda: (early.append("drjit" not in sys.modules), prepare())
with open(sys.argv[1], "rb") as file:
    bsdf = pickle.load(file)
assert early == [True], early
print(*bsdf.reflectance([[0.6, 0.0, 0.8]] * 3)[2])
"""


@pytest.mark.parametrize("name", ["walk", "adding, a peak", "lobes, lanes"])
def test_another_process_can_read_them(name: str, tmp_path: Path) -> None:
    """One that has not imported Dr.Jit: it is told first where LLVM is."""
    bsdf, path = made(name), tmp_path / "bsdf.pickle"
    path.write_bytes(pickle.dumps(bsdf))
    done = subprocess.run([sys.executable, "-c", READER, path], capture_output=True, text=True, check=True)
    found = [float(word) for word in done.stdout.split()]
    np.testing.assert_allclose(found, bsdf.reflectance([[0.6, 0.0, 0.8]] * 3)[2], rtol=1e-6)


@pytest.mark.parametrize("method", ["walk", "lobes"])
def test_derivatives_are_not_lost_in_silence(method: str) -> None:
    x = Float(0.1)
    dr.enable_grad(x)
    bsdf = ur.solve(ur.Stack(layers=[COAT, GOLD]), method, parameters={"layer_0.alpha": x})
    for copied in (pickle.dumps, copy.deepcopy):
        with pytest.raises(ur.UrushiError, match=r"layer_0\.alpha: found .* derivatives.*drjit\.detach"):
            copied(bsdf)


def test_what_cannot_be_made_again_says_so() -> None:
    class Own(BSDF):
        def __init__(self) -> None:
            self.diagnostics: dict[str, Any] = {}

        eval = pdf = sample = reflectance = transmittance = None  # type: ignore[assignment]

    with pytest.raises(ur.UrushiError, match=r"an? Own can be neither pickled nor copied deeply"):
        pickle.dumps(Own())
    assert copy.copy(Own()).diagnostics == {}


def test_errors_come_back_from_other_processes() -> None:
    """As a worker sends them."""
    with pytest.raises(ur.UnsupportedStack) as raised:
        ur.solve(ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=(0.1, 0.2)), GOLD]), "adding")
    with pytest.raises(ur.MaterialError) as refused:
        ur.solve(ur.Stack(layers=[COAT, GOLD]), "walk", parameters={"layer_0.alpha": -1.0})
    for error in (raised.value, refused.value):
        other = pickle.loads(pickle.dumps(error))
        assert type(other) is type(error) and str(other) == str(error)
        assert vars(other) == vars(error)
