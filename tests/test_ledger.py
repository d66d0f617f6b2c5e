"""Where the light goes: ledgers sum to one, agree with closed forms, and with one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import urushi as ur
from lanes import needs_llvm
from outside import degrees
from urushi.solvers.bsdf import BSDF
from urushi.solvers.ledger import Ledger, owners

pytestmark = needs_llvm

METHODS = ("adding", "lobes", "walk")
WI = degrees([0, 30, 65, 80])
COAT = ur.Dielectric(ior=1.5)
#: presets, and how far lobes are off in any entry (measured, rounded up)
PRESETS = {"plastic": 0.005, "enamel-on-gold": 0.004, "milky-glass": 0.001, "wet-stone": 0.01, "skin": 0.001}
SLOW = {
    "frosted-glass": 0.001,
    "car-paint": 0.001,
    "urushi-black": 0.001,
    "dry-stone": 1e-6,
    "thin-slab": 1e-6,
}
BOTH = [*PRESETS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]


def directions(stack: ur.Stack) -> np.ndarray:
    """From above, and from below where light comes through."""
    return WI if stack.layers[-1].opaque else np.concatenate([WI, WI * [1, 1, -1]])


def entries(ledger: Ledger) -> np.ndarray:
    """All that adds up to 1, in rows (2 + 2 L, N, C)."""
    return np.concatenate([ledger.reflected[None], ledger.transmitted[None], ledger.absorbed, ledger.lost])


def ledger(stack: ur.Stack, method: str, wi: np.ndarray) -> tuple[Ledger, np.ndarray]:
    """A ledger, and how far off any of its entries may be."""
    options = {"adding": {"accuracy": 1e-4}, "lobes": {}, "walk": {"samples": 1 << 12}}[method]
    found = ur.solve(stack, method, **options).absorption(wi, with_error=True)
    assert found.error is not None
    return found, 1e-6 + (4.5 * entries(found.error) if method == "walk" else 0)  # type: ignore[arg-type]


def fresnel(cos: np.ndarray, n: float) -> np.ndarray:
    """Reflectance of a smooth dielectric, from the side of index 1 (n < 1: from the denser one)."""
    inner = np.sqrt(np.maximum(1 - (1 - cos**2) / n**2, 0))
    s, p = (cos - n * inner) / (cos + n * inner), (n * cos - inner) / (n * cos + inner)
    return 0.5 * (s**2 + p**2)


def check(found: Ledger, layer: int, expected: np.ndarray, allowed: np.ndarray | float) -> None:
    off = np.abs(found.absorbed[layer, :, 0] - expected)
    limit = allowed if np.ndim(allowed) == 0 else np.asarray(allowed)[2 + layer, :, 0]
    assert (off <= limit).all(), (found.names[layer], off, limit)


# --- closed forms ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_smooth_slab_that_absorbs(method: str) -> None:
    """Between two Fresnel interfaces: T a (1 - R a) ... in closed form, the same from both sides."""
    depth, cos = 0.7, WI[:, 2]
    stack = ur.Stack(layers=[COAT, ur.Medium(depth=depth, albedo=0.0), ur.Dielectric(ior=1.0)])
    r, inner = fresnel(cos, 1.5), np.sqrt(1 - (1 - cos**2) / 1.5**2)
    a = np.exp(-depth / inner)
    absorbed = (1 - r) * (1 - a) / (1 - r * a)
    for wi in (WI, WI * [1, 1, -1]):
        found, allowed = ledger(stack, method, wi)
        check(found, 1, absorbed, allowed)
        left = 1 - found.reflected - found.transmitted
        check(found, 1, left[:, 0], 1e-12 if method != "walk" else allowed)
        assert not found.absorbed[[0, 2]].any() and np.abs(found.lost).max() < 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_two_media_over_a_metal(method: str) -> None:
    """Light goes down and up through both, again and again: a geometric series by hand."""
    upper, lower, cos = 0.2, 0.5, WI[:, 2]
    media = (ur.Medium(depth=upper, albedo=0.0), ur.Medium(depth=lower, albedo=0.0))
    stack = ur.Stack(layers=[COAT, *media, ur.Conductor(eta=0.3, k=3.0)])
    r, inner = fresnel(cos, 1.5), np.sqrt(1 - (1 - cos**2) / 1.5**2)
    a, b = np.exp(-upper / inner), np.exp(-lower / inner)
    n = (0.3 - 3j) / 1.5
    beyond = np.sqrt(n**2 - (1 - inner**2))
    metal = 0.5 * (
        np.abs((inner - beyond) / (inner + beyond)) ** 2
        + np.abs((n**2 * inner - beyond) / (n**2 * inner + beyond)) ** 2
    )
    light = (1 - r) / (1 - r * metal * (a * b) ** 2)
    found, allowed = ledger(stack, method, WI)
    check(found, 1, light * (1 - a) * (1 + a * b**2 * metal), allowed)
    check(found, 2, light * a * (1 - b) * (1 + b * metal), allowed)
    check(found, 3, light * a * b * (1 - metal), allowed)
    assert not found.absorbed[0].any() and np.abs(found.lost).max() < 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_paint_under_a_smooth_coat(method: str) -> None:
    """The base gets (1 - R) / (1 - rho R_i) and absorbs 1 - rho of it, R_i the mean reflectance from inside."""
    rho = np.array([0.9, 0.5, 0.1])
    stack = ur.Stack(layers=[COAT, ur.Diffuse(reflectance=tuple(rho))])
    x, weight = np.polynomial.legendre.leggauss(200)
    outside = 0.5 * (x + 1)
    inside = 1 - (1 - weight @ (fresnel(outside, 1.5) * outside)) / 1.5**2
    found, allowed = ledger(stack, method, WI)
    expected = (1 - fresnel(WI[:, 2], 1.5))[:, None] * (1 - rho) / (1 - rho * inside)
    limit = allowed[3] if method == "walk" else 1e-4
    assert (np.abs(found.absorbed[1] - expected) <= limit).all()
    assert not found.absorbed[0].any() and np.abs(found.lost).max() < 1e-6


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("again", [False, "compensated"])
def test_what_facets_lose_and_what_metal_absorbs(method: str, again: object) -> None:
    """A mirror absorbs nothing, all that is missing is lost; with light given back, nothing is."""
    mirror = ur.Conductor(eta=0.0, k=1.0, alpha=0.5, multiple_scattering=again)
    found, allowed = ledger(ur.Stack(layers=[mirror]), method, WI)
    error = 1e-3 if method != "walk" else allowed + 1e-3
    assert (np.abs(entries(found)[2]) <= (error if np.ndim(error) == 0 else error[2])).all()
    assert (found.lost[0, 0] > 0.1).all() if not again else (np.abs(found.lost) < 1e-12).all()
    gold = ur.Conductor(material="Au", alpha=0.5, multiple_scattering=again)
    metal, allowed = ledger(ur.Stack(layers=[gold]), method, WI)
    assert (metal.absorbed[0, :, 2] > 0.5).all()
    assert (metal.lost <= found.lost + allowed[3:]).all() if method == "walk" else True


@pytest.mark.parametrize(("method", "albedo"), [*((method, 0.4) for method in METHODS), ("adding", 0.0)])
def test_from_below_is_upside_down(method: str, albedo: float) -> None:
    """Light from below a stack does what it does from above the stack upside down, layer by layer."""
    media = [ur.Medium(depth=0.2, albedo=0.0), ur.Medium(depth=0.6, albedo=albedo)]
    stack = ur.Stack(layers=[COAT, *media, ur.Dielectric(ior=1.2)])
    turned = ur.Stack(exterior=1.2, layers=[COAT, *media[::-1], ur.Dielectric(ior=1.0)])
    below, allowed = ledger(stack, method, WI * [1, 1, -1])
    above, more = ledger(turned, method, WI)
    off = np.abs(below.absorbed - above.absorbed[::-1])
    assert (off <= (allowed[2:6] + more[2:6][::-1] if method == "walk" else 1e-6)).all()
    assert (above.absorbed[1] - above.absorbed[2] > 0.05).all()


def test_lobes_know_what_is_lost_of_diffuse_light() -> None:
    """A rough mirror behind a medium that scatters: much of what it loses had lost its direction before."""
    media = ur.Medium(depth=2.0, albedo=1.0)
    stack = ur.Stack(layers=[media, ur.Conductor(eta=0.0, k=1.0, alpha=0.8)])
    exact, lobes = (ledger(stack, method, WI)[0] for method in ("adding", "lobes"))
    assert (exact.lost[1] > 0.1).all() and np.abs(exact.absorbed).max() < 1e-9
    assert np.abs(lobes.lost[1] - exact.lost[1]).max() < 0.03 and np.abs(lobes.absorbed[1]).max() < 1e-3


# --- the sum, and one method against another -------------------------------------------------------------------------


QUICK = ("anodised-aluminium", "frosted-glass", "milky-glass")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in ur.presets()]
)
def test_the_ledger_of_lobes_sums_to_one(name: str) -> None:
    stack = ur.load(f"preset:{name}")
    if any(isinstance(value, ur.Texture) for value in stack.parameters().values()):
        pytest.skip("textures have values in Mitsuba only")
    found = ur.solve(stack, "lobes").absorption(directions(stack))
    assert np.abs(found.total - 1).max() < 1e-12
    assert entries(found).min() > -1e-3


@pytest.mark.parametrize("name", BOTH)
def test_adding_and_the_walk_agree(name: str) -> None:
    """Within the errors of both; adding sums to one exactly, and is where lobes are about."""
    stack = ur.load(f"preset:{name}")
    wi = directions(stack)
    bsdf = ur.solve(stack, "adding", accuracy=3e-3)
    exact = bsdf.absorption(wi)
    assert np.abs(exact.total - 1).max() < 1e-12 and entries(exact).min() > -1e-9
    assert np.abs(exact.reflected - bsdf.reflectance(wi)).max() < 1e-12
    assert np.abs(exact.transmitted - bsdf.transmittance(wi)).max() < 1e-12
    walk = ur.solve(stack, "walk", samples=1 << 12)
    sampled = walk.absorption(wi, with_error=True)
    assert np.array_equal(sampled.reflected, walk.reflectance(wi))
    agree(sampled, exact, bsdf.diagnostics["estimated_error"])
    lobes = ur.solve(stack, "lobes").absorption(wi)
    assert np.abs(entries(lobes) - entries(exact)).max() < (PRESETS | SLOW)[name]


def agree(sampled: Ledger, exact: Ledger, error: float) -> None:
    assert sampled.error is not None
    assert (np.abs(sampled.total - 1) <= 4.5 * sampled.error.total + 1e-5).all()
    allowed = 4.5 * entries(sampled.error) + error + 1e-5  # type: ignore[arg-type]
    off = np.abs(entries(sampled) - entries(exact))
    assert (off <= allowed).all(), (sampled.names, np.argwhere(off > allowed), off.max())


def test_planted_faults_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A share booked on the wrong layer keeps the sum, a flight that is forgotten does not."""
    from urushi.solvers.walk.ledger import Tally

    stack = ur.load("preset:skin")
    exact = ur.solve(stack, "adding", accuracy=1e-2).absorption(WI)
    walk = ur.solve(stack, "walk", samples=1 << 12)
    sampled = walk.absorption(WI, with_error=True)
    agree(sampled, exact, 1e-3)
    wrong = exact.absorbed.copy()
    wrong[[1, 3]] += 0.03 * wrong[1] * np.array([-1, 1])[:, None, None]
    with pytest.raises(AssertionError):
        agree(sampled, replace(exact, absorbed=wrong), 1e-3)
    flown = Tally.flown
    monkeypatch.setattr(
        Tally, "flown", lambda self, s, r, here, *more: flown(self, s, r, here & (s["d"].z < 0), *more)
    )
    with pytest.raises(AssertionError):
        agree(walk.absorption(WI, with_error=True), exact, 1e-3)


