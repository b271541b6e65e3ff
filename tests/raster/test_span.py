"""The columns of pixels that a triangle may cover in some rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.raster._bins import Corners
from diffshadow.raster._span import span

COUNT = 4096
BLOCK = 16

_span = jax.jit(lambda x, y, bottom, top: span(Corners.snapped((x, y, jnp.zeros_like(x))), bottom, top))

_on_device = lambda x, y, bottom, top: map(np.asarray, _span(x.astype(np.float32), y.astype(np.float32), bottom, top))


def exact_span(x, y, low, high):
    """Least and greatest x of triangles (3, n) within `low` <= y <= `high`, in float64; infinite where they miss."""
    left, right = np.full(low.shape, np.inf), np.full(low.shape, -np.inf)
    for k in range(3):
        x0, x1, y0, y1 = x[k], x[k - 1], y[k], y[k - 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings = [x0 + (row - y0) * (x1 - x0) / (y1 - y0) for row in (low, high)]
        between = [(row - y0) * (row - y1) < 0 for row in (low, high)]
        for at, counts in [(x0, (y0 >= low) & (y0 <= high)), *zip(crossings, between, strict=True)]:
            left, right = (np.where(counts, pick(side, at), side) for pick, side in ((np.fmin, left), (np.fmax, right)))
    return left, right


@pytest.mark.parametrize("reach", [4, 300, 8000, 60000])
@pytest.mark.parametrize("shape", ["any", "thin", "horizontal"])
def test_a_span_is_that_of_the_triangle_in_these_rows(shape, reach):
    random = np.random.default_rng([reach, len(shape)])
    x, y = random.uniform(0, reach, (2, 3, COUNT))
    if shape == "thin":
        share = random.uniform(0, 1, COUNT)
        x[2], y[2] = (at[0] + share * (at[1] - at[0]) + random.uniform(-0.6, 0.6, COUNT) for at in (x, y))
    if shape == "horizontal":
        y[1] = y[0]
    x, y = (np.clip(np.round(at * 256) / 256, 0, reach) for at in (x, y))
    bottom = random.integers(np.floor(y.min(0)).astype(int), np.ceil(y.max(0)).astype(int) + 1).astype(np.int32)
    bottom[::64] = np.ceil(y.max(0))[::64] + 1
    top = bottom + random.integers(0, BLOCK, COUNT).astype(np.int32)

    first, last = _on_device(x, y, bottom, top)
    left, right = exact_span(x, y, bottom + 0.5, top + 0.5)
    misses = np.isinf(left)
    assert misses[::64].all()
    assert (first > last)[misses].all()
    # Columns are those whose centres are within the triangle's reach, and rarely one more on a side.
    for further in (np.ceil(left - 0.5) - first, last - np.floor(right - 0.5)):
        assert set(further[~misses]) <= {0, 1}
        assert 0.5 < np.mean(further[~misses] == 0) < 1


def test_a_centre_on_an_edge_is_within_the_span():
    random = np.random.default_rng(5)
    # Edges through centres that are `step` apart, of a triangle to their left, and of its mirror image.
    step, count = random.integers(1, 12, (2, COUNT)), random.integers(2, 700, COUNT)
    number = random.integers(0, count + 1)
    start = random.integers(0, 100, (2, COUNT)) + 0.5
    x, y = (np.stack([at, at + count * by, at]) for at, by in zip(start, step, strict=True))
    centre = (start + number * step - 0.5).astype(np.int32)
    _, last = _on_device(x, y, centre[1], centre[1])
    np.testing.assert_array_equal(last, centre[0])
    first, _ = _on_device(8000 - x, y, centre[1], centre[1])
    np.testing.assert_array_equal(first, 7999 - centre[0])
