"""Widths, the published recursion against printed numbers, tables against what they were made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conftest import Tool
from lanes import needs_llvm

pytestmark = needs_llvm


def _lane(value: float):
    from drjit.llvm.ad import Float64

    return Float64(value)


def _dielectric(eta: float, alpha: float):
    from urushi.optics.fresnel import fresnel_dielectric
    from urushi.solvers.lobes.published import Layer
    from urushi.solvers.lobes.width import PUBLISHED

    return Layer(
        lambda cos, _: fresnel_dielectric(cos, eta, 1 / eta)[0],
        eta=eta,
        width=lambda scale: PUBLISHED.additive(_lane(alpha) * scale),
    )


def _metal(eta: float, k: float, alpha: float):
    from urushi.optics.fresnel import fresnel_conductor
    from urushi.solvers.lobes.published import Layer
    from urushi.solvers.lobes.width import PUBLISHED

    return Layer(
        lambda cos, _: fresnel_conductor(cos, eta, k),
        width=lambda scale: PUBLISHED.additive(_lane(alpha) * scale),
        opaque=True,
    )


def _numbers(layers: list, cos: float, **options: bool) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and roughnesses of the lobes."""
    from urushi.solvers.lobes.published import add_up
    from urushi.solvers.lobes.width import PUBLISHED

    lobes, _ = add_up(layers, _lane(cos), **options)
    zero = _lane(0)
    return (
        np.array([np.array(energy + zero)[0] for energy, _ in lobes]),
        np.array([np.array(PUBLISHED.roughness(width + zero))[0] for _, width in lobes]),
    )


# Numbers worked out by hand from the equations of Belcour 2018, with Fresnel's reflectance of smooth interfaces.


def test_coat_on_metal() -> None:
    layers = [_dielectric(1.5, 0.1), _metal(0.2 / 1.5, 3 / 1.5, 0.05)]
    energy, alpha = _numbers(layers, 0.8)
    np.testing.assert_allclose(energy, [0.0438947360, 0.8556148135], rtol=1e-9)
    np.testing.assert_allclose(alpha, [0.1, 0.1238763], atol=6e-8)
    _, alpha = _numbers(layers, 0.8, exact=True)
    assert alpha[1] == pytest.approx(0.1366683, abs=6e-8)


def test_forward_scattering_medium() -> None:
    import drjit as dr

    from urushi.solvers.lobes.medium import forward_width
    from urushi.solvers.lobes.published import Layer

    medium = Layer(
        lambda cos, _: 0 * cos,
        transmittance=lambda cos: (1 + 0.2 / cos) * dr.exp(-0.3 / cos),
        scattered=forward_width(_lane(0.9)),
    )
    layers = [_dielectric(1.5, 0.05), medium, _metal(1 / 1.5, 4 / 1.5, 0.1)]
    energy, alpha = _numbers(layers, 0.7)
    np.testing.assert_allclose(energy[[0, 2]], [0.0509169356, 0.5152019409], rtol=1e-9)
    np.testing.assert_allclose(alpha[[0, 2]], [0.05, 0.3286391], atol=6e-8)


def test_three_interfaces_and_both_jacobians() -> None:
    layers = [_dielectric(1.5, 0.05), _dielectric(2 / 1.5, 0.1), _metal(0.1, 1.5, 0.02)]
    energy, alpha = _numbers(layers, 0.9, exact=True)
    np.testing.assert_allclose(energy, [0.0407918879, 0.0188756821, 0.8255903155], rtol=1e-9)
    np.testing.assert_allclose(alpha, [0.05, 0.1627136, 0.1084726], atol=6e-8)
    _, consistent = _numbers(layers, 0.9, exact=True, published=False)
    np.testing.assert_allclose(consistent, [0.05, 0.1627136, 0.1096818], atol=6e-8)


