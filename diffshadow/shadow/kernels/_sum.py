"""Sums of compares over the texels that kernels read: the basis of every filter."""

import dataclasses
import math
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from ..._arithmetic import for_any, sums_up_to, take
from ..._device import chunk_size
from ..._padding import round_up_to_power_of_two
from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from .._map import ShadowMap
from ._corrections import Corrections
from ._kernel import AbstractKernel, AbstractRow
from ._padded_map import PaddedMap, pad
from ._terms import AbstractTerms, checkpoint, total, zeros_like

# The cost of one iteration of the loop over a kernel's steps, in taps. Longer iterations run no faster, compile more
# slowly and take more memory.
_COST_OF_A_STEP = 4
# The cost of a step with its derivatives, relative to the step alone.
_COST_OF_DERIVATIVES = 4
# Active look-ups per iteration of the loop over them, on a CPU and on a GPU.
_AT_ONCE = 1 << 13, 1 << 17


def sum_over(
    kernel: AbstractKernel,
    padded: PaddedMap,
    compare: AbstractCompare,
    lookup: Lookup,
    steps: Any,
    active: Bool[Array, "i p j q"] | None = None,
) -> Array:
    """The weighted sum of compares with all texels that a kernel reads, for each look-up.

    If the map has silhouettes, the sum over stored depths is corrected by them.

    **Arguments:**

    - `lookup`: the look-ups of the pixels of an image, (h, w), or of its `Blocks`. The arrays of `kernel` have the same
        shape, or are scalars.
    - `steps`: the kernel's steps: a pytree of arrays whose first axis is the step. Arrays that differ between the
        pixels of a block have its axes too, (n, rows, 1, columns). They carry no gradient.
    - `active`: where the sum is needed, in blocks; by default everywhere. It is 0 elsewhere. Differentiable with
      respect to everything except `steps`.
    """
    silhouettes = padded.silhouettes
    if not compare.has_depth_derivative:
        # Derivatives with respect to depths are zero, and XLA would compute them for all pixels and the whole map.
        padded, lookup = padded.with_depths_detached(), lookup.with_depths_detached()
    position, lookup = lookup.position, lookup.at(lookup.x, lookup.y)
    # Without unused fields, whose zero derivatives XLA would compute.
    plain_map = dataclasses.replace(padded, silhouettes=None, view=None)
    if silhouettes is None:
        return total(_Plain(), plain_map, compare, (kernel, lookup), steps, active)
    # With a hard compare, only outlines give a derivative with respect to a receiver's position. Steps between texels
    # give none.
    follows_outlines = not compare.has_depth_derivative
    still = lookup.detached() if follows_outlines else lookup
    plain = total(_Plain(), plain_map, compare, (kernel, still), steps, active)
    reach = kernel.reach(lookup, steps)
    # Under a soft compare, the parts of nearly all texels differ.
    depths = None if compare.has_depth_derivative else lookup.depths_within(reach)
    near = silhouettes.blocks.may_part(lookup, reach, depths)
    near = near if active is None else near & active
    if follows_outlines and position is not None:
        # Only look-ups near silhouettes then differentiate the projection of their points.
        lookup = still.of(position)
    return plain + total(Corrections(follows_outlines), padded, compare, (kernel, lookup), steps, near)


def sum_over_rows(row: AbstractRow, shadow_map: ShadowMap, compare: AbstractCompare, lookup: Lookup) -> Array:
    """The weighted sum of compares with the texels of all rows, for the look-ups of an image."""
    return sum_over(row, pad(shadow_map, row.texels), compare, lookup, np.arange(row.texels))


