"""Sections of the bias, which keeps surfaces from shadowing themselves."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from ...settings import Form, biases
from ...settings.biases import Number
from ._section import Conflict, Section, Variants, fault, given

PLANES = Variants(biases.Plane, "none", __name__)
PlaneConfig = Annotated[biases.Plane, PLANES]


class TermsConfig(Section, biases.Terms):
    """The weights of a bias that is linear in what a shader knows of a receiver; a sum below 0 counts as 0."""

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return any(getattr(self, key) is not None for key in type(self).model_fields)


_Numbers = Annotated[tuple[Number, ...], Form("a list of numbers")]


class LayerConfig(Section):
    """A hidden layer of a network."""

    weight: Annotated[
        tuple[_Numbers, ...], Form("a list of lists of numbers"), "a list of weights for each of the layer's values"
    ]
    bias: Annotated[_Numbers, "what is added to each of the layer's values"]


class NetworkConfig(Section):
    """A perceptron that corrects the terms. Its inputs are all features of the terms except `one`."""

    hidden: Annotated[tuple[LayerConfig, ...], Form("a list of layers"), "hidden layers, each with weight and bias"]
    last: Annotated[_Numbers, "weights of the last hidden layer's values, in texels"]


def has_terms(bias: Mapping[str, Any]) -> bool:
    """`TermsConfig.given` of a bias that is not validated yet. What is no mapping is reported elsewhere."""
    terms = bias.get("terms")
    return bool(given(terms, *terms) if isinstance(terms, Mapping) else terms)


class BiasConfig(Section, biases.Bias):
    """Biases, which move receivers towards the light before the compare."""

    terms: TermsConfig = Field(
        default_factory=TermsConfig, description="a bias that depends on several things that a shader knows"
    )
    network: Annotated[NetworkConfig | None, "a perceptron that corrects terms; default: none"] = None
    plane: PlaneConfig = Field(default_factory=PLANES.make, description="bias from the receiver's plane")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        if data.get("network") is not None and not has_terms(data):
            what = fault("is given without terms", "the terms that it corrects", "give terms, such as {slope: 0.5}")
            yield ("network",), what
