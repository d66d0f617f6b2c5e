"""The walk against other programs and other methods: path-traced geometry, discrete ordinates, adding-doubling,
pbrt, and a repaired Guo 2018 (tests/data/README.md names programs and versions)."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import Tally, cases, degrees, stack
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
        if isinstance(case["layers"], str):
            gold = ur.Conductor(
                eta=(0.143, 0.375, 1.442), k=(3.983, 2.386, 1.603), alpha=0.2, masking="separable"
            )
            layers = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.1, masking="separable"), gold])
        else:
            layers = stack(case["layers"])
        theta_i, theta_o, phi = np.array([value["triple"] for value in case["values"]]).T
        truth, error = (np.array([value[key] for value in case["values"]]) for key in ("f_cos", "stderr"))
        found, found_error = solve(layers).eval(degrees(theta_i), degrees(theta_o, phi), with_error=True)
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
    slab = ur.Stack(
        layers=[ur.Medium(depth=case["tau"], albedo=case["omega"], phase=ur.HenyeyGreenstein(g=case["g"]))]
    )
    bsdf = solve(slab, 1 << 15)
    mu0 = case["mu0"]
    wi = np.array([[np.sqrt(1 - mu0**2), 0.0, mu0]])
    # What the table calls azimuth 0 goes on the way it came, on the other side of the normal from wi.
    mus, phis = (
        grid.ravel() for grid in np.meshgrid(case["mus"], np.array(case["phis"]) + np.pi, indexing="ij")
    )
    for sign, table in ((1, "brdf"), (-1, "btdf")):
        sin = np.sqrt(1 - mus**2)
        wo = np.stack([sin * np.cos(phis), sin * np.sin(phis), sign * mus], axis=1)
        found, error = bsdf.eval(wi, wo, with_error=True)
        truth = np.ravel(case[table])
        tally.add(table, found[:, 0] / mus, error[:, 0] / mus, truth, 0, rounding=3e-4)
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
