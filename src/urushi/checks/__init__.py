"""Checks: physical truth as a library. They run on any solved stack, and know only what every BSDF can do.

    energy           nothing gives back more light than it gets
    reciprocity      light could have come the other way
    finite           no answer is negative, infinite or undefined, anywhere
    normalisation    the density of `sample` integrates to 1: a deterministic integral, so it sees a thousandth
    chi2             samples go where the density says
    agreement        eval, sample, reflectance and transmittance tell of the same light

A check is a file beside this one with a function `check(answers, quick) -> Report` and a line in `CHECKS`. It asks
`answers` for the stack solved with as many samples as it needs. All of them share one seed and one rate of false alarms
(`chance`). That a check finds what it is there for is proven by planting a fault for each.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from urushi.solvers import BSDF, solve
from urushi.stack import Stack

from . import agreement, chi2, energy, finiteness, normalisation, reciprocity
from .report import Answers, Report

#: name -> check, from the cheap to the expensive
CHECKS: dict[str, Callable[[Answers, bool], Report]] = {
    "energy": energy.check,
    "reciprocity": reciprocity.check,
    "finite": finiteness.check,
    "normalisation": normalisation.check,
    "chi2": chi2.check,
    "agreement": agreement.check,
}

#: methods whose answers are means of so many samples
SAMPLING = ("walk",)

__all__ = ["CHECKS", "Answers", "Report", "run", "run_on"]


def run(stack: Stack, method: str = "walk", quick: bool = True, **options: Any) -> list[Report]:
    """Check a stack as one method solves it.

    Args:
        stack: the description.
        method: as in `urushi.solve`.
        quick: some seconds; else more samples and more directions, and minutes.
        **options: of the method, such as `parameters`; not `samples`, which every check chooses for itself.

    Returns:
        One report for each check, in the order of `CHECKS`.
    """

    @cache
    def answers(samples: int) -> BSDF:
        own = {"samples": samples} if method in SAMPLING else {}
        return solve(stack, method, **own, **options)

    return run_on(answers, quick)


def run_on(answers: Answers, quick: bool = True) -> list[Report]:
    """Check what `answers` gives: any function from a number of samples to a BSDF."""
    return [check(answers, quick) for check in CHECKS.values()]
