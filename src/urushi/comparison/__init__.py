"""Comparing: several methods, and any other BSDF, on one very stack, against the truth.

    report = ur.compare("preset:enamel-on-gold", methods=("adding", "lobes", "walk"), contenders=["principled"])
    print(report)
    report.save("report.html")

The reference is adding to a finer accuracy than asked of the method, or, where adding cannot, a long walk; what it does
not know itself is carried along as the uncertainty of every error.

    questions    the directions that are asked        reference   what is taken for the truth, and its uncertainty
    contenders   BSDFs that are no method             clock       times, in turn and warm
    errors       how far off, and how noisy           verdict     which to take, and why
    measure      all of it together                   report      what was found
    words        numbers as people read them          page, svg, figures   the same as a page that needs nothing else
"""

from __future__ import annotations

from .measure import compare
from .report import Report

__all__ = ["Report", "compare"]
