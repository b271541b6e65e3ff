"""Arithmetic on arrays: conversions, safe roots and quotients, look-ups, and values with custom derivatives."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.custom_batching import custom_vmap
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from ._device import is_on_gpu


def as_float(x: Any) -> Array:
    """`x` as an array of JAX's default float: float32, or float64 under `jax.enable_x64`."""
    return _as(x, jnp.result_type(float))


def as_number(x: Any) -> Any:
    """Like `as_float`, but returns non-numbers unchanged, so that a check can name them."""
    if x is None or isinstance(x, str):
        return x
    try:
        return as_float(x)
    except (TypeError, ValueError):
        return x


def as_numbers(xs: Any) -> Any:
    """A sequence of numbers as a tuple. Other values are returned unchanged."""
    # NumPy cannot read a sequence of traced numbers.
    return tuple(map(as_number, xs)) if isinstance(xs, Sequence) or np.ndim(xs) else xs


def in_float64(tree: Any) -> Any:
    """`tree` with every floating-point array in float64. Call it under `jax.enable_x64`."""
    return jax.tree.map(lambda x: as_float(x) if eqx.is_inexact_array(x) else x, tree)


def as_int(x: Any) -> Array:
    """`x` as an int32 array."""
    return _as(x, jnp.int32)


def as_array(x: Any) -> Array:
    """`x` as an array with the dtype of `x`."""
    # `jnp.asarray` compiles a program for each shape of a NumPy array.
    return x if isinstance(x, jax.Array) else jax.device_put(np.asarray(x))


def _as(x: Any, dtype: Any) -> Array:
    if isinstance(x, jax.Array) and x.dtype == dtype and not x.weak_type:
        return x
    # NumPy converts without compiling a program for each shape.
    number = np.ndarray | np.generic | jax.Array | float | int
    known = lambda part: isinstance(part, number) and not isinstance(part, Tracer)
    on_host = known(x) or (isinstance(x, list | tuple) and all(map(known, x)))
    # Numbers out of range become infinite, as elsewhere in JAX.
    with np.errstate(over="ignore"):
        return jnp.asarray(np.asarray(x, dtype) if on_host else x, dtype=dtype)


def concrete(x: Any) -> np.ndarray | None:
    """`x` as a NumPy array, or `None` if any part of it is traced and has no value yet."""
    return None if is_traced(x) else np.asarray(x)


def is_traced(tree: Any) -> bool:
    """Whether an array in `tree` is traced and has no value yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def array_module(*arrays: Any) -> Any:
    """`jax.numpy` if one of the `arrays` is traced. Otherwise NumPy, which compiles nothing."""
    return jnp if is_traced(arrays) else np


def dot(a: Float[Array, "*n d"], b: Float[Array, "*m d"]) -> Float[Array, "..."]:
    """Dot product over the last axis."""
    # Written out, because XLA fuses sums with surrounding operations, but not reductions.
    return sum(a[..., i] * b[..., i] for i in range(1, a.shape[-1])) + a[..., 0] * b[..., 0]


def safe_norm(x: Float[Array, "*n d"]) -> Float[Array, "*n"]:
    """Euclidean norm over the last axis, with a zero instead of a NaN gradient at 0."""
    return safe_sqrt(dot(x, x))


def safe_divide(a: Float[Array, "*#n"], b: Float[Array, "*#n"], otherwise: float = 0.0) -> Float[Array, "..."]:
    """`a / b`, or `otherwise` where `b` is 0, without NaN in value or gradient."""
    zero = b == 0
    return jnp.where(zero, otherwise, a / jnp.where(zero, 1, b))


def safe_sqrt(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The square root, or 0 for negative numbers, without NaN in value or gradient."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1)), 0)


@jax.jit
def normalize(x: Float[Array, "*n d"]) -> Float[Array, "*n d"]:
    """`x` scaled to unit length along the last axis; the zero vector stays zero."""
    return safe_divide(x, jnp.broadcast_to(safe_norm(x)[..., None], x.shape))


def take(values: Array, index: Int[Array, "*n"]) -> Array:
    """`values[index]` along the first axis, for indices in bounds. A negative index reads the first element."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def take_last(values: Array, index: Int[Array, "*n"]) -> Array:
    """`values[..., index]`. Like `take`, but along the last axis."""
    return values.at[..., index].get(mode="promise_in_bounds", wrap_negative_indices=False)


# The number of additions in one step of the loop.
_SUMS_AT_ONCE = 8


