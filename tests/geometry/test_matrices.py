"""Cameras and lights given by matrices: they draw what those draw whose matrices they have."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LIGHTS, covered, floor_and_card, floor_camera, marked, shadows, side_camera, technique

from diffshadow.geometry import (
    MatrixCamera,
    MatrixLight,
    OrthographicCamera,
    Scene,
    View,
    look_at,
    orthographic,
    perspective,
)
from diffshadow.raster import draw_surface
from diffshadow.reference import trace_visibility
from diffshadow.shadow import Bilinear, draw_shadow_map

MESH = floor_and_card()
CAMERAS = {
    "pinhole": side_camera(),
    "orthographic": OrthographicCamera((2, 3, 3), (0, 0, 0), height=4.0, near=-1.0, far=9.0, resolution=(64, 64)),
}
TECHNIQUE = technique(Bilinear(), slope=1.0)
NAMES = {"camera": MatrixCamera, "light": MatrixLight}


def matrices(view: View):
    return np.asarray(view.world_to_eye), np.asarray(view.eye_to_clip)


def same_to_the_bit(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", marked(CAMERAS, ["orthographic"]))
def test_camera_of_anothers_matrices_draws_the_same_surface(kind):
    camera = CAMERAS[kind]
    of_matrices = MatrixCamera(*matrices(camera.view()), camera.resolution)
    same_to_the_bit(draw_surface(MESH, camera), draw_surface(MESH, of_matrices))
    for name in ("eye", "near", "far"):
        np.testing.assert_allclose(getattr(of_matrices, name), getattr(camera, name), rtol=1e-5, atol=1e-5)
    assert of_matrices.is_perspective == (kind == "pinhole")
    # It looks at its target, which is no farther off than it sees.
    along = np.asarray(of_matrices.target - of_matrices.eye)
    np.testing.assert_allclose(along / np.linalg.norm(along), -of_matrices.world_to_eye[2, :3], atol=1e-5)
    assert dataclasses.replace(of_matrices, resolution=(8, 8)).resolution == (8, 8)


def test_camera_off_the_centre_sees_its_part_of_the_image():
    whole = side_camera((64, 64))
    tangent = float(np.tan(np.radians(20.0)))
    part = perspective(tangent * jnp.array([0.0, 1.0]), tangent * jnp.array([-1.0, 0.0]), whole.near, whole.far)
    lower_right = draw_surface(MESH, MatrixCamera(whole.view().world_to_eye, part, (32, 32)))
    surface = draw_surface(MESH, whole)
    same = np.asarray(lower_right.face) == np.asarray(surface.face)[:32, 32:]
    # Corners of triangles are rounded to a fraction of a pixel of either image.
    assert same.mean() > 0.998
    positions = np.asarray(lower_right.position)[same], np.asarray(surface.position)[:32, 32:][same]
    np.testing.assert_allclose(*positions, atol=1e-5)


@pytest.mark.parametrize("kind", marked(LIGHTS, ["directional"]))
def test_light_of_anothers_matrices_casts_the_same_shadow(kind):
    light, surface = LIGHTS[kind](MESH), draw_surface(MESH, side_camera())
    of_matrices = MatrixLight(*matrices(light.view()))
    assert of_matrices.is_directional == light.is_directional
    assert not of_matrices.has_size
    theirs, ours = (draw_shadow_map(MESH, each, (64, 64)) for each in (light, of_matrices))
    np.testing.assert_array_equal(ours.depth, theirs.depth)
    visibility = np.asarray(shadows(TECHNIQUE, ours, surface))
    np.testing.assert_allclose(visibility, shadows(TECHNIQUE, theirs, surface), atol=1e-5)
    assert visibility.min() == 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", LIGHTS)
def test_light_off_the_centre_has_its_part_of_the_map(kind):
    """Of a frustum that is as high, and three quarters as wide with as many fewer texels."""
    light, surface = LIGHTS[kind](MESH), draw_surface(MESH, floor_camera(resolution=(64, 64)))
    world_to_eye, eye_to_clip = matrices(light.view())
    right, top = 1 / eye_to_clip[0, 0], 1 / eye_to_clip[1, 1]
    make = orthographic if light.is_directional else perspective
    sides = jnp.array([-right / 2, right]), jnp.array([-top, top])
    part = draw_shadow_map(MESH, MatrixLight(world_to_eye, make(*sides, light.near, light.far)), (64, 48))
    whole = draw_shadow_map(MESH, light, (64, 64))
    np.testing.assert_allclose(part.depth, whole.depth[:, 16:], atol=2e-4)
    both = np.asarray(covered(TECHNIQUE, part, surface) & covered(TECHNIQUE, whole, surface))
    assert both.mean() > 0.5
    off = np.abs(np.asarray(shadows(TECHNIQUE, part, surface)) - np.asarray(shadows(TECHNIQUE, whole, surface)))
    # Alike but for texels along outlines, whose corners were rounded otherwise.
    assert np.quantile(off[both], 0.98) < 1e-3


def test_reference_is_that_of_the_camera_and_the_light_whose_matrices_they_have():
    camera, light = side_camera((32, 32)), LIGHTS["spot"](MESH)
    given = MatrixCamera(*matrices(camera.view()), camera.resolution), MatrixLight(*matrices(light.view()))
    theirs, ours = trace_visibility(Scene(MESH, camera, light)), trace_visibility(Scene(MESH, *given))
    np.testing.assert_array_equal(ours.mask, theirs.mask)
    assert np.mean(ours.visibility != theirs.visibility) < 0.002


def test_matrices_can_be_traced_once_their_kind_is_known():
    view = side_camera().view()
    camera = MatrixCamera(*matrices(view), (64, 64))
    seen = eqx.filter_jit(lambda camera: (camera.eye, camera.view().clip(jnp.zeros(3))))
    np.testing.assert_allclose(seen(camera)[1], view.clip(jnp.zeros(3)), rtol=1e-6)

    def eye(shift, **kind):
        moved = view.world_to_eye.at[:3, 3].add(shift)
        return MatrixCamera(moved, view.eye_to_clip + 0 * shift[0], (64, 64), **kind).eye

    slope = jax.jit(jax.jacfwd(lambda shift: eye(shift, is_perspective=True)))(jnp.zeros(3))
    np.testing.assert_allclose(slope, -view.world_to_eye[:3, :3].T, atol=1e-6)
    with pytest.raises(ValueError, match="eye_to_clip is traced, so its kind is unknown; expected is_perspective"):
        jax.jit(eye)(jnp.zeros(3))


def of_an_engine(is_perspective, left_handed, depth):
    """Matrices of an engine as its documentation states them, and points with what the engine sees there.

    The window is off the axis, near is 0.5, far is 9. The engine sees columns and rows from -1 to 1, and window depth.
    """
    (left, right), (bottom, top), (near, far), (first, last) = (-1.0, 3.0), (-0.5, 1.5), (0.5, 9.0), depth
    eye, ahead = np.array([1.0, 2.0, 3.0]), np.array([1.0, -2.0, 2.0]) / 3
    across = np.cross([0, 1, 0], ahead) * (1 if left_handed else -1)
    across /= np.linalg.norm(across)
    up = np.cross(ahead, across) * (1 if left_handed else -1)
    along = ahead if left_handed else -ahead
    view, projection = np.eye(4), np.zeros((4, 4))
    view[:3, :3] = across, up, along
    view[:3, 3] = -view[:3, :3] @ eye
    sign = 1 if left_handed else -1
    sides = np.array([[left, right], [bottom, top]])
    width, middle = sides[:, 1] - sides[:, 0], sides.sum(axis=1)
    x, y, distance = np.random.default_rng(0).uniform([-1, -0.5, 0.6], [3, 1.5, 8.9], (20, 3)).T
    if is_perspective:
        # The window lies on the near plane. Depth over w is a + b / distance.
        projection[[0, 1], [0, 1]] = 2 * near / width
        projection[:2, 2] = -sign * middle / width
        slope = (last - first) * near * far / (near - far)
        projection[2, 2:] = sign * (first - slope / near), slope
        projection[3, 2] = sign
        x, y = x * distance / near, y * distance / near
        window = np.stack([near * x / distance, near * y / distance])
        depth = far * (distance - near) / (distance * (far - near))
    else:
        projection[[0, 1], [0, 1]] = 2 / width
        projection[:2, 3] = -middle / width
        slope = (last - first) / (far - near)
        projection[2, 2:] = sign * slope, first - slope * near
        projection[3, 3] = 1
        window, depth = np.stack([x, y]), (distance - near) / (far - near)
    points = eye + np.outer(x, across) + np.outer(y, up) + np.outer(distance, ahead)
    columns, rows = (2 * window - middle[:, None]) / width[:, None]
    return view, projection, points, np.stack([columns, rows, depth], axis=-1)


@pytest.mark.parametrize("depth", [(-1.0, 1.0), (0.0, 1.0), (1.0, 0.0)], ids=["opengl", "direct3d", "reversed"])
@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("is_perspective", [False, True])
def test_light_of_an_engines_matrices_sees_what_the_engine_sees(is_perspective, left_handed, depth):
    view, projection, points, expected = of_an_engine(is_perspective, left_handed, depth)
    light = MatrixLight.from_engine(view, projection, left_handed=left_handed, depth=depth)
    clip = np.asarray(light.view().clip(jnp.asarray(points, jnp.float32)))
    found = clip[:, :3] / clip[:, 3:]
    columns, rows, window_depth = expected.T
    np.testing.assert_allclose(found[:, 0], -columns if left_handed else columns, atol=1e-5)
    np.testing.assert_allclose(found[:, 1], rows, atol=1e-5)
    np.testing.assert_allclose(found[:, 2] / 2 + 0.5, window_depth, atol=1e-5)
    assert light.is_perspective == is_perspective
    np.testing.assert_allclose([light.view().near, light.view().far], [0.5, 9.0], rtol=1e-4)
    np.testing.assert_allclose(light.position, [1, 2, 3], atol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"depth": (1.0, 1.0)}, r"depth is \(1.0, 1.0\); expected two numbers that differ"),
        ({"depth": (0.0, np.inf)}, r"depth is \(0.0, inf\); expected two numbers that differ"),
        ({"left_handed": True}, "the matrix light's eye_to_clip has the last row"),
        ({"world_to_eye": np.eye(3)}, r"the engine's world_to_eye has shape \(3, 3\)"),
    ],
)
def test_matrices_of_no_engine_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        MatrixLight.from_engine(**{"world_to_eye": RIGID, "eye_to_clip": FRUSTUM, **wrong})


RIGID = np.asarray(look_at(jnp.array([1.0, 2.0, 3.0]), jnp.array([-1.0, -2.0, -3.0]), jnp.array([0.0, 1.0, 0.0])))
SIDES = jnp.array([-1.0, 1.0])
NEAR, FAR = jnp.array(0.5), jnp.array(9.0)
FRUSTUM, BOX = (np.asarray(make(SIDES, SIDES, NEAR, FAR)) for make in (perspective, orthographic))


def changed(matrix, row, column, value):
    matrix = matrix.copy()
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("world_to_eye", "eye_to_clip", "options", "said"),
    [
        (RIGID[:3], FRUSTUM, {}, r"'s world_to_eye has shape \(3, 4\); expected one matrix, \(4, 4\)"),
        (RIGID, FRUSTUM[None], {}, r"'s eye_to_clip has shape \(1, 4, 4\)"),
        (changed(RIGID, 0, 3, np.nan), FRUSTUM, {}, "'s world_to_eye is .*nan.*; expected finite numbers"),
        (RIGID.T, FRUSTUM, {}, "expected a rotation and translation.* transpose it if it acts on row vectors"),
        (RIGID @ np.diag([2.0, 2.0, 2.0, 1.0]), FRUSTUM, {}, "expected a rotation and translation.* remove any scale"),
        (np.diag([1.0, 1.0, -1.0, 1.0]) @ RIGID, FRUSTUM, {}, "mirror it if its eye looks along"),
        (RIGID, FRUSTUM.T, {}, r"'s eye_to_clip has the last row .*; expected 0, 0, -1, 0 of a perspective"),
        (RIGID, FRUSTUM, {"is_perspective": False}, "has is_perspective = False, but .*; expected them to agree"),
        (RIGID, changed(FRUSTUM, 1, 1, -1.0), {}, "flip y if it points down"),
        (RIGID, changed(FRUSTUM, 2, 0, 0.3), {}, "do not use oblique near planes"),
        (RIGID, changed(BOX, 0, 1, 0.3), {}, "expected a matrix as glFrustum or glOrtho makes"),
        (RIGID, np.asarray(perspective(SIDES, SIDES, FAR, NEAR)), {}, "has near = 9.0.* expected 0 < near < far"),
        (RIGID, np.asarray(orthographic(SIDES, SIDES, FAR, NEAR)), {}, "expected near < far"),
        (RIGID, changed(changed(FRUSTUM, 2, 2, -1.0), 2, 3, -1.0), {}, "and far = .*inf; expected 0 < near < far"),
    ],
)
def test_matrices_that_are_no_view_are_refused(name, world_to_eye, eye_to_clip, options, said):
    with pytest.raises(ValueError, match=f"the matrix {name}.*{said}"):
        NAMES[name](world_to_eye, eye_to_clip, **options)
