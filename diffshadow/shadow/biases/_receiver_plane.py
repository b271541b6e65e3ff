"""Receiver plane depth bias (Isidoro, "Shadow Mapping: GPU-based Tips and Techniques", GDC 2006)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..._arithmetic import as_number, at_most
from ..._types import AsOptional, AsScalar
from ...settings.biases import ReceiverPlane as Settings
from .._receiver import Receiver
from .._shader import ShaderBias, ShaderPart, constants_of
from ._abstract import AbstractBias, BiasTerms, in_depth, shader_of_length


class ReceiverPlane(AbstractBias):
    """Receiver plane depth bias: each tap compares with the depth of the receiver's plane at the tap, so that a planar
    receiver does not shadow itself under a filter of any width.

    The plane is evaluated at the centre of each tap's texel, where the map sampled its depth. Both depths then belong
    to the same point of the plane, and only rounding remains to be covered (`Receiver.rounding`). Other implementations
    evaluate the plane at the tap itself and are wrong by up to half a texel. They subtract the fractional sampling
    error (Isidoro 2006), `min(Σ texel · |dz/duv|, 0.01)`, which is not needed here but available as `fudge` and
    `limit`.

    - `fudge`: scale of the fractional sampling error, `|g_x| + |g_y|` texels with `g` the depth slopes along the map's
        axes. Other implementations use 1.
    - `limit`: upper bound on the fractional sampling error times `fudge`, in texels; `None` for no bound.
    - `deepening`: upper bound on the plane's depth at a tap relative to the receiver's depth, in texels; `None` for no
        bound. The plane of a steep wall continues far below the floor at its foot, so the floor shadows the wall
        wherever the kernel reaches the floor. 0 prevents this without acne, but leaks some light where another object
        touches the wall. No lower bound is needed, because a plane in front of the actual surface can only add light.
        Slopes are clamped at 89.4°.
    """

    settings: ClassVar = Settings

    fudge: AsScalar = eqx.field(converter=as_number, default=Settings.fudge)
    limit: AsOptional = eqx.field(converter=as_number, default=Settings.limit)
    deepening: AsOptional = eqx.field(converter=as_number, default=Settings.deepening)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        fudge = at_most(self.fudge * jnp.sum(jnp.abs(receiver.slope), axis=-1), self.limit)
        deepening = None if self.deepening is None else in_depth(self.deepening, "texels", receiver)
        return BiasTerms(
            in_depth(fudge, "texels", receiver) + receiver.rounding, follows_plane=True, deepening=deepening
        )

    def shader(self, prefix: str = "") -> ShaderBias:
        constants = constants_of(
            (f"{prefix}FUDGE", self.fudge, "factor of the fractional sampling error"),
            (f"{prefix}FUDGE_LIMIT", self.limit, "its most, in texels"),
            (f"{prefix}DEEPENING", self.deepening, "of the receiver's plane at a tap, in texels"),
        )
        fudge = f"SHADOW_{prefix}FUDGE * (abs(at.slope.x) + abs(at.slope.y))"
        fudge = fudge if self.limit is None else f"min({fudge}, SHADOW_{prefix}FUDGE_LIMIT)"
        deepest = None if self.deepening is None else shader_of_length(f"SHADOW_{prefix}DEEPENING", "texels")
        depths = shader_of_length(fudge, "texels"), "at.rounding"
        return ShaderBias(ShaderPart(constants, ""), depths, follows_plane=True, deepest=deepest)
