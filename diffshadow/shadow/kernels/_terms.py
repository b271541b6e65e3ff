"""Sums over what kernels read, and their derivatives."""

import abc
import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from ..._misc import a_step, round_up_to_power_of_two, take
from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from ._kernel import AbstractKernel
from ._padded_map import PaddedMap

# Pixels per iteration of the loop over active pixels, on a CPU and on a GPU.
_PIXELS_A_STEP = 1 << 13, 1 << 17

KEPT = "kept"
"""The name of what reverse mode keeps of an iteration, by `checkpoint_name`; all else it computes again."""

At = tuple[AbstractKernel, Lookup]
"""Where a sum is evaluated: look-ups, and a kernel whose arrays have one value per look-up."""


class AbstractTerms(eqx.Module):
    """The terms of a sum, and the order in which they are added up."""

    @abc.abstractmethod
    def term(self, padded: PaddedMap, compare: AbstractCompare, at: At, step: Any) -> Float[Array, "*n"]:
        """The terms of all look-ups at a step."""

    @abc.abstractmethod
    def add_up(
        self, function: Callable[[At, Any], Any], padded: PaddedMap, compare: AbstractCompare, at: At, steps: Any
    ) -> Any:
        """The sum of `function(at, step)`, arrays with one value per look-up, over all steps."""


def _sum(
    terms: AbstractTerms,
    padded: PaddedMap,
    compare: AbstractCompare,
    at: At,
    steps: Any,
    active: Bool[Array, "i p j q"] | None,
) -> Any:
    """The sum of all terms where look-ups are `active`, and 0 elsewhere."""
    at, _ = _position_apart(*at)
    one = lambda at, step: terms.term(padded, compare, at, step)
    some = lambda at: terms.add_up(one, padded, compare, at, steps)
    return some(at) if active is None else _where_active(some, at, active)


total: Any = eqx.filter_custom_jvp(_sum)


@total.def_jvp
def _total_jvp(primals, tangents):
    """Computes each term's derivatives with respect to the look-up's numbers in reverse mode, and sums them like the
    terms. The cost of a Jacobian then does not depend on the number of parameters. Derivatives with respect to the map
    and the compare are not per look-up, and are summed separately, in forward mode."""
    terms, padded, compare, (kernel, lookup), steps, active = primals
    _, d_padded, d_compare, (d_kernel, d_lookup), _, _ = tangents
    # A scalar that all look-ups share has a derivative at each.
    spread = lambda leaf: jnp.broadcast_to(leaf, lookup.depth.shape) if eqx.is_inexact_array(leaf) else leaf
    at, position = _position_apart(jax.tree.map(spread, kernel), lookup)
    d_at, d_position = _position_apart(d_kernel, d_lookup)
    # Where look-ups are given as points in the world, x and y follow these and the map's view.
    follows = position is not None and bool(jax.tree.leaves((d_padded.view, d_position)))
    moves = jax.tree.map(lambda d: d is not None, d_at, is_leaf=_is_none)
    place = lambda at: (at[1].x, at[1].y)
    if follows:
        moves = eqx.tree_at(place, moves, (True, True))

    def term(padded: PaddedMap, compare: AbstractCompare, at: At, step: Any) -> Array:
        # XLA does not vectorize the derivatives of a soft compare in a kernel that gathers depths too, and compiles it
        # slowly.
        apart = compare.has_depth_derivative
        return terms.term(dataclasses.replace(padded, apart=apart), compare, at, step)

    def one(at: At, step: Any) -> Any:
        moving, still = eqx.partition(at, moves)
        value, pull = jax.vjp(lambda moving: term(padded, compare, eqx.combine(moving, still), step), moving)
        of_map = lambda padded, compare: term(padded, compare, at, step)
        change = eqx.filter_jvp(of_map, (padded, compare), (d_padded, d_compare))[1]
        return value, pull(jnp.ones_like(value))[0], change

    def some(given: Any) -> Any:
        at, position, d_position = given
        value, slopes, change = terms.add_up(one, padded, compare, at, steps)
        if follows:
            texel = lambda view, position: dataclasses.replace(padded, view=view).texel(position, at[1].layer)
            _, motion = eqx.filter_jvp(texel, (padded.view, position), (d_padded.view, d_position))
            for slope, d in zip(checkpoint_name(place(slopes), KEPT), motion, strict=True):
                if d is not None:
                    change = slope * d if change is None else change + slope * d
            slopes = eqx.tree_at(place, slopes, (None, None))
        return value, slopes, change

    given = at, position, d_position
    value, slopes, change = some(given) if active is None else _where_active(some, given, active)
    tangent = jnp.zeros_like(value) if change is None else change
    for slope, d in zip(jax.tree.leaves(slopes), jax.tree.leaves(d_at), strict=True):
        tangent = tangent + slope * d
    return value, tangent


