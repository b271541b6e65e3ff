"""The sum of several biases."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from ..._arithmetic import as_numbers, concrete
from ..._types import Scalar
from ..._words import counted
from ...settings.biases import Bias as Settings
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, joined, number, numbers
from ._abstract import AbstractBias, BiasTerms
from ._constant import ConstantBias
from ._normal_offset import NormalOffset
from ._slope import SlopeBias


class Bias(AbstractBias):
    """The bias of a shadow mapping: the sum of constant bias, slope bias, normal offset and others.

    It is a bias (`AbstractBias`) itself, and adds up its parts: `Bias(constant=1.0, slope=2.0)` is a
    `ConstantBias(1.0)` and a `SlopeBias(2.0)`. A single part, or a bias of your own, can be used instead of the sum.
    In a fit, the names of its numbers are `bias.constant`, `bias.slope` and so on.

    - `constant`, `slope`, `normal_offset`: a number of texels, or a bias module; by default absent. (A configuration
        without a bias uses a rule of thumb: see `bias_for`.)
    - `terms`: a `LinearBias`, a `PerceptronBias` or `None`.
    - `plane`: a `ReceiverPlane`, an `AdaptiveBias` or `None`.
    - `factors`: for a map with layers, such as cascades: a factor for each layer, which multiplies all parts except
        `plane`. With or without factors, biases are in texels of their own layer.

    **Raises** `ValueError` when called with `factors` for a map without layers.

    !!! Example

        ```python
        bias = shadow.Bias(constant=0.5, slope=1.0, normal_offset=0.5)
        bias.slope.value  # 1.0
        ```
    """

    settings: ClassVar = Settings

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
        self.factors = as_numbers(factors)

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
                    f"the bias has {counted(len(self.factors), 'factor')}, one for each layer, and the map has no "
                    "layers; expected a map of cascades or of a point light: leave factors out"
                )
            terms = terms.scaled(jnp.stack(self.factors)[receiver.layer])
        return terms if self.plane is None else terms + self.plane(receiver)

    def shader(self, prefix: str = "") -> ShaderBias:
        each = [self.constant, self.slope, self.normal_offset]
        parts = [part.shader(prefix) for part in each if not _is_zero(part)]
        parts += [] if self.terms is None else [self.terms.shader(f"{prefix}TERMS_")]
        if self.factors is not None:
            name = f"{prefix}FACTORS"
            constant = Constant(name, numbers(jnp.stack(self.factors)), "of the bias in each of the map's layers")
            scaled = lambda terms: tuple(f"SHADOW_{name}[at.layer] * ({term})" for term in terms)
            parts = [part._replace(depths=scaled(part.depths), offsets=scaled(part.offsets)) for part in parts]
            parts.append(ShaderBias(ShaderPart((constant,), "")))
        parts += [] if self.plane is None else [self.plane.shader(f"{prefix}PLANE_")]
        return ShaderBias(
            joined(part.part for part in parts),
            tuple(depth for part in parts for depth in part.depths),
            tuple(offset for part in parts for offset in part.offsets),
            any(part.follows_plane for part in parts),
            next((part.deepest for part in parts if part.deepest is not None), None),
        )


def _is_zero(part: AbstractBias) -> bool:
    least = getattr(part, "least", None)
    return isinstance(part, ConstantBias | SlopeBias | NormalOffset) and number(part.value) == 0 and least is None
