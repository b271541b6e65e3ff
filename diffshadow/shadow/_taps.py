"""Look-ups in a shadow map, from which every filter is made.

A texel that holds nothing, and everything beyond the border, is lit however soft the compare. To that end the map is
padded by two texels: clamped look-ups then always land on texels that exist, and no branch is needed.
"""

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._types import Visibility
from ._compare import AbstractCompare
from ._map import ShadowMap
from ._receiver import Lookup

TapMode = Literal["nearest", "bilinear"]

_PADDING = 2
# Deeper than any receiver by far more than any soft compare is wide.
_NOTHING = 1e6
# Taps written out in one step of the loop over taps: more run no faster, and take longer to compile.
_UNROLLED = 8


class PaddedMap(eqx.Module):
    """A shadow map's depths as one row of memory, padded with depths that shadow nothing."""

    depth: Float[Array, " n"]
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)

    def __getitem__(self, index: tuple[Int[Array, "*n"], Int[Array, "*n"]]) -> Float[Array, "*n"]:
        """Depths at (x, y), which may lie at most two texels outside."""
        x, y = index
        flat = (y + _PADDING) * (self.width + 2 * _PADDING) + (x + _PADDING)
        return self.depth.at[flat].get(mode="promise_in_bounds")

    def texel(self, x: Float[Array, "*n"], y: Float[Array, "*n"]) -> tuple[Int[Array, "*n"], Int[Array, "*n"]]:
        """The texel that a position lies in, clamped so that it and its neighbours exist."""
        clamp = lambda p, size: jnp.clip(jnp.floor(lax.stop_gradient(p)), -_PADDING, size).astype(jnp.int32)
        return clamp(x, self.width), clamp(y, self.height)


def pad(shadow_map: ShadowMap) -> PaddedMap:
    """The map, padded, with empty texels that shadow nothing."""
    depth = jnp.where(shadow_map.depth < 1, shadow_map.depth, _NOTHING)
    height, width = shadow_map.resolution
    return PaddedMap(jnp.pad(depth, _PADDING, constant_values=_NOTHING).reshape(-1), height, width)


