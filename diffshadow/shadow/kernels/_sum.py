"""Sums of compares over the texels that kernels read: what every filter is made of."""

import math
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool

from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from .._map import ShadowMap
from ..silhouettes._corrections import Corrections
from ._blocks import Blocks
from ._kernel import AbstractKernel, AbstractRow
from ._padded_map import PaddedMap, pad
from ._terms import AbstractTerms, total, zeros_like

# The cost of a step of the loop over a kernel's, in nearest taps: longer ones run no faster and compile more slowly.
_COST_OF_A_STEP = 16
# The cost of a step with its derivatives, relative to the step alone.
_COST_OF_DERIVATIVES = 2


def sum_over(
    kernel: AbstractKernel,
    padded: PaddedMap,
    compare: AbstractCompare,
    lookup: Lookup,
    steps: Any,
    active: Bool[Array, "i p j q"] | None = None,
) -> Array:
    """The weighted sum of compares with all texels that a kernel reads, for each look-up.

    Where casters end within texels, the sum over stored depths is corrected by the map's silhouettes.

    **Arguments:**

    - `lookup`: for the pixels of an image, (h, w), or for its `Blocks`; so are the arrays of `kernel`, or scalars.
    - `steps`: what the kernel takes at each of its steps: a pytree of arrays whose first axis counts them. Arrays that
        differ for each pixel of a block have its axes as well, (n, rows, 1, columns). They carry no gradient.
    - `active`: of blocks, where the sum is needed: it is 0 elsewhere. Everywhere if left out.

    Differentiable with respect to all but `steps`.
    """
    silhouettes = padded.silhouettes
    if active is None and silhouettes is None:
        return total(_Plain(), padded, compare, (kernel, lookup), steps, None)
    if lookup.depth.ndim == 2:
        blocks = Blocks.of(lookup.depth.shape)
        at = rearranged((kernel, lookup), blocks.cut)
        return blocks.join(sum_over(at[0], padded, compare, at[1], steps))
    if silhouettes is None:
        return total(_Plain(), padded, compare, (kernel, lookup), steps, active)
    # A receiver that moves sees outlines pass. It sees no steps between texels, which a hard compare makes.
    follows_outlines = not compare.has_depth_derivative
    plain_lookup = lookup.detached() if follows_outlines else lookup
    plain = total(_Plain(), padded, compare, (kernel, plain_lookup), steps, active)
    near = silhouettes.texels.any_within(lookup.x, lookup.y, lookup.layer, kernel.reach(lookup, steps))
    near = near if active is None else near & active
    return plain + total(Corrections(follows_outlines), padded, compare, (kernel, lookup), steps, near)


def sum_over_rows(row: AbstractRow, shadow_map: ShadowMap, compare: AbstractCompare, lookup: Lookup) -> Array:
    """The weighted sum of compares with the texels of all rows, for look-ups of the pixels of an image."""
    return sum_over(row, pad(shadow_map, row.texels), compare, lookup, np.arange(row.texels))


class _Plain(AbstractTerms):
    """Compares with stored depths, one step of the kernel after another.

    A few steps are written out in each step of a loop: they run as one fused expression, which a long chain of them
    does not.
    """

    def term(self, padded, compare, at, step):
        kernel, lookup = at
        return kernel.footprint(lookup, step).lit(padded, compare, lookup)

    def add_up(self, function, padded, at, steps):
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
            # Barrier: otherwise all steps read from memory what one of them could compute.
            return add(total, *lax.optimization_barrier((at, some))), None

        total, loops = jax.tree.map(zeros_like, like), count // at_once
        if loops > 1:
            head = jax.tree.map(lambda s: s[: loops * at_once].reshape(loops, at_once, *s.shape[1:]), steps)
            total, _ = lax.scan(step, total, head)
            steps = jax.tree.map(lambda s: s[loops * at_once :], steps)
        # Barrier: otherwise every step computes the look-ups itself.
        total = add(total, lax.optimization_barrier(at), steps)
        # Barrier: otherwise XLA iterates over the pixels in the order of whatever reads the sum, and no longer
        # vectorizes. One by one, since derivatives need the sum before they are there themselves.
        return jax.tree.map(lax.optimization_barrier, total)
