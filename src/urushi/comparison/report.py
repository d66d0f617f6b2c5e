"""What a comparison found: numbers, and the ways to show them."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from urushi.errors import UrushiError


@dataclass(frozen=True)
class Flux:
    """Reflectance or transmittance of one colour for one angle: C values, and the uncertainty of each."""

    view: str
    value: list[float]
    error: list[float]


@dataclass(frozen=True)
class Error:
    """How far one answer is from the reference, relative to the peak of f |cos| for the same incident light.

    Attributes:
        rms, largest: over all directions and colours; None where the stack has delta parts only.
        rms_uncertainty, largest_uncertainty: what of that the reference, and the noise of the answer, may account for.
        beyond: the part of the rms that they do not account for.
        where: incident and outgoing direction of the largest, in words; `wi` and `wo` are the same in numbers.
        by_view: rms for each incident direction, by its name.
        misplaced: share of the light that leaves elsewhere: half of the integral of |error| over that of the
            reference, at the angle where it is largest; `misplaced_uncertainty` is what noise may account for. None
            for the walk.
        reflectance, transmittance: the largest absolute errors of the fluxes, over angles and colours.
        flux_uncertainty: of those, at most.
    """

    rms: float | None
    rms_uncertainty: float | None
    beyond: float | None
    largest: float | None
    largest_uncertainty: float | None
    where: str
    wi: list[float]
    wo: list[float]
    by_view: dict[str, float]
    misplaced: float | None
    misplaced_uncertainty: float | None
    reflectance: float
    transmittance: float
    flux_uncertainty: float


@dataclass(frozen=True)
class Row:
    """What was found out about one method or contender.

    Attributes:
        name: of the method, or the contender.
        kind: "method" or "contender".
        said: settings, or what a contender was made from.
        error: against the reference; None where it cannot do the stack.
        reflectance, transmittance: for each view.
        build: seconds to solve; None for a contender.
        eval_ns, sample_ns: wall time of one evaluation and one sample, in nanoseconds.
        walk_noise: the walk's noise (rms, relative to the peak) in the time that one evaluation of this takes.
        match: samples after which the walk's noise is as small as this answer's error; None where it has none.
        render_noise: relative noise of the reflectance after a millisecond of `sample` for light at 30 degrees.
        bytes: on disk, beside the program.
        cannot: what it cannot do, sentences; those of this very stack first.
    """

    name: str
    kind: str
    said: str
    error: Error | None
    reflectance: list[Flux] = field(default_factory=list)
    transmittance: list[Flux] = field(default_factory=list)
    build: float | None = None
    eval_ns: float | None = None
    sample_ns: float | None = None
    walk_noise: float | None = None
    match: float | None = None
    render_noise: float | None = None
    bytes: int | None = None
    cannot: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """The outcome of `compare` for one stack.

    Attributes:
        name, description: of the stack.
        layers: what it consists of, in words.
        reference: what was taken for the truth, in words; `reference_method` is "adding" or "walk".
        uncertainty: of the reference, rms relative to the peak.
        reflectance, transmittance: of the reference.
        rows: the methods in the order they were asked for, then the contenders.
        verdict: which to take, and why.
        auto: what `method="auto"` takes, and why.
        machine: where the times were measured.
        seconds: that the comparison took.
    """

    name: str
    description: str
    layers: str
    reference: str
    reference_method: str
    uncertainty: float | None
    reflectance: list[Flux]
    transmittance: list[Flux]
    rows: list[Row]
    verdict: str
    auto: str
    machine: str
    seconds: float
    figures: dict[str, str] = field(default_factory=dict, repr=False)

    def row(self, name: str) -> Row:
        """What was found out about one method or contender.

        Raises:
            UrushiError: there is none of that name.
        """
        for row in self.rows:
            if row.name == name:
                return row
        raise UrushiError(f"found {name!r}; allowed: {', '.join(row.name for row in self.rows)}")

    def as_dict(self) -> dict[str, Any]:
        """All numbers, as JSON has them; the figures are not among them."""
        found = asdict(self)
        found.pop("figures")
        return found

    def html(self) -> str:
        """One page that needs nothing else."""
        from .page import page

        return page([self])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the report: `.json` or `.html`."""
        save([self], path)

    def __str__(self) -> str:
        from .words import text

        return text(self)

    def _repr_html_(self) -> str:
        from .page import fragment

        return fragment(self)


def save(reports: list[Report], path: str | os.PathLike[str]) -> None:
    """Write several reports into one file, whole or not at all: `.json` or `.html`.

    Raises:
        UrushiError: another ending, or a place that cannot be written to.
    """
    from urushi.io import replace

    path = Path(path)
    ending = path.suffix.lower()
    if ending not in (".json", ".html"):
        raise UrushiError(f"path: found {str(path)!r}; allowed: a name ending in .json or .html")
    if ending == ".json":
        content = as_json(reports)
    else:
        from .page import page

        content = page(reports)
    try:
        replace(path, content.encode())
    except OSError as error:
        raise UrushiError(f"{path} cannot be written: {error.strerror or error}") from None


def as_json(reports: list[Report]) -> str:
    """All numbers of several reports."""
    from urushi import __version__

    found = {"urushi": __version__, "reports": [report.as_dict() for report in reports]}
    return json.dumps(found, indent=1, allow_nan=False)
