"""Checks: physical truth as a library. They know only what every BSDF can do.

    energy           nothing gives back more light than it gets
    reciprocity      light could have come the other way
    not negative     there is no less than no light
    finite           no answer is infinite or undefined, anywhere
    normalisation    the density of `sample` integrates to 1: a deterministic integral, so it sees a thousandth
    chi2             samples go where the density says
    agreement        eval, sample, reflectance and transmittance tell of the same light

They run on any BSDF. What knows its layers is checked for what follows from them, too: a stack of smooth interfaces
without absorption must give back all light.

A check is a file beside this one with a function `check(answers, quick) -> Report` and a line in `CHECKS`. It asks
`answers` for the BSDF with as many samples as it needs. All of them share one seed and one rate of false alarms
(`chance`). That a check finds what it is there for is proven by planting a fault for each.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from urushi.solvers import BSDF, SOLVERS, choose, solve
from urushi.stack import Stack

from . import agreement, chi2, energy, finiteness, negativity, normalisation, reciprocity
from .report import Answers, Report

#: name -> check, from the cheap to the expensive
CHECKS: dict[str, Callable[[Answers, bool], Report]] = {
    "energy": energy.check,
    "reciprocity": reciprocity.check,
    "not negative": negativity.check,
    "finite": finiteness.check,
    "normalisation": normalisation.check,
    "chi2": chi2.check,
    "agreement": agreement.check,
}

#: methods whose answers are means of so many samples
SAMPLING = ("walk",)

__all__ = ["CHECKS", "Answers", "Report", "answers_of", "run", "run_on"]


def run(stack: Stack | BSDF, method: str = "walk", quick: bool = True, **options: Any) -> list[Report]:
    """Check a stack as one method solves it, or any BSDF as it is.

    Args:
        stack: the description; or a BSDF, which needs neither method nor options.
        method: as in `urushi.solve`.
        quick: some seconds; else more samples and more directions, and minutes.
        **options: of the method, such as `parameters`; not `samples`, which every check chooses for itself.

    Returns:
        One report for each check, in the order of `CHECKS`.
    """
    return run_on(answers_of(stack, method, **options), quick)


def answers_of(stack: Stack | BSDF, method: str = "walk", **options: Any) -> Answers:
    """What `run_on` takes, of a description (see `run`) or of any BSDF."""
    if isinstance(stack, BSDF):
        bsdf, resampled = stack, getattr(stack, "with_samples", None)
        if resampled is None:
            return lambda samples: bsdf
        # Draws of a plain BSDF are cheap, and wider apart than those of a walk.
        return cache(lambda samples: resampled(2 if samples == 1 else min(16 * samples, 1 << 20)))
    if method == "auto":
        method = choose(stack, SOLVERS, options).method
    described = stack

    @cache
    def answers(samples: int) -> BSDF:
        own = {"samples": samples} if method in SAMPLING else {}
        return solve(described, method, **own, **options)

    return answers


def run_on(
    answers: Answers, quick: bool = True, progress: Callable[[int, int], object] | None = None
) -> list[Report]:
    """Check what `answers` gives.

    Args:
        answers: any function from a number of samples to a BSDF.
        quick: as for `run`.
        progress: called with (done, all) after each check.
    """
    reports = []
    for i, check in enumerate(CHECKS.values()):
        reports.append(check(answers, quick))
        if progress is not None:
            progress(i + 1, len(CHECKS))
    return reports
