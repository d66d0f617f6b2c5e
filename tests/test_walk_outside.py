"""The walk against other programs and other methods: path-traced geometry, discrete ordinates, adding-doubling,
pbrt, and a repaired Guo 2018 (tests/data/README.md names programs and versions)."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import Tally, cases, degrees, disort, guo, stack
from quadrature import gauss
from urushi.solvers import BSDF

pytestmark = needs_llvm

SAMPLES = 1 << 16


def solve(layers: ur.Stack, samples: int = SAMPLES) -> BSDF:
    return ur.solve(layers, "walk", samples=samples)


def test_geometry() -> None:
    """Mitsuba's volumetric path tracer on plane interfaces one unit apart: unlimited depth, no layer model at all."""
    tally = Tally()
    for case in cases("geometry"):
        bsdf = solve(stack(case["layers"], case["name"]))
        if case.get("reflectance"):
            theta, truth, error = np.array(case["reflectance"]).T
            found, found_error = bsdf.reflectance(degrees(theta), with_error=True)
            tally.add(case["name"] + ", reflectance", found[:, 0], found_error[:, 0], truth, error)
        view, light, phi, truth, error = np.array(case["f_cos"]).T
        found, found_error = bsdf.eval(degrees(view), degrees(light, phi), with_error=True)
        tally.add(case["name"], found[:, 0], found_error[:, 0], truth, error)
    assert len(tally.z) > 70
    tally.settle()


def test_guo() -> None:
    """Case a is a closed form (quadrature to 1e-6); b and c are Guo's walk, repaired, in double precision."""
    tally = Tally()
    for case in cases("guo"):
        layers, wi, wo, truth, error = guo(case)
        found, found_error = solve(layers).eval(wi, wo, with_error=True)
        # One channel stands for three where nothing is coloured; a colour's channels share their paths.
        tally.add("guo " + case["name"], found[:, :1], found_error[:, :1], truth[:, :1], error[:, :1])
        tally.add("guo " + case["name"], found[:, 1:], found_error[:, 1:], truth[:, 1:], error[:, 1:])
    tally.settle(independent=1 / 3)


def test_pbrt() -> None:
    """pbrt-v4's layered BxDF with its weights corrected: correlated masking, f without cosine."""
    tally = Tally()
    for case in cases("pbrt"):
        bsdf = solve(stack(case["layers"]))
        theta_i, theta_o, phi, truth, error = np.array(case["f"]).T
        wo = degrees(theta_o, phi)
        found, found_error = bsdf.eval(degrees(theta_i), wo, with_error=True)
        tally.add("pbrt " + case["name"], found[:, 0] / wo[:, 2], found_error[:, 0] / wo[:, 2], truth, error)
        theta, truth, error = np.array(case["reflectance"]).T
        found, found_error = bsdf.reflectance(degrees(theta), with_error=True)
        tally.add("pbrt reflectance " + case["name"], found[:, 0], found_error[:, 0], truth, error)
    tally.settle()


@pytest.mark.parametrize(
    "case", cases("slab_disort"), ids=lambda case: f"{case['tau']} {case['g']} {case['mu0']}"
)
def test_discrete_ordinates(case: dict) -> None:
    """DISORT: R, T and every angle of Henyey-Greenstein slabs without boundaries (64 streams: good to about 1e-4)."""
    tally = Tally()
    slab, wi, tables = disort(case)
    bsdf = solve(slab, 1 << 15)
    for table, wo in tables.items():
        found, error = (x[:, 0] / np.abs(wo[:, 2]) for x in bsdf.eval(wi, wo, with_error=True))
        tally.add(table, found, error, np.ravel(case[table]), 0, rounding=3e-4)
    for flux, key in ((bsdf.reflectance, "R"), (bsdf.transmittance, "T")):
        found, error = flux(wi, with_error=True)
        tally.add(key, found[:, 0], error[:, 0], case[key], 0, rounding=2e-4)
    tally.settle()


def test_slabs_with_smooth_boundaries() -> None:
    """Adding-doubling with Fresnel boundaries (good to 1e-4), at normal and at diffuse incidence."""
    tally = Tally()
    mu2, weight = gauss(24, 0, 1)  # diffuse incidence: integral of R over 2 mu dmu = d(mu^2)
    mu = np.sqrt(mu2)
    wi = np.concatenate([[[0.0, 0, 1]], np.stack([np.sqrt(1 - mu2), 0 * mu, mu], axis=1)])
    for case in cases("slab_glass"):
        medium = ur.Medium(depth=case["depth"], albedo=case["albedo"], phase=ur.HenyeyGreenstein(g=case["g"]))
        bsdf = solve(ur.Stack(layers=[ur.Dielectric(ior=case["ior"]), medium, ur.Dielectric(ior=1.0)]))
        for flux, name in ((bsdf.reflectance, "R"), (bsdf.transmittance, "T")):
            found, error = (x[:, 0] for x in flux(wi, with_error=True))
            tally.add(f"{name} normal", found[0], error[0], case[f"{name}_normal"], 1e-4)
            diffuse = weight @ found[1:], np.sqrt(weight**2 @ error[1:] ** 2)
            tally.add(f"{name} diffuse", *diffuse, case[f"{name}_hemispherical"], 2e-4)
    tally.settle()
