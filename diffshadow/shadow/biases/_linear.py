"""A linear combination of values that a shader knows about the receiver."""

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_float, at_least
from ..._checks import check_value
from ..._types import Scalar
from ...settings.biases import Terms as Settings
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, number
from ._abstract import AbstractBias, BiasTerms, in_depth, shader_of_length
from ._features import FEATURES


class LinearBias(AbstractBias):
    """`max(0, Σ weight · feature)`, in texels along the light's axis.

    The term `one` is a constant bias, and the term `slope` is a slope bias with the profile `"tangent"`.

    - `weights`: a weight for each feature, by the feature's name, in texels per unit of the feature; of any sign.
        Features:
        - `one`: 1;
        - `slope`: the norm of the receiver's depth slope in the map, as in `SlopeBias`;
        - `sine`, `one_minus_cosine`: sin θ and 1 - cos θ, with θ the angle between normal and light;
        - `texel_size`: the width of a texel at the receiver, in percent of the map's depth range;
        - `distance`: the distance along the light's axis, 0 at the map's near plane and 1 at its far plane;
        - `blocker_distance`: the distance of the map's depth in front of the receiver, in texels, from 0 to 16.

    **Raises** `ValueError` if there are no weights, a name is not the name of a feature, or a weight is out of its
    range.

    !!! Example

        ```python
        bias = shadow.Bias(constant=0.5, plane=shadow.LinearBias({"slope": 1.0, "sine": 0.3}))
        ```
    """

    weights: dict[str, Scalar]

    def __init__(self, weights: Mapping[str, float | Scalar]):
        self.weights = {name: as_float(weight) for name, weight in weights.items()}

    def _check_rules(self):
        if not self.weights:
            raise ValueError("the linear bias has no terms; expected one or more")
        for name, weight in self.weights.items():
            if name not in FEATURES:
                raise ValueError(f"the linear bias has a term {name!r}; expected terms among {', '.join(FEATURES)}")
            check_value(f"LinearBias.weights[{name!r}]", weight, Settings.each()[name])

    def total(self, receiver: Receiver) -> Float[Array, "h w"]:
        """The sum of all terms, in texels. It may have any sign."""
        terms = (weight * FEATURES[name].of(receiver) for name, weight in self.weights.items())
        return sum(terms, start=jnp.zeros_like(receiver.cosine))

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return BiasTerms(in_depth(at_least(self.total(receiver), as_float(0)), "texels", receiver))

    def shader(self, prefix: str = "") -> ShaderBias:
        part, total = self.shader_total(prefix)
        return ShaderBias(part, (shader_of_length(f"max({total}, 0.0)", "texels"),))

    def shader_total(self, prefix: str) -> tuple[ShaderPart, str]:
        """The weights, and the expression for `total`."""
        names = [name for name in FEATURES if name in self.weights]
        weight = lambda name: f"{prefix}WEIGHT_OF_{name.upper()}"
        constants = tuple(
            Constant(weight(name), number(self.weights[name]), "of the bias, in texels per unit") for name in names
        )
        total = " + ".join(f"SHADOW_{weight(name)} * ({FEATURES[name].shader})" for name in names)
        return ShaderPart(constants, ""), total
