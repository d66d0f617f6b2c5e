"""The accuracy holds at every incidence: where lobes are narrow in azimuth, and next to normal incidence, a node."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees

pytestmark = needs_llvm


@pytest.mark.parametrize(("accuracy", "alpha"), [(5e-2, 0.4), (1e-2, 0.25), (1e-3, 0.25), (3e-3, 0.5)])
def test_metal_under_dye(accuracy: float, alpha: float) -> None:
    """Dye that scatters nothing dims both ways; what is below has a closed form, which the solver does not use here."""
    metal = ur.Conductor(eta=2.137, k=4.713, alpha=alpha)
    dyed = ur.solve(ur.Stack(layers=[ur.Medium(depth=0.02, albedo=0.0), metal]), "adding", accuracy=accuracy)
    bare = ur.solve(ur.Stack(layers=[metal]), "adding", accuracy=accuracy)
    theta, phi = (a.ravel() for a in np.meshgrid(np.linspace(0, 86, 44), 180 + np.linspace(0, 60, 31)))
    wo = degrees(theta, phi)
    for incidence in (0.0, 50.0, 75.0, 80.0, 84.0):
        wi = np.broadcast_to(degrees(incidence), wo.shape)
        truth = bare.eval(wi, wo) * np.exp(-0.02 * (1 / wi[:, 2:] + 1 / wo[:, 2:])) / wo[:, 2:]
        error = np.abs(dyed.eval(wi, wo) / wo[:, 2:] - truth).max() / truth.max()
        assert error < accuracy, (incidence, error)


def test_lobes_next_to_normal_incidence() -> None:
    """Five degrees off, where no node is, they take more nodes than at normal incidence."""
    metal = ur.Conductor(eta=2.375, k=2.366, alpha=0.264)
    stack = ur.Stack(layers=[ur.Dielectric(ior=1.465), ur.Medium(depth=0.055, albedo=0.72), metal])
    found, fine = ur.solve(stack, "adding", accuracy=3e-3), ur.solve(stack, "adding", nodes=60)
    theta, phi = (a.ravel() for a in np.meshgrid(np.linspace(0, 60, 61), np.linspace(0, 180, 31)))
    wo = degrees(theta, phi)
    for incidence in (0.0, 3.0, 5.0, 8.0):
        wi = np.broadcast_to(degrees(incidence), wo.shape)
        truth = fine.eval(wi, wo) / wo[:, 2:]
        assert np.abs(found.eval(wi, wo) / wo[:, 2:] - truth).max() < 3e-3 * truth.max(), incidence
