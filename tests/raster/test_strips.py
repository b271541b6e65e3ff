"""Points in strips: every point is found by every query that it answers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import marked

from diffshadow.raster._strips import BLOCK, in_strips

POINTS = 3000


def spread(rng, how):
    if how == "even":
        return rng.random((2, POINTS))
    if how == "clustered":
        return np.clip(0.3 + rng.normal(size=(2, POINTS)) * 10.0 ** rng.uniform(-6, 0, POINTS), 0, 1)
    # Few places, each of many points.
    return rng.choice([0.0, 0.1, 0.25, 1.0], (2, POINTS))


@pytest.mark.exhaustive
@pytest.mark.parametrize("how", ["even", "clustered", "at few places"])
@pytest.mark.parametrize("share", marked([1.0, 0.3, 0.0], [1.0]))
def test_every_point_of_a_part_of_the_view_is_found(how, share):
    rng = np.random.default_rng(4)
    x, y = spread(rng, how)
    valid = rng.random(POINTS) < share
    # Parts of the view, of which some have no height or no width, and some reach beyond it or are empty.
    middle, half = rng.random((2, 200)), 10.0 ** rng.uniform(-6, 0.3, (2, 200))
    (left, low), (right, high) = middle - half, middle + half
    low[:40] = high[:40] = rng.choice(y, 40)
    left[20:60] = right[20:60] = rng.choice(x, 40)
    left[60:70], right[60:70] = np.inf, -np.inf
    with jax.enable_x64(True):
        strips = jax.jit(in_strips)(jnp.asarray(x), jnp.asarray(y), jnp.asarray(valid))
        order, margin = np.asarray(strips.order), 1e-8
        first, count = map(np.asarray, jax.jit(type(strips).strips_between)(strips, low - margin, high + margin))
        query = np.repeat(np.arange(200), count)
        strip = np.concatenate([f + np.arange(c) for f, c in zip(first, count, strict=True)])
        given = strip.astype(np.int32), left[query] - margin, right[query] + margin
        block, blocks = map(np.asarray, jax.jit(type(strips).blocks_between)(strips, *given))
    assert sorted(order.ravel()[order.ravel() < POINTS]) == list(range(POINTS))
    assert (first + count <= len(strips.low)).all()
    assert (block // strips.blocks == strip)[blocks > 0].all()
    assert ((block + blocks - 1) // strips.blocks == strip)[blocks > 0].all()
    visited = 0
    for number in range(200):
        mine = query == number
        parts = [order[b : b + n].ravel() for b, n in zip(block[mine], blocks[mine], strict=True)]
        candidates = np.concatenate([*parts, np.zeros(0, int)])
        wanted = np.flatnonzero(
            valid & (left[number] <= x) & (x <= right[number]) & (low[number] <= y) & (y <= high[number])
        )
        assert np.isin(wanted, candidates).all()
        assert len(np.unique(candidates)) == len(candidates) or (candidates == POINTS).any()
        visited += len(candidates) - len(wanted)
    # What is found in vain is the rest of a block at either end of each strip, and of a strip.
    if how == "even" and share == 1:
        assert visited / 200 < 30 * BLOCK