def nearest_tap(padded: PaddedMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
    """Compares with the texel that each look-up falls into. Its gradient does not see the position."""
    texel = padded.texel(lookup.texel[..., 0], lookup.texel[..., 1])
    return compare(padded[texel], lookup.depth, lookup.depth_per_texel)


def bilinear_tap(padded: PaddedMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
    """Compares with the four texels round each look-up, and blends the four results (never the depths)."""
    u, v = lookup.texel[..., 0] - 0.5, lookup.texel[..., 1] - 0.5
    column, row = padded.texel(u, v)
    right, above = u - lax.stop_gradient(jnp.floor(u)), v - lax.stop_gradient(jnp.floor(v))
    lit = lambda i, j: compare(padded[column + i, row + j], lookup.depth, lookup.depth_per_texel)
    lower = lit(0, 0) * (1 - right) + lit(1, 0) * right
    upper = lit(0, 1) * (1 - right) + lit(1, 1) * right
    return lower * (1 - above) + upper * above


def single_tap(shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare, mode: TapMode) -> Visibility:
    """One compare a receiver."""
    return _TAPS[mode](pad(shadow_map), lookup, compare)


def mean_of_taps(
    shadow_map: ShadowMap,
    lookup: Lookup,
    compare: AbstractCompare,
    radius: Float[Array, "..."],
    offsets: Float[Array, "n *p 2"],
    mode: TapMode,
    spread: Callable[[Array], Array] = lambda offset: offset,
) -> Visibility:
    """The mean of taps at `texel + radius · offset`.

    **Arguments:**

    - `radius`: in texels, a scalar or one for each receiver.
    - `offsets`: (n, ..., 2), `n` offsets in the unit disk; `spread` shapes one component (...) to the receivers'.
    - `mode`: `"nearest"` or `"bilinear"` taps; nearest ones give `radius` and position no gradient.

    Differentiable with respect to all but `offsets`.
    """
    radius = jnp.broadcast_to(radius, lookup.depth.shape)
    return _mean(pad(shadow_map), compare, lookup, radius, offsets, mode, spread)


_TAPS = {"nearest": nearest_tap, "bilinear": bilinear_tap}


def _moved(lookup: Lookup, radius: Array, x: Array, y: Array) -> Lookup:
    moved = lookup.texel + jnp.stack([radius * x, radius * y], axis=-1)
    return Lookup(moved, lookup.depth, lookup.depth_per_texel, lookup.inside)


def _scan_mean(one: Callable[[Array, Array], Any], like: Any, offsets: Array, spread: Callable) -> Any:
    """The mean of `one(x, y)` over the offsets."""

    def add(total: Any, offset: Array) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, one(spread(offset[..., 0]), spread(offset[..., 1]))), None

    zero = jax.tree.map(jnp.zeros_like, like)
    total, _ = lax.scan(add, zero, offsets, unroll=min(_UNROLLED, offsets.shape[0]))
    return jax.tree.map(lambda x: x / offsets.shape[0], total)


def _plain_mean(padded, compare, lookup, radius, offsets, mode, spread):
    one = lambda x, y: _TAPS[mode](padded, _moved(lookup, radius, x, y), compare)
    return _scan_mean(one, lookup.depth, offsets, spread)


@eqx.filter_custom_jvp
def _mean(padded, compare, lookup, radius, offsets, mode, spread):
    return _plain_mean(padded, compare, lookup, radius, offsets, mode, spread)


@_mean.def_jvp
def _mean_jvp(primals, tangents):
    """Each tap gives its derivatives by all of a receiver's numbers at once, in reverse mode, and they are summed as
    the taps are: a Jacobian then costs the same for any number of parameters."""
    padded, compare, lookup, radius, offsets, mode, spread = primals
    d_padded, d_compare, d_lookup, d_radius, *_ = tangents

    def one(x: Array, y: Array) -> Any:
        def tap(texel: Array, depth: Array, depth_per_texel: Array) -> Visibility:
            return _TAPS[mode](padded, Lookup(texel, depth, depth_per_texel, lookup.inside), compare)

        moved = _moved(lookup, radius, x, y)
        value, pull = jax.vjp(tap, moved.texel, moved.depth, moved.depth_per_texel)
        by_texel, by_depth, by_unit = pull(jnp.ones_like(value))
        by_radius = by_texel[..., 0] * x + by_texel[..., 1] * y
        return value, by_texel, by_depth, by_unit, by_radius

    like = (lookup.depth, lookup.texel, lookup.depth, lookup.depth, lookup.depth)
    value, by_texel, by_depth, by_unit, by_radius = _scan_mean(one, like, offsets, spread)
    tangent = jnp.zeros_like(value)
    if d_lookup is not None:
        if d_lookup.texel is not None:
            tangent = tangent + jnp.sum(by_texel * d_lookup.texel, axis=-1)
        if d_lookup.depth is not None:
            tangent = tangent + by_depth * d_lookup.depth
        if d_lookup.depth_per_texel is not None:
            tangent = tangent + by_unit * d_lookup.depth_per_texel
    if d_radius is not None:
        tangent = tangent + by_radius * d_radius
    # A map or a compare that itself changes cannot be summed up per receiver.
    for_map = lambda padded: _plain_mean(padded, compare, lookup, radius, offsets, mode, spread)
    for_compare = lambda compare: _plain_mean(padded, compare, lookup, radius, offsets, mode, spread)
    for function, primal, d in ((for_map, padded, d_padded), (for_compare, compare, d_compare)):
        if any(leaf is not None for leaf in jax.tree.leaves(d)):
            tangent = tangent + eqx.filter_jvp(function, (primal,), (d,))[1]
    return value, tangent
