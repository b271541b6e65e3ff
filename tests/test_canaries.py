"""Faults of past jax releases that this package would suffer from; each test fails on a jax that has the fault."""

import os
import subprocess
import sys

import pytest

# A healthy jax needs a few seconds, most of them to start.
TIME_LIMIT_S = 120

# jax issue 39103 (0.10.2): rows past the 16,384th (float64) or the 32,768th (float32) come out wrong, without a word.
ROWS_OF_SQUARES = """
import jax, jax.numpy as jnp, numpy as np

def squares(matrices, rows):
    return jax.vmap(lambda m, r: jnp.sum((m @ r) ** 2), in_axes=(None if matrices.ndim == 2 else 0, 0))(matrices, rows)

for dtype in (jnp.float32, jnp.float64):
    with jax.enable_x64(dtype == jnp.float64):
        for n in (16_385, 32_769, 100_000):
            first = np.arange(n) % 1000
            rows = jnp.asarray(np.stack([first, 0 * first, 0 * first], axis=1), dtype)
            shared = jnp.eye(3, dtype=dtype)
            for matrices in (shared, jnp.broadcast_to(shared, (n, 3, 3))):
                np.testing.assert_array_equal(jax.jit(squares)(matrices, rows), first**2)
"""

# jax issues 39257 and 40412 (0.10.2, 0.11.0): broadcast, multiply, reduce at a high rank kills or hangs the process.
WIDE_BROADCAST = """
import jax, jax.numpy as jnp, numpy as np

def likelihood(a, b):
    return jnp.log(jnp.maximum(jnp.sum(a[..., None, None, None, None, None] * b, axis=2), 1e-16))

wide = jax.jit(likelihood)(jnp.ones((10, 4, 6)), jnp.ones((10, 4, 6, 9, 9, 9, 9, 9)))
np.testing.assert_allclose(wide, np.log(6), rtol=1e-6)

thin = jnp.ones((3, 1, 2, 2, 8, 8, 8))
np.testing.assert_array_equal(jax.jit(lambda a, b: jnp.sum(a * b, axis=3))(thin, thin), 2)
"""

# jax issue 40101 (0.11.1): each small write in a loop costs a copy of the whole array. These two million writes, which
# take milliseconds, then take half an hour.
LOOP_OF_SMALL_WRITES = """
import jax, jax.numpy as jnp, numpy as np

n = 2_000_000
loop = jax.jit(lambda x: jax.lax.fori_loop(0, n, lambda i, a: a.at[i].set(i), x))
np.testing.assert_array_equal(loop(jnp.zeros(n, jnp.int32)), np.arange(n))
"""


def run_on_cpu(program: str) -> None:
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False)
    assert result.returncode == 0, f"exit code {result.returncode}\n{result.stderr[-4000:]}"


def test_many_rows_of_small_matrix_products_are_right_under_jit():
    run_on_cpu(ROWS_OF_SQUARES)


@pytest.mark.exhaustive
def test_wide_broadcast_and_reduction_neither_crashes_nor_hangs():
    run_on_cpu(WIDE_BROADCAST)


@pytest.mark.exhaustive
def test_loop_of_small_writes_takes_time_linear_in_its_length():
    run_on_cpu(LOOP_OF_SMALL_WRITES)
