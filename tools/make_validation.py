"""Compare every method with numbers from outside, and keep what was found: docs/data/validation.json.

    python tools/make_validation.py                 all of it, about ten minutes on two cores
    python tools/make_validation.py --only pbrt     one source again (or "presets")

Truth is what tests/data holds, of other programs and of path-traced geometry; `tests/data/README.md` names them. For
each source and method the file has how many values were compared, and by how much they differ: of reflectances and
transmittances absolutely, of the BSDF relative to the largest value of its case at the same angle of incidence. Of the
walk there are deviations in standard errors, too, whose root mean square is 1 if nothing but chance is at work.
The tables of docs/validation.md are made from it by tools/make_docs.py.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

import outside  # noqa: E402
import run as benchmarks  # noqa: E402
import urushi as ur  # noqa: E402
from outside import cases, degrees, stack  # noqa: E402
from quadrature import gauss  # noqa: E402

FILE = ROOT / "docs" / "data" / "validation.json"
SAMPLES = 1 << 14
METHODS: dict[str, dict[str, Any]] = {
    "walk": {"samples": SAMPLES},
    "adding": {"accuracy": 1e-3},
    "lobes": {},
}


class Question(NamedTuple):
    """One thing that a source knows of a case.

    Attributes:
        ask: solved stack -> (values, standard errors).
        truth, error: the same of the source.
        scale: what differences are divided by: 1, or the peak of the BSDF.
    """

    ask: Callable[[Any], tuple[Any, Any]]
    truth: Any
    error: Any
    scale: Any = 1.0


def along(mu: Any) -> np.ndarray:
    """Directions of these cosines at azimuth 0."""
    mu = np.atleast_1d(np.asarray(mu, float))
    return np.stack([np.sqrt(1 - mu**2), 0 * mu, mu], axis=1)


def flux(wi: np.ndarray, truth: Any, error: Any = 0.0, name: str = "reflectance") -> Question:
    """A reflectance or a transmittance; the first channel stands for all."""

    def ask(bsdf: Any) -> tuple[Any, Any]:
        return tuple(x[:, 0] for x in getattr(bsdf, name)(wi, with_error=True))  # type: ignore[return-value]

    return Question(ask, truth, error)


def density(wi: np.ndarray, wo: np.ndarray, truth: Any, error: Any = 0.0, cosine: bool = False) -> Question:
    """The BSDF, by the peak of all values at the same incidence; `cosine`: the truth lacks |cos theta_o|."""
    scale = np.abs(wo[:, 2]) if cosine else np.ones(len(wo))
    truth = np.asarray(truth, float)
    columns = truth.shape[1] if truth.ndim > 1 else 1
    wi, _ = np.broadcast_arrays(wi, wo)
    _, group = np.unique(np.round(wi[:, 2], 6), return_inverse=True)
    size = np.abs(truth.reshape(len(wo), -1)).max(1)
    peak = np.array([size[group == g].max() for g in range(group.max() + 1)])[group]

    def ask(bsdf: Any) -> tuple[Any, Any]:
        value, spread = (x[:, :columns] / scale[:, None] for x in bsdf.eval(wi, wo, with_error=True))
        return value.reshape(truth.shape), spread.reshape(truth.shape)

    return Question(ask, truth, error, peak.reshape(-1, *[1] * (truth.ndim - 1)))


Case = tuple[str, ur.Stack, dict[str, Question]]


def geometry() -> Iterator[Case]:
    """Real surfaces one unit apart, path traced."""
    for case in cases("geometry"):
        view, light, phi, truth, error = np.array(case["f_cos"]).T
        questions = {"f": density(degrees(view), degrees(light, phi), truth, error)}
        if case.get("reflectance"):
            theta, truth, error = np.array(case["reflectance"]).T
            questions["R, T"] = flux(degrees(theta), truth, error)
        yield case["name"], stack(case["layers"], case["name"]), questions


def slab_disort() -> Iterator[Case]:
    """Slabs without boundaries, by discrete ordinates."""
    for case in cases("slab_disort"):
        slab, wi, tables = outside.disort(case)
        name = f"depth {case['tau']}, g {case['g']}, cosine {case['mu0']}"
        for table, key, fluxes in (("brdf", "R", "reflectance"), ("btdf", "T", "transmittance")):
            yield (
                f"{name}, {table}",
                slab,
                {
                    "f": density(wi, tables[table], np.ravel(case[table]), cosine=True),
                    "R, T": flux(wi, [case[key]], name=fluxes),
                },
            )


def slab_glass() -> Iterator[Case]:
    """Slabs between smooth boundaries, by another adding-doubling: at normal and at diffuse incidence."""
    mu2, weight = gauss(24, 0, 1)
    wi = np.concatenate([along(1.0), along(np.sqrt(mu2))])
    for case in cases("slab_glass"):
        medium = ur.Medium(depth=case["depth"], albedo=case["albedo"], phase=ur.HenyeyGreenstein(g=case["g"]))
        layers = ur.Stack(layers=[ur.Dielectric(ior=case["ior"]), medium, ur.Dielectric(ior=1.0)])
        for name, fluxes in (("R", "reflectance"), ("T", "transmittance")):

            def ask(bsdf: Any, fluxes: str = fluxes) -> tuple[Any, Any]:
                value, error = (x[:, 0] for x in getattr(bsdf, fluxes)(wi, with_error=True))
                diffuse = weight @ value[1:], np.sqrt(weight**2 @ error[1:] ** 2)
                return np.array([value[0], diffuse[0]]), np.array([error[0], diffuse[1]])

            truth = [case[f"{name}_normal"], case[f"{name}_hemispherical"]]
            yield (
                f"index {case['ior']}, depth {case['depth']}, {name}",
                layers,
                {"R, T": Question(ask, truth, 1e-4)},
            )


def guo() -> Iterator[Case]:
    """A closed form, and the walk of Guo et al. 2018, repaired."""
    for case in cases("guo"):
        layers, wi, wo, truth, error = outside.guo(case)
        # The channels of a walk share their paths: one of them is compared.
        yield case["name"], layers, {"f": density(wi, wo, truth[:, 0], error[:, 0])}


def pbrt() -> Iterator[Case]:
    """pbrt-v4's layered BxDF, its weights corrected."""
    for case in cases("pbrt"):
        theta_i, theta_o, phi, truth, error = np.array(case["f"]).T
        questions = {"f": density(degrees(theta_i), degrees(theta_o, phi), truth, error, cosine=True)}
        theta, truth, error = np.array(case["reflectance"]).T
        questions["R, T"] = flux(degrees(theta), truth, error)
        yield case["name"], stack(case["layers"]), questions