def _position_apart(kernel: AbstractKernel, lookup: Lookup) -> tuple[At, Any]:
    """A kernel with its look-up, or their tangents, and the look-up's position apart from both."""
    apart = eqx.tree_at(lambda lookup: lookup.position, lookup, None, is_leaf=_is_none)
    return (kernel, apart), lookup.position


def _where_active(function: Callable[[Any], Any], at: Any, active: Bool[Array, "i p j q"]) -> Any:
    """`function` of a tree of arrays for the active look-ups, laid out by `Blocks`; 0 elsewhere.

    Runs of `q` pixels that contain an active one are gathered, and processed a fixed number at a time. Each row of a
    block has its own queue, so that a table of offsets still broadcasts. Iterations without runs are skipped.
    """
    i, p, j, q = active.shape
    runs = i * p * j
    chosen = jnp.moveaxis(jnp.any(active, axis=-1), 1, 0).reshape(p, i * j)
    number = jnp.moveaxis(jnp.arange(runs, dtype=jnp.int32).reshape(i, p, j), 1, 0).reshape(p, i * j)
    rank = jnp.cumsum(chosen, axis=1, dtype=jnp.int32) - 1
    most = jnp.max(rank) + 1
    at_once = min(i * j, round_up_to_power_of_two(max(1, a_step(*_PIXELS_A_STEP) // (p * q))))
    capacity = math.ceil(i * j / at_once) * at_once
    # Runs that are not chosen go to the last slot, which is never read; empty slots hold the number `runs`.
    queue = jnp.full((p, capacity + 1), runs, jnp.int32)
    queue = queue.at[jnp.arange(p)[:, None], jnp.where(chosen, rank, capacity)].set(number, mode="promise_in_bounds")
    queue = jnp.moveaxis(queue[:, :-1].reshape(p, capacity // at_once, at_once), 1, 0)

    @partial(jax.checkpoint, policy=jax.checkpoint_policies.save_only_these_names(KEPT))
    def some(own: Int[Array, "p n"]) -> Any:
        run = jnp.minimum(own, runs - 1)
        return function(rearranged(at, lambda a: take(a.reshape(runs, q), run)))

    like = jax.eval_shape(some, queue[0])
    none = lambda own: jax.tree.map(zeros_like, like)
    step = lambda at_step: lax.cond(at_step[0] * at_once < most, some, none, at_step[1])
    values = lax.map(step, (jnp.arange(capacity // at_once, dtype=jnp.int32), queue))
    # Every run is put once, so `add` equals `set`; unlike `set`, it has a transpose.
    put = lambda values: jnp.zeros((runs, q), values.dtype).at[queue].add(values, mode="drop").reshape(active.shape)
    return jax.tree.map(lambda values: jnp.where(active, put(values), 0), values)


def zeros_like(like: jax.ShapeDtypeStruct) -> Array:
    """Zeros of a shape and dtype."""
    return jnp.zeros(like.shape, like.dtype)


def _is_none(x: Any) -> bool:
    return x is None