def test_width_and_roughness_are_inverse() -> None:
    from urushi.solvers.lobes.width import OURS, PUBLISHED

    alpha = np.array([0.0, 1e-4, 0.01, 0.1, 0.5, 0.9])
    width = [np.array(PUBLISHED.additive(_lane(a)))[0] for a in alpha]
    np.testing.assert_allclose(width[2:5], [0.0063492, 0.0863, 0.8745], rtol=1e-3)
    for scale in (OURS, PUBLISHED):
        width = [np.array(scale.additive(_lane(a)))[0] for a in alpha]
        np.testing.assert_allclose([np.array(scale.roughness(_lane(w)))[0] for w in width], alpha, atol=1e-9)


@pytest.mark.parametrize(
    "alphas", [(0.05, 0.05), (0.02, 0.1), (0.1, 0.3), (0.3, 0.3), (0.05, 0.05, 0.05), (0.02, 0.05, 0.1, 0.2)]
)
def test_widths_add_as_slopes_do(alphas: tuple[float, ...], rng: np.random.Generator) -> None:
    """The median of the sum of GGX slopes, against the roughness of the sum of their widths."""
    from urushi.solvers.lobes.width import OURS

    count = 200_000
    total = np.zeros((count, 2))
    for alpha in alphas:
        u, phi = rng.random(count), 2 * np.pi * rng.random(count)
        total += (alpha * np.sqrt(u / (1 - u)) * np.array([np.cos(phi), np.sin(phi)])).T
    median = np.median(np.linalg.norm(total, axis=1))  # of one GGX slope it is alpha
    width = sum(np.array(OURS.additive(_lane(alpha)))[0] for alpha in alphas)
    assert np.array(OURS.roughness(_lane(width)))[0] == pytest.approx(median, rel=0.04)


@pytest.mark.parametrize("turn", [0.0, 20.0, 90.0, 130.0])
def test_turning_all_frames_turns_the_lobe(turn: float) -> None:
    from urushi.interfaces.base import Frame
    from urushi.solvers.lobes.width import axes, of_interface, plus

    def lobe(extra: float) -> tuple[float, float, float]:
        widths = [
            of_interface(_lane(x), _lane(y), Frame(_lane(angle + extra)), False)
            for x, y, angle in ((0.1, 0.3, 15.0), (0.2, 0.05, 70.0))
        ]
        x, y, frame = axes(plus(*widths))
        angle = np.degrees(np.arctan2(np.array(frame.sin)[0], np.array(frame.cos)[0]))
        return np.array(x)[0], np.array(y)[0], angle

    x, y, angle = lobe(0.0)
    turned_x, turned_y, turned = lobe(turn)
    assert (turned_x, turned_y) == pytest.approx((x, y), abs=1e-9)
    assert np.sin(np.radians(turned - angle - turn)) == pytest.approx(0, abs=1e-9)
    # The axes are those of neither interface, but each lies between theirs.
    assert x > y and 15.0 < angle % 180 < 160.0


@pytest.mark.parametrize("inside", [False, True])
def test_tables_hold_what_interfaces_do(inside: bool, rng: np.random.Generator) -> None:
    """Between the nodes, too: reflectance and transmittance of dielectrics from either side."""
    from urushi.interfaces.base import Frame
    from urushi.interfaces.dielectric import BoundDielectric
    from urushi.interfaces.energy import directional
    from urushi.optics.microfacet import Microfacets
    from urushi.solvers.lobes import tables

    worst = 0.0
    for alpha, eta in ((0.07, 1.33), (0.25, 1.5), (0.6, 1.9)):
        ratio = 1 / eta if inside else eta
        cos = rng.uniform(0.3, 1.0, 12)
        facets = Microfacets(_lane(alpha), _lane(alpha), "ggx", "correlated")
        truth = directional(BoundDielectric(_lane(ratio), facets, False, Frame(0.0)), cos)
        found = tables.dielectric(
            ("ggx", "correlated"), type(_lane(0))(cos), _lane(ratio), _lane(alpha), None
        )
        for a, b in zip(found, (truth.reflectance, truth.transmittance), strict=True):
            worst = max(worst, float(np.abs(np.array(a) - b).max()))
    assert worst < (0.012 if inside else 0.004)


