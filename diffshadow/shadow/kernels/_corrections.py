"""Corrections by silhouettes to a sum of compares over texels.

A texel with a silhouette has two parts with different depths. Its correction is the kernel's weight times the change of
the compare: the mean over the covered part of the texel, minus the compare with the stored depth. Each pair of a
look-up (*n,) and a texel that it reads has a correction. The sums of a look-up's corrections are (*n,), like the
kernel's sums.

Few texels have a silhouette, and such a texel costs many times as much as a plain one. The sum over stored depths is
therefore evaluated everywhere, and then corrected for each texel with a silhouette. Under a hard compare, this is only
necessary if the receiver is between the depths of the texel's parts. Otherwise, both parts give the same result.
"""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import for_any, take
from ..._device import chunk_size
from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from ..silhouettes import Rectangle
from ._kernel import Footprint, Span
from ._padded_map import PaddedMap
from ._padded_silhouettes import may_part
from ._set_bits import WIDTH, SetBits, empty_words, put_bits
from ._terms import KEPT, AbstractTerms, At, checkpoint, zeros_like

# The number of look-ups, and of texels with silhouettes, per iteration of the loops over them, on a CPU and on a GPU.
# Arrays with a power-of-two size would begin in the same sets of a CPU's cache. A kernel that reads 26 of them took
# twice as long.
_LOOKUPS_AT_ONCE = (1 << 13) + 16, 1 << 18
_TEXELS_AT_ONCE = (1 << 14) + 16, 1 << 20


class Corrections(AbstractTerms):
    """The correction of each texel that has a silhouette. A step is a pair: the kernel's step and the texel's number.

    - `follows_outlines`: whether a look-up's motion has the derivative of the outlines' opposite motion.
    """

    follows_outlines: bool = eqx.field(static=True)

    def term(self, padded, compare, at, step):
        kernel, lookup = at
        step, number = step
        if not self.follows_outlines:
            return _correction(kernel.footprint(lookup, step), padded, compare, lookup, number, None)
        here = lookup.detached()
        # Zero, with the derivative of the opposite motion.
        motion = here.x - lookup.x, here.y - lookup.y
        return _correction(kernel.footprint(here, step), padded, compare, here, number, motion)

    def add_up(self, function, padded, compare, at, steps):
        """The sum for look-ups (n,), with tables of steps that have a column for each look-up, as `where` gathers
        them."""
        found, texels = _find(padded, compare, at, steps)

        def values_at(row: Int[Array, " t"], lookup: Int[Array, " t"]) -> Any:
            number = row // texels
            at_step = lambda s: take(s, number) if s.ndim == 1 else take(s.reshape(-1), number * s.shape[1] + lookup)
            here = rearranged(at, lambda a: take(a, lookup))
            return lookup, function(here, (jax.tree.map(at_step, steps), row % texels))

        lookups, count = at[1].depth.size, jax.tree.leaves(steps)[0].shape[0]
        return _sums(found, values_at, lookups, count * texels * lookups, chunk_size(*_TEXELS_AT_ONCE))

    def where(self, active, function, at, steps):
        """Gathers single look-ups, because few are active."""
        shape, size, steps = active.shape, active.size, jax.tree.map(jnp.asarray, steps)
        at = rearranged(at, lambda a: a.reshape(-1))

        def values_at(bit: Int[Array, " n"], word: Int[Array, " n"]) -> Any:
            lookup = jnp.minimum(word * WIDTH + bit, size - 1)
            # Without the barrier, XLA computes these again for each number of a table.
            lookup, place = lax.optimization_barrier((lookup, jnp.unravel_index(lookup, shape)))

            def own(table: Array) -> Array:
                """A column of the table for each look-up. Its last axes equal the look-ups' axes, or have length 1."""
                count, *sizes = table.shape
                if not sizes:
                    return table
                index = jnp.arange(count, dtype=jnp.int32)[:, None]
                for n, i in zip(sizes, place[-len(sizes) :], strict=True):
                    index = index * n + (i if n > 1 else 0)
                return take(table.reshape(-1), index)

            here = rearranged(at, lambda a: take(a, lookup))
            return lookup, function(here, jax.tree.map(own, steps))

        sums = _sums(SetBits.of(active.reshape(-1)), values_at, size, size, chunk_size(*_LOOKUPS_AT_ONCE))
        return jax.tree.map(lambda a: a.reshape(shape), sums)


