"""Derivatives where plain formulas have none, of a norm and a quotient at 0; powers of two; arrays from the host; the
option that XLA reads; and the garbage collector."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scenes import compiled_programs

from diffshadow._arithmetic import as_array, as_float, for_any, in_unit_range, safe_divide, safe_norm, sums_up_to
from diffshadow._padding import round_up_to_power_of_two


def test_a_norm_has_no_slope_at_zero_and_its_own_elsewhere():
    norm, slope = jax.vmap(jax.value_and_grad(safe_norm))(jnp.array([[0.0, 0.0], [3.0, -4.0]]))
    np.testing.assert_allclose(norm, [0, 5])
    np.testing.assert_allclose(slope, [[0, 0], [0.6, -0.8]], rtol=1e-6)


def test_a_quotient_by_zero_is_the_other_value_and_has_no_slope():
    quotient = lambda pair: safe_divide(pair[0], pair[1], 7.0)
    value, slope = jax.vmap(jax.value_and_grad(quotient))(jnp.array([[3.0, 0.0], [3.0, 2.0]]))
    np.testing.assert_allclose(value, [7, 1.5])
    np.testing.assert_allclose(slope, [[0, 0], [0.5, -0.75]])


@pytest.mark.parametrize("count", [0, 1, 8, 21])
def test_sums_up_to_each_value_are_those_of_numpy(count):
    values = np.random.default_rng(count).integers(-4, 5, count, np.int32)
    found = sums_up_to(jnp.asarray(values))
    assert found.dtype == jnp.int32
    np.testing.assert_array_equal(found, np.cumsum(values))
    np.testing.assert_array_equal(jax.vmap(sums_up_to)(jnp.ones((2, count), bool)), [np.arange(count) + 1] * 2)


def test_what_is_kept_in_range_has_second_derivatives():
    square = lambda x: in_unit_range(x) ** 2
    forward, reverse = jax.jacfwd(jax.jacfwd(square)), jax.grad(jax.grad(square))
    assert [float(second(jnp.asarray(0.3))) for second in (forward, reverse)] == [2, 2]


@jax.custom_jvp
def _square_if_positive(x):
    return jnp.where(x > 0, x * x, 0)


@_square_if_positive.defjvp
def _square_if_positive_jvp(primals, tangents):
    """As filters do it: a branch reads tangents, and changes nothing where its condition does not hold."""
    (x,), (d,) = primals, tangents
    slope = lax.cond(for_any(x > 0), lambda x, d: jnp.where(x > 0, 2 * x * d, 0), lambda x, d: 0 * d, x, d)
    return _square_if_positive(x), slope


@pytest.mark.parametrize("x", [[1.0, -2.0, 3.0], [-1.0, -2.0, -3.0]])
def test_a_condition_for_any_of_a_batch_has_derivatives_in_reverse_mode(x):
    of_all = lambda x: jnp.sum(jax.vmap(_square_if_positive)(x))
    expected = 2 * np.maximum(x, 0)
    np.testing.assert_array_equal(jax.jit(jax.grad(of_all))(jnp.array(x)), expected)
    # The condition is one for all, so that the branch is skipped where it holds for none.
    assert "cond[" in str(jax.make_jaxpr(jax.vmap(jax.grad(_square_if_positive)))(jnp.array(x)))


def test_numbers_are_rounded_up_to_powers_of_two():
    rounded = [round_up_to_power_of_two(n) for n in (0, 1, 2, 3, 4, 5, 1023, 1024, 1025)]
    assert rounded == [0, 1, 2, 4, 4, 8, 1024, 1024, 2048]


@pytest.mark.parametrize("given", [np.ones((7, 11), np.float32), np.ones((11, 7)), np.ones((7, 11), bool), [0.5] * 77])
def test_arrays_from_the_host_are_moved_and_nothing_is_compiled(given):
    with compiled_programs() as compiled:
        moved, number = as_array(given), as_float(given)
    assert moved.dtype == jnp.result_type(np.asarray(given))
    assert number.dtype == jnp.float32
    np.testing.assert_array_equal(moved, given)
    np.testing.assert_array_equal(number, given)
    assert compiled == []
