"""Residuals: how far shadow mapping is from its reference, pixel by pixel."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Mask, Scalar, Visibility
from ..raster import Surface
from ..shadow import ShadowMap, ShadowMapping
from ._parameters import Bounds, with_values


class Problem(eqx.Module):
    """A technique, what it is fitted to, and what stays as it is.

    - `technique`: the shadow mapping whose numbers are fitted.
    - `shadow_map`, `surface`: what it looks at. Neither depends on bias or filter, so neither is drawn again.
    - `reference`: (h, w), visibility in [0, 1].
    - `mask`: (h, w), the pixels that count.
    """

    technique: ShadowMapping
    shadow_map: ShadowMap
    surface: Surface
    reference: Visibility
    mask: Mask

    def residual(self, technique: ShadowMapping) -> Float[Array, "h w"]:
        """Visibility less reference at the pixels that count, 0 elsewhere.

        Scaled so that the sum of its squares is the mean square error.
        """
        visibility = technique.visibility(self.shadow_map, self.surface)
        count = jnp.maximum(jnp.sum(self.mask), 1)
        return jnp.where(self.mask, visibility - self.reference, 0) / jnp.sqrt(count)

    def mean_square_error(self, technique: ShadowMapping) -> Scalar:
        """The mean square error over the pixels that count."""
        return jnp.sum(self.residual(technique) ** 2)


def residual_at(
    problem: Problem, names: tuple[str, ...], bounds: Bounds, y: Float[Array, " p"]
) -> Float[Array, "h w"]:
    """The residual with the named parameters at the free values `y` (p,)."""
    return problem.residual(with_values(problem.technique, names, bounds.to_bounded(y)))
