"""Which method to take, in a sentence or two, with the numbers that decide it."""

from __future__ import annotations

from .report import Row
from .words import nanoseconds, percent, seconds, size, walks

#: an error that hardly anybody sees, relative to the peak or to all the light
UNSEEN = 0.03
#: share of the light in the wrong place that nobody overlooks
WRONG = 0.25
#: times the cost of adding at which the walk is no longer what a path tracer wants
DEAR = 4.0


def verdict(rows: list[Row]) -> str:
    """The verdict on what was compared: methods and contenders."""
    by = {row.name: row for row in rows if row.kind == "method"}
    able = {name: row for name, row in by.items() if row.error is not None}
    said = []
    adding, lobes, walk = (able.get(name) for name in ("adding", "lobes", "walk"))
    if adding is not None:
        said.append(_adding(adding, walk))
    elif "adding" in by:
        said.append(f"Adding is out: {by['adding'].cannot[0]}.")
    if walk is not None:
        said.append(_walk(walk, adding))
    elif "walk" in by:
        said.append(f"The walk is out: {by['walk'].cannot[0]}.")
    if lobes is not None:
        said.append(_lobes(lobes, walk is not None))
    elif "lobes" in by:
        said.append(f"Lobes are out: {by['lobes'].cannot[0]}.")
    said += [_contender(row, lobes) for row in rows if row.kind == "contender" and row.error is not None]
    return " ".join(said)


def _adding(row: Row, walk: Row | None) -> str:
    text = f"Take adding for exact values and tables: {_off(row)}, without noise"
    if row.build is not None and row.eval_ns is not None:
        text += f", solved once in {seconds(row.build)}, then {nanoseconds(row.eval_ns)} an evaluation"
    if row.bytes is not None:
        text += f" from {size(row.bytes)}"
    if row.walk_noise is not None and walk is not None:
        text += f"; the walk has {percent(row.walk_noise)} of noise after as long"
    return text + "."


def _walk(row: Row, adding: Row | None) -> str:
    cost = f" {nanoseconds(row.eval_ns)} a sample" if row.eval_ns is not None else ""
    if row.eval_ns and adding is not None and adding.eval_ns and row.eval_ns > DEAR * adding.eval_ns:
        return (
            f"The walk is dear here,{cost}, {row.eval_ns / adding.eval_ns:.0f} × an evaluation by adding: take it "
            "where there are textures or derivatives, without bias."
        )
    if adding is None:
        return f"Take the walk: it is the one without bias that can do this stack,{cost}."
    return (
        f"Take the walk in a path tracer, for textures and for derivatives: no bias, nothing to solve,{cost}."
    )


def _lobes(row: Row, walked: bool) -> str:
    text = f"Lobes are {_off(row)} and {nanoseconds(row.eval_ns or 0.0)} an evaluation"
    error = row.error
    if error is not None and max(error.rms or 0.0, error.misplaced or 0.0, error.reflectance) <= UNSEEN:
        text += ": good enough for a game and for looking around"
    elif error is not None and (error.misplaced or 0.0) > WRONG:
        text += ": not for this stack"
    else:
        text += ": for a game or a preview, not where the look must be right"
    if error is not None and error.largest is not None:
        text += f" (at most {percent(error.largest)} off, {error.where})"
    if row.match is not None and walked:
        count = (
            "a single walk has less noise"
            if row.match < 1
            else f"{walks(row.match)} walks have as much noise"
        )
        text += f"; {count} {'than' if row.match < 1 else 'as'} that error"
    return text + "."


def _contender(row: Row, lobes: Row | None) -> str:
    text = f"{row.name} is {_off(row)}"
    if lobes is not None and lobes.error is not None and row.error is not None:
        mine, theirs = row.error.misplaced, lobes.error.misplaced
        if mine is not None and theirs is not None and theirs > 0:
            text += f": {mine / theirs:.2g} × that of lobes"
    return text + "."


def _off(row: Row) -> str:
    error = row.error
    if error is None or error.rms is None:
        least = error.reflectance if error is not None else 0.0
        return f"off by {least:.2g} in reflectance (all light leaves in single directions)"
    if error.beyond is not None and error.beyond <= (error.rms_uncertainty or 0.0):
        return f"as near as the reference can tell ({percent(error.rms)} of the peak, rms)"
    text = f"off by {percent(error.rms)} of the peak (rms)"
    if error.misplaced is None or error.misplaced <= 2 * (error.misplaced_uncertainty or 0.0):
        return text
    return f"{text}, with {percent(error.misplaced)} of the light in the wrong place"
