"""Random valid descriptions over the whole allowed range, drawn from the same rules that validate them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

import urushi as ur
from urushi.description.base import Description
from urushi.description.graded import Heights, Profile
from urushi.description.parameter import Covariance, Normal, Parameter, Roughness
from urushi.description.phases import Curve
from urushi.optics.ior import conductor_names
from urushi.stack import LAYERS, PHASES

# The same examples on every machine, and no failure because a machine is slow.
settings.register_profile("urushi", derandomize=True, deadline=None)
settings.load_profile("urushi")

IMAGE = Path(ur.__file__).parent / "materials" / "textures" / "wood-albedo.png"


def numbers(rule: Parameter) -> st.SearchStrategy[float]:
    """One number within the bounds of a parameter, the bounds themselves included."""
    if isinstance(rule, Roughness):
        return st.just(0.0) | st.floats(rule.smallest, rule.high)
    return st.sampled_from([rule.low, rule.high]) | st.floats(rule.low, rule.high)


def textures(rule: Parameter) -> st.SearchStrategy[ur.Texture]:
    """A texture in place of a parameter; its file exists."""
    scales = st.floats(0.0 if rule.low >= 0 else -1e6, 1e6)
    return st.builds(ur.Texture, file=st.just(IMAGE), scale=scales, raw=st.sampled_from([None, False, True]))


def values(rule: Parameter | Curve, textured: bool) -> st.SearchStrategy[Any]:
    """Every form that a parameter may have."""
    if isinstance(rule, Curve):
        return st.lists(st.floats(0, 1e12), min_size=2, max_size=9).filter(lambda found: max(found) >= 1e-12)
    forms: st.SearchStrategy[Any] = numbers(rule)
    if isinstance(rule, Normal):
        sideways = st.floats(-1, 1)
        forms = st.tuples(sideways, sideways, st.floats(rule.lowest, 1))
    elif isinstance(rule, Covariance):
        deviation = st.floats(0, 0.7)
        forms = st.tuples(deviation, deviation, st.floats(-1, 1)).map(
            lambda s: (s[0] * s[0], s[1] * s[1], s[0] * s[1] * s[2])
        )
    elif isinstance(rule, Roughness):
        rough = st.floats(rule.smallest, rule.high)
        forms |= st.tuples(rough, rough) | st.just((0.0, 0.0))
    elif rule.size:
        forms |= st.tuples(*[numbers(rule)] * rule.size)
    return forms | textures(rule) if textured and rule.texture else forms


def phases(textured: bool = False) -> st.SearchStrategy[Description]:
    """Any registered phase function."""
    return st.one_of(
        *[
            st.builds(piece, **{name: values(rule, textured) for name, rule in piece.rules().items()})
            for piece in PHASES.values()
        ]
    )


@st.composite
def layers(draw: st.DrawFn, kind: str, textured: bool = False) -> Description:
    """A layer of a registered kind; about half of its optional fields are given."""
    piece = LAYERS[kind]
    rules = piece.rules()
    chosen = set(draw(st.sampled_from(piece.alternatives))) if piece.alternatives else set()
    excluded = {name for names in piece.alternatives for name in names} - chosen
    given: dict[str, Any] = {}
    for name, rule in rules.items():
        needed = name in chosen or piece.model_fields[name].is_required()
        if name in excluded or not (needed or draw(st.booleans())):
            continue
        if name == "phase":
            given[name] = draw(phases(textured))
        elif name == "material":
            given[name] = draw(st.sampled_from(conductor_names()))
        elif isinstance(rule, Parameter):
            given[name] = draw(values(rule, textured))
        elif isinstance(rule, Profile | Heights):
            pass
        else:
            given[name] = draw(st.sampled_from(rule.choices))  # type: ignore[attr-defined]
    if kind == "graded":
        given |= draw(graded(given.get("phase", ur.Isotropic())))
    if "eta" in given and _zero(given["eta"]) and _zero(given["k"]):
        given["k"] = 1.0
    if "thickness" in given and not isinstance(given["thickness"], ur.Texture):
        # Times the largest sigma_t, this is the deepest depth allowed.
        given["thickness"] = min(given["thickness"], 1e-3)
    if given.get("multiple_scattering") == "walk" and "masking" in given:
        given["masking"] = "correlated"
    return piece(**given)


@st.composite
def graded(draw: st.DrawFn, phase: Description) -> dict[str, Any]:
    """What a graded medium has of each height: albedos, phase functions or both, at equal steps or not."""
    count = draw(st.integers(2, 6))
    which = draw(st.sampled_from(["albedo", "phase", "both"]))
    found: dict[str, Any] = {"albedo": draw(st.floats(0, 1)), "phase": phase}
    if which != "phase":
        found["albedo"] = draw(st.lists(st.floats(0, 1), min_size=count, max_size=count))
    if which != "albedo":
        found["phase"] = draw(st.lists(phases(), min_size=count, max_size=count))
    if draw(st.booleans()):
        steps = draw(st.lists(st.floats(1e-3, 1), min_size=count - 1, max_size=count - 1))
        heights = [sum(steps[:k]) / sum(steps) for k in range(count)]
        found["at"] = [*heights[:-1], 1.0]
    return found


def _zero(value: Any) -> bool:
    return not isinstance(value, ur.Texture) and 0.0 in (value if isinstance(value, tuple) else (value,))


@st.composite
def stacks(
    draw: st.DrawFn, opaque: bool | None = None, textured: bool = False, most: int = 6, text: bool = False
) -> ur.Stack:
    """A valid stack.

    Args:
        opaque: True for an opaque base, False for none, None for either.
        textured: textures may stand in place of parameters.
        most: largest number of layers.
        text: any name and description, rather than none.
    """
    bases = [kind for kind, piece in LAYERS.items() if piece.opaque]
    clear = [kind for kind, piece in LAYERS.items() if not piece.opaque]
    with_base = draw(st.booleans()) if opaque is None else opaque
    kinds = draw(st.lists(st.sampled_from(clear), min_size=0 if with_base else 1, max_size=most - with_base))
    kinds += [draw(st.sampled_from(bases))] if with_base else []
    given: dict[str, Any] = {"layers": [draw(layers(kind, textured)) for kind in kinds]}
    if draw(st.booleans()):
        given["exterior"] = draw(numbers(ur.Stack.rules()["exterior"]))  # type: ignore[arg-type]
    if text:
        letters = st.characters(exclude_categories=["Cs"])
        one_line = st.text(letters, max_size=30).map(lambda name: " ".join(name.splitlines()))
        given |= {"name": draw(one_line), "description": draw(st.text(letters, max_size=60))}
    return ur.Stack(**given)
