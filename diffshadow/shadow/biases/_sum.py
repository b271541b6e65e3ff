"""The sum of several biases."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..._checks import check_not_negative
from ..._misc import as_float, concrete
from ..._types import Scalar
from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms
from ._constant import ConstantBias
from ._normal_offset import NormalOffset
from ._slope import SlopeBias


class Bias(AbstractBias):
    """The sum of constant bias, slope bias, normal offset and a bias that uses the receiver's plane.

    - `constant`, `slope`, `normal_offset`: a number of texels, or a bias module.
    - `terms`: a `LinearBias`, a `PerceptronBias` or none.
    - `plane`: a `ReceiverPlane`, an `AdaptiveBias` or none.
    - `factors`: for a map with layers, such as cascades: a factor for each layer, by which all of these but `plane` are
        multiplied there. Biases are in texels of their own layer with or without it.

    **Raises** `ValueError` if a number is negative or not finite; and when called with `factors` for a map without
    layers.
    """

    constant: AbstractBias
    slope: AbstractBias
    normal_offset: AbstractBias
    plane: AbstractBias | None
    factors: tuple[Scalar, ...] | None
    terms: AbstractBias | None

    def __init__(
        self,
        constant: Any = 0.0,
        slope: Any = 0.0,
        normal_offset: Any = 0.0,
        plane: AbstractBias | None = None,
        factors: Sequence[float | Scalar] | None = None,
        terms: AbstractBias | None = None,
    ):
        self.constant = constant if isinstance(constant, AbstractBias) else ConstantBias(constant)
        self.slope = slope if isinstance(slope, AbstractBias) else SlopeBias(slope)
        self.normal_offset = normal_offset if isinstance(normal_offset, AbstractBias) else NormalOffset(normal_offset)
        self.plane, self.terms = plane, terms
        self.factors = None if factors is None else tuple(as_float(factor) for factor in factors)

    def __check_init__(self):
        for factor in self.factors or ():
            check_not_negative("a factor of the bias", factor, "times the bias")

    @property
    def reach(self) -> float:
        parts = (self.constant, self.slope, self.normal_offset, self.terms)
        moved = sum(part.reach for part in parts if part is not None)
        known = [concrete(factor) for factor in self.factors or ()]
        factor = max((float(np.max(each)) for each in known if each is not None), default=1.0)
        return moved * factor + (0.0 if self.plane is None else self.plane.reach)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        terms = self.constant(receiver) + self.slope(receiver) + self.normal_offset(receiver)
        terms = terms if self.terms is None else terms + self.terms(receiver)
        if self.factors is not None:
            if receiver.layer is None:
                raise ValueError(
                    f"the bias has {len(self.factors)} factors, one for each layer, and the map has no layers; "
                    "expected a map of cascades or of a point light: leave factors out"
                )
            terms = terms.scaled(jnp.stack(self.factors)[receiver.layer])
        return terms if self.plane is None else terms + self.plane(receiver)
