"""Separable blurs of maps, and look-ups in blurred maps.

The weight of each texel is the integral of the kernel over it, so a blur grows smoothly with its radius.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import at_most, concrete, is_traced, sums_along, take
from ..._checks import check_order, check_value
from ..._types import DepthMap, Resolution, Scalar, TexelMap
from ...settings.filters import Shape
from ._separable import weight_between


def limit_radius(module: Any, field: str = "radius") -> None:
    """Sets the upper bound on a `module`'s radius, rounded up to half texels. The default is the radius itself.

    Inside `jit`, where the radius is unknown, the default is `TRACED_RADIUS`. A larger radius is then a runtime error.
    `check_radius` checks invalid values.
    """
    limit = f"max_{field}"
    radius, greatest = getattr(module, field), getattr(module, limit)
    if greatest is None and is_traced(radius):
        message = (
            f"{type(module).__name__}.{field} is above {TRACED_RADIUS:g} texels, the most for a {field} that is traced "
            f"by JAX (in jax.jit, grad or vmap) without {limit}; expected an upper bound: pass {limit}=, in texels"
        )
        setattr(module, field, eqx.error_if(radius, lax.stop_gradient(radius) > TRACED_RADIUS, message))
        setattr(module, limit, TRACED_RADIUS)
    else:
        setattr(module, limit, _radius_limit(radius, greatest))


def _radius_limit(radius: Any, max_radius: Any) -> Any:
    given = radius if max_radius is None else max_radius
    known = concrete(given)
    if known is not None and not (known.dtype.kind in "iuf" and known.shape == () and 0 <= known < np.inf):
        return 1.0 if max_radius is None else max_radius
    return max(1.0, math.ceil(2 * float(given)) / 2)


TRACED_RADIUS = 8.0
"""The default upper bound on a traced radius, in texels. Time and memory grow with its square."""


def check_radius(module: Any, field: str = "radius") -> None:
    """**Raises** `ValueError` if a `module`'s radius is known and above its upper bound, or if this bound is out of
    range."""
    limit = f"max_{field}"
    check_value(f"{type(module).__name__}.{limit}", getattr(module, limit), module.settings.each()[field])
    check_order(module, field, limit, equal=True)


class Blur(eqx.Module):
    """A separable blur of a map.

    - `radius`: the blur's radius in texels, clamped to `max_radius`. Up to half a texel, nothing is blurred.
    - `max_radius`: upper bound on `radius`.
    - `kernel`: its shape.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Shape = eqx.field(static=True)

    @property
    def reach(self) -> int:
        """The number of texels on each side of a texel that the blur reads."""
        return math.ceil(self.max_radius - 0.5)

    @property
    def margin(self) -> int:
        """The number of texels on each side by which a blurred map is wider than the map. Its outermost texels have the
        value beyond the border."""
        return self.reach + 1

    @property
    def weights(self) -> Float[Array, " k"]:
        """The weights of the texels in a row. The middle texel is at the kernel's centre."""
        offset = jnp.arange(-self.reach, self.reach + 1, dtype=self.radius.dtype)
        return weight_between(self.kernel, at_most(self.radius, self.max_radius), offset - 0.5, offset + 0.5)

    def __call__(self, values: Float[Array, "*n h w"], beyond: Scalar) -> Float[Array, "*n H W"]:
        """`values` blurred, and `margin` texels wider on each side. `beyond` is the value outside the border."""
        around = [(0, 0)] * (values.ndim - 2) + [(self.reach + self.margin,) * 2] * 2
        wide = jnp.pad(values, around, constant_values=beyond)
        weights = self.weights
        return sums_along(sums_along(wide, weights, values.ndim - 1), weights, values.ndim - 2)


def bilinear_fetch(
    resolution: Resolution, texel: TexelMap, layer: Int[Array, "h w"] | None, margin: int
) -> Callable[[Float[Array, "*l H W"]], DepthMap]:
    """A function that fetches at `texel` (h, w, 2) from maps `margin` texels wider on each side; clamps to the edge."""
    height, width = (size + 2 * margin for size in resolution)

    def split(position: Array, size: int) -> tuple[Array, Array]:
        """The texel to the left of `position`, and the weight of the texel to the right."""
        # The margin's outermost texels have the border's value, so look-ups may be clamped to them.
        position = jnp.clip(position - 0.5 + margin, 0, size - 1)
        left = jnp.minimum(jnp.floor(lax.stop_gradient(position)), size - 2)
        return left.astype(jnp.int32), position - left

    column, right = split(texel[..., 0], width)
    row, above = split(texel[..., 1], height)
    first = row * width + column
    if layer is not None:
        first = first + layer * (height * width)

    def fetch(blurred: Float[Array, "*l H W"]) -> DepthMap:
        row_of_memory = blurred.reshape(-1)
        at = lambda skip: take(row_of_memory, first + skip)
        lower = at(0) * (1 - right) + at(1) * right
        upper = at(width) * (1 - right) + at(width + 1) * right
        return lower * (1 - above) + upper * above

    return fetch
