"""Settings of biases, which keep surfaces from shadowing themselves."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from annotated_types import Len

from ._settings import At, Fitted, Form, Limits, Settings, Unit
from .quantities import MAX_FACTOR, MAX_LAYERS, MAX_TEXELS, Texels

BiasUnit = Literal["texels", "depth"]
"""Unit of a bias along the light's axis: texel widths at the receiver, or window depth."""
SlopeProfile = Literal["tangent", "one_minus_cosine"]
OffsetProfile = Literal["sine", "constant", "one_minus_cosine", "across"]
_UNIT_NAMES = {"texels": "texels", "depth": "window depth"}


class Bias(Settings):
    """Biases, which move receivers towards the light before the compare."""

    constant: Annotated[
        Texels,
        Fitted(),
        At("constant.value"),
        "constant bias, in texels; default: a rule of thumb for the filter, or 0 with terms",
    ] = 0.0
    slope: Annotated[
        Texels,
        Fitted(),
        At("slope.value"),
        "bias per unit of the receiver's slope, in texels; default: a rule of thumb for the filter, or 0 with a plane "
        "or terms",
    ] = 0.0
    slope_profile: Annotated[
        SlopeProfile, At("slope.profile"), "growth of the slope bias with the angle to the light"
    ] = "tangent"
    slope_least: Annotated[
        Texels | None, Fitted(), At("slope.least"), "least slope bias, in texels; default: no bound"
    ] = None
    slope_most: Annotated[
        Texels | None, Fitted(), At("slope.most"), "greatest slope bias, in texels; default: no bound"
    ] = None
    unit: Annotated[
        BiasUnit,
        At("constant.unit", "slope.unit"),
        "unit of the constant and slope bias: texel widths, or window depth from 0 to 1",
    ] = "texels"
    normal_offset: Annotated[
        Texels,
        Fitted(),
        At("normal_offset.value"),
        "shift along the receiver's normal, in texels; default: a rule of thumb for the filter, or 0 with a constant "
        "and a slope, a plane or terms",
    ] = 0.0
    normal_offset_profile: Annotated[
        OffsetProfile, At("normal_offset.profile"), "growth of the normal offset with the angle to the light"
    ] = "sine"
    # A larger factor would make a different bias for the cascade.
    factors: Annotated[
        tuple[Annotated[float, Limits(0, 1000)], ...] | None,
        Len(1, MAX_LAYERS),
        Form(f"a list of 1 to {MAX_LAYERS} factors"),
        Fitted(),
        "factors of these biases, one for each map of the light, such as its cascades; default: all 1",
    ] = None
    ascending = (("slope_least", "slope_most", True),)

    def units(self) -> Mapping[str, str]:
        # A module that is a part of these biases may have no unit, or a wrong one.
        unit = _UNIT_NAMES.get(getattr(self, "unit", "texels"), "texels")
        return dict.fromkeys(("constant", "slope", "slope_least", "slope_most"), unit)


class Plane(Settings):
    """Bias from the receiver's plane."""

    type: Any


class NoPlane(Plane):
    """Taps compare against the receiver's depth."""

    type: Literal["none"] = "none"


class ReceiverPlane(Plane):
    """Taps compare against the depth of the receiver's plane at their texel."""

    type: Literal["receiver_plane"] = "receiver_plane"
    fudge: Annotated[
        float,
        Limits(0, MAX_TEXELS),
        Fitted(),
        "additional bias, in units of the sum of the receiver's slopes along x and y",
    ] = 0.0
    limit: Annotated[Texels | None, Fitted(), "greatest bias that fudge may add, in texels; default: no limit"] = None
    deepening: Annotated[
        Texels | None,
        Fitted(),
        "greatest distance behind the receiver at which a tap may compare, in texels; default: no limit",
    ] = None


class AdaptiveBias(Plane):
    """Moves the receiver to the depth of its plane at the texel's centre. For nearest look-ups."""

    type: Literal["adaptive"] = "adaptive"
    epsilon: Annotated[Texels, Fitted(), "additional bias, in texels"] = 0.0


_Weight = Annotated[float | None, Limits(-MAX_TEXELS, MAX_TEXELS), Unit("texels"), Fitted(needs_value=True)]
Number = Annotated[float, Limits(-MAX_FACTOR, MAX_FACTOR)]
"""A weight of a network."""


class Terms(Settings):
    """The weights of a bias that is linear in values that a shader knows about a receiver. A sum below 0 counts as
    0."""

    one: Annotated[_Weight, "bias in texels everywhere; default: no such term"] = None
    slope: Annotated[_Weight, "bias in texels per unit of the receiver's slope; default: no such term"] = None
    sine: Annotated[_Weight, "bias in texels times the sine of the angle to the light; default: no such term"] = None
    one_minus_cosine: Annotated[
        _Weight, "bias in texels times 1 - cos of the angle to the light; default: no such term"
    ] = None
    texel_size: Annotated[
        _Weight, "bias in texels per percent of the map's depth range that a texel is wide; default: no such term"
    ] = None
    distance: Annotated[
        _Weight,
        "bias in texels times the distance along the light's axis, 0 at near and 1 at far; default: no such term",
    ] = None
    blocker_distance: Annotated[
        _Weight,
        "bias in texels per texel of distance from the map's depth to the receiver behind it; default: no such term",
    ] = None
