"""Percentage-closer filtering (Reeves, Salesin & Cook 1987)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._arithmetic import at_least, at_most
from ...settings.filters import PercentageCloser as Settings
from .._lookup import Lookup
from .._shader import ShaderPart
from ..kernels import MIN_RADIUS, AbstractRow, AbstractSizedRow, Footprint, Span
from ._sized import AbstractSizedFilter


class PercentageCloser(AbstractSizedFilter):
    """The fraction of a box in the map that does not shadow the receiver.

    The box moves and grows smoothly: the weight of each texel is its area inside the box. A radius of 0.5 is
    the bilinear compare; 2.5 covers 5 x 5 texels.

    - `radius`: half the box's width, in texels.
    - `max_radius`: upper bound on `radius`, in texels; the number of taps grows with its square. Defaults to `radius`,
        or to 8 if `radius` is traced; rounded up to a half texel.

    **Raises** `ValueError` if `radius` is above `max_radius`.

    !!! Example

        ```python
        box = shadow.PercentageCloser(1.5, max_radius=4.0)  # a fit may widen it to 4 texels
        shadow.ShadowMapping(box, shadow.Bias(1.0)).visibility(state, surface).shape  # (32, 32)
        ```
    """

    settings: ClassVar = Settings

    def row(self) -> AbstractRow:
        return _Row(self.max_radius, at_least(at_most(self.radius, self.max_radius), MIN_RADIUS))

    def shader(self) -> ShaderPart:
        return self.shader_of("filters/_pcf.glsl")


class _Row(AbstractSizedRow):
    """One row of the box's texels, numbered from the lowest that a box of these radii can cover."""

    def footprint(self, lookup: Lookup, step: Int[Array, "*n"]) -> Footprint:
        column, left = _lower_edge(lookup.x, self.radius)
        row, below = _lower_edge(lookup.y, self.radius)
        columns = [_covered(left, self.radius, i) for i in range(self.texels)]
        own = _covered(below, self.radius, step)
        area = _width(left, self.radius) * _width(below, self.radius)
        return Footprint(column, row, columns, [own._replace(weight=own.weight / area)], step)


def _lower_edge(position: Float[Array, "*n"], radius: Float[Array, "..."]) -> tuple[Array, Array]:
    """The texel that contains the lower edge of a box around `position`, and the position of the edge in that texel."""
    own = jnp.floor(position)
    # Relative to the position's own texel, so that weights add up to 1 at any distance from the origin.
    edge = position - own - radius
    first = jnp.floor(edge)
    return own + first, edge - first


def _width(edge: Float[Array, "*n"], radius: Float[Array, "..."]) -> Float[Array, "*n"]:
    """The rounded width of a box, which is the sum of the parts of all texels that it covers.

    The width of a narrow box is a small difference of larger numbers, so its parts do not add up to exactly `2 ·
    radius`.
    """
    return (edge + 2 * radius) - edge


def _covered(edge: Float[Array, "*n"], radius: Float[Array, "..."], number: Array | int) -> Span:
    """The part of texel `number` that a box covers. Texels are counted from the one with its lower `edge`."""
    upper = edge + 2 * radius - number
    # Cheaper than a clip, which halves derivatives at its bounds.
    low, high = jnp.where(number == 0, edge, 0), jnp.where(upper < 0, 0, jnp.where(upper < 1, upper, 1))
    return Span(high - low, low - 0.5, high - 0.5)
