"""Sums of compares over what kernels read: what every filter is made of.

A few steps of a kernel are written out in each step of a loop: they run as one fused expression, which a long chain of
them does not. Where casters end within texels, the sum over stored depths is corrected, texel by texel that has a
silhouette: these are few, and cost many times a plain one.
"""

import abc
import math
from collections.abc import Callable
from operator import itemgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._misc import round_up_to_power_of_two
from ._compare import AbstractCompare
from ._kernel import AbstractKernel, AbstractRow, Sites
from ._map import ShadowMap
from ._padded_map import PaddedMap, pad
from ._set_bits import SetBits, empty_words, put_bits

# What a step of the loop over a kernel's may cost, in nearest taps: more run no faster, and take longer to compile.
_COST_OF_A_STEP = 16
# A step with its derivatives, as against the step alone.
_COST_OF_DERIVATIVES = 2
# Pixels of a row that are laid out together: a vector's worth.
_VECTOR = 8
# What one step of the loop over pixels that are wanted takes, and of that over texels with silhouettes.
_PIXELS_A_STEP = 8192
_TEXELS_A_STEP = 16384


class Blocks(eqx.Module):
    """An image cut into the tiles of a pattern, without moving anything in memory.

    An image (h, w) becomes (h / rows, rows, w / columns, columns), of which a table (rows, 1, columns) is right for
    all tiles. Tiles narrower than a vector are repeated.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    @classmethod
    def of(cls, shape: tuple[int, ...], tile: int = 1) -> "Blocks":
        height, width = shape
        return cls((height, width), tile, tile * math.ceil(_VECTOR / tile))

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


def sum_over(
    kernel: AbstractKernel,
    padded: PaddedMap,
    compare: AbstractCompare,
    sites: Sites,
    steps: Any,
    wanted: Bool[Array, "i p j q"] | None = None,
) -> Array:
    """The sum of compares with all texels that a kernel reads.

    **Arguments:**

    - `sites`: the pixels of an image, (h, w), or its `Blocks`.
    - `steps`: what the kernel takes at each of its steps: a pytree of arrays whose first axis counts them. What is
        different for each pixel of a block has its axes as well, (n, rows, 1, columns). They carry no gradient.
    - `wanted`: of blocks, where the sum is wanted: it is 0 elsewhere. Everywhere if left out.

    Differentiable with respect to all but `steps`.
    """
    if wanted is None and padded.silhouettes is None:
        return _total(_Plain(kernel), padded, compare, sites, steps, None)
    if sites.depth.ndim == 2:
        blocks = Blocks.of(sites.depth.shape)
        return blocks.join(sum_over(kernel, padded, compare, sites.map(blocks.cut), steps))
    held = padded.silhouettes is not None and not _sees_depths(compare, sites)
    plain = _total(_Plain(kernel), padded, compare, sites.held() if held else sites, steps, wanted)
    if padded.silhouettes is None:
        return plain
    near = padded.silhouettes.texels.any_within(sites.x, sites.y, sites.layer, kernel.reach(sites, steps))
    near = near if wanted is None else near & wanted
    return plain + _total(_Corrections(kernel, held), padded, compare, sites, steps, near)


def sum_over_rows(row: AbstractRow, shadow_map: ShadowMap, compare: AbstractCompare, sites: Sites) -> Array:
    """The sum of compares with the texels of all rows, for sites that are the pixels of an image."""
    return sum_over(row, pad(shadow_map, row.texels), compare, sites, np.arange(row.texels))


class _AbstractTerms(eqx.Module):
    """What is summed up, and how."""

    kernel: AbstractKernel

    @abc.abstractmethod
    def term(self, padded: PaddedMap, compare: AbstractCompare, sites: Sites, step: Any) -> Float[Array, "*n"]:
        """What sites get at a step."""

    @abc.abstractmethod
    def add_up(self, function: Callable[[Sites, Any], Any], padded: PaddedMap, sites: Sites, steps: Any) -> Any:
        """The sum of `function(sites, step)`, arrays for the sites, over all steps."""


class _Plain(_AbstractTerms):
    """Compares with stored depths, one step of the kernel after another."""

    def term(self, padded, compare, sites, step):
        return self.kernel.footprint(sites, step).lit(padded, compare, sites)

    def add_up(self, function, padded, sites, steps):
        like = jax.eval_shape(function, sites, jax.tree.map(itemgetter(0), steps))
        with_derivatives = len(jax.tree.leaves(like)) > 1
        cost = self.kernel.cost * (_COST_OF_DERIVATIVES if with_derivatives else 1)
        count = jax.tree.leaves(steps)[0].shape[0]
        at_once = math.ceil(count / math.ceil(count * cost / _COST_OF_A_STEP))

        def add(total: Any, sites: Sites, some: Any) -> Any:
            for i in range(jax.tree.leaves(some)[0].shape[0]):
                one = jax.tree.map(jnp.asarray, jax.tree.map(itemgetter(i), some))
                total = jax.tree.map(jnp.add, total, function(sites, one))
            return total

        def step(total: Any, some: Any) -> tuple[Any, None]:
            # Else all steps would read from memory what one of them could work out.
            return add(total, *lax.optimization_barrier((sites, some))), None

        total, loops = jax.tree.map(_zeros, like), count // at_once
        if loops > 1:
            head = jax.tree.map(lambda s: s[: loops * at_once].reshape(loops, at_once, *s.shape[1:]), steps)
            total, _ = lax.scan(step, total, head)
            steps = jax.tree.map(lambda s: s[loops * at_once :], steps)
        # Else every step would work out for itself where the look-ups are.
        total = add(total, lax.optimization_barrier(sites), steps)
        # Else XLA runs through the pixels as whoever reads the sum lays them out, and no longer vectorizes. One by one,
        # since derivatives need the sum before they are there themselves.
        return jax.tree.map(lax.optimization_barrier, total)


class _Corrections(_AbstractTerms):
    """What silhouettes change, one texel after another that has one; a step is a kernel's and the texel's number.

    - `moves_outlines`: whether a site that moves counts as if outlines moved the other way, and all else with it.
    """

    moves_outlines: bool = eqx.field(static=True)

    def term(self, padded, compare, sites, step):
        step, number = step
        if not self.moves_outlines:
            return self.kernel.footprint(sites, step).correction(padded, compare, sites, number)
        here = sites.held()
        # No motion, but its derivative.
        motion = here.x - sites.x, here.y - sites.y
        return self.kernel.footprint(here, step).correction(padded, compare, here, number, motion)

    def add_up(self, function, padded, sites, steps):
        shape = sites.depth.shape
        flat = lambda a: a.reshape(-1)
        # A step's number, or its table, which gets a row for each step of all sites.
        wide = lambda s: (
            jnp.asarray(s) if s.ndim == 1 else jnp.broadcast_to(s, (s.shape[0], *shape)).reshape(s.shape[0], -1)
        )
        sites, steps = sites.map(flat), jax.tree.map(wide, steps)
        found, texels = self._find(padded, sites, steps)

        def values_at(row: Int[Array, " t"], pixel: Int[Array, " t"]) -> Any:
            number = row // texels
            at_step = lambda s: s[number] if s.ndim == 1 else s[number, pixel]
            here = sites.map(lambda a: a.at[pixel].get(mode="promise_in_bounds"))
            return function(here, (jax.tree.map(at_step, steps), row % texels))

        @jax.checkpoint
        def add(total: Any, first: Int[Array, ""]) -> Any:
            exists = first + jnp.arange(_TEXELS_A_STEP, dtype=jnp.int32) < found.count
            row, pixel = lax.optimization_barrier(found.locate(first, _TEXELS_A_STEP))
            values = values_at(row, pixel)
            put = lambda total, values: total.at[pixel].add(jnp.where(exists, values, 0), mode="promise_in_bounds")
            return jax.tree.map(put, total, values)

        def step(total: Any, first: Int[Array, ""]) -> tuple[Any, None]:
            return lax.cond(first < found.count, add, lambda total, _: total, total, first), None

        most = jax.tree.leaves(steps)[0].shape[0] * texels * sites.depth.size
        all_pixels = jnp.zeros(sites.depth.size, jnp.int32)
        total = jax.tree.map(_zeros, jax.eval_shape(values_at, all_pixels, all_pixels))
        total, _ = lax.scan(step, total, jnp.arange(0, most, _TEXELS_A_STEP, dtype=jnp.int32))
        return jax.tree.map(lambda a: a.reshape(shape), total)

    def _find(self, padded: PaddedMap, sites: Sites, steps: Any) -> tuple[SetBits, int]:
        """Which of the texels that each site reads, step after step, have a silhouette, and how many a step reads."""
        places = lambda step: self.kernel.footprint(sites, step).places(padded, sites)
        count = jax.tree.leaves(steps)[0].shape[0]
        texels = len(jax.eval_shape(places, jax.tree.map(itemgetter(0), steps)))

        def mark(words: Any, at: Any) -> tuple[Any, None]:
            number, step = at
            return put_bits(words, number * texels, [padded.has_silhouette(*place) for place in places(step)]), None

        words = empty_words(count * texels, sites.depth.size)
        words, _ = lax.scan(mark, words, (jnp.arange(count, dtype=jnp.int32), steps))
        return SetBits(words), texels


def _sum(
    terms: _AbstractTerms,
    padded: PaddedMap,
    compare: AbstractCompare,
    sites: Sites,
    steps: Any,
    wanted: Bool[Array, "i p j q"] | None,
) -> Any:
    """The sum of all terms, where it is `wanted`, and 0 elsewhere."""
    one = lambda sites, step: terms.term(padded, compare, sites, step)
    some = lambda sites: terms.add_up(one, padded, sites, steps)
    return some(sites) if wanted is None else _where_wanted(some, sites, wanted)


_total: Any = eqx.filter_custom_jvp(_sum)


@_total.def_jvp
def _total_jvp(primals, tangents):
    """Each term gives its derivatives by all of a site's numbers at once, in reverse mode, and they are summed as the
    terms are: a Jacobian then costs the same for any number of parameters. What changes with the map or the compare
    cannot be summed up per site, and is added up beside."""
    terms, padded, compare, sites, steps, wanted = primals
    _, d_padded, d_compare, d_sites, _, _ = tangents
    # A radius of all has a derivative at each site.
    sites = eqx.tree_at(lambda s: s.radius, sites, jnp.broadcast_to(sites.radius, sites.depth.shape))
    moves = jax.tree.map(lambda d: d is not None, d_sites, is_leaf=_is_none)
    if not _sees_depths(compare, sites):
        d_padded = _without_depths(d_padded)

    def one(sites: Sites, step: Any) -> Any:
        moving, still = eqx.partition(sites, moves)
        value, pull = jax.vjp(lambda moving: terms.term(padded, compare, eqx.combine(moving, still), step), moving)
        beside = lambda padded, compare: terms.term(padded, compare, sites, step)
        change = eqx.filter_jvp(beside, (padded, compare), (d_padded, d_compare))[1]
        return value, pull(jnp.ones_like(value))[0], change

    some = lambda sites: terms.add_up(one, padded, sites, steps)
    value, slopes, change = some(sites) if wanted is None else _where_wanted(some, sites, wanted)
    tangent = jnp.zeros_like(value) if change is None else change
    for slope, d in zip(jax.tree.leaves(slopes), jax.tree.leaves(d_sites), strict=True):
        tangent = tangent + slope * d
    return value, tangent


def _sees_depths(compare: AbstractCompare, sites: Sites) -> bool:
    """Whether visibility changes as stored depths do, by the little of a soft compare: a hard one never sees it."""
    against = lambda stored: compare(stored, sites.depth, sites.depth_per_texel)
    change = lambda: eqx.filter_jvp(against, (sites.depth,), (sites.depth,))[1]
    return eqx.filter_eval_shape(change) is not None


def _without_depths(change: Any) -> Any:
    """A map's tangent, less that of its depths: else it would be worked out for the whole map though none sees it."""
    outlined = change.silhouettes is not None
    of_outline = lambda d: (d.silhouettes.map.inner, d.silhouettes.map.outer) if outlined else ()
    return eqx.tree_at(lambda d: (d.depth, *of_outline(d)), change, replace_fn=lambda _: None, is_leaf=_is_none)