def sums_up_to(values: Int[Array, " n"] | Bool[Array, " n"], dtype: DTypeLike = jnp.int32) -> Int[Array, " n"]:
    """The inclusive prefix sum of integers or Booleans. Equals `jnp.cumsum`.

    For a CPU, XLA compiles `jnp.cumsum` to a tree of up to ten kernels, and a loop to one kernel. The loop takes less
    than half of the time to compile, and less to run.
    """
    if is_on_gpu():
        return jnp.cumsum(values, dtype=dtype)

    def add(total: Array, value: Array) -> tuple[Array, Array]:
        total = total + value
        return total, total

    return lax.scan(add, jnp.zeros((), dtype), values.astype(dtype), unroll=_SUMS_AT_ONCE)[1]


_RUN = 32


def take_in_runs(values: Array, index: Int[Array, "*n"]) -> Array:
    """`take` for non-negative indices with many equal neighbours. Its transpose first adds up runs of equal indices.

    In each run of 32 indices, the transpose first adds up the gradients of all indices that equal the first one. This
    saves additions to one address, which a GPU does one after another.
    """
    runs = jnp.pad(index.reshape(-1), (0, -index.size % _RUN)).reshape(-1, _RUN)
    first = runs[:, :1]
    is_first = runs == first
    # If the index equals the run's first one, it is replaced by an index out of bounds, where nothing is added.
    others = jnp.where(is_first, values.shape[0], runs)
    own = values.at[others].get(mode="fill", fill_value=0, wrap_negative_indices=False)
    found = jnp.where(jnp.expand_dims(is_first, range(2, own.ndim)), take(values, first), own)
    return found.reshape(-1, *values.shape[1:])[: index.size].reshape(*index.shape, *values.shape[1:])


@jax.jit
def components(vectors: Float[Array, "*n c"]) -> tuple[Float[Array, "*n"], ...]:
    """The coordinates x, y and so on of vectors, as separate arrays."""
    return tuple(vectors[..., k] for k in range(vectors.shape[-1]))


def sums_along(values: Float[Array, "..."], weights: Sequence[float] | Float[Array, " k"], axis: int) -> Array:
    """The sums of k neighbours along an axis, weighted by `weights` (k,). The axis becomes k - 1 shorter.

    The sum is written out and reads memory once. A running total of equal weights would be no faster below k = 60, and
    it loses digits to cancellation that variances need. A convolution is many times slower on a CPU.
    """
    count = len(weights)
    size = values.shape[axis] - count + 1
    shifted = (lax.slice_in_dim(values, k, k + size, axis=axis) for k in range(count))
    return sum((weights[k] * part for k, part in enumerate(shifted)), start=jnp.zeros((), values.dtype))


def at_most(x: Float[Array, "*n"], bound: Float[Array, "*#n"] | float | None) -> Float[Array, "*n"]:
    """`min(x, bound)`, or `x` if the bound is `None`. At `x == bound`, it has the derivative of `x`."""
    return x if bound is None else jnp.where(x > bound, bound, x)


def at_least(x: Float[Array, "*n"], bound: Float[Array, "*#n"] | float | None) -> Float[Array, "*n"]:
    """`max(x, bound)`, or `x` if the bound is `None`. At `x == bound`, it has the derivative of `x`."""
    return x if bound is None else jnp.where(x < bound, bound, x)


@custom_vmap
def for_any(condition: Bool[Array, ""]) -> Bool[Array, ""]:
    """`condition`. Under `jax.vmap`, whether it is true for any element of the batch.

    Use it for a branch of `lax.cond` that changes nothing where the condition is false. With a separate condition for
    each element of the batch, JAX would take both branches for all elements, and it has no reverse mode for a branch
    that reads tangents.
    """
    return condition


@for_any.def_vmap
def _for_any_of_batch(size, is_batched, condition):
    return jnp.any(condition, axis=0) if is_batched[0] else condition, False


@jax.custom_jvp
def with_gradient_of(smooth: Float[Array, "*n"], value: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """`value` with the derivative of `smooth`, for values that are rounded or found by a search."""
    return value


@with_gradient_of.defjvp
def _with_gradient_of_jvp(primals, tangents):
    # The value again, with its derivative, for higher derivatives.
    return with_gradient_of(*primals), tangents[0]


def in_unit_range(mean: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """`mean` clipped to [0, 1], with its own derivative. Rounding can move a mean of such values out of this range."""
    return with_gradient_of(mean, jnp.clip(jax.lax.stop_gradient(mean), 0, 1))
