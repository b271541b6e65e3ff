"""The sum of several biases."""

from typing import Any

from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms
from ._constant import ConstantBias
from ._normal_offset import NormalOffset
from ._slope import SlopeBias


class Bias(AbstractBias):
    """The sum of constant bias, slope bias, normal offset and a bias that uses the receiver's plane.

    - `constant`, `slope`, `normal_offset`: a number of texels, or a bias module.
    - `plane`: a `ReceiverPlane`, an `AdaptiveBias` or none.

    **Raises** `ValueError` if a number is negative or not finite.
    """

    constant: AbstractBias
    slope: AbstractBias
    normal_offset: AbstractBias
    plane: AbstractBias | None

    def __init__(
        self, constant: Any = 0.0, slope: Any = 0.0, normal_offset: Any = 0.0, plane: AbstractBias | None = None
    ):
        self.constant = constant if isinstance(constant, AbstractBias) else ConstantBias(constant)
        self.slope = slope if isinstance(slope, AbstractBias) else SlopeBias(slope)
        self.normal_offset = normal_offset if isinstance(normal_offset, AbstractBias) else NormalOffset(normal_offset)
        self.plane = plane

    def __call__(self, receiver: Receiver) -> BiasTerms:
        terms = self.constant(receiver) + self.slope(receiver) + self.normal_offset(receiver)
        return terms if self.plane is None else terms + self.plane(receiver)
