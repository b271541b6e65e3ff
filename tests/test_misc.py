"""Derivatives where plain formulas have none: of a norm and a quotient at 0."""

import jax
import jax.numpy as jnp
import numpy as np

from diffshadow._misc import safe_divide, safe_norm


def test_a_norm_has_no_slope_at_zero_and_its_own_elsewhere():
    norm, slope = jax.vmap(jax.value_and_grad(safe_norm))(jnp.array([[0.0, 0.0], [3.0, -4.0]]))
    np.testing.assert_allclose(norm, [0, 5])
    np.testing.assert_allclose(slope, [[0, 0], [0.6, -0.8]], rtol=1e-6)


def test_a_quotient_by_zero_is_the_other_value_and_has_no_slope():
    quotient = lambda pair: safe_divide(pair[0], pair[1], 7.0)
    value, slope = jax.vmap(jax.value_and_grad(quotient))(jnp.array([[3.0, 0.0], [3.0, 2.0]]))
    np.testing.assert_allclose(value, [7, 1.5])
    np.testing.assert_allclose(slope, [[0, 0], [0.5, -0.75]])
