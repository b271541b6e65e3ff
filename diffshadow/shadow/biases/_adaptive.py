"""Adaptive bias (Dou, Yan, Kerzner, Dai & Wyman, "Adaptive Depth Bias for Shadow Maps", JCGT 3(4), 2014)."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ..._misc import as_float, dot
from ..._types import Scalar
from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms, check_not_negative, in_depth


class AdaptiveBias(AbstractBias):
    """Just as much as lifts the receiver to its own plane at the centre of the texel it falls into.

    That point of the plane is what the map would hold of it, the only thing that could shadow it falsely. Where it is
    deeper than the receiver, no bias is needed. On a plane with depth slopes `g_x` and `g_y` the bias is
    `(|g_x| + |g_y|) / 2` texels at the most, in the corner of a texel, where a constant bias needs that everywhere.

    It serves one nearest look-up. Wider kernels look into other texels too: they need a `ReceiverPlane`.

    - `epsilon`: added, in texels. That is the paper's adaptive epsilon, a length carried over to window depth where the
        receiver is; its length is a share of the scene's size, here of a texel's. Rounding is taken care of besides
        (`Receiver.rounding`).

    **Raises** `ValueError` if `epsilon` is negative or not finite.
    """

    epsilon: Scalar = eqx.field(converter=as_float, default=0.0)

    def __check_init__(self):
        check_not_negative("the adaptive bias's epsilon", self.epsilon)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        centre = jnp.floor(lax.stop_gradient(receiver.texel)) + 0.5
        # Window depth is linear in the window along a plane, under every light.
        lift = jnp.maximum(dot(receiver.slope, receiver.texel - centre), 0)
        return BiasTerms(in_depth(lift + self.epsilon, "texels", receiver) + receiver.rounding)
