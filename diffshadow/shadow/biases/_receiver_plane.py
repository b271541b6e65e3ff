"""Receiver-plane bias (Isidoro, "Shadow Mapping: GPU-based Tips and Techniques", GDC 2006)."""

import equinox as eqx
import jax.numpy as jnp

from ..._misc import as_float
from ..._types import Scalar
from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms, at_most, check_not_negative, in_depth, optional_float


class ReceiverPlane(AbstractBias):
    """Each tap compares with the depth of the receiver's plane at its own place, so that a filter of any width sees a
    plane as flat.

    The plane is evaluated at the centre of each tap's texel, where the map's depth was taken, and not where the tap
    itself falls: both then mean the same point of the plane, and nothing remains to be covered but rounding, which is
    (`Receiver.rounding`). Implementations that evaluate it at the tap are wrong by up to half a texel and subtract
    `min(Σ texel · |dz/duv|, 0.01)`, the `fudge` and `limit` here, which then is not needed.

    - `fudge`: subtracted besides, in units of `|g_x| + |g_y|` texels, the slopes along the map's axes; 1 is usual
        elsewhere.
    - `limit`: the most that `fudge` may subtract, in texels; none for no limit.
    - `deepening`: how much deeper than the receiver a tap may be compared, in texels; none for as deep as the plane
        goes. The plane of a steep wall runs far below the floor at its foot, which then shadows the wall wherever the
        kernel reaches over it: 0 ends that, and brings no acne, but lights a little where something touches the wall.
        A plane far in front of what is there only lights, as it should. No receiver counts as steeper than 89.4°.

    **Raises** `ValueError` if a number is negative or not finite.
    """

    fudge: Scalar = eqx.field(converter=as_float, default=0.0)
    limit: Scalar | None = eqx.field(converter=optional_float, default=None)
    deepening: Scalar | None = eqx.field(converter=optional_float, default=None)

    def __check_init__(self):
        check_not_negative("the receiver plane's fudge", self.fudge, "times the slope")
        check_not_negative("the receiver plane's limit", self.limit)
        check_not_negative("the receiver plane's deepening", self.deepening)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        fudge = at_most(self.fudge * jnp.sum(jnp.abs(receiver.slope), axis=-1), self.limit)
        deepening = None if self.deepening is None else in_depth(self.deepening, "texels", receiver)
        return BiasTerms(
            in_depth(fudge, "texels", receiver) + receiver.rounding, follows_plane=True, deepening=deepening
        )
