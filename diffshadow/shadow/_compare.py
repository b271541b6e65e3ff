"""Depth compares, hard or smooth, which test whether a receiver is behind the stored depth."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import as_number
from .._checks import CheckedModule
from .._types import AsScalar
from ..settings import maps
from ..settings.maps import DepthOperator, SoftKernel
from ._shader import Constant, ShaderPart, number, text_of


class AbstractCompare(CheckedModule):
    """Compares stored depth with receiver depth.

    - `has_depth_derivative`: whether the result has a derivative with respect to depth. If it has none, the result
        changes only where `receiver` passes `stored`. Elsewhere, a texel with a silhouette is compared once for all of
        its parts.
    """

    @property
    def has_depth_derivative(self) -> bool:
        return True

    @abc.abstractmethod
    def __call__(
        self, stored: Float[Array, "*n"], receiver: Float[Array, "*n"], depth_per_texel: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """Visibility in [0, 1]: 1 where the receiver is lit.

        **Arguments:**

        - `stored`: window depth in the map.
        - `receiver`: window depth of the receiver, minus its bias.
        - `depth_per_texel`: window depth per texel width at the receiver.
        """

    def shader(self) -> ShaderPart:
        """The function `shadow_compare` of a shader.

        **Raises** `ValueError` if it has no shader.
        """
        raise ValueError(
            f"the compare is of type {type(self).__name__}, which has no shader; expected HardCompare or SoftCompare"
        )


class HardCompare(AbstractCompare):
    """The compare of graphics hardware: 1 if lit, 0 if shadowed. Its gradient is zero everywhere.

    - `operator`: `"less_equal"`, lit where `receiver <= stored`, or `"less"`, lit where `receiver < stored`.

    !!! Example

        ```python
        hard = shadow.HardCompare("less")
        hard(jnp.array([0.5, 0.5]), jnp.array([0.4, 0.5]), jnp.ones(2))  # [1. 0.]
        ```
    """

    settings: ClassVar = maps.HardCompare

    operator: DepthOperator = eqx.field(static=True, default=maps.HardCompare.operator)

    @property
    def has_depth_derivative(self) -> bool:
        return False

    def __call__(self, stored, receiver, depth_per_texel):
        lit = receiver <= stored if self.operator == "less_equal" else receiver < stored
        return lit.astype(stored.dtype)

    def shader(self) -> ShaderPart:
        operator = "<=" if self.operator == "less_equal" else "<"
        return ShaderPart((), _FUNCTION.format(f"shadow_select(0.0, 1.0, receiver {operator} stored)"))


def _exponential(t: Array) -> Array:
    return jnp.exp(jnp.minimum(t, 0))


def _gaussian(t: Array) -> Array:
    return jax.scipy.stats.norm.cdf(jnp.clip(t, -20, 20))


def _linear(t: Array) -> Array:
    return jnp.clip(0.5 * t + 0.5, 0, 1)


def _smoothstep(t: Array) -> Array:
    s = _linear(t)
    return s * s * (3 - 2 * s)


_KERNELS = {
    "logistic": jax.nn.sigmoid,
    "linear": _linear,
    "smoothstep": _smoothstep,
    "gaussian": _gaussian,
    "exponential": _exponential,
}


# The same in a shader.
_IN_SHADER = {
    "logistic": "1.0 / (1.0 + exp(-({t})))",
    "linear": "clamp(0.5 * {t} + 0.5, 0.0, 1.0)",
    "smoothstep": "smoothstep(-1.0, 1.0, {t})",
    "exponential": "exp(min({t}, 0.0))",
    "gaussian": "shadow_normal({t})",
}
_FUNCTION = """// 1 where the receiver is lit, 0 where the stored depth shadows it.
float shadow_compare(float stored, float receiver, float depth_per_texel) {{
    return {};
}}
"""


class SoftCompare(AbstractCompare):
    """A compare that rises smoothly from shadowed to lit, `k((stored - receiver) / width)`.

    - `width`: the compare's width, in texel widths along the light's axis; more than 0. The limit for 0 is the hard
      compare.
    - `kernel`: `"logistic"`, 1 / (1 + exp(-t)); `"gaussian"`, the normal CDF with standard deviation `width`;
        `"linear"` and `"smoothstep"`, ramps from -width to width; `"exponential"`, min(1, exp(t)), as in exponential
        shadow maps (Annen et al. 2008).

    !!! Example

        ```python
        soft = shadow.SoftCompare(0.5)  # texels; visibility then has a derivative by the bias
        soft(jnp.array([0.5]), jnp.array([0.5]), jnp.ones(1))  # [0.5]
        ```
    """

    settings: ClassVar = maps.SoftCompare

    width: AsScalar = eqx.field(converter=as_number, default=maps.SoftCompare.width)
    kernel: SoftKernel = eqx.field(static=True, default=maps.SoftCompare.kernel)

    def __call__(self, stored, receiver, depth_per_texel):
        return _KERNELS[self.kernel]((stored - receiver) * (1 / (self.width * depth_per_texel)))

    def shader(self) -> ShaderPart:
        width = Constant("COMPARE_WIDTH", number(self.width), "of the soft compare, in texels along the light's axis")
        step = _IN_SHADER[self.kernel].format(t="(stored - receiver) / (SHADOW_COMPARE_WIDTH * depth_per_texel)")
        helper = text_of("_normal.glsl") + "\n" if self.kernel == "gaussian" else ""
        return ShaderPart((width,), helper + _FUNCTION.format(step))
