"""Adaptive bias (Dou, Yan, Kerzner, Dai & Wyman, "Adaptive Depth Bias for Shadow Maps", JCGT 3(4), 2014)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ..._arithmetic import as_number, dot
from ..._types import AsScalar
from ...settings.biases import AdaptiveBias as Settings
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, number, text_of
from ._abstract import AbstractBias, BiasTerms, in_depth


class AdaptiveBias(AbstractBias):
    """The smallest bias that moves the receiver to the depth of its own plane at the centre of its texel.

    The map stores the plane's depth at that point, and only this depth can shadow the receiver falsely. If it is deeper
    than the receiver, no bias is needed. On a plane with depth slopes `g_x` and `g_y`, the bias is at most `(|g_x| +
    |g_y|) / 2` texels, in the corners of a texel. A constant bias needs this maximum everywhere.

    Use it with a single nearest look-up. Wider kernels also read other texels, and need a `ReceiverPlane`.

    - `epsilon`: an additional bias in texels. It is the paper's adaptive epsilon, a length that is converted to window
      depth at the receiver. The paper's unit is the scene's size. Here the unit is a texel. Rounding is covered
      separately (`Receiver.rounding`).
    """

    settings: ClassVar = Settings

    epsilon: AsScalar = eqx.field(converter=as_number, default=Settings.epsilon)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        centre = jnp.floor(lax.stop_gradient(receiver.texel)) + 0.5
        # Window depth is linear in the window over a plane, for every light.
        lift = jnp.maximum(dot(receiver.slope, receiver.texel - centre), 0)
        return BiasTerms(in_depth(lift + self.epsilon, "texels", receiver) + receiver.rounding)

    def shader(self, prefix: str = "") -> ShaderBias:
        epsilon = Constant("EPSILON", number(self.epsilon), "added to the adaptive bias, in texels")
        part = ShaderPart((epsilon,), text_of("biases/_adaptive.glsl"))
        return ShaderBias(part, ("shadow_adaptive_bias(at)",))
