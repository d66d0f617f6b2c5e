"""False alarms come as often as `urushi.checks.chance` says: right BSDFs with honest noise, over many seeds.

One in a hundred thousand cannot be counted, so the rate is raised to one in twenty for the count.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import urushi as ur
from urushi import checks
from urushi.checks import chance
from urushi.solvers import BSDF, Sample

RATE = 0.05
#: chance that a count is this far off if the rate is right
UNLIKELY = 1e-6


class Noisy(BSDF):
    """A white diffuse surface, in numpy, whose values and fluxes are noisy and say how much.

    Args:
        noise: relative standard deviation of one sample.
        claimed: what it says of its error, relative to the truth.
    """

    def __init__(self, samples: int, seed: int, noise: float = 2.0, claimed: float = 1.0) -> None:
        self.stack = ur.Stack(layers=[ur.Diffuse(reflectance=1.0)])
        self.diagnostics = {"method": "noisy"}
        self.noise, self.claimed = noise / np.sqrt(samples), claimed
        self.rng = np.random.default_rng((seed, samples))

    def _noised(self, truth: np.ndarray, with_error: bool) -> Any:
        error = self.noise * truth
        value = truth + error * self.rng.standard_normal(truth.shape)
        return (value, self.claimed * error) if with_error else value

    def eval(self, wi: Any, wo: Any, *, with_error: bool = False) -> Any:
        cos = np.broadcast_to(np.maximum(wo[:, 2], 0), max(len(wi), len(wo)))
        return self._noised(np.repeat(cos[:, None] / np.pi, 3, axis=1), with_error)

    def pdf(self, wi: Any, wo: Any) -> Any:
        return np.broadcast_to(np.maximum(wo[:, 2], 0) / np.pi, max(len(wi), len(wo)))

    def sample(self, wi: Any, u: Any) -> Sample:
        cos, phi = np.sqrt(1 - u[:, 1]), 2 * np.pi * u[:, 2]
        sin = np.sqrt(u[:, 1])
        wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=1)
        weight = self._noised(np.ones((len(u), 3)), False)
        return Sample(wo, weight, cos / np.pi, np.zeros(len(u), bool))

    def reflectance(self, wi: Any, *, with_error: bool = False) -> Any:
        return self._noised(np.ones((len(wi), 3)), with_error)

    def transmittance(self, wi: Any, *, with_error: bool = False) -> Any:
        return self._noised(np.zeros((len(wi), 3)), with_error)


def alarms(name: str, seeds: range, monkeypatch: pytest.MonkeyPatch, **noise: float) -> int:
    """How many of the seeds make a check fail, at the raised rate."""
    monkeypatch.setattr(chance, "FALSE_ALARM", RATE)
    failed = 0
    for seed in seeds:
        monkeypatch.setattr(chance, "SEED", seed)
        report = checks.CHECKS[name](lambda samples, seed=seed: Noisy(samples, seed, **noise), True)
        failed += not report.passed
    return failed


@pytest.mark.parametrize(
    ("name", "runs"),
    [
        ("energy", 400),
        ("reciprocity", 400),
        ("chi2", 40),
        pytest.param("agreement", 40, marks=pytest.mark.slow),
        pytest.param("chi2", 200, marks=pytest.mark.slow),
    ],
)
def test_as_often_as_said(name: str, runs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = alarms(name, range(runs), monkeypatch)
    assert failed <= stats.binom.isf(UNLIKELY, runs, RATE), f"{failed} of {runs}"
    if runs > 100:  # and the check looks as closely as it says: not one alarm would be a check that sleeps
        assert failed >= stats.binom.ppf(UNLIKELY, runs, RATE / 4), f"{failed} of {runs}"


@pytest.mark.parametrize("name", ["energy", "reciprocity"])
def test_errors_that_are_too_small_are_seen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the true error claimed: alarms are many times too frequent, so the count above can fail."""
    failed = alarms(name, range(100), monkeypatch, claimed=0.5)
    assert failed > stats.binom.isf(UNLIKELY, 100, RATE)


def test_at_the_rate_of_the_checks_themselves_none_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    rate = chance.FALSE_ALARM
    assert rate == 1e-5
    found = 0
    for seed in range(200):
        monkeypatch.setattr(chance, "SEED", seed)
        for name in ("energy", "reciprocity"):
            found += not checks.CHECKS[name](lambda samples, seed=seed: Noisy(samples, seed), True).passed
    assert found <= stats.binom.isf(UNLIKELY, 400, rate)
