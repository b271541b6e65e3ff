"""The interface of biases."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._checks import CheckedModule
from ..._types import VectorMap
from ...settings.biases import BiasUnit
from .._receiver import Receiver
from .._shader import ShaderBias


class BiasTerms(eqx.Module):
    """The changes that a bias makes to a look-up. Terms of several biases can be added.

    - `depth`: (h, w), subtracted from the receiver's window depth.
    - `displacement`: (h, w, 3), added to the receiver's position before projection, in world units; or `None`.
    - `follows_plane`: whether each tap compares with the depth of the receiver plane at its own texel.
    - `deepening`: (h, w), upper bound on the plane's depth relative to the receiver's depth, in window depth; `None`
        for no bound. A sum has the smaller bound.
    """

    depth: Float[Array, "h w"]
    displacement: VectorMap | None = None
    follows_plane: bool = eqx.field(static=True, default=False)
    deepening: Float[Array, "h w"] | None = None

    def __add__(self, other: "BiasTerms") -> "BiasTerms":
        return BiasTerms(
            self.depth + other.depth,
            _either(jnp.add, self.displacement, other.displacement),
            self.follows_plane or other.follows_plane,
            _either(jnp.minimum, self.deepening, other.deepening),
        )

    def scaled(self, factor: Float[Array, "h w"]) -> "BiasTerms":
        """`factor` (h, w) times the bias in depth and the displacement."""
        moved = None if self.displacement is None else factor[..., None] * self.displacement
        return BiasTerms(factor * self.depth, moved, self.follows_plane, self.deepening)


class AbstractBias(CheckedModule):
    """A method that keeps receivers clear of their own depth."""

    @abc.abstractmethod
    def __call__(self, receiver: Receiver) -> BiasTerms:
        """The bias at each receiver."""

    def shader(self, prefix: str = "") -> ShaderBias:
        """The bias in a shader. The names of its constants begin with `prefix`.

        **Raises** `ValueError` if it has no shader.
        """
        raise ValueError(
            f"the bias is of type {type(self).__name__}, which has no shader; expected constant, slope, normal offset, "
            "linear, perceptron, adaptive or receiver plane"
        )

    @property
    def reach(self) -> float:
        """The maximum distance by which the bias moves the look-up, in texels. 0 if unknown, for example inside
        `jit`."""
        return 0.0


def in_depth(bias: Float[Array, "..."], unit: BiasUnit, receiver: Receiver) -> Float[Array, "h w"]:
    """Converts a `bias` along the light's axis to window depth."""
    per_unit = receiver.depth_per_texel if unit == "texels" else jnp.ones_like(receiver.depth_per_texel)
    return bias * per_unit


def shader_of_length(length: str, unit: BiasUnit) -> str:
    """The conversion to window depth in a shader."""
    return f"({length}) * at.depth_per_texel" if unit == "texels" else f"({length})"


def _either(both: Any, a: Array | None, b: Array | None) -> Array | None:
    return (a if b is None else b) if a is None or b is None else both(a, b)
