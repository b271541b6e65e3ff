"""The extent of texels on the screen: closed forms, and figures of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LIGHTS, floor_and_card, quad, seen_by, side_camera

from diffshadow.geometry import DirectionalLight, PinholeCamera
from diffshadow.metrics import measure_aliasing
from diffshadow.shadow import Aliasing, ShadowMap, aliasing

SIZE = (64, 64)


def map_from(light, size=SIZE) -> ShadowMap:
    """A map of this light: what it holds does not matter."""
    return ShadowMap(jnp.zeros(size), light)


@pytest.mark.exhaustive
def test_texels_on_a_plane_under_light_from_above_have_their_closed_form():
    # Of a level camera at height h with a focal length of F pixels: t F / z across, and t F h / z² along the view.
    height, texels, width = 1.7, 64, 30.0
    floor = quad((0, 0, -50), (60, 0, 0), (0, 0, -60))
    camera = PinholeCamera((0, height, 0), (0, height, -10), fov_y=60.0, near=0.1, far=100.0, resolution=SIZE)
    # The map's x lies along the view.
    light = DirectionalLight((0, -1, 0), (0, 0, 0), (width, width), -5, 5)
    surface = seen_by(camera, floor)
    found = aliasing(map_from(light), surface, camera)
    focal, texel = SIZE[0] / 2 / np.tan(np.deg2rad(30)), width / texels
    mask = np.asarray(found.mask)
    assert mask.mean() > 0.1
    depth = -np.asarray(surface.position, np.float64)[mask, 2]
    across, along = texel * focal / depth, texel * focal * height / depth**2
    # Beside the middle of the image, a step along the view moves a point sideways, too.
    sideways = texel * focal * np.asarray(surface.position)[mask, 0] / depth**2
    expected = np.stack([sideways, across, along, np.zeros_like(along)], axis=-1).reshape(-1, 2, 2)
    jacobian = np.asarray(found.jacobian)[mask]
    np.testing.assert_allclose(np.abs(jacobian), np.abs(expected), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(np.asarray(found.area)[mask], across * along, rtol=1e-4)
    np.testing.assert_allclose(
        np.asarray(found.extent)[mask], np.linalg.svd(expected, compute_uv=False)[:, 0], rtol=1e-4
    )


def test_only_surfaces_in_the_map_that_face_the_light_are_measured():
    mesh, camera = floor_and_card(), side_camera(SIZE)
    surface = seen_by(camera, mesh)
    half = DirectionalLight((0.0, -1.0, 0.1), (1.5, 0.5, 0), (3.0, 8.0), -4, 4)
    mask = np.asarray(aliasing(map_from(half), surface, camera).mask)
    x = np.asarray(surface.position)[..., 0]
    assert mask.any()
    assert x[mask].min() > 0 - 1e-5
    from_below = DirectionalLight((0.0, 1.0, 0.1), (0, 0, 0), (8.0, 8.0), -4, 4)
    assert not np.asarray(aliasing(map_from(from_below), surface, camera).mask).any()


@pytest.mark.parametrize("light", ["directional", pytest.param("spot", marks=pytest.mark.exhaustive)])
def test_extents_are_those_of_finite_steps_in_the_map(light):
    # Moving the camera's pixels by one and finding by how much the texel moves is the inverse.
    mesh, camera = floor_and_card(), side_camera(SIZE)
    surface = seen_by(camera, mesh)
    shadow_map = map_from(LIGHTS[light](mesh))
    found = aliasing(shadow_map, surface, camera)
    clip = np.asarray(shadow_map.view.clip(surface.position), np.float64)
    texel = (clip[..., :2] / clip[..., 3:] * 0.5 + 0.5) * SIZE[0]
    floor = np.asarray(found.mask) & (np.asarray(surface.face) < 2)
    inner = floor[1:-1, 1:-1] & floor[2:, 1:-1] & floor[:-2, 1:-1] & floor[1:-1, 2:] & floor[1:-1, :-2]
    along_x, along_y = (texel[1:-1, 2:] - texel[1:-1, :-2]) / 2, (texel[2:, 1:-1] - texel[:-2, 1:-1]) / 2
    inverse = np.linalg.inv(np.stack([along_x, along_y], axis=-1)[inner])
    assert inner.sum() > 1000
    np.testing.assert_allclose(np.asarray(found.jacobian)[1:-1, 1:-1][inner], inverse, rtol=0.02, atol=0.02)


@jax.jit
def _extents(matrices):
    """Both extents, and the derivative of the sum of the longest."""
    of = lambda matrices: Aliasing(matrices, matrices, jnp.ones(matrices.shape[:2], bool))
    gradient = jax.grad(lambda matrices: jnp.sum(of(matrices).extent))(matrices)
    return of(matrices).extent, of(matrices).least_extent, gradient


def test_singular_values_are_those_of_numpy():
    matrices = np.random.default_rng(0).normal(size=(5, 7, 2, 2)).astype(np.float32)
    matrices[0, 0] = 0
    longest, shortest, gradient = _extents(matrices)
    values = np.linalg.svd(matrices, compute_uv=False)
    np.testing.assert_allclose(longest, values[..., 0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(shortest, values[..., 1], rtol=1e-4, atol=1e-6)
    assert np.isfinite(gradient).all()


def test_figures_of_extents():
    extent, mask = np.full((10, 20), 2.0), np.ones((10, 20), bool)
    extent[0, :2], extent[5] = 8.0, 0.5
    mask[9], extent[9] = False, np.inf
    figures = measure_aliasing(extent, mask)
    assert figures.worst == 8
    assert figures.percentile_99 == np.percentile(extent[mask], 99)
    assert figures.mean_log2 == pytest.approx((2 * 3 + 20 * -1 + 158) / 180)
    assert figures.undersampled == pytest.approx(160 / 180)
    for wrong, words in (
        ((extent, np.zeros_like(mask)), "has no pixels"),
        ((extent, np.ones_like(mask)), "negative, NaN or infinite"),
        ((extent, mask[1:]), "expected booleans of the same shape"),
    ):
        with pytest.raises(ValueError, match=words):
            measure_aliasing(*wrong)
