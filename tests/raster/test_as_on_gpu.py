"""What takes another way on GPUs, taken on any device: the same results.

Programs are found again by the shapes of what they are given, so these have shapes of their own.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from triangle_soups import depth_rounding, soup

from diffshadow._arithmetic import take, take_in_runs
from diffshadow._padding import padded_to
from diffshadow.raster import Items, rasterize, visible_depth

RESOLUTION = (59, 83)
FACES = 157


@pytest.fixture
def on(monkeypatch):
    """Makes what follows take the way of a backend."""
    return lambda backend: monkeypatch.setattr(jax, "default_backend", lambda: backend)


@pytest.fixture(scope="module")
def triangles():
    clip, _ = soup(np.random.default_rng(5), FACES, RESOLUTION)
    return jnp.asarray(clip), jnp.arange(3 * FACES, dtype=jnp.int32).reshape(-1, 3)


def draw(clip, faces):
    return rasterize(clip, faces, RESOLUTION)


def slope(clip, faces, face):
    return jax.grad(lambda clip: jnp.sum(visible_depth(face, clip, faces) ** 2))(clip)


@pytest.mark.exhaustive
def test_the_same_pixels_and_derivatives(triangles, on):
    on("gpu")
    found = jax.jit(draw)(*triangles)
    moved = jax.jit(slope)(*triangles, found.face)
    on("cpu")
    # Outside of `jit`, in buffers of a shape of their own.
    expected = draw(*triangles)
    np.testing.assert_array_equal(found.face, expected.face)
    np.testing.assert_allclose(found.depth, expected.depth, rtol=0, atol=depth_rounding())
    expected = jax.jit(lambda *given: slope(*given))(*triangles, expected.face)
    assert np.max(np.abs(expected)) > 1
    np.testing.assert_allclose(moved, expected, rtol=1e-4, atol=1e-4 * np.max(np.abs(expected)))


def test_the_first_items_follow_the_last(on):
    on("gpu")
    lengths = np.array([0, 3, 0, 2, 4, 0], np.int32)
    owners = np.repeat(np.arange(6), lengths)
    places = np.concatenate([np.arange(n) for n in lengths])
    owner, place, exists = Items.of(jnp.asarray(lengths)).chunk(4, 17)
    numbers = np.arange(4, 21)
    np.testing.assert_array_equal(exists, numbers < 9)
    np.testing.assert_array_equal(owner, owners[numbers % 9])
    np.testing.assert_array_equal(place, places[numbers % 9])
    owner, _, exists = Items.of(jnp.zeros(6, jnp.int32)).chunk(0, 17)
    assert not np.any(exists)
    assert np.all((owner >= 0) & (owner < 6))


@pytest.mark.exhaustive
@pytest.mark.parametrize("columns", [(), (3,)])
def test_reading_in_runs_is_reading(columns):
    rng = np.random.default_rng(0)
    values = jnp.asarray(rng.normal(size=(11, *columns)), jnp.float32)
    index = jnp.asarray(np.repeat(rng.integers(11, size=23), rng.integers(1, 70, 23))[: 7 * 43].reshape(7, 43))
    weights = jnp.asarray(rng.normal(size=(7, 43, *columns)), jnp.float32)
    np.testing.assert_array_equal(take_in_runs(values, index), take(values, index))
    slope = lambda read: jax.grad(lambda values: jnp.sum(weights * read(values, index) ** 2))(values)
    np.testing.assert_allclose(slope(take_in_runs), slope(take), rtol=1e-4, atol=1e-5)


def test_arrays_are_filled_up_alike(on):
    array, value = jnp.arange(12, dtype=jnp.float32).reshape(2, 3, 2), np.array([5.0, 6.0])
    on("cpu")
    on_host = padded_to(array, 5, value, axis=1)
    on("gpu")
    on_device = padded_to(array, 5, value, axis=1)
    assert isinstance(on_host, np.ndarray)
    assert isinstance(on_device, jax.Array)
    assert on_host.dtype == on_device.dtype == np.float32
    np.testing.assert_array_equal(on_device, on_host)
    np.testing.assert_array_equal(on_host, np.concatenate([array, np.broadcast_to(value, (2, 2, 2))], axis=1))
