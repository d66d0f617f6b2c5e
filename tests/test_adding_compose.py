"""A solved coat on a solved base is the whole stack solved at once."""

from __future__ import annotations

import numpy as np
import pytest

import urushi as ur
from urushi import add as put_on
from urushi.errors import UrushiError

MILK = ur.Medium(depth=0.5, albedo=[0.95, 0.6, 0.2], phase=ur.HenyeyGreenstein(g=0.4))
GREY = ur.Medium(depth=0.3, albedo=0.8)
WHITE = ur.Diffuse(reflectance=0.7)
#: layers of a coat and of a base, and the index between them
PAIRS = {
    "rough on medium": ([ur.Dielectric(ior=1.5, alpha=0.4)], [MILK, WHITE], 1.5),
    "smooth on medium": ([ur.Dielectric(ior=1.5)], [MILK, WHITE], 1.5),
    "coat with medium": ([ur.Dielectric(ior=1.5), GREY], [ur.Conductor(material="Au", alpha=0.4)], 1.5),
    "medium on medium": ([ur.Dielectric(ior=1.5), GREY], [MILK, WHITE], 1.5),
    "pane": ([ur.Dielectric(ior=1.5), GREY], [ur.Dielectric(ior=1.0)], 1.5),
    "pane the other way": ([ur.Dielectric(ior=1.5)], [GREY, ur.Dielectric(ior=1.2)], 1.5),
    "rough pane": ([ur.Dielectric(ior=1.3, alpha=0.5), GREY], [MILK, ur.Dielectric(ior=1.0, alpha=0.5)], 1.3),
    "bare": ([GREY], [MILK], 1.0),
}


def solved(layers, exterior, indices, nodes=12):
    return ur.solve(ur.Stack(layers=layers, exterior=exterior), "adding", nodes=nodes, indices=indices)


def apart(one, other):
    """The largest difference of any order of any part."""
    sides = [(True, True), (True, False), (False, True), (False, False)]
    if (True, False) not in other.solution.parts:
        sides = sides[:1]
    orders = range(max(one.matrices.orders, other.matrices.orders))
    return max(
        np.abs(one.matrices.operator(k, *s) - other.matrices.operator(k, *s)).max()
        for k in orders
        for s in sides
    )


@pytest.mark.parametrize("name", PAIRS)
def test_on_the_same_nodes_it_is_the_whole_solved_at_once(name, rng):
    coat, base, between = PAIRS[name]
    indices = sorted({1.0, 1.2, between} if "other" in name else {1.0, between})
    one, other = solved(coat, 1.0, indices), solved(base, between, indices)
    both, whole = put_on(one, other), solved([*coat, *base], 1.0, indices)
    assert both.stack == whole.stack
    assert both.diagnostics["interpolation_error"] == 0
    assert both.solution.closed_form == whole.solution.closed_form
    # The layers end their series in azimuth where too little is left, each by its own measure.
    assert apart(both, whole) < 2e-4
    w = rng.normal(size=(2, 300, 3))
    turn = np.arange(300) % 4  # from above and below, to either side
    w[..., 2] = np.abs(w[..., 2]) * np.where([turn < 2, turn % 2 == 0], 1, -1)
    wi, wo = w / np.linalg.norm(w, axis=2, keepdims=True)
    value, found = whole.eval(wi, wo), both.eval(wi, wo)
    for side in range(4):
        here = turn == side
        assert np.abs(found[here] - value[here]).max() <= 1e-3 * value[here].max(), side
    assert np.abs(both.reflectance(wi) - whole.reflectance(wi)).max() < 1e-4


def test_other_nodes_are_interpolated_and_the_error_told():
    coat, base, between = PAIRS["rough on medium"]
    whole = solved([*coat, *base], 1.0, [1.0, 1.5], nodes=30)
    one, other = solved(coat, 1.0, [1.0], nodes=24), solved(base, between, [1.5], nodes=20)
    both = put_on(one, other)
    told = both.diagnostics["interpolation_error"]
    assert 0 < told < 1e-3
    known = [solution.diagnostics["estimated_error"] for solution in (one, other)]
    assert both.diagnostics["estimated_error"] == pytest.approx(sum(known) + told)
    w = np.array([[np.sin(t), 0, np.cos(t)] for t in np.radians([0, 20, 45, 60, 75])])
    assert np.abs(both.reflectance(w) - whole.reflectance(w)).max() < both.diagnostics["estimated_error"]
    assert np.abs(both.reflectance(w) - whole.reflectance(w)).max() < 1e-3


def test_what_does_not_fit_is_refused():
    coat, base, between = PAIRS["rough on medium"]
    one, other = solved(coat, 1.0, [1.0]), solved(base, between, [1.5])
    with pytest.raises(UrushiError, match="opaque"):
        put_on(other, other)
    with pytest.raises(UrushiError, match=r"index 1\.5 on a base whose exterior is 1\.3"):
        put_on(one, solved(base, 1.3, [1.3]))
    with pytest.raises(UrushiError, match="BSDF"):
        put_on(ur.solve(ur.Stack(layers=coat), "walk"), other)
    with pytest.raises(UrushiError, match="solved with indices"):
        put_on(one, solved(base, between, ()))
    with pytest.raises(UrushiError, match="indices"):
        solved(coat, 1.0, (0.5,))