def _sums(
    found: SetBits,
    values_at: Callable[[Int[Array, " b"], Int[Array, " b"]], tuple[Int[Array, " b"], Any]],
    size: int,
    most: int,
    at_once: int,
) -> Any:
    """Sums (size,) of the values at set bits, at most `most`. Each iteration adds `at_once`.

    From rows and columns of set bits, `values_at` returns indices into the sums, and the values to add there.
    """
    at_once = min(at_once, most)

    @checkpoint
    def add(total: Any, first: Int[Array, ""]) -> Any:
        row, column, exists = lax.optimization_barrier(found.locate(first, at_once))
        place, values = values_at(row, column)
        put = lambda total, values: total.at[place].add(jnp.where(exists, values, 0), mode="promise_in_bounds")
        return jax.tree.map(put, total, values)

    def step(total: Any, first: Int[Array, ""]) -> tuple[Any, None]:
        return lax.cond(for_any(first < found.count), add, lambda total, _: total, total, first), None

    none = jnp.zeros(size, jnp.int32)
    total = jax.tree.map(zeros_like, jax.eval_shape(values_at, none, none)[1])
    return lax.scan(step, total, jnp.arange(0, most, at_once, dtype=jnp.int32))[0]


def _find(padded: PaddedMap, compare: AbstractCompare, at: At, steps: Any) -> tuple[SetBits, int]:
    """Which texels may have parts that compare differently, for each look-up in all steps, and the number of texels
    that a step reads."""
    kernel, lookup = at
    silhouettes = padded.silhouettes
    assert silhouettes is not None

    def differs(step: Any) -> list[Bool[Array, "*n"]]:
        footprint = kernel.footprint(lookup, step)

        def in_texel(place: Array, right: int, up: Array | int) -> Bool[Array, "*n"]:
            bounds = take(silhouettes.bounds, place + (up * padded.stride + right))
            # Under a soft compare, the parts of nearly all texels differ.
            if compare.has_depth_derivative:
                return may_part(bounds)
            depth = footprint.depth(lookup, right, up)
            return may_part(bounds, (depth, depth))

        first = padded.place(footprint.column, footprint.row, lookup.layer)
        texels = [(i, j) for j in range(len(footprint.rows)) for i in range(len(footprint.columns))]
        return [in_texel(first, i, footprint.up + j) for i, j in texels]

    count = jax.tree.leaves(steps)[0].shape[0]
    texels = len(jax.eval_shape(differs, jax.tree.map(itemgetter(0), steps)))

    def mark(words: Any, at_step: Any) -> tuple[Any, None]:
        number, step = at_step
        return put_bits(words, number * texels, differs(step)), None

    words = empty_words(count * texels, lookup.depth.size)
    words, _ = lax.scan(mark, words, (jnp.arange(count, dtype=jnp.int32), steps))
    return SetBits(checkpoint_name(words, KEPT)), texels


def _correction(
    footprint: Footprint,
    padded: PaddedMap,
    compare: AbstractCompare,
    lookup: Lookup,
    number: Int[Array, "*n"],
    motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None,
) -> Float[Array, "*n"]:
    """The change of the sum by the silhouette in the texel `number`, which must have one.

    The texel's compare is replaced by its mean over the part of the texel that the kernel covers. The outline is moved
    by `motion` if given.
    """
    i, j = number % len(footprint.columns), number // len(footprint.columns)
    column, row = _choose(footprint.columns, i), _choose(footprint.rows, j)
    place = padded.place(footprint.column, footprint.row, lookup.layer) + (footprint.up + j) * padded.stride + i
    depth = footprint.depth(lookup, i, footprint.up + j)
    against = lambda stored: compare(stored, depth, lookup.depth_per_texel)
    part = Rectangle(column.low, column.high, row.low, row.high)
    assert padded.silhouettes is not None
    slot, stored = take(padded.silhouettes.map.slot, place), take(padded.depth, place)
    return column.weight * row.weight * padded.silhouettes.change(against, stored, slot, part, motion)


def _choose(spans: Any, number: Int[Array, "*n"]) -> Span:
    chosen = spans[0]
    for i, span in enumerate(spans[1:], start=1):
        chosen = Span(*(jnp.where(number == i, new, old) for new, old in zip(span, chosen, strict=True)))
    return chosen