def _where_wanted(function: Callable[[Sites], Any], sites: Sites, wanted: Bool[Array, "i p j q"]) -> Any:
    """What a function gives, arrays for sites laid out by `Blocks`, where that is `wanted`; 0 elsewhere.

    Runs of `q` pixels that hold a wanted one are gathered, those of each of a block's rows together so that a table
    of offsets still fits, and taken a fixed number at a time. Steps that find none left do nothing.
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
    def some(own: Int[Array, "p n"]) -> Any:
        held = jnp.minimum(own, runs - 1)
        return function(sites.map(lambda a: a.reshape(runs, q).at[held].get(mode="promise_in_bounds")))

    like = jax.eval_shape(some, queue[0])
    none = lambda own: jax.tree.map(_zeros, like)
    step = lambda at: lax.cond(at[0] * a_step < most, some, none, at[1])
    values = lax.map(step, (jnp.arange(room // a_step, dtype=jnp.int32), queue))
    # No run is put twice; what is added up, unlike what is set, has a transpose.
    put = lambda values: jnp.zeros((runs, q), values.dtype).at[queue].add(values, mode="drop").reshape(wanted.shape)
    return jax.tree.map(lambda values: jnp.where(wanted, put(values), 0), values)


def _zeros(like: jax.ShapeDtypeStruct) -> Array:
    return jnp.zeros(like.shape, like.dtype)


def _is_none(x: Any) -> bool:
    return x is None
