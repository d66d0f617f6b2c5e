"""Every check passes on a right BSDF and finds a fault that is planted for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from urushi import checks
from urushi.checks.chance import FALSE_ALARM, chi2_p_value, numbers, sigmas, significance
from urushi.checks.sphere import Patch, direction, integrate, radiance
from urushi.solvers import BSDF, Sample

pytestmark = needs_llvm

WHITE = ur.Stack(layers=[ur.Diffuse(reflectance=1.0)])
GLASS = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3)])
PLATE = ur.Stack(layers=[ur.Dielectric(ior=1.5), ur.Dielectric(ior=1.33)])
STACKS = {"white": WHITE, "glass": GLASS, "plate": PLATE}


@cache
def solved(name: str, samples: int) -> BSDF:
    return ur.solve(STACKS[name], "walk", samples=samples)


class Fault(BSDF):
    """A right BSDF with something broken. The rest is passed on."""

    def __init__(self, right: BSDF) -> None:
        self.right, self.stack, self.diagnostics = right, right.stack, right.diagnostics

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        value, error = (
            self.right.eval(wi, wo, with_error=True) if with_error else (self.right.eval(wi, wo), 0)
        )
        factor = self.factor(np.asarray(wi, float), np.asarray(wo, float))[:, None]
        return (value * factor, error * factor) if with_error else value * factor

    def pdf(self, wi: Any, wo: Any) -> Any:
        return self.right.pdf(wi, wo)

    def sample(self, wi: Any, u: Any) -> Sample:
        found = self.right.sample(wi, u)
        factor = np.where(found.delta, 1, self.factor(np.asarray(wi, float), found.wo))
        return replace(found, weight=found.weight * factor[:, None])

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        return self.right.reflectance(wi, with_error=with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        return self.right.transmittance(wi, with_error=with_error)

    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """What eval and the weight of sample are multiplied by."""
        return np.ones(max(len(wi), len(wo)))


class LostCosine(Fault):
    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return super().factor(wi, wo) / np.maximum(np.abs(wo[:, 2]), 1e-6)


class Gain(Fault):
    """One per cent more of everything."""

    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return 1.01 * super().factor(wi, wo)

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        found = self.right.reflectance(wi, with_error=with_error)
        return (found[0] * 1.01, found[1]) if with_error else found * 1.01


class Nonreciprocal(Fault):
    """Five per cent more where light comes in steeply."""

    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return super().factor(wi, wo) * (1 + 0.05 * np.abs(wi[:, 2]))


class SwappedEta(Fault):
    """(n_o / n_i)^2 for radiance."""

    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return radiance(self.stack, *np.broadcast_arrays(wi, wo)) ** -2


class Nan(Fault):
    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.where(np.abs(wo[:, 2]) < 1e-4, np.nan, super().factor(wi, wo))


class Negative(Fault):
    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return np.where((wo[:, 0] > 0.99), -1, super().factor(wi, wo))


class LouderEval(Fault):
    """Two per cent more in eval, which the fluxes know nothing of."""

    def factor(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return 1.02 * super().factor(wi, wo)


class Densities(Fault):
    """A density that is wrong in pdf and sample alike."""

    def pdf(self, wi: Any, wo: Any) -> Any:
        return self.right.pdf(wi, wo) * self.shape(
            np.broadcast_to(wo, np.broadcast_shapes(np.shape(wi), np.shape(wo)))
        )

    def sample(self, wi: Any, u: Any) -> Sample:
        found = self.right.sample(wi, u)
        return replace(found, pdf=np.where(found.delta, found.pdf, found.pdf * self.shape(found.wo)))

    def shape(self, wo: np.ndarray) -> np.ndarray:
        return np.full(len(wo), 1.01)


class Hole(Densities):
    """No density where samples go, though they say that there is one."""

    def sample(self, wi: Any, u: Any) -> Sample:
        return self.right.sample(wi, u)

    def shape(self, wo: np.ndarray) -> np.ndarray:
        return np.where(wo[:, 0] > 0.9, 0.0, 1.0)


class HollowWeight(Densities):
    """Samples that say themselves that they cannot be, and carry light all the same."""

    def shape(self, wo: np.ndarray) -> np.ndarray:
        return np.where(wo[:, 0] > 0.9, 0.0, 1.0)


class NegativeDensity(Densities):
    def shape(self, wo: np.ndarray) -> np.ndarray:
        return np.where(wo[:, 0] > 0.9, -1.0, 1.0)


class Leaning(Fault):
    """Samples that lean to one side by some hundredths of the range."""

    def sample(self, wi: Any, u: Any) -> Sample:
        return self.right.sample(wi, np.stack([u[:, 0], u[:, 1] ** 1.08, u[:, 2] ** 1.08], axis=1))


class UnlikelyDelta(Fault):
    """Delta parts that say they are likelier than they are."""

    def sample(self, wi: Any, u: Any) -> Sample:
        found = self.right.sample(wi, u)
        return replace(found, pdf=np.where(found.delta, np.minimum(found.pdf * 1.02, 1), found.pdf))


FAULTS: list[tuple[str, type[Fault], set[str]]] = [
    ("white", LostCosine, {"reciprocity", "agreement"}),
    ("white", Gain, {"energy"}),
    ("glass", Nonreciprocal, {"reciprocity"}),
    ("glass", SwappedEta, {"reciprocity", "agreement"}),
    ("white", Nan, {"finite"}),
    ("glass", Negative, {"not negative"}),
    ("white", LouderEval, {"agreement"}),
    ("glass", LouderEval, {"agreement"}),
    ("white", Densities, {"normalisation"}),
    ("glass", Densities, {"normalisation"}),
    ("glass", Hole, {"normalisation", "chi2"}),
    ("glass", HollowWeight, {"chi2"}),
    ("white", NegativeDensity, {"not negative", "normalisation", "chi2"}),
    ("white", Leaning, {"chi2"}),
    ("glass", Leaning, {"chi2"}),
    ("plate", UnlikelyDelta, {"normalisation"}),
]


@pytest.mark.parametrize("name", STACKS)
def test_a_right_bsdf_passes(name: str) -> None:
    reports = checks.run_on(lambda samples: Fault(solved(name, samples)))
    assert [report.text for report in reports if not report.passed] == []
    assert len(reports) == len(checks.CHECKS)


@pytest.mark.parametrize(
    ("name", "fault", "found_by"), [pytest.param(*row, id=f"{row[1].__name__}-{row[0]}") for row in FAULTS]
)
def test_a_planted_fault_is_found(name: str, fault: type[Fault], found_by: set[str]) -> None:
    for check in found_by:
        report = checks.CHECKS[check](lambda samples: fault(solved(name, samples)), True)
        assert not report.passed, report
        assert "bsdf" in report.closer
        eval(report.closer, {"bsdf": fault(solved(name, 4)), "checks": checks, "np": np})


def test_every_check_has_a_planted_fault() -> None:
    assert set().union(*(found for *_, found in FAULTS)) == set(checks.CHECKS)


def test_what_is_not_claimed_passes_whatever_is_found() -> None:
    wrong = Nonreciprocal(solved("glass", 4096))
    wrong.diagnostics = wrong.diagnostics | {"reciprocal": False}
    report = checks.CHECKS["reciprocity"](lambda samples: wrong, True)
    assert report.passed and not report.claimed and report.number > report.limit
    assert "does not claim" in report.text


def test_an_approximation_agrees_as_well_as_it_claims() -> None:
    louder = LouderEval(solved("white", 16384))
    louder.diagnostics = louder.diagnostics | {"consistent_to": 0.025}
    report = checks.CHECKS["agreement"](lambda samples: louder, True)
    assert report.passed and "claims to agree with itself to 2.5 %" in report.text
    louder.diagnostics |= {"consistent_to": 0.01}
    assert not checks.CHECKS["agreement"](lambda samples: louder, True).passed


def test_run_takes_a_bsdf() -> None:
    reports = checks.run(solved("white", 4096))
    assert [report.name for report in reports if not report.passed] == []


def test_run_takes_auto() -> None:
    assert checks.answers_of(WHITE, "auto")(1).diagnostics["method"] == "adding"


def test_run_takes_options_of_the_method() -> None:
    stack = ur.Stack(layers=[ur.Diffuse(reflectance=0.2)])
    (energy, *_) = checks.run(stack, parameters={"layer_0.reflectance": 0.7})
    assert energy.number == pytest.approx(0.7)


# ------------------------------------------------------------------------------------- their own tools


def test_a_number_that_is_none_never_passes() -> None:
    assert not checks.Report.of("x", float("nan"), 1, "").passed
    assert checks.Report.of("x", 1, 1, "").passed


def test_false_alarms_are_shared_out() -> None:
    """Šidák: all of the comparisons together keep the rate."""
    for m in (1, 10, 1000):
        assert 1 - (1 - significance(m)) ** m == pytest.approx(FALSE_ALARM, rel=1e-6)
    assert sigmas(1) == pytest.approx(4.417, abs=1e-3)


def test_latin_hypercube() -> None:
    u = numbers(1000, 0)
    assert ((u >= 0) & (u < 1)).all()
    assert all(len(set((u[:, i] * 1000).astype(int))) == 1000 for i in range(3))


def test_chi2_of_right_and_wrong_counts() -> None:
    """P-values of right counts are uniform (Kolmogorov-Smirnov); a bin that expects nothing must be empty."""
    from scipy import stats

    rng = np.random.default_rng(5)
    expected = np.geomspace(0.1, 1000, 40)
    p = [chi2_p_value(rng.poisson(expected), expected) for _ in range(400)]
    # Counts here are Poisson, so there is one degree of freedom more than of a fixed total.
    assert stats.kstest(p, "uniform").pvalue > 1e-4 or np.mean(p) < 0.6
    assert chi2_p_value(np.array([5.0, 1]), np.array([6.0, 0])) == 0
    assert chi2_p_value(expected * 1.3, expected) < 1e-6


@pytest.mark.parametrize("cos", [1.0, 0.5, 0.01, -0.3])
def test_integrals_over_a_hemisphere(cos: float) -> None:
    """Solid angle 2 pi, cosine pi, and a peak of known integral in a thousandth of a radian."""
    axis = direction(cos, 0.3)[0]
    patch = Patch(tuple(axis))
    assert integrate(lambda w: np.ones(len(w)), patch, (14, 12), 1e-6)[0].sum() == pytest.approx(
        2 * np.pi, rel=1e-5
    )
    assert integrate(lambda w: np.abs(w[:, 2]), patch, (14, 12), 1e-6)[0].sum() == pytest.approx(
        np.pi, rel=1e-5
    )
    kappa = 1e6  # von Mises-Fisher: kappa / (2 pi) exp(kappa (cos - 1)), all of it within 5e-3 radians
    if abs(cos) > 0.1:
        peak = integrate(
            lambda w: kappa / (2 * np.pi) * np.exp(-kappa * np.square(w - axis).sum(axis=1) / 2),
            patch,
            (28, 12),
            1e-6,
        )
        assert peak[0].sum() == pytest.approx(1, rel=1e-4)
    wo, weight = patch.stratified((40, 30), 3)
    assert ((wo[..., 2] > 0) == (cos > 0)).all()
    assert weight.mean(axis=0).sum() == pytest.approx(2 * np.pi, rel=0.01)
    s, phi = np.array([-5.0, -1.0, -0.01]), np.array([-3.0, 0.2, 2.0])
    assert np.allclose(patch.coordinates(patch.directions(s, phi)[0]), (s, phi), atol=1e-6)