# --- where it comes from ---------------------------------------------------------------------------------------------


def test_joined_results_and_files_have_one(tmp_path) -> None:
    """Their descriptions are enough to solve the inside."""
    from urushi.adapters.native import load, save

    coat = ur.Stack(layers=[ur.Dielectric(ior=1.5, alpha=0.3), ur.Medium(depth=0.5, albedo=0.2)])
    base = ur.Stack(exterior=1.5, layers=[ur.Diffuse(reflectance=(0.8, 0.4, 0.1))])
    whole = ur.Stack(layers=[*coat.layers, *base.layers])
    solved = ur.solve(whole, "adding", nodes=12)
    expected = solved.absorption(WI)
    parts = [ur.solve(part, "adding", nodes=12, indices=(1.0, 1.5)) for part in (coat, base)]
    joined = ur.add(*parts).absorption(WI)
    save(solved, tmp_path / "whole.urushi.npz")
    read = load(tmp_path / "whole.urushi.npz").absorption(WI)
    for found in (joined, read):
        assert (
            found.names == expected.names == ("layers[0] dielectric", "layers[1] medium", "layers[2] diffuse")
        )
        assert np.abs(found.total - 1).max() < 1e-12
        assert np.abs(entries(found) - entries(expected)).max() < 1e-3