def test_a_sample_of_the_tables_is_made_anew(tool: Tool) -> None:
    """The generator gives what is shipped, for one index ratio, roughness and side."""
    maker = tool("make_lobe_tables")
    from urushi.solvers.lobes import axes, tables

    side, k, a = 1, 7, 4
    eta = 1 / axes.ratios()[k]
    cos, alpha = axes.cosines(eta), axes.squares(axes.ROUGHNESSES)[a]
    r, t, through, back = maker.directional(
        cos, np.full_like(cos, alpha), np.full_like(cos, eta), ("ggx", "correlated")
    )
    with np.load(Path(tables.__file__).parent / "data" / "ggx_correlated.npz") as file:
        shipped = file["dielectric"][side, k, a, 0] * tables.STEP
    np.testing.assert_allclose(shipped[:, 0], r, atol=2e-3)
    np.testing.assert_allclose(shipped[:, 1], t, atol=2e-3)
    np.testing.assert_allclose(shipped[:, 3], back, atol=4e-3)
    seen = t > 1e-3
    np.testing.assert_allclose(shipped[seen, 2], through[seen], atol=2e-2)


def test_a_sample_of_what_goes_back_and_forth_is_made_anew(tool: Tool) -> None:
    """Round trips, widths and sheets, for one index ratio and few roughnesses."""
    lobe_round_trips, lobe_sheets, lobe_widths = map(tool, ("lobe_round_trips", "lobe_sheets", "lobe_widths"))
    from urushi.solvers.lobes import axes, tables

    data = Path(tables.__file__).parent / "data"
    with np.load(data / "round_trips.npz") as file:
        shipped = file["round_trips"] * tables.STEP
    k, a, w = 4, np.array([4, 6]), np.array([2, 4])  # a node at which widths are counted
    eta = float(axes.ratios()[k])
    alphas, widths = axes.squares(axes.ROUGHNESSES)[a], axes.squares(axes.WIDTHS)[w]
    cos = axes.cosines(eta, axes.ENTRIES)
    made = lobe_round_trips.round_trips(eta, alphas, widths, cos)
    np.testing.assert_allclose(shipped[0, k][np.ix_(a, w)][..., :7], made, atol=2e-3)
    counted = lobe_widths.too_wide(eta, alphas[:1], widths[:1], cos)
    np.testing.assert_allclose(shipped[0, k, a[0], w[0], 8:, 7], counted[0, 0, 8:], rtol=0.15)
    with np.load(data / "sheets.npz") as file:
        shipped = file["sheets"] * tables.STEP
    eta = float(axes.ratios(axes.SHEETS)[5])
    cos = axes.cosines(2.0, axes.SHEET_COSINES)
    np.testing.assert_allclose(shipped[5][np.ix_(w, w)], lobe_sheets.sheet(eta, widths, cos), atol=2e-3)


def test_a_sample_of_what_layers_make_of_diffuse_light_is_made_anew(tool: Tool) -> None:
    lobe_mixing = tool("lobe_mixing")
    from urushi.solvers.lobes import axes, mixing, tables
    from urushi.solvers.lobes.moments import EVEN

    data = Path(tables.__file__).parent / "data"
    with np.load(data / "mixing.npz") as file:
        dielectric, metal = (file[name] * tables.STEP for name in ("dielectric", "metal"))
    eta, alpha = float(axes.ratios()[4]), float(axes.squares(axes.ROUGHNESSES)[5])
    np.testing.assert_allclose(dielectric[0, 4, 5], lobe_mixing.dielectric(eta, alpha), atol=1e-3)
    np.testing.assert_allclose(dielectric[1, 4, 5], lobe_mixing.dielectric(1 / eta, alpha), atol=1e-3)
    np.testing.assert_allclose(metal[5], lobe_mixing.metal(alpha), atol=1e-3)
    with np.load(data / "mixing.npz") as file:
        backs = file["backs"][1, 3, 2, 3] * tables.STEP
    eta = 1 / float(axes.ratios(axes.BACK_INDICES)[3])
    alphas, widths = axes.squares(axes.BACK_ROUGHNESSES)[2:3], axes.squares(axes.BACK_WIDTHS)[3:4]
    cos = axes.cosines(eta, axes.BACK_ENTRIES)
    made = lobe_mixing.back(eta, alphas, widths, cos)
    np.testing.assert_allclose(backs, made[0, 0], atol=1e-3)
    looked_up = mixing.backs(type(_lane(0))(cos), *(_lane(x) for x in (eta, alphas[0], widths[0])))
    np.testing.assert_allclose(np.array(looked_up.parts[1:]).T, made[0, 0], atol=2e-3)
    assert np.abs(made[0, 0] - EVEN[1:]).max() > 0.1  # it is not even light
    g, albedo, depth = 9, 4, 8
    made = lobe_mixing.slabs(range(g, g + 1), range(albedo, albedo + 1))
    with np.load(data / "slabs.npz") as file:
        for name, values in made.items():
            np.testing.assert_allclose(
                file[name][g, albedo, depth] * tables.STEP, values[0, 0, depth], atol=1e-3
            )


