"""Images drawn in bands are those drawn in one buffer.

Programs are found again by the shapes of what they are given, so these have shapes of their own.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from triangle_soups import big, depth_rounding, medium, sliver, soup, tiny

from diffshadow.raster import _band_pass, rasterize, rasterize_depth

# Not a multiple of the number of bands.
RESOLUTION = (101, 93)
FACES = 211


@pytest.fixture
def in_bands(monkeypatch):
    """Makes programs that are traced from here on draw in bands."""
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    for name, value in (("_MAX_IN_ONE", 0), ("_MIN_BYTES", 1), ("_MIN_ROWS", 20)):
        monkeypatch.setattr(_band_pass, name, value)
    assert _band_pass.bands_of(RESOLUTION, 4) == 4


@pytest.fixture(scope="module")
def clips():
    """Two views of triangles: most are small, so that the large ones do not hide all others."""
    rng = np.random.default_rng(3)
    small = lambda kinds: np.concatenate([kinds[i % 4](rng, RESOLUTION) for i in range(FACES - 15)])
    views = [[small((tiny, medium, big, sliver)), soup(rng, 15, RESOLUTION)[0]] for _ in range(2)]
    return jnp.asarray([np.concatenate(view) for view in views], jnp.float32)


@pytest.fixture(scope="module")
def faces():
    return jnp.arange(3 * FACES, dtype=jnp.int32).reshape(-1, 3)


def whole(clips, faces, viewports=None):
    """The same in one buffer. Outside of a trace, small images are drawn into a buffer of another shape."""
    with pytest.MonkeyPatch.context() as one:
        one.setattr(_band_pass, "_MAX_IN_ONE", 1 << 25)
        return rasterize(clips, faces, RESOLUTION, viewports=viewports)


@pytest.mark.exhaustive
def test_depths_are_the_same_under_vmap(clips, faces, in_bands):
    found = jax.jit(jax.vmap(lambda clip: rasterize_depth(clip, faces, RESOLUTION)))(clips)
    np.testing.assert_allclose(found, whole(clips, faces).depth, rtol=0, atol=depth_rounding())


def test_faces_and_depths_are_the_same_in_viewports(clips, faces, in_bands):
    viewports = jnp.array([[47, 90], RESOLUTION])
    bands = jax.jit(lambda clips, viewports: rasterize(clips, faces, RESOLUTION, viewports=viewports))
    found, expected = bands(clips, viewports), whole(clips, faces, viewports)
    assert all(len(np.unique(face)) > 20 for face in expected.face)
    np.testing.assert_array_equal(found.face, expected.face)
    np.testing.assert_allclose(found.depth, expected.depth, rtol=0, atol=depth_rounding())


@pytest.mark.parametrize(
    ("size", "bytes_a_pixel", "bands"),
    [((2048, 2048), 4, 1), ((2048, 2048), 8, 16), ((4096, 300), 8, 1), ((4096, 4096), 8, 32)],
)
def test_large_images_are_drawn_in_bands(size, bytes_a_pixel, bands, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert _band_pass.bands_of(size, bytes_a_pixel) == bands
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert _band_pass.bands_of(size, bytes_a_pixel) == 1
