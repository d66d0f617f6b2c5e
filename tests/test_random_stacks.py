"""A million random stacks in random directions: no answer is undefined, infinite or negative, none creates energy, and
every path comes to an end.

Hypothesis draws the structure of a stack, which costs a compilation; all numbers are drawn anew for every evaluation,
over the whole range that the description allows.
"""

from __future__ import annotations

import faulthandler
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import urushi as ur
from lanes import needs_llvm
from strategies import stacks
from urushi.checks.finiteness import directions
from urushi.description.parameter import Covariance, Normal, Parameter, Roughness
from urushi.solvers.numbers import described

pytestmark = needs_llvm

LANES = 40_000
#: deeper conservative media take for ever by their nature
DEEPEST = 1e3


@pytest.fixture(autouse=True)
def watch() -> Iterator[None]:
    faulthandler.dump_traceback_later(300, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


def plain(stack: ur.Stack) -> ur.Stack:
    """The same structure without a walk between facets; depths and complex indices given as such."""
    layers = []
    for layer in stack.layers:
        given = {name: getattr(layer, name) for name in type(layer).model_fields}
        given |= {name: False for name in ("multiple_scattering",) if name in given}
        if layer.kind == "medium":
            given |= {"depth": 1.0, "thickness": None, "sigma_t": None}
        if layer.kind == "conductor":
            given |= {"material": None, "eta": 1.0, "k": 1.0}
        layers.append(type(layer)(**given))
    return ur.Stack(layers=layers, exterior=stack.exterior)


def lane_values(stack: ur.Stack, n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Values for every parameter and every lane; a quarter of them at an end of the range."""
    found = {}
    for name, value in described(stack).items():
        if name == "exterior":
            continue
        head, _, leaf = name.rpartition(".")
        layer: Any = stack.layers[int(name.split(".")[0].removeprefix("layer_"))]
        rule: Any = type(layer.phase if head.endswith(".phase") else layer).rules()[leaf]
        assert isinstance(rule, Parameter)
        if isinstance(rule, Normal):
            sideways, up = rng.uniform(-1, 1, (n, 2)), 10.0 ** rng.uniform(-3, 0, n)
            found[name] = np.column_stack([sideways, up])
            continue
        if isinstance(rule, Covariance):
            deviation = rng.uniform(0, 0.7, (n, 2)) * rng.integers(0, 2, (n, 2))
            correlation = rng.uniform(-1, 1, n) * deviation.prod(axis=1)
            found[name] = np.column_stack([deviation**2, correlation])
            continue
        width = len(value) if isinstance(value, tuple) else rng.choice([1, 3]) if rule.size == 3 else 1
        ends = rng.choice([rule.low, min(rule.high, DEEPEST) if leaf == "depth" else rule.high], (n, width))
        if isinstance(rule, Roughness):
            inner = 10.0 ** rng.uniform(-4, 0, (n, width))
            ends = np.where(rng.random((n, 1)) < 0.5, 0.0, ends + (ends == 0) * 1e-4)  # all of a pair or none
        elif leaf == "depth":
            # Few lanes are deep: where nothing absorbs either, a path there has a million collisions.
            inner, ends = 10.0 ** rng.uniform(-7, 1.5, (n, width)), ends * (rng.random((n, width)) < 0.02)
        elif leaf in ("eta", "k"):
            inner, ends = 10.0 ** rng.uniform(-2, 1, (n, width)), np.full((n, width), 1e-2)
        else:
            inner = rng.uniform(rule.low, rule.high, (n, width))
        values = np.where(rng.random((n, 1)) < 0.25, ends, inner)
        found[name] = values[:, 0] if width == 1 else values
    return found


def obeys(stack: ur.Stack, seed: int) -> None:
    rng = np.random.default_rng(seed)
    stack = plain(stack)
    wi, wo, u = directions(LANES)
    n = len(wi)
    order = rng.permutation(n)
    wi, wo, u = wi[order], wo[order], u[order]
    parameters = lane_values(stack, n, rng)
    bsdf = ur.solve(stack, "walk", samples=1, seed=seed, parameters=parameters)
    sample = bsdf.sample(wi, u)
    reflectance, transmittance = bsdf.reflectance(wi), bsdf.transmittance(wi)
    answers = {
        "eval": bsdf.eval(wi, wo),
        "pdf": bsdf.pdf(wi, wo),
        "weight": sample.weight,
        "sample pdf": sample.pdf,
        "reflectance": reflectance,
        "transmittance": transmittance,
    }
    for name, found in answers.items():
        wrong = ~(np.isfinite(found) & (found >= 0)).reshape(n, -1).all(axis=1)
        if wrong.any():
            i = int(np.argmax(wrong))
            numbers = {key: np.asarray(value[i]).tolist() for key, value in parameters.items()}
            pytest.fail(
                f"{name} is {found[i]} in {wrong.sum()} lanes; wi={wi[i].tolist()} wo={wo[i].tolist()} "
                f"u={u[i].tolist()} exterior={stack.exterior} {numbers}\n{stack}"
            )
    assert np.all(np.abs(np.linalg.norm(sample.wo, axis=1)[sample.pdf > 0] - 1) < 1e-3)
    # Of one path each: the mean over all lanes, each of them at most 1 in truth.
    total = reflectance + transmittance
    spread = total.std(axis=0) / np.sqrt(n)
    assert np.all(total.mean(axis=0) <= 1 + 6 * spread + 1e-5), total.mean(axis=0)


MIRRORS = [ur.Dielectric(ior=1.5), ur.Dielectric(ior=2.0), ur.Dielectric(ior=1.2)]
DEEP = [
    ur.Dielectric(ior=1.5, alpha=0.1),
    ur.Medium(depth=1.0, albedo=1.0),
    ur.Dielectric(ior=1.5, alpha=0.1),
]


@given(stack=stacks(opaque=False, most=4), seed=st.integers(0, 2**32 - 1))
@example(stack=ur.Stack(layers=MIRRORS), seed=1)
@example(stack=ur.Stack(layers=DEEP, exterior=2.0), seed=2)
@settings(max_examples=11, suppress_health_check=list(HealthCheck))
def test_stacks_that_transmit(stack: ur.Stack, seed: int) -> None:
    obeys(stack, seed)


@given(stack=stacks(opaque=True, most=4), seed=st.integers(0, 2**32 - 1))
@example(stack=ur.Stack(layers=[*MIRRORS, ur.Conductor(material="Ag", alpha=0)]), seed=3)
@example(stack=ur.Stack(layers=[DEEP[0], DEEP[1], ur.Diffuse(reflectance=1.0)]), seed=4)
@settings(max_examples=11, suppress_health_check=list(HealthCheck))
def test_opaque_stacks(stack: ur.Stack, seed: int) -> None:
    obeys(stack, seed)


@pytest.mark.slow
@given(stack=stacks(most=6), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
def test_many_more(stack: ur.Stack, seed: int) -> None:
    obeys(stack, seed)


def test_deep_and_white() -> None:
    """Optical depth 1000 and nothing absorbs: all light returns or passes, and the walk ends."""
    bsdf = ur.solve(ur.Stack(layers=[ur.Medium(depth=1e3, albedo=1.0)]), "walk", samples=256)
    wi = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0.6, 0, -0.8]])
    r, t = bsdf.reflectance(wi), bsdf.transmittance(wi)
    # A conservative slab passes about (mu + 2/3) / (depth + 4/3).
    assert np.allclose(r + t, 1, atol=0.02) and np.all(t < 0.02)
