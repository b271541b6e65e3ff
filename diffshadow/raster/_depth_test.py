"""How a depth buffer stores and compares depths, as OpenGL defines it."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import check_value
from ..settings import maps
from ..settings.maps import DepthFormat, DepthOperator

_STEPS = {"unorm24": (1 << 24) - 1, "unorm16": (1 << 16) - 1}


class DepthTest(NamedTuple):
    """The format and the comparison of a depth buffer. The buffer is cleared to depth 1, and fragments must also pass
    the comparison with this value.

    - `format`: `"float32"`, or `"unorm24"` or `"unorm16"`, which round to the nearest step (ties to even).
    - `compare`: `"less"`, which keeps the first of several equal depths, or `"less_equal"`, which keeps the last.

    `rasterize` **raises** `ValueError` for any other value.
    """

    format: DepthFormat = maps.ShadowMap.depth_format
    compare: DepthOperator = "less"

    def check(self) -> None:
        """**Raises** `ValueError` if a field has an unknown value."""
        check_value("the depth test's format", self.format, DepthFormat)
        check_value("the depth test's compare", self.compare, DepthOperator)

    def encode(self, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The buffer's value for window `depth`: the depth itself, or the number of steps, which is exact in
        float32."""
        return depth if self.format == "float32" else jnp.round(depth * _STEPS[self.format])

    def decode(self, stored: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Window depth as read from the buffer: the float depth, or the integer depth divided by its maximum.

        The quotient is rounded correctly, so `encode(decode(u)) == u` for every step `u`.
        """
        if self.format == "float32":
            return stored
        steps = _STEPS[self.format]
        # XLA compiles division by a constant as multiplication by its inverse, which misses the nearest float for half
        # of the steps. But u / n = u / (n + 1) + u / (n (n + 1)). The first term is exact, because n + 1 is a power of
        # two. The second is so small that only the sum is rounded.
        return stored * (1 / (steps + 1)) + stored * (1 / (steps * (steps + 1)))

    def passes_empty(self, stored: Float[Array, "*n"]) -> Array:
        """Whether the value `stored` passes the comparison against an empty buffer."""
        empty = self.encode(jnp.ones((), stored.dtype))
        return stored < empty if self.compare == "less" else stored <= empty

    def resolution_at(self, greatest: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The unit of polygon offset in window depth, for a triangle with the maximum depth `greatest`.

        OpenGL defines it as the smallest difference that the buffer is guaranteed to resolve. That is two steps of a
        fixed-point buffer, as in Mesa, or one unit in the last place of the maximum depth for a float buffer.
        """
        if self.format == "float32":
            _, exponent = jnp.frexp(greatest)
            return jnp.ldexp(jnp.ones_like(greatest), exponent - 24)
        return jnp.full_like(greatest, 2 / _STEPS[self.format])