def test_a_spectrum_has_as_many_columns() -> None:
    depth = np.linspace(0.1, 1.0, 5)
    stack = ur.Stack(layers=[COAT, ur.Medium(depth=0.5, albedo=0.0), ur.Conductor(eta=1.4, k=7.0)])
    found = ur.solve(stack, "adding", parameters={"layer_1.depth": depth}).absorption(WI, with_error=True)
    assert found.absorbed.shape == (3, 4, 5) and found.total.shape == found.error.total.shape == (4, 5)
    one = ur.solve(stack.replace({"layer_1.depth": float(depth[4])}), "adding").absorption(WI)
    assert np.abs(found.absorbed[:, :, 4] - one.absorbed[:, :, 0])[1].max() < 1e-12
    assert np.abs(found.total - 1).max() < 1e-12


@pytest.mark.parametrize("method", ["lobes", "walk"])
def test_parameters_of_every_evaluation(method: str) -> None:
    """As many depths as directions: the deeper, the darker."""
    stack = ur.Stack(layers=[COAT, ur.Medium(depth=0.5, albedo=0.0), ur.Diffuse(reflectance=0.5)])
    depths = np.array([0.0, 0.2, 0.5, 1.0])
    wi = np.repeat(WI[:1], 4, axis=0)
    found = ur.solve(stack, method, parameters={"layer_1.depth": depths}).absorption(wi)
    assert found.absorbed[1, 0, 0] == pytest.approx(0, abs=1e-6)
    assert (np.diff(found.absorbed[1, :, 0]) > 0.05).all()