def layerlab() -> Iterator[Case]:
    """layerlab (Jakob et al. 2014), two faults repaired.

    Its own errors: 4e-4 of albedos above a cosine of 0.15, and 1e-3 of the peak.
    """
    from test_adding_outside import layerlab_stack

    for case in cases("layerlab"):
        mu = np.array(case["mu"])
        known = mu >= 0.15
        truth = np.array(case["f"])
        grids = np.array(case["f_mu_i"])[:, None, None], np.array(case["f_mu_o"])[:, None], case["f_phi"]
        mu_i, mu_o, phi = (grid.ravel() for grid in np.broadcast_arrays(*grids))
        sin = np.sqrt(1 - mu_o**2)
        wo = np.stack([-sin * np.cos(phi), sin * np.sin(phi), mu_o], axis=-1)
        values = density(along(mu_i), wo, truth.ravel(), cosine=True)
        yield (
            case["name"],
            layerlab_stack(case),
            {
                "f": values._replace(error=1e-3 * values.scale),
                "R, T": flux(along(mu[known]), np.array(case["R"])[known], 4e-4),
            },
        )


SOURCES: dict[str, tuple[str, Callable[[], Iterator[Case]]]] = {
    "geometry": ("Mitsuba's path tracer, on real surfaces and media", geometry),
    "slab_disort": ("DISORT: discrete ordinates, slabs", slab_disort),
    "slab_glass": ("iadpython: adding-doubling, slabs with smooth boundaries", slab_glass),
    "layerlab": ("layerlab, rough coats and media", layerlab),
    "guo": ("a closed form; Guo et al. 2018, repaired", guo),
    "pbrt": ("pbrt-v4, weights corrected", pbrt),
}


