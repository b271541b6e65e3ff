"""Corrections by silhouettes to a sum of compares over texels.

Few of the texels that are read have a silhouette, and such a texel costs many times a plain one. So the sum over stored
depths is evaluated everywhere, and then corrected for each texel with a silhouette. Under a hard compare only if the
receiver lies between the depths of its parts: beyond both, or before both, they compare alike.
"""

from operator import itemgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from ..._misc import a_step, take
from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from ..kernels._kernel import Footprint, Span
from ..kernels._padded_map import PaddedMap
from ..kernels._terms import KEPT, AbstractTerms, At, zeros_like
from ._half_planes import Rectangle
from ._padded import may_part
from ._set_bits import SetBits, empty_words, put_bits

# Texels with silhouettes per iteration of the loop over them, on a CPU and on a GPU.
_TEXELS_A_STEP = 1 << 14, 1 << 18


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
        shape, steps = at[1].depth.shape, jax.tree.map(jnp.asarray, steps)
        found, texels = _find(padded, compare, at, steps)
        at = rearranged(at, lambda a: a.reshape(-1))
        pixels, at_once = at[1].depth.size, a_step(*_TEXELS_A_STEP)

        def values_at(row: Int[Array, " t"], pixel: Int[Array, " t"]) -> Any:
            number = row // texels
            place = jnp.unravel_index(pixel, shape)

            def at_step(s: Array) -> Array:
                """Steps are numbers, or tables, which are repeated along axes of length 1."""
                index = (0 if size == 1 else i for i, size in zip(place, s.shape[1:], strict=False))
                return s.at[number, *index].get(mode="promise_in_bounds", wrap_negative_indices=False)

            here = rearranged(at, lambda a: take(a, pixel))
            return function(here, (jax.tree.map(at_step, steps), row % texels))

        @jax.checkpoint
        def add(total: Any, first: Int[Array, ""]) -> Any:
            exists = first + jnp.arange(at_once, dtype=jnp.int32) < found.count
            row, pixel = lax.optimization_barrier(found.locate(first, at_once))
            values = values_at(row, pixel)
            put = lambda total, values: total.at[pixel].add(jnp.where(exists, values, 0), mode="promise_in_bounds")
            return jax.tree.map(put, total, values)

        def step(total: Any, first: Int[Array, ""]) -> tuple[Any, None]:
            return lax.cond(first < found.count, add, lambda total, _: total, total, first), None

        most = jax.tree.leaves(steps)[0].shape[0] * texels * pixels
        all_pixels = jnp.zeros(pixels, jnp.int32)
        total = jax.tree.map(zeros_like, jax.eval_shape(values_at, all_pixels, all_pixels))
        total, _ = lax.scan(step, total, jnp.arange(0, most, at_once, dtype=jnp.int32))
        return jax.tree.map(lambda a: a.reshape(shape), total)


def _find(padded: PaddedMap, compare: AbstractCompare, at: At, steps: Any) -> tuple[SetBits, int]:
    """Which of the texels that each look-up reads in all steps may not compare alike in all of their parts, and how
    many texels a step reads."""
    kernel, lookup = at
    silhouettes = padded.silhouettes
    assert silhouettes is not None

    def differs(step: Any) -> list[Bool[Array, "*n"]]:
        footprint = kernel.footprint(lookup, step)

        def in_texel(place: Array, right: int, up: Array | int) -> Bool[Array, "*n"]:
            # Under a soft compare, the parts of nearly all texels differ.
            depth = None if compare.has_depth_derivative else footprint.depth(lookup, right, up)
            return may_part(take(silhouettes.bounds, place + (up * padded.stride + right)), depth)

        first = padded.place(footprint.column, footprint.row, lookup.layer)
        texels = [(i, j) for j in range(len(footprint.rows)) for i in range(len(footprint.columns))]
        return [in_texel(first, i, footprint.up + j) for i, j in texels]

    count = jax.tree.leaves(steps)[0].shape[0]
    texels = len(jax.eval_shape(differs, jax.tree.map(itemgetter(0), steps)))

    def mark(words: Any, at_step: Any) -> tuple[Any, None]:
        number, step = at_step
        return put_bits(words, number * texels, [bits.reshape(-1) for bits in differs(step)]), None

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
    """The change of the sum by the silhouette in the texel of this `number`, which must have one.

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