class _Plain(AbstractTerms):
    """Compares with stored depths, one step of the kernel after another.

    The loop over steps is partly unrolled: XLA fuses a few steps into one expression, but not a long chain of them.
    """

    def term(self, padded, compare, at, step):
        kernel, lookup = at
        return kernel.footprint(lookup, step).lit(padded, compare, lookup)

    def add_up(self, function, padded, compare, at, steps):
        kernel, _ = at
        like = jax.eval_shape(function, at, jax.tree.map(itemgetter(0), steps))
        with_derivatives = len(jax.tree.leaves(like)) > 1
        cost = kernel.cost * (_COST_OF_DERIVATIVES if with_derivatives else 1)
        count = jax.tree.leaves(steps)[0].shape[0]
        at_once = math.ceil(count / math.ceil(count * cost / _COST_OF_A_STEP))

        def add(total: Any, at: Any, some: Any) -> Any:
            for i in range(jax.tree.leaves(some)[0].shape[0]):
                one = jax.tree.map(jnp.asarray, jax.tree.map(itemgetter(i), some))
                total = jax.tree.map(jnp.add, total, function(at, one))
            return total

        def step(total: Any, some: Any) -> tuple[Any, None]:
            # Without the barrier, XLA hoists computations out of the loop, and each step reads them from memory.
            return add(total, *lax.optimization_barrier((at, some))), None

        total, loops = jax.tree.map(zeros_like, like), count // at_once
        if loops > 1:
            head = jax.tree.map(lambda s: s[: loops * at_once].reshape(loops, at_once, *s.shape[1:]), steps)
            total, _ = lax.scan(step, total, head)
            steps = jax.tree.map(lambda s: s[loops * at_once :], steps)
        # Without the barrier, every step computes the look-ups itself.
        total = add(total, lax.optimization_barrier(at), steps)
        # Without the barrier, XLA iterates over the pixels in the order of the sum's consumer, and no longer
        # vectorizes. There is one barrier per array, because derivatives use the sum before they are complete
        # themselves.
        return jax.tree.map(lax.optimization_barrier, total)

    def where(self, active, function, at, steps):
        """Gathers runs of `q` look-ups, laid out by `Blocks`, that contain an active one.

        Each row of a block has its own queue, so that a table of offsets still broadcasts.
        """
        i, p, j, q = active.shape
        runs = i * p * j
        chosen = jnp.moveaxis(jnp.any(active, axis=-1), 1, 0).reshape(p, i * j)
        number = jnp.moveaxis(jnp.arange(runs, dtype=jnp.int32).reshape(i, p, j), 1, 0).reshape(p, i * j)
        rank = jax.vmap(sums_up_to)(chosen) - 1
        most = jnp.max(rank) + 1
        at_once = min(i * j, round_up_to_power_of_two(max(1, chunk_size(*_AT_ONCE) // (p * q))))
        capacity = math.ceil(i * j / at_once) * at_once
        # Runs that are not chosen go to the last slot, which is never read. Empty slots have the number `runs`.
        queue = jnp.full((p, capacity + 1), runs, jnp.int32)
        slot = jnp.arange(p)[:, None], jnp.where(chosen, rank, capacity)
        queue = queue.at[slot].set(number, mode="promise_in_bounds")
        queue = jnp.moveaxis(queue[:, :-1].reshape(p, capacity // at_once, at_once), 1, 0)

        @checkpoint
        def some(own: Int[Array, "p n"]) -> Any:
            run = jnp.minimum(own, runs - 1)
            return function(rearranged(at, lambda a: take(a.reshape(runs, q), run)), steps)

        like = jax.eval_shape(some, queue[0])
        none = lambda own: jax.tree.map(zeros_like, like)
        step = lambda at_step: lax.cond(for_any(at_step[0] * at_once < most), some, none, at_step[1])
        values = lax.map(step, (jnp.arange(capacity // at_once, dtype=jnp.int32), queue))
        # Every run is stored once, so `add` equals `set`. In contrast to `set`, it has a transpose.
        put = lambda values: jnp.zeros((runs, q), values.dtype).at[queue].add(values, mode="drop").reshape(active.shape)
        return jax.tree.map(lambda values: jnp.where(active, put(values), 0), values)