def compare(source: Callable[[], Iterator[Case]]) -> dict[str, Any]:
    """Method -> what of the source was compared, and how far off it is."""
    found: dict[str, dict[str, Any]] = {}
    for name, layers, questions in source():
        for method, options in METHODS.items():
            mine = found.setdefault(method, {"cases": 0, "values": {}, "cannot": 0})
            try:
                bsdf = ur.solve(layers, method, **options)
            except ur.UnsupportedStack as error:
                mine["cannot"] += 1
                print(name, method, error)
                continue
            mine["cases"] += 1
            for quantity, question in questions.items():
                value, spread = (np.asarray(x, float) for x in question.ask(bsdf))
                away = value - np.asarray(question.truth, float)
                entry = mine["values"].setdefault(
                    quantity, {"count": 0, "largest": 0.0, "known": 0.0, "z": []}
                )
                entry["count"] += away.size
                relative = float(np.max(np.abs(away / question.scale)))
                known = float(np.max(np.abs(question.error / question.scale)))
                entry["known"] = max(entry["known"], known)
                if relative > entry["largest"]:
                    entry.update(largest=relative, where=name)
                if method == "walk":
                    # what the printed digits of a source and its own discretisation leave
                    size = np.hypot(
                        np.hypot(spread, question.error), 2e-4 * np.abs(np.asarray(question.truth))
                    )
                    entry["z"] += list(np.ravel(away / np.maximum(size, 1e-12)))
    for mine in found.values():
        for entry in mine["values"].values():
            z = np.array(entry.pop("z"))
            if z.size:
                entry["rms"], entry["worst"] = float(np.sqrt(np.mean(z**2))), float(np.abs(z).max())
    return found


def presets() -> dict[str, Any]:
    """By preset, the largest difference of the reflectance of walk and lobes from adding's at 0 to 75 degrees."""
    wi, rows = degrees([0, 30, 45, 60, 75]), {}
    for name in ur.presets():
        layers = ur.load(f"preset:{name}")
        try:
            truth = ur.solve(layers, "adding").reflectance(wi)
        except ur.UnsupportedStack as error:
            rows[name] = {"cannot": f"adding: {error.reasons[0]}"}
            continue
        value, spread = ur.solve(layers, "walk", samples=SAMPLES).reflectance(wi, with_error=True)
        rows[name] = {
            "walk": float(np.abs(value - truth).max()),
            "sigma": float(spread.max()),
            "worst": float((np.abs(value - truth) / np.hypot(spread, 5e-4)).max()),
        }
        try:
            rows[name]["lobes"] = float(np.abs(ur.solve(layers, "lobes").reflectance(wi) - truth).max())
        except ur.UnsupportedStack as error:
            rows[name]["cannot"] = f"lobes: {error.reasons[0]}"
        print(name, rows[name], flush=True)
    return rows


def main(arguments: list[str] | None = None) -> None:
    """Measure, and keep."""
    parser = argparse.ArgumentParser(description="Compare every method with numbers from outside.")
    parser.add_argument("--only", choices=[*SOURCES, "presets"], action="append", help="this one again")
    only = parser.parse_args(arguments).only or [*SOURCES, "presets"]
    kept = json.loads(FILE.read_text("utf-8")) if FILE.exists() else {"sources": {}}
    for name in only:
        if name == "presets":
            kept["presets"] = presets()
        else:
            about, source = SOURCES[name]
            kept["sources"][name] = {"about": about, "methods": compare(source)}
            print(name, json.dumps(kept["sources"][name], indent=1), flush=True)
        kept["sources"] = {one: kept["sources"][one] for one in SOURCES if one in kept["sources"]}
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        kept["machine"] = benchmarks.machine()
        FILE.parent.mkdir(exist_ok=True)
        FILE.write_text(json.dumps(kept, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
