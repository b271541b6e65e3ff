"""Look-ups in a shadow map, from which every filter is made.

Filters are sums of parts, such as taps. A few parts are written out in each step of a loop: they run as one fused
expression, which a long chain of them does not.
"""

import math
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._misc import round_up_to_power_of_two
from .._types import Mask, Visibility
from ._compare import AbstractCompare
from ._cut_rectangle import WHOLE_TEXEL, Rectangle
from ._lookup import Lookup
from ._map import ShadowMap
from ._padded_map import PaddedMap, pad
from .patterns import Pattern, interleaved_gradient_noise

TapMode = Literal["nearest", "bilinear"]

# What a step of the loop over parts may cost, in nearest taps: more run no faster, and take longer to compile.
_COST_OF_A_STEP = 16
# A tap where casters end within texels, as against a plain one.
_COST_OF_SILHOUETTES = 16
# A part with its derivatives, as against the part alone.
_COST_OF_DERIVATIVES = 2
# Pixels of a row that are laid out together: a vector's worth.
_VECTOR = 8
# Half the width of a square that stands for a point, in texels.
_POINT = 1 / 512
# Pixels that one step of the loop over those that are wanted takes.
_PIXELS_A_STEP = 8192


class Sites(eqx.Module):
    """Look-ups laid out in any way, and what the taps round them depend on.

    - `x`, `y`, `depth`, `depth_per_texel`, `slope`, `layer`, `deepest`: as in `Lookup`.
    - `radius`: in texels, of each or of all.
    - `turn`: cosine and sine of the angle by which each turns its pattern; none where none does.
    """

    x: Float[Array, "*n"]
    y: Float[Array, "*n"]
    depth: Float[Array, "*n"]
    depth_per_texel: Float[Array, "*n"]
    slope: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None
    layer: Int[Array, "*n"] | None
    radius: Float[Array, "..."]
    turn: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None
    deepest: Float[Array, "*n"] | None = None

    def map(self, function: Callable[[Array], Array]) -> "Sites":
        """With `function` of every array but a `radius` of all."""
        return jax.tree.map(lambda leaf: function(leaf) if leaf.ndim else leaf, self)

    def lit(
        self,
        padded: PaddedMap,
        compare: AbstractCompare,
        place: Array,
        x: Float[Array, "*n"],
        y: Float[Array, "*n"],
        right: Array | int = 0,
        up: Array | int = 0,
        part: Rectangle = WHOLE_TEXEL,
    ) -> Float[Array, "*n"]:
        """The compare with a texel, at whose centre the receiver's plane is met.

        It lies `right` and `up` of texel (x, y), which is stored at `place`. Where a caster ends in it, the mean over
        a `part` of it.
        """
        depth = self.depth
        if self.slope is not None:
            depth = depth + self.slope[0] * (x + right + 0.5 - self.x) + self.slope[1] * (y + up + 0.5 - self.y)
            depth = depth if self.deepest is None else jnp.minimum(depth, self.deepest)
        against = lambda stored: compare(stored, depth, self.depth_per_texel)
        return padded.mean(against, place, up * padded.stride + right, part)


def sites_of(lookup: Lookup, radius: Float[Array, "..."] | float = 0.0) -> Sites:
    """The look-ups, pixel by pixel."""
    slope = None if lookup.slope is None else (lookup.slope[..., 0], lookup.slope[..., 1])
    x, y, radius = lookup.texel[..., 0], lookup.texel[..., 1], jnp.asarray(radius)
    return Sites(x, y, lookup.depth, lookup.depth_per_texel, slope, lookup.layer, radius, deepest=lookup.deepest)