def _mixing_of(reflectance: float, transmittance: float):
    """The mixings of a layer that sends even light out evenly, and reflects more of what comes near the horizon."""
    from urushi.solvers.lobes.moments import EVEN, Mixing

    return [
        Mixing([[part * even, slope * even, 0.0, 0.0] for even in EVEN])
        for part, slope in ((reflectance, -0.1), (transmittance, 0.05))
    ]


def test_what_a_layer_loses_is_given_back_as_it_reflects_and_transmits() -> None:
    from urushi.solvers.lobes.moments import EVEN, Moments

    r, t = _mixing_of(0.2, 0.6)
    one, two = r.completed(t)
    for light in (Moments(*EVEN), Moments(1.0, 0.5, 0.1, -0.2)):
        before, after = ([(m * light).parts for m in pair] for pair in ((r, t), (one, two)))
        assert after[0][0] + after[1][0] == pytest.approx(1)
        gained = [a[0] - b[0] for a, b in zip(after, before, strict=True)]
        assert gained[1] == pytest.approx(3 * gained[0])  # 0.6 : 0.2
        np.testing.assert_allclose(after[0], np.array(EVEN) * after[0][0])  # evenly


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("masking", ["correlated", "separable"])
def test_every_kind_of_facets_makes_of_even_light_what_its_own_table_says(
    distribution: str, masking: str
) -> None:
    from urushi.solvers.lobes import mixing, tables
    from urushi.solvers.lobes.moments import EVEN, Moments

    kind, alpha, zero = (distribution, masking), _lane(0.8), _lane(0.0)
    for eta in (1.5, 1 / 1.5):
        mixed = mixing.dielectric(kind, _lane(eta), alpha, False, zero)
        told = tables.dielectric_diffuse(kind, _lane(eta), alpha, zero)
        for found, truth in zip(mixed, told, strict=True):
            assert np.array((found * Moments(*EVEN)).parts[0])[0] == pytest.approx(
                np.array(truth)[0], abs=3e-3
            )


def test_tables_are_small() -> None:
    from urushi.solvers.lobes import tables

    folder = Path(tables.__file__).parent / "data"
    assert 0 < sum(path.stat().st_size for path in folder.glob("*.npz")) < 3_000_000


@pytest.mark.parametrize(("n", "even"), [(1.33, 0.06593), (1.4, 0.07681), (1.5, 0.09178), (2.0, 0.16060)])
def test_even_light_on_smooth_dielectrics(n: float, even: float) -> None:
    """Printed means over the hemisphere; from inside 1 - R_i = (1 - R_e) / n^2."""
    from urushi.solvers.lobes.operators import even_fresnel

    outside, inside = (np.array(even_fresnel(_lane(eta)))[0] for eta in (n, 1 / n))
    assert outside == pytest.approx(even, abs=6e-6)
    assert 1 - inside == pytest.approx((1 - outside) / n**2, rel=1e-12)
