"""Sections of the bias, which keeps surfaces from shadowing themselves."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from ._section import (
    MOST_FACTOR,
    MOST_TEXELS,
    Conflict,
    Fitted,
    Form,
    Section,
    Texels,
    as_list,
    by_type,
    fault,
    given,
    ordered,
    value_at,
)

MOST_LAYERS = 8
"""The most maps of a light: as many cascades, or the six faces of a point light."""
# Beyond it the bias of a cascade is another bias.
_Factor = Annotated[float, Field(ge=0, le=1000)]
_TEXELS = 0.5
"""Default of the constant and the slope bias."""


class NoPlaneConfig(Section):
    """Taps compare against the receiver's depth."""

    type: Literal["none"] = "none"


class ReceiverPlaneConfig(Section):
    """Taps compare against the depth of the receiver's plane at their texel."""

    type: Literal["receiver_plane"] = "receiver_plane"
    fudge: Annotated[float, Fitted()] = Field(
        default=0.0,
        ge=0,
        le=MOST_TEXELS,
        description="additional bias, in units of the sum of the receiver's slopes along x and y",
    )
    limit: Annotated[Texels | None, Fitted()] = Field(
        default=None, ge=0, description="greatest bias that fudge may add, in texels; default: no limit"
    )
    deepening: Annotated[Texels | None, Fitted()] = Field(
        default=None,
        ge=0,
        description="how much deeper than the receiver a tap may compare, in texels; default: no limit",
    )


class AdaptiveBiasConfig(Section):
    """Moves the receiver to the depth of its plane at the texel's centre; for nearest look-ups."""

    type: Literal["adaptive"] = "adaptive"
    epsilon: Annotated[Texels, Fitted()] = Field(default=0.0, ge=0, description="additional bias, in texels")


PlaneConfig = Annotated[
    Annotated[NoPlaneConfig, Tag("none")]
    | Annotated[ReceiverPlaneConfig, Tag("receiver_plane")]
    | Annotated[AdaptiveBiasConfig, Tag("adaptive")],
    by_type("none"),
]


def _weight(feature: str, per: str) -> Any:
    """A weight of a term, by the name of its feature."""
    return Annotated[
        Texels | None,
        Fitted(f"weights.{feature}", needs_value=True),
        Field(ge=-MOST_TEXELS, description=f"bias in texels {per}; default: no such term"),
    ]


class TermsConfig(Section):
    """The weights of a bias that is linear in what a shader knows of a receiver; a sum below 0 counts as 0."""

    one: _weight("one", "everywhere") = None
    slope: _weight("slope", "per unit of the receiver's slope") = None
    sine: _weight("sine", "times the sine of the angle to the light") = None
    one_minus_cosine: _weight("one_minus_cosine", "times 1 - cos of the angle to the light") = None
    texel_size: _weight("texel_size", "per percent of the map's depth range that a texel is wide") = None
    distance: _weight("distance", "times the distance along the light's axis, 0 at near and 1 at far") = None
    blocker_distance: _weight("blocker_distance", "per texel that the map's depth lies in front of the receiver") = None

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return any(getattr(self, key) is not None for key in type(self).model_fields)


_Number = Annotated[float, Field(ge=-MOST_FACTOR, le=MOST_FACTOR)]
_Numbers = Annotated[tuple[_Number, ...], as_list, Form("a list of numbers")]


class LayerConfig(Section):
    """A hidden layer of a network."""

    weight: Annotated[tuple[_Numbers, ...], as_list, Form("a list of lists of numbers")] = Field(
        description="a list of weights for each of the layer's values"
    )
    bias: _Numbers = Field(description="what is added to each of the layer's values")


class NetworkConfig(Section):
    """A perceptron that corrects the terms, and whose inputs are those of the terms but one."""

    hidden: Annotated[tuple[LayerConfig, ...], as_list, Form("a list of layers")] = Field(
        description="hidden layers, each with weight and bias"
    )
    last: _Numbers = Field(description="weights of the last hidden layer's values, in texels")


def _has_terms(bias: Mapping[str, Any]) -> bool:
    """`TermsConfig.given` of a bias that is not validated yet. What is no mapping is reported elsewhere."""
    terms = bias.get("terms")
    return bool(given(terms, *terms) if isinstance(terms, Mapping) else terms)


class BiasConfig(Section):
    """Biases, which move receivers towards the light before the compare."""

    constant: Annotated[Texels, Fitted("constant.value")] = Field(
        default=_TEXELS, ge=0, description="constant bias, in texels; default: 0.5, or 0 with a plane or terms"
    )
    slope: Annotated[Texels, Fitted("slope.value")] = Field(
        default=_TEXELS,
        ge=0,
        description="bias per unit of the receiver's slope, in texels; default: 0.5, or 0 with a plane or terms",
    )
    slope_profile: Literal["tangent", "one_minus_cosine"] = Field(
        default="tangent", description="how the slope bias grows with the angle to the light"
    )
    slope_least: Annotated[Texels | None, Fitted("slope.least")] = Field(
        default=None, ge=0, description="least slope bias, in texels; default: no bound"
    )
    slope_most: Annotated[Texels | None, Fitted("slope.most")] = Field(
        default=None, ge=0, description="greatest slope bias, in texels; default: no bound"
    )
    unit: Literal["texels", "depth"] = Field(
        default="texels", description="unit of the constant and slope bias: texel widths, or window depth from 0 to 1"
    )
    normal_offset: Annotated[Texels, Fitted("normal_offset.value")] = Field(
        default=0.0, ge=0, description="shift along the receiver's normal, in texels"
    )
    normal_offset_profile: Literal["sine", "constant", "one_minus_cosine"] = Field(
        default="sine", description="how the normal offset grows with the angle to the light"
    )
    factors: Annotated[tuple[_Factor, ...] | None, as_list, Form("a list of factors"), Fitted()] = Field(
        default=None,
        min_length=1,
        max_length=MOST_LAYERS,
        description="factors of these biases, one for each map of the light, such as its cascades; default: all 1",
    )
    terms: TermsConfig = Field(
        default_factory=TermsConfig, description="a bias that depends on several things that a shader knows"
    )
    network: NetworkConfig | None = Field(default=None, description="a perceptron that corrects terms; default: none")
    plane: PlaneConfig = Field(default_factory=NoPlaneConfig, description="bias from the receiver's plane")

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        # The defaults are in texels, and a bias from the receiver's plane or of terms needs no other.
        plain = value_at(data, "plane", "type", default="none") == "none" and not _has_terms(data)
        if plain and data.get("unit") != "depth":
            return data
        return {"constant": 0.0, "slope": 0.0, **data}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(cls, data, "slope_least", "slope_most", equal=True)
        if data.get("network") is not None and not _has_terms(data):
            what = fault("is given without terms", "the terms that it corrects", "give terms, such as {slope: 0.5}")
            yield ("network",), what

    def units(self) -> Mapping[str, str]:
        if self.unit == "texels":
            return {}
        return dict.fromkeys(("constant", "slope", "slope_least", "slope_most"), "window depth")
