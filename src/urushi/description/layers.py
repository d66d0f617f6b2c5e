"""Interfaces and media, as data. A new one is a class here and its name in the registry at the end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from urushi.description.base import Choice, Description, Registered, Rule, shown
from urushi.description.parameter import Covariance, Normal, Parameter, Roughness, Texture, scaled
from urushi.description.phases import PHASES, Isotropic, Phase
from urushi.errors import MaterialError, close

# The fields that every microfacet interface has. -------------------------------------------------------------------

Number = float | Texture
Colour = float | tuple[float, float, float] | Texture

Alpha = Annotated[
    float | tuple[float, float] | Texture,
    Roughness(
        0.0,
        1.0,
        size=2,
        meaning="microfacet roughness itself (not its root): the slope of the facets, along x and y if two",
        source="a smooth interface",
    ),
]
Distribution = Annotated[
    Literal["ggx", "beckmann"],
    Choice("ggx", "beckmann", meaning="distribution of the microfacet normals"),
]
Masking = Annotated[
    Literal["correlated", "separable"],
    Choice("correlated", "separable", meaning="Smith masking-shadowing: height-correlated or separable"),
]
MultipleScattering = Annotated[
    Literal[False, "walk", "compensated"],
    Choice(
        False,
        "walk",
        "compensated",
        meaning="scattering between the facets: none, a random walk on them, or energy compensation",
        hint="say which model",
    ),
]
WalkedOnly = Annotated[
    Literal[False, "walk"],
    Choice(
        False,
        "walk",
        meaning="scattering between the facets: none, or a random walk on them",
        hint="say which model",
    ),
]
NormalVector = Annotated[
    tuple[float, float, float] | Texture | None,
    Normal(-1.0, 1.0, size=3, meaning="shading normal in the tangent frame (none: the surface's own)"),
]
SlopeVariance = Annotated[
    tuple[float, float, float] | Texture | None,
    Covariance(
        -0.5,
        0.5,
        size=3,
        meaning="variance xx, yy and covariance xy of the slopes of a normal map too fine to be seen (none: 0)",
    ),
]
Rotation = Annotated[
    Number,
    Parameter(
        -360.0,
        360.0,
        unit="degree",
        meaning="rotation of the tangent frame about the normal, counter-clockwise seen from above",
        source="the surface's own frame",
        why_one="one rotation serves every colour",
    ),
]


def _walk_on_correlated_heights(values: Mapping[str, Any]) -> None:
    """A walk between facets knows at which height it is, and what it sees from there."""
    if values["multiple_scattering"] == "walk" and values["masking"] == "separable":
        raise MaterialError(
            "found masking 'separable' and multiple_scattering 'walk', which walks on height-correlated facets; "
            "allowed: masking 'correlated', or another multiple_scattering",
            where="masking",
        )


class Layer(Description):
    """Base of everything that may lie in a stack."""

    opaque: ClassVar[bool] = False
    """Nothing passes through: the layer can only be the last one."""

    is_medium: ClassVar[bool] = False
    """It fills the space between two interfaces rather than being one."""

    @classmethod
    def called(cls) -> str:
        """The layer in a sentence: ``a conductor``."""
        return f"a {cls.kind}"


class Dielectric(Layer):
    """An interface between two clear materials, smooth or rough.

    Args:
        ior: absolute index of the material below the interface, 1 (air) to 5.
        alpha: microfacet roughness: 0 (smooth) or 1e-4 to 1, or a pair along x and y.
        distribution: "ggx" or "beckmann".
        masking: "correlated" or "separable" Smith masking-shadowing ("walk" takes "correlated" only).
        multiple_scattering: False, "walk" or "compensated".
        normal: shading normal, a vector in the tangent frame or a normal map (None: the surface's own).
        rotation: rotation of the tangent frame about the normal in degrees.
        slope_variance: (xx, yy, xy) of the slopes of a normal map too fine to be seen, which adds to the roughness.

    Raises:
        MaterialError: a value is not allowed.
    """

    kind = "dielectric"

    ior: Annotated[
        Number,
        Parameter(
            1.0,
            5.0,
            meaning="absolute index of refraction of the material below the interface (air: 1)",
            source="common glass and plastic, about 1.5",
            why_one="one index serves every colour, since each channel would refract into its own direction",
        ),
    ] = 1.5
    alpha: Alpha = 0.0
    distribution: Distribution = "ggx"
    masking: Masking = "correlated"
    multiple_scattering: MultipleScattering = False
    normal: NormalVector = None
    rotation: Rotation = 0.0
    slope_variance: SlopeVariance = None

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """A masking that the walk has."""
        _walk_on_correlated_heights(values)


class _ConductorName(Rule):
    """The name of a conductor in the table of indices."""

    meaning = "name of a conductor whose complex index is tabulated (instead of eta and k)"

    def read(self, value: Any) -> str:
        """The name, as the table spells it."""
        from urushi.optics.ior import conductor_names  # here, so that `import urushi` reads no table

        names = conductor_names()
        if not isinstance(value, str) or value not in names:
            raise self.refuse(value, near=close(value, names) if isinstance(value, str) else "")
        return str(value)

    def allowed(self) -> str:
        """In words."""
        return "the name of a conductor, such as Au, Ag, Al, Cu, Cr or W (urushi.optics.ior.conductor_names lists them)"

    def schema(self) -> dict[str, Any]:
        """Every name in the table."""
        from urushi.optics.ior import conductor_names

        return {"enum": list(conductor_names())}


class Conductor(Layer):
    """A metal: an opaque base, smooth or rough.

    The complex index is ``eta - i k`` (k > 0 absorbs), absolute, given by the name of a metal or by both numbers.

    Args:
        material: name of a metal, such as "Au"; "none" is a perfect mirror.
        eta: real part of the index, 0 to 20, one number or RGB.
        k: imaginary part, 0 to 30, one number or RGB; eta and k cannot both be 0.
        alpha: microfacet roughness: 0 (smooth) or 1e-4 to 1, or a pair along x and y.
        distribution: "ggx" or "beckmann".
        masking: "correlated" or "separable" Smith masking-shadowing ("walk" takes "correlated" only).
        multiple_scattering: False, "walk" or "compensated".
        normal: shading normal, a vector in the tangent frame or a normal map (None: the surface's own).
        rotation: rotation of the tangent frame about the normal in degrees.
        slope_variance: (xx, yy, xy) of the slopes of a normal map too fine to be seen, which adds to the roughness.

    Raises:
        MaterialError: a value is not allowed, or neither or both of ``material`` and ``eta``, ``k`` are given.
    """

    kind = "conductor"
    opaque = True
    alternatives = (("material",), ("eta", "k"))

    material: Annotated[str | None, _ConductorName()] = None
    eta: Annotated[
        Colour | None, Parameter(0.0, 20.0, size=3, meaning="real part of the absolute complex index")
    ] = None
    k: Annotated[
        Colour | None, Parameter(0.0, 30.0, size=3, meaning="imaginary part of the absolute complex index")
    ] = None
    alpha: Alpha = 0.0
    distribution: Distribution = "ggx"
    masking: Masking = "correlated"
    multiple_scattering: MultipleScattering = False
    normal: NormalVector = None
    rotation: Rotation = 0.0
    slope_variance: SlopeVariance = None

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """A material or both numbers, and an index that is not 0; a masking that the walk has."""
        _walk_on_correlated_heights(values)
        named = values["material"] is not None
        given = [name for name in ("eta", "k") if values[name] is not None]
        if named and given:
            raise MaterialError(
                f"found material {values['material']!r} and {' and '.join(given)}; allowed: material, or eta and k",
                where=given[0],
            )
        if not named and len(given) < 2:
            missing = "eta and k are" if not given else "k is" if given == ["eta"] else "eta is"
            raise MaterialError(
                f"{missing} missing; allowed: material (a name such as Au), or both eta and k",
                where="material" if not given else "k" if given == ["eta"] else "eta",
            )
        if not named and any(
            n == 0.0 == k for n, k in zip(_three(values["eta"]), _three(values["k"]), strict=True)
        ):
            raise MaterialError(
                f"found eta {shown(values['eta'])} and k {shown(values['k'])}, both 0 in the same channel; "
                "allowed: an index that is not 0 (a perfect mirror is material 'none')",
                where="eta",
            )


class Diffuse(Layer):
    """A Lambertian base: opaque, scatters equally into all directions; rough, it has facets that do so.

    Args:
        reflectance: fraction of the light that returns (from each facet), 0 to 1, one number or RGB.
        alpha: roughness: 0 (Lambert's surface) or 1e-4 to 1, or a pair along x and y.
        distribution: "ggx" or "beckmann".
        multiple_scattering: False or "walk".
        rotation: rotation of the tangent frame about the normal in degrees.
        normal: shading normal, a vector in the tangent frame or a normal map (None: the surface's own).

    Raises:
        MaterialError: a value is not allowed.
    """

    kind = "diffuse"
    opaque = True

    @classmethod
    def called(cls) -> str:
        """The layer in a sentence."""
        return "a diffuse base"

    reflectance: Annotated[
        Colour,
        Parameter(
            0.0,
            1.0,
            size=3,
            colour=True,
            meaning="fraction of the light that returns",
            source="as in Mitsuba",
        ),
    ] = 0.5
    normal: NormalVector = None
    alpha: Annotated[
        float | tuple[float, float] | Texture,
        Roughness(
            0.0,
            1.0,
            size=2,
            meaning="roughness: the slope of the facets, along x and y if two",
            source="Lambert",
        ),
    ] = 0.0
    distribution: Distribution = "ggx"
    multiple_scattering: WalkedOnly = False
    rotation: Rotation = 0.0


class Medium(Layer):
    """A plane-parallel medium that absorbs and scatters, without any interface of its own.

    Args:
        depth: optical depth (dimensionless): the extinction along the normal is exp(-depth). One number or RGB.
        thickness: geometric thickness in any unit of length, together with ``sigma_t``, instead of ``depth``.
        sigma_t: extinction coefficient per that same unit of length, one number or RGB.
        albedo: single-scattering albedo, 0 (absorbs) to 1 (scatters only), one number or RGB.
        phase: phase function.

    Raises:
        MaterialError: a value is not allowed, or neither or both of ``depth`` and ``thickness``, ``sigma_t`` are given.
    """

    kind = "medium"
    is_medium = True
    alternatives = (("depth",), ("thickness", "sigma_t"))

    depth: Annotated[
        Colour | None, Parameter(0.0, 1e6, size=3, meaning="optical depth, along the normal")
    ] = None
    albedo: Annotated[Colour, Parameter(0.0, 1.0, size=3, colour=True, meaning="single-scattering albedo")]
    phase: Annotated[
        Phase, Registered(PHASES, "phase function", meaning="how the medium scatters into directions")
    ] = Isotropic()
    thickness: Annotated[
        Number | None,
        Parameter(
            1e-12,
            1e9,
            unit="length",
            meaning="geometric thickness, instead of depth",
            why_one="a layer is equally thick for every colour",
        ),
    ] = None
    sigma_t: Annotated[
        Colour | None,
        Parameter(0.0, 1e9, size=3, unit="1/length", meaning="extinction coefficient, with thickness"),
    ] = None

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Depth, or thickness with sigma_t, and a depth that is allowed."""
        given = [name for name in ("thickness", "sigma_t") if values[name] is not None]
        if values["depth"] is not None and given:
            raise MaterialError(
                f"found depth and {' and '.join(given)}; allowed: depth, or thickness and sigma_t",
                where=given[0],
            )
        if values["depth"] is not None:
            return
        if len(given) < 2:
            missing = "depth is" if not given else "sigma_t is" if given == ["thickness"] else "thickness is"
            raise MaterialError(
                f"{missing} missing; allowed: depth, or both thickness and sigma_t", where=missing.split()[0]
            )
        if any(isinstance(values[name], Texture) for name in given):
            return  # what an image holds is for the solver to read
        deepest = cls.rules()["depth"].high  # type: ignore[attr-defined]
        if max(_three(_optical_depth(values["thickness"], values["sigma_t"]))) > deepest:
            raise MaterialError(
                f"found thickness {shown(values['thickness'])} times sigma_t {shown(values['sigma_t'])}; "
                f"allowed: a product (the optical depth) of at most {deepest:g}",
                where="sigma_t",
            )

    @property
    def optical_depth(self) -> Colour:
        """Optical depth: ``depth``, or ``thickness`` times ``sigma_t``.

        Raises:
            MaterialError: the product has no one value: a texture times a colour or times another texture.
        """
        if self.depth is not None:
            return self.depth
        product: Colour | None = _optical_depth(self.thickness, self.sigma_t)
        if product is None:
            raise MaterialError(
                f"found thickness {shown(self.thickness)} and sigma_t {shown(self.sigma_t)}, whose product "
                "is neither a number nor one texture; allowed here: a texture for one of them and one number "
                "for the other",
                where="thickness",
            )
        return product


def _three(value: Any) -> tuple[float, ...]:
    """RGB of a value (a texture, whose values are unknown here, counts as not 0)."""
    if isinstance(value, Texture):
        return (0.5, 0.5, 0.5)
    return value if isinstance(value, tuple) else (value,) * 3


def _optical_depth(thickness: Any, sigma_t: Any) -> Any:
    """The product; None where it is neither numbers nor one texture."""
    if isinstance(thickness, Texture) or isinstance(sigma_t, Texture):
        texture, other = (thickness, sigma_t) if isinstance(thickness, Texture) else (sigma_t, thickness)
        return scaled(texture, other) if isinstance(other, float) else None
    if isinstance(sigma_t, tuple):
        return tuple(thickness * sigma for sigma in sigma_t)
    return thickness * sigma_t


LAYERS: dict[str, type[Description]] = {
    layer.kind: layer for layer in (Dielectric, Conductor, Diffuse, Medium)
}
"""Every interface and medium, by its name in material files."""
