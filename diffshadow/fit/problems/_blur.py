"""The Gaussian under which images are compared where lights or meshes move."""

import math

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from ..._misc import sums_along
from ..._types import Scalar

REACH_OF_BLUR = 4
"""Where the Gaussian is cut off, in standard deviations."""


@eqx.filter_jit
def blurred(image: Float[Array, "h w"], widest: float, sharpness: Scalar | float) -> Float[Array, "h w"]:
    """An image under a Gaussian of standard deviation `widest / sharpness` in pixels; 0 beyond its border."""
    if widest == 0:
        return image
    reach = math.ceil(REACH_OF_BLUR * widest)
    weights = norm.pdf(jnp.arange(-reach, reach + 1), scale=widest / sharpness).astype(image.dtype)
    # Barrier: otherwise XLA recomputes the first sums for each of the second.
    columns = lax.optimization_barrier(sums_along(jnp.pad(image, reach), weights, axis=0))
    return sums_along(columns, weights, axis=1)