def test_a_base_that_is_black_in_one_colour() -> None:
    """Its matrices are 0, which no factor can change: the other colours must not suffer."""
    base = ur.Diffuse(reflectance=(0.0, 0.5, 1.0))
    found = ur.solve(ur.Stack(layers=[COAT, base]), "adding", accuracy=1e-2).absorption(WI)
    sent = 1 - fresnel(WI[:, 2], 1.5)
    assert (
        np.abs(found.absorbed[1, :, 0] - sent).max() < 1e-2 and np.abs(found.absorbed[1, :, 2]).max() < 1e-9
    )


def test_media_at_the_ends_and_one_on_another() -> None:
    """Index-matched boundaries belong to no layer."""
    media = [ur.Medium(depth=depth, albedo=0.5) for depth in (0.3, 0.4, 0.5)]
    stack = ur.Stack(layers=[media[0], COAT, *media[1:]])
    assert owners(stack) == ([None, 1, None, None], [None, 0, 2, 3, None])
    for method in METHODS:
        found, _ = ledger(stack, method, WI)
        assert (found.absorbed[[0, 2, 3]] > 0.05).all()
        assert (np.abs(found.total - 1) < (1e-12 if method != "walk" else 0.05)).all()


def test_the_table() -> None:
    stack = ur.load("preset:enamel-on-gold")
    text = str(ur.solve(stack, "lobes").absorption(WI[0]))
    lines = text.splitlines()
    assert lines[0] == "light from (0.000, 0.000, 1.000)" and lines[-1].split() == ["total", *["1.0000"] * 3]
    words = [" ".join(line.split()[:-3]) for line in lines[1:-1]]
    assert words == [
        "reflected",
        "transmitted",
        "layers[0] dielectric absorbed",
        "layers[0] dielectric lost",
        "layers[1] medium absorbed",
        "layers[2] conductor absorbed",
        "layers[2] conductor lost",
    ]
    many = str(ur.solve(stack, "lobes").absorption(np.repeat(WI, 3, axis=0), with_error=True))
    assert many.endswith("... and 4 more directions") and "±" in many


def test_what_has_no_ledger_says_so() -> None:
    metal = ur.Stack(layers=[COAT, ur.Conductor(material="Al", alpha=0.2)])
    with pytest.raises(ur.UrushiError, match="published: found True"):
        ur.solve(metal, "lobes", published=True).absorption(WI)
    with pytest.raises(ur.UrushiError, match="max_depth: found 3"):
        ur.solve(metal, "walk", max_depth=3).absorption(WI)
    with pytest.raises(ur.UrushiError, match="samples: found 1"):
        ur.solve(metal, "walk", samples=1).absorption(WI, with_error=True)
    bsdf = ur.solve(metal, "lobes")
    with pytest.raises(ur.UrushiError, match=r"wi\[1\]: found z = -0.8"):
        bsdf.absorption([[0, 0, 1], [0.6, 0, -0.8]])
    with pytest.raises(ur.UrushiError, match="Array3f"):
        from drjit.llvm.ad import Array3f

        bsdf.absorption(Array3f(0, 0, 1))
    with pytest.raises(ur.UrushiError, match="knows nothing of what is inside"):
        BSDF.absorption(bsdf, WI)
