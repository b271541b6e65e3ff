"""Images drawn in bands are those drawn in one buffer.

Programs are found again by the shapes of what they are given, so these have shapes of their own.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from triangle_soups import big, depth_rounding, medium, sliver, soup, tiny

from diffshadow.raster import DepthTest, _band_pass, rasterize, rasterize_depth

# Not a multiple of the number of bands.
RESOLUTION = (101, 93)
FACES = 211


@pytest.fixture
def in_bands(monkeypatch):
    """Makes programs that are traced from here on draw in bands."""
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    for name, value in (("_MOST_IN_ONE", 0), ("_LEAST_BYTES", 1), ("_LEAST_ROWS", 20)):
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


def test_faces_and_depths_are_the_same(clips, faces, in_bands):
    draw = lambda clip: rasterize(clip, faces, RESOLUTION)
    found = jax.jit(jax.vmap(draw))(clips)
    # Outside of a trace, small images are drawn into a buffer of another shape, which is drawn in one.
    for i, clip in enumerate(clips):
        with pytest.MonkeyPatch.context() as one:
            one.setattr(_band_pass, "_MOST_IN_ONE", 1 << 25)
            expected = draw(clip)
        assert len(np.unique(expected.face)) > 20
        np.testing.assert_array_equal(found.face[i], expected.face)
        np.testing.assert_allclose(found.depth[i], expected.depth, rtol=0, atol=depth_rounding())


def test_depths_are_the_same_in_viewports_and_other_formats(clips, faces, in_bands):
    test = DepthTest("unorm24", "less_equal", clear=0.75)
    given = {"cull": "front", "depth_test": test, "polygon_offset": (1.5, 2.0)}
    viewports = jnp.array([[47, 90], RESOLUTION])
    bands = jax.jit(lambda clips, viewports: rasterize(clips, faces, RESOLUTION, viewports=viewports, **given).depth)
    found = bands(clips, viewports)
    with pytest.MonkeyPatch.context() as one:
        one.setattr(_band_pass, "_MOST_IN_ONE", 1 << 25)
        expected = rasterize(clips, faces, RESOLUTION, viewports=viewports, **given).depth
    assert np.mean(expected < 0.75) > 0.2
    np.testing.assert_array_equal(found, expected)
    alone = jax.jit(lambda clip: rasterize_depth(clip, faces, RESOLUTION, **given))(clips[1])
    np.testing.assert_array_equal(alone, found[1])


@pytest.mark.parametrize(
    ("size", "bytes_a_pixel", "bands"),
    [((2048, 2048), 4, 1), ((2048, 2048), 8, 16), ((4096, 300), 8, 1), ((4096, 4096), 8, 32)],
)
def test_large_images_are_drawn_in_bands(size, bytes_a_pixel, bands, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert _band_pass.bands_of(size, bytes_a_pixel) == bands
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert _band_pass.bands_of(size, bytes_a_pixel) == 1
