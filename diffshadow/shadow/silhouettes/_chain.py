"""Chains of more than two edges within a texel, as two lines that meet in a corner.

The lines bound the same area as the chain, so that a texel's coverage and its derivative are those of the chain.
"""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import take
from ._outline import Outline

# Longer chains are not followed.
_MOST_VERTICES = 3
# How far from a texel's centre its vertices are, in texels, but for rounding.
_INSIDE = 0.5001
# In square texels: areas that do not count, so that no direction is left to rounding.
_NO_AREA = 1e-4
# Added to each vertex's weight, so that the weights of a straight chain are not all 0.
_LEAST_WEIGHT = 1e-6

_Point = tuple[Float[Array, " t"], Float[Array, " t"]]


class Corner(NamedTuple):
    """Where the two lines meet, and in which texels there is such a chain.

    The place carries the derivative of the area, but not that of where along the chain it is. `turn` is positive if
    the lines turn to the left, negative if to the right, and 0 if they hardly turn.
    """

    place: Float[Array, "t 2"]
    exists: Bool[Array, " t"]
    turn: Float[Array, " t"]


def corner_of_chain(
    outline: Outline,
    edges: tuple[Int[Array, " t"], Int[Array, " t"]],
    ends: tuple[Float[Array, "t 2"], Float[Array, "t 2"]],
    centre: Float[Array, "t 2"],
) -> Corner:
    """The corner that replaces the vertices of the outline within texels.

    **Arguments:**

    - `edges`: by which it enters and leaves, -1 for none; `ends`: where, relative to the texels' `centre`.
    """
    walk, arrived = _walk(outline, *edges)
    start, end = ((v[:, 0], v[:, 1]) for v in ends)
    chain = [start]
    inside = arrived[-1]
    for number, is_end in zip(walk, arrived[:-1], strict=True):
        vertex = take(outline.end, number)
        point = lax.optimization_barrier((vertex[:, 0] - centre[:, 0], vertex[:, 1] - centre[:, 1]))
        inside = inside & (is_end | (jnp.maximum(jnp.abs(point[0]), jnp.abs(point[1])) < _INSIDE))
        chain.append((jnp.where(is_end, end[0], point[0]), jnp.where(is_end, end[1], point[1])))
    chain.append(end)

    chord = _minus(end, start)
    still = [lax.stop_gradient(point) for point in chain]
    last = jnp.where(arrived[2], still[2][0], still[3][0]), jnp.where(arrived[2], still[2][1], still[3][1])
    length = jnp.hypot(*lax.stop_gradient(chord))
    exists = inside & ~arrived[1] & ~_cross_each_other((still[0], still[1]), (last, still[-1])) & (length > _NO_AREA)
    # The weight of a vertex vanishes where it leaves the texel: the corner is then at the other one.
    triples = zip(still, still[1:], still[2:], strict=False)
    weights = [jnp.abs(_cross(_minus(b, a), _minus(c, b))) + _LEAST_WEIGHT for a, b, c in triples]
    total = sum(weights)
    mean = [
        jnp.clip(sum(w * point[k] for w, point in zip(weights, still[1:-1], strict=True)) / total, -0.5, 0.5)
        for k in (0, 1)
    ]
    # Twice the area between the chain and the chord, and between the lines and the chord. From the mean of the
    # vertices, the corner lies across the chord, no further than at the texel's border.
    pairs = itertools.pairwise(chain[1:])
    doubled = sum(_cross(_minus(a, start), _minus(b, start)) for a, b in pairs)
    safe = jnp.where(exists, length, 1)
    normal = -still[-1][1] / safe + still[0][1] / safe, still[-1][0] / safe - still[0][0] / safe
    by_normal = jnp.where(exists, _cross(normal, chord), 1)
    away = (doubled - _cross(_minus((mean[0], mean[1]), start), chord)) / by_normal
    way = jnp.sign(lax.stop_gradient(away))
    to_border = [
        jnp.where(n == 0, 2, (0.5 - jnp.sign(way * n) * m) / jnp.where(n == 0, 1, jnp.abs(n)))
        for n, m in zip(normal, mean, strict=True)
    ]
    away = way * jnp.minimum(way * away, jnp.minimum(*to_border))
    place = mean[0] + away * normal[0], mean[1] + away * normal[1]
    turn = lax.stop_gradient(_cross(_minus(place, start), _minus(end, place)))
    return Corner(jnp.stack(place, axis=-1), exists, jnp.where(jnp.abs(turn) > _NO_AREA, turn, 0))


def _walk(
    outline: Outline, first: Int[Array, " t"], last: Int[Array, " t"]
) -> tuple[list[Int[Array, " t"]], list[Bool[Array, " t"]]]:
    """The edges of chains in their order, for each whether it is the last one, and then whether that was found.

    Behind the last edge, all are the same.
    """
    # Barriers: otherwise XLA walks again in each of the kernels that use the edges.
    edge = lax.optimization_barrier(jnp.maximum(first, 0))
    edges, arrived = [], [first == last]
    for _ in range(_MOST_VERTICES):
        edges.append(edge)
        following = take(outline.following, edge)
        edge = lax.optimization_barrier(jnp.where(arrived[-1] | (following < 0), edge, following))
        arrived.append(edge == last)
    known = (first >= 0) & (last >= 0)
    return edges, [*arrived[:-1], arrived[-1] & known]


def _cross_each_other(one: tuple[_Point, _Point], other: tuple[_Point, _Point]) -> Bool[Array, " t"]:
    """Whether segments do. Then the chain crosses itself, and the outline turns there."""

    def parts(a: tuple[_Point, _Point], b: tuple[_Point, _Point]) -> Bool[Array, " t"]:
        way = _minus(a[1], a[0])
        return _cross(way, _minus(b[0], a[0])) * _cross(way, _minus(b[1], a[0])) < 0

    return parts(one, other) & parts(other, one)


def _minus(a: _Point, b: _Point) -> _Point:
    return a[0] - b[0], a[1] - b[1]


def _cross(a: _Point, b: _Point) -> Float[Array, " t"]:
    return a[0] * b[1] - a[1] * b[0]