def nearest_tap(
    padded: PaddedMap, compare: AbstractCompare, sites: Sites, x: Float[Array, "*n"], y: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Compares with the texel that (x, y) falls into. Its gradient does not see the position.

    Where a caster ends in the texel, it is the side that (x, y) lies on that counts.
    """
    column, row = jnp.floor(x), jnp.floor(y)
    place = padded.place(column, row, sites.layer)
    if padded.silhouettes is None:
        return sites.lit(padded, compare, place, column, row)
    along = lambda p: (jnp.clip(p - _POINT, -0.5, 0.5), jnp.clip(p + _POINT, -0.5, 0.5))
    here = Rectangle(*along(x - column - 0.5), *along(y - row - 0.5))
    return sites.lit(padded, compare, place, column, row, part=here)


def bilinear_tap(
    padded: PaddedMap, compare: AbstractCompare, sites: Sites, x: Float[Array, "*n"], y: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Compares with the four texels round (x, y), and blends the four results (never the depths)."""
    u, v = x - 0.5, y - 0.5
    column, row = jnp.floor(u), jnp.floor(v)
    right, above = u - column, v - row
    place = padded.place(column, row, sites.layer)
    along = lambda share, i: (-0.5 + share, 0.5) if i == 0 else (-0.5, share - 0.5)
    lit = lambda i, j: sites.lit(
        padded, compare, place, column, row, i, j, Rectangle(*along(right, i), *along(above, j))
    )
    lower = lit(0, 0) * (1 - right) + lit(1, 0) * right
    upper = lit(0, 1) * (1 - right) + lit(1, 1) * right
    return lower * (1 - above) + upper * above


_TAPS = {"nearest": nearest_tap, "bilinear": bilinear_tap}
_COSTS = {"nearest": 1.0, "bilinear": 4.0}


def single_tap(shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare, mode: TapMode) -> Visibility:
    """One compare a receiver."""
    sites, padded = sites_of(lookup), pad(shadow_map)
    if shadow_map.silhouettes is None:
        return _TAPS[mode](padded, compare, sites, sites.x, sites.y)
    here = jnp.zeros(1, sites.x.dtype)
    return sum_of_parts(_DiskTap(mode), padded, compare, sites, (here, here))


class _DiskTap(eqx.Module):
    """A tap at `radius · offset`."""

    mode: TapMode = eqx.field(static=True)

    def __call__(self, padded: PaddedMap, compare: AbstractCompare, sites: Sites, offset: tuple[Array, Array]) -> Array:
        x, y = offset
        if sites.turn is not None:
            cosine, sine = sites.turn
            x, y = cosine * x - sine * y, sine * x + cosine * y
        return _TAPS[self.mode](padded, compare, sites, sites.x + sites.radius * x, sites.y + sites.radius * y)

    @property
    def cost(self) -> float:
        return _COSTS[self.mode]

    def reach(self, sites: Sites, offsets: tuple[Array, Array]) -> Float[Array, "..."]:
        x, y = offsets
        farthest = jnp.sqrt(jnp.max(x * x + y * y))
        return sites.radius * farthest + (0.5 if self.mode == "bilinear" else 0.0)


def mean_of_taps(
    shadow_map: ShadowMap,
    lookup: Lookup,
    compare: AbstractCompare,
    radius: Float[Array, "..."],
    pattern: Pattern,
    mode: TapMode,
    wanted: Mask | None = None,
) -> Visibility:
    """The mean of taps at `texel + radius · offset`.

    **Arguments:**

    - `radius`: in texels, a scalar or one for each receiver.
    - `pattern`: the offsets of each receiver, as the pixels of an image.
    - `mode`: `"nearest"` or `"bilinear"` taps; nearest ones give `radius` and position no gradient.
    - `wanted`: the receivers whose mean is wanted, (h, w): others are 0, and most of them cost nothing. All if left
        out.

    Differentiable with respect to all but `pattern`.
    """
    sites = sites_of(lookup, radius)
    if pattern.rotated:
        angle = 2 * jnp.pi * interleaved_gradient_noise(lookup.depth.shape).astype(lookup.depth.dtype)
        sites = eqx.tree_at(lambda s: s.turn, sites, (jnp.cos(angle), jnp.sin(angle)), is_leaf=_is_none)
    blocks = _Blocks.of(pattern, lookup.depth.shape)
    sites, offsets = sites.map(blocks.cut), blocks.table(pattern)
    arguments = _DiskTap(mode), pad(shadow_map), compare, sites, offsets
    return blocks.join(_sum_in_blocks(*arguments, None if wanted is None else blocks.cut(wanted))) / pattern.samples


class _Blocks(eqx.Module):
    """An image cut into the tiles of a pattern, without moving anything in memory.

    An image (h, w) becomes (h / rows, rows, w / columns, columns), of which a table (rows, 1, columns) is right for
    all tiles. Tiles narrower than a vector are repeated.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    @classmethod
    def of(cls, pattern: Pattern, shape: tuple[int, ...]) -> "_Blocks":
        size, (height, width) = pattern.offsets.shape[1], shape
        return cls((height, width), size, size * math.ceil(_VECTOR / size))

    @property
    def _padding(self) -> tuple[tuple[int, int], tuple[int, int]]:
        height, width = self.shape
        return (0, -height % self.rows), (0, -width % self.columns)

    def cut(self, image: Array) -> Array:
        # Pixels that fill up the last blocks are copies: whatever is evaluated there is as harmless as elsewhere.
        padded = jnp.pad(image, self._padding, mode="edge") if any(after for _, after in self._padding) else image
        height, width = padded.shape
        return padded.reshape(height // self.rows, self.rows, width // self.columns, self.columns)

    def join(self, blocks: Array) -> Array:
        height, width = self.shape
        return blocks.reshape(blocks.shape[0] * self.rows, -1)[:height, :width]

    def table(self, pattern: Pattern) -> tuple[Float[Array, "n p 1 q"], Float[Array, "n p 1 q"]]:
        offsets = lax.stop_gradient(pattern.offsets)
        wide = jnp.tile(offsets, (1, 1, self.columns // self.rows, 1))[:, :, None]
        # Else each tap would cut its own offset out of the pattern, at every pixel.
        return lax.optimization_barrier((wide[..., 0], wide[..., 1]))


def _plain_sum(part: Any, padded: PaddedMap, compare: AbstractCompare, sites: Sites, steps: Any) -> Array:
    one = lambda sites, step: part(padded, compare, sites, step)
    return _scan_sum(one, sites, sites.depth, steps, _cost(part, padded))


def _cost(part: Any, padded: PaddedMap) -> float:
    return part.cost * (1 if padded.silhouettes is None else _COST_OF_SILHOUETTES)


def _scan_sum(one: Callable[[Any, Any], Any], sites: Any, like: Any, steps: Any, cost: float) -> Any:
    """The sum of `one(sites, step)` over `steps`, arrays like `like`."""
    count = jax.tree.leaves(steps)[0].shape[0]
    at_once = math.ceil(count / math.ceil(count * cost / _COST_OF_A_STEP))

    def add(total: Any, sites: Any, some: Any) -> Any:
        for i in range(jax.tree.leaves(some)[0].shape[0]):
            total = jax.tree.map(
                jnp.add, total, one(sites, jax.tree.map(jnp.asarray, jax.tree.map(itemgetter(i), some)))
            )
        return total

    def step(total: Any, some: Any) -> tuple[Any, None]:
        # Else all parts would read from memory what one of them could work out.
        return add(total, *lax.optimization_barrier((sites, some))), None

    total, loops = jax.tree.map(jnp.zeros_like, like), count // at_once
    if loops > 1:
        head = jax.tree.map(lambda s: s[: loops * at_once].reshape(loops, at_once, *s.shape[1:]), steps)
        total, _ = lax.scan(step, total, head)
        steps = jax.tree.map(lambda s: s[loops * at_once :], steps)
    # Else every part would work out for itself where the look-ups are.
    total = add(total, lax.optimization_barrier(sites), steps)
    # Else XLA runs through the pixels as whoever reads the sum lays them out, and no longer vectorizes.
    return lax.optimization_barrier(total)


def sum_of_parts(part: Any, padded: PaddedMap, compare: AbstractCompare, sites: Sites, steps: Any) -> Array:
    """The sum of `part(padded, compare, sites, step)` over `steps`, for sites that are the pixels of an image.

    **Arguments:**

    - `part`: a module with that method, which treats each site by itself, with its `cost` in nearest taps, and with
        `reach(sites, steps)`: half the width of a square round a site that holds all that it reads, in texels.
    - `steps`: a pytree of arrays whose first axis counts the parts. They carry no gradient.
    """
    if padded.silhouettes is None:
        return _sum_of_parts(part, padded, compare, sites, steps)
    height, width = sites.depth.shape
    blocks = _Blocks((height, width), 1, _VECTOR)
    return blocks.join(_sum_in_blocks(part, padded, compare, sites.map(blocks.cut), steps, None))


def _sum_in_blocks(
    part: Any, padded: PaddedMap, compare: AbstractCompare, sites: Sites, steps: Any, wanted: Array | None
) -> Float[Array, "i p j q"]:
    """`sum_of_parts` for sites laid out by `_Blocks`, where it is `wanted`, and 0 elsewhere."""
    add = _sum_of_parts if wanted is None else partial(_sum_where_wanted, wanted=wanted)
    plain = add(part, padded.without_silhouettes(), compare, sites, steps)
    if padded.silhouettes is None:
        return plain
    # Few receivers see one, and it costs many times a plain texel.
    near = padded.silhouettes.texels.any_within(sites.x, sites.y, sites.layer, part.reach(sites, steps))
    near = near if wanted is None else near & wanted
    return jnp.where(near, _sum_where_wanted(part, padded, compare, sites, steps, near), plain)


@eqx.filter_custom_jvp
def _sum_of_parts(part: Any, padded: PaddedMap, compare: AbstractCompare, sites: Sites, steps: Any) -> Array:
    """The sum of `part(padded, compare, sites, step)` over `steps`, for sites laid out in any way."""
    return _plain_sum(part, padded, compare, sites, steps)


@_sum_of_parts.def_jvp
def _sum_of_parts_jvp(primals, tangents):
    """Each part gives its derivatives by all of a site's numbers at once, in reverse mode, and they are summed as the
    parts are: a Jacobian then costs the same for any number of parameters."""
    part, padded, compare, sites, steps = primals
    _, d_padded, d_compare, d_sites, _ = tangents
    # A radius of all has a derivative at each site.
    sites = eqx.tree_at(lambda s: s.radius, sites, jnp.broadcast_to(sites.radius, sites.depth.shape))
    moving = jax.tree.map(lambda d: d is not None, d_sites, is_leaf=_is_none)
    moving, still = eqx.partition(sites, moving)

    def one(at: tuple[Sites, Sites], step: Any) -> Any:
        value, pull = jax.vjp(lambda moving: part(padded, compare, eqx.combine(moving, at[1]), step), at[0])
        return value, pull(jnp.ones_like(value))[0]

    cost = _COST_OF_DERIVATIVES * _cost(part, padded)
    value, slopes = _scan_sum(one, (moving, still), (sites.depth, moving), steps, cost)
    tangent = jnp.zeros_like(value)
    for slope, d in zip(jax.tree.leaves(slopes), jax.tree.leaves(d_sites), strict=True):
        tangent = tangent + slope * d
    # A map or a compare that itself changes cannot be summed up per site.
    for_map = lambda padded: _plain_sum(part, padded, compare, sites, steps)
    for_compare = lambda compare: _plain_sum(part, padded, compare, sites, steps)
    for function, primal, d in ((for_map, padded, d_padded), (for_compare, compare, d_compare)):
        if any(leaf is not None for leaf in jax.tree.leaves(d)):
            change = eqx.filter_jvp(function, (primal,), (d,))[1]
            # A hard compare does not see the map move.
            tangent = tangent if change is None else tangent + change
    return value, tangent


def _sum_where_wanted(
    part: Any,
    padded: PaddedMap,
    compare: AbstractCompare,
    sites: Sites,
    steps: Any,
    wanted: Bool[Array, "i p j q"],
) -> Float[Array, "i p j q"]:
    """The sum where it is `wanted` and 0 elsewhere, for sites laid out by `_Blocks`.

    Runs of `q` pixels that hold a wanted one are gathered, those of each of a block's rows together so that a table
    of offsets still fits, and summed a fixed number at a time. Steps that find none left do nothing.
    """
    i, p, j, q = wanted.shape
    runs = i * p * j
    chosen = jnp.moveaxis(jnp.any(wanted, axis=-1), 1, 0).reshape(p, i * j)
    number = jnp.moveaxis(jnp.arange(runs, dtype=jnp.int32).reshape(i, p, j), 1, 0).reshape(p, i * j)
    rank = jnp.cumsum(chosen, axis=1, dtype=jnp.int32) - 1
    most = jnp.max(rank) + 1
    a_step = min(i * j, round_up_to_power_of_two(max(1, _PIXELS_A_STEP // (p * q))))
    room = math.ceil(i * j / a_step) * a_step
    # Runs that are not chosen go to a place that is never read, and places that no run takes name none.
    queue = jnp.full((p, room + 1), runs, jnp.int32)
    queue = queue.at[jnp.arange(p)[:, None], jnp.where(chosen, rank, room)].set(number, mode="promise_in_bounds")
    queue = jnp.moveaxis(queue[:, :-1].reshape(p, room // a_step, a_step), 1, 0)

    @jax.checkpoint
    def some(own: Int[Array, "p n"]) -> Float[Array, "p n q"]:
        held = jnp.minimum(own, runs - 1)
        gathered = sites.map(lambda a: a.reshape(runs, q).at[held].get(mode="promise_in_bounds"))
        return _sum_of_parts(part, padded, compare, gathered, steps)

    none = lambda own: jnp.zeros((*own.shape, q), sites.depth.dtype)
    step = lambda at: lax.cond(at[0] * a_step < most, some, none, at[1])
    values = lax.map(step, (jnp.arange(room // a_step, dtype=jnp.int32), queue))
    total = jnp.zeros((runs, q), sites.depth.dtype).at[queue].set(values, mode="drop")
    return jnp.where(wanted, total.reshape(wanted.shape), 0)


def _is_none(x: Any) -> bool:
    return x is None
