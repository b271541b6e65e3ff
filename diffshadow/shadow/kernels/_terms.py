"""Sums over the texels that kernels read, and their derivatives."""

import abc
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float

from .._compare import AbstractCompare
from .._lookup import Lookup
from ._kernel import AbstractKernel
from ._padded_map import PaddedMap

KEPT = "kept"
"""The `checkpoint_name` of the values that reverse mode keeps for active look-ups."""

checkpoint = partial(jax.checkpoint, policy=jax.checkpoint_policies.save_only_these_names(KEPT))
"""For functions of active look-ups. In reverse mode, recomputes everything except the kept values."""

At = tuple[AbstractKernel, Lookup]
"""The arguments of a sum: look-ups, and a kernel whose arrays have one value per look-up."""


class AbstractTerms(eqx.Module):
    """The terms of a sum, and the order of their addition."""

    @abc.abstractmethod
    def term(self, padded: PaddedMap, compare: AbstractCompare, at: At, step: Any) -> Float[Array, "*n"]:
        """The terms of all look-ups at a step."""

    @abc.abstractmethod
    def add_up(
        self, function: Callable[[At, Any], Any], padded: PaddedMap, compare: AbstractCompare, at: At, steps: Any
    ) -> Any:
        """The sum of `function(at, step)`, arrays with one value per look-up, over all steps."""

    @abc.abstractmethod
    def where(self, active: Bool[Array, "*n"], function: Callable[[Any, Any], Any], at: Any, steps: Any) -> Any:
        """`function(at, steps)`, arrays with one value per look-up, where look-ups are active, and 0 elsewhere.

        Active look-ups are gathered, and processed a fixed number at a time by a `checkpoint`.
        """


def _sum(
    terms: AbstractTerms,
    padded: PaddedMap,
    compare: AbstractCompare,
    at: At,
    steps: Any,
    active: Bool[Array, "*n"] | None,
) -> Any:
    """The sum of all terms where look-ups are `active`, and 0 elsewhere."""
    at, _ = _position_apart(*at)
    one = lambda at, step: terms.term(padded, compare, at, step)
    some = lambda at, steps: terms.add_up(one, padded, compare, at, steps)
    return some(at, steps) if active is None else terms.where(active, some, at, steps)


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
    # If look-ups are given as points in the world, x and y depend on these and on the map's view.
    follows = position is not None and bool(jax.tree.leaves((d_padded.view, d_position)))
    moves = jax.tree.map(lambda d: d is not None, d_at, is_leaf=_is_none)
    place = lambda at: (at[1].x, at[1].y)
    if follows:
        moves = eqx.tree_at(place, moves, (True, True))

    def term(padded: PaddedMap, compare: AbstractCompare, at: At, step: Any) -> Array:
        # XLA does not vectorize the derivatives of a soft compare in a kernel that also gathers depths, and compiles it
        # slowly.
        apart = compare.has_depth_derivative
        return terms.term(dataclasses.replace(padded, apart=apart), compare, at, step)

    def one(at: At, step: Any) -> Any:
        moving, still = eqx.partition(at, moves)
        value, pull = jax.vjp(lambda moving: term(padded, compare, eqx.combine(moving, still), step), moving)
        of_map = lambda padded, compare: term(padded, compare, at, step)
        change = eqx.filter_jvp(of_map, (padded, compare), (d_padded, d_compare))[1]
        return value, pull(jnp.ones_like(value))[0], change

    def some(given: Any, steps: Any) -> Any:
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
    value, slopes, change = some(given, steps) if active is None else terms.where(active, some, given, steps)
    tangent = jnp.zeros_like(value) if change is None else change
    for slope, d in zip(jax.tree.leaves(slopes), jax.tree.leaves(d_at), strict=True):
        tangent = tangent + slope * d
    return value, tangent


def _position_apart(kernel: AbstractKernel, lookup: Lookup) -> tuple[At, Any]:
    """A kernel with its look-up, or their tangents, and the look-up's position separately."""
    apart = eqx.tree_at(lambda lookup: lookup.position, lookup, None, is_leaf=_is_none)
    return (kernel, apart), lookup.position


def zeros_like(like: jax.ShapeDtypeStruct) -> Array:
    """Zeros of a shape and dtype."""
    return jnp.zeros(like.shape, like.dtype)


def _is_none(x: Any) -> bool:
    return x is None
