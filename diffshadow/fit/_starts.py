"""The starts of fits: several starts spread over the bounds."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import as_float
from ._parameters import Parameters


def starts_within(parameters: Parameters, initial: Float[Array, " p"], count: int, seed: int) -> Float[Array, "s p"]:
    """`initial` (p,) followed by a scrambled Sobol sequence over the bounds, `count` values in all."""
    if count == 1:
        return as_float(np.asarray(initial)[None])
    from scipy.stats import qmc  # Imported here, because it is slow to load.

    sobol = qmc.Sobol(initial.shape[0], rng=np.random.default_rng(seed))
    # A power of two at once, because these points are evenly spread.
    fractions = sobol.random_base2(max(count - 2, 0).bit_length())[: count - 1]
    return jnp.concatenate([initial[None], parameters.at(as_float(fractions))])
