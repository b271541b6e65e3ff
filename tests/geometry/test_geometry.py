"""Transforms, views, cameras and meshes, against their definitions."""

import functools
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffshadow._padding import shared_size
from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    SpotLight,
    face_normals,
    infinite_far,
    library_mesh,
    look_at,
    merge,
    orbit_eye,
    orthographic,
    perspective,
    rotation,
    scaling,
    transform_points,
    transform_vectors,
    translation,
)

UP = jnp.array([0.0, 1.0, 0.0])
SIDES = jnp.array([-1.0, 1.0])
coordinate = st.floats(-1, 1, width=32)
vector = st.tuples(coordinate, coordinate, coordinate).filter(lambda v: math.hypot(*v) > 0.1)
many_examples = settings(max_examples=30, deadline=None)


def divided(clip):
    clip = np.asarray(clip, np.float64)
    return clip[..., :3] / clip[..., 3:]


def cloud(scale, n=200, seed=0):
    """Points of a box about as large as `scale`, off the origin."""
    rng = np.random.default_rng(seed)
    return jnp.asarray(scale * (rng.uniform(-1, 1, (n, 3)) * [1, 0.5, 2] + [0.3, 0.5, -0.2]), jnp.float32)


# Transforms


@many_examples
@given(vector, vector, vector)
def test_look_at_is_rigid_and_puts_the_eye_at_the_origin_looking_along_minus_z(eye, forward, up):
    eye, forward = jnp.array(eye), jnp.array(forward)
    matrix = look_at(eye, forward, jnp.array(up))
    rows = np.asarray(matrix[:3, :3], np.float64)
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-5)
    assert np.linalg.det(rows) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(transform_points(matrix, eye), [0, 0, 0, 1], atol=1e-6)
    ahead = np.asarray(transform_points(matrix, eye + forward))
    np.testing.assert_allclose(ahead, [0, 0, -np.linalg.norm(forward), 1], atol=1e-5)
    # What is up lies in the upper half of the eye's yz plane, but where the view is along it.
    upright = np.asarray(transform_vectors(matrix, jnp.array(up)))
    if np.linalg.norm(np.cross(forward, up)) > 1e-2 * np.linalg.norm(forward) * np.linalg.norm(up):
        assert upright[0] == pytest.approx(0, abs=1e-5)
        assert upright[1] > 0


@pytest.mark.parametrize("forward", [(0, 1, 0), (0, -1, 0), (0, -3, 0), (1e-5, -1, 0)])
def test_look_at_along_its_up_direction_is_still_rigid(forward):
    rows = np.asarray(look_at(jnp.zeros(3), jnp.array(forward, float), UP)[:3, :3])
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(rows) == pytest.approx(1, abs=1e-6)


def test_perspective_maps_the_corners_of_its_frustum_to_those_of_the_clip_cube():
    left_right, bottom_top, near, far = (-0.3, 0.7), (-0.2, 0.5), 0.5, 20.0
    matrix = perspective(jnp.array(left_right), jnp.array(bottom_top), jnp.array(near), jnp.array(far))
    for x, y, z in itertools.product((0, 1), repeat=3):
        distance = (near, far)[z]
        corner = jnp.array([left_right[x] * distance, bottom_top[y] * distance, -distance])
        clip = transform_points(matrix, corner)
        assert float(clip[3]) == pytest.approx(distance)
        np.testing.assert_allclose(divided(clip), [2 * x - 1, 2 * y - 1, 2 * z - 1], atol=1e-5)


def test_infinite_far_is_the_limit_of_far_planes_and_sees_infinity_at_depth_one():
    sides, near = jnp.array([-0.4, 0.6]), jnp.array(0.5)
    endless = infinite_far(perspective(sides, sides, near, jnp.array(20.0)), near)
    farther = perspective(sides, sides, near, jnp.array(1e7))
    points = cloud(3.0) - jnp.array([0.0, 0.0, 8.0])
    np.testing.assert_allclose(transform_points(endless, points), transform_points(farther, points), rtol=1e-6)
    # Window depth 1 - near / z.
    np.testing.assert_allclose(divided(transform_points(endless, points))[:, 2], 1 + 1 / points[:, 2], atol=1e-6)
    at_infinity = np.asarray(points) @ np.asarray(endless)[:, :3].T
    np.testing.assert_array_equal(at_infinity[:, 2], at_infinity[:, 3])


def test_orthographic_maps_the_corners_of_its_box_to_those_of_the_clip_cube():
    left_right, bottom_top, near, far = (-3.0, 7.0), (-2.0, 5.0), -1.0, 20.0
    matrix = orthographic(jnp.array(left_right), jnp.array(bottom_top), jnp.array(near), jnp.array(far))
    for x, y, z in itertools.product((0, 1), repeat=3):
        clip = transform_points(matrix, jnp.array([left_right[x], bottom_top[y], -(near, far)[z]]))
        np.testing.assert_allclose(clip, [2 * x - 1, 2 * y - 1, 2 * z - 1, 1], atol=1e-5)


@many_examples
@given(vector, st.floats(-6, 6))
def test_rotation_turns_by_its_angle_about_its_axis(axis, angle):
    unit = np.array(axis) / math.hypot(*axis)
    turn = np.asarray(rotation(jnp.array(axis), angle)[:3, :3], np.float64)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-5)
    np.testing.assert_allclose(turn @ unit, unit, atol=1e-5)
    across = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    across /= np.linalg.norm(across)
    # By the right-hand rule `across` moves towards `unit × across`.
    expected = math.cos(angle) * across + math.sin(angle) * np.cross(unit, across)
    np.testing.assert_allclose(turn @ across, expected, atol=1e-5)


def test_translation_and_scaling_act_on_points_and_vectors():
    point = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(transform_points(translation(jnp.array([4.0, 5.0, 6.0])), point), [5, 7, 9, 1])
    np.testing.assert_allclose(transform_vectors(translation(jnp.array([4.0, 5.0, 6.0])), point), point)
    np.testing.assert_allclose(transform_points(scaling(2.0), point), [2, 4, 6, 1])
    np.testing.assert_allclose(transform_points(scaling(jnp.array([1.0, 0.0, -1.0])), point), [1, 0, -3, 1])


def test_orbit_eye_measures_azimuth_from_z_to_x_and_elevation_upwards():
    target = jnp.array([1.0, 2.0, 3.0])
    for azimuth, elevation, towards in [
        (0.0, 0.0, (0, 0, 1)),
        (90.0, 0.0, (1, 0, 0)),
        (0.0, 90.0, (0, 1, 0)),
        (45.0, 30.0, (math.sqrt(0.375), 0.5, math.sqrt(0.375))),
    ]:
        np.testing.assert_allclose((orbit_eye(target, 2.0, azimuth, elevation) - target) / 2, towards, atol=1e-6)


# Views


@functools.cache
def views(is_double=False):
    eye, target = (1.0, 2.0, 3.0), (0.2, -0.3, 0.1)
    seen_from = {
        "pinhole": PinholeCamera(eye, target, fov_y=40.0, near=0.5, far=9.0, resolution=(30, 50)),
        "orthographic": OrthographicCamera(eye, target, height=3.0, near=0.5, far=9.0, resolution=(30, 50)),
        "directional": DirectionalLight((0.3, -1.0, 0.2), (0.3, 0.5, -0.2), (3.1, 4.3), -1.5, 2.5),
        "spot": SpotLight((3.0, 5.0, 4.0), (-2.7, -4.5, -4.2), 20.0, 4.0, 9.5),
    }
    view_of = eqx.filter_jit(lambda one: one.view())
    return {name: view_of(one) for name, one in seen_from.items()}


VIEWS = ["pinhole", "orthographic", "directional", "spot"]


def on_axis(view, distance):
    """World points at `distance` along the view axis, by the inverse of the view's rigid part."""
    to_world = np.linalg.inv(np.asarray(view.world_to_eye, np.float64))
    return (to_world[:3, 3] - np.asarray(distance, np.float64)[..., None] * to_world[:3, 2]).astype(view.near.dtype)


@eqx.filter_jit
def clip_of(view, points):
    return view.clip(points)


@eqx.filter_jit
def along_axis(view, depth, distance, resolution=(30, 50)):
    """Distances of window depths; the slope of window depth and a texel's size at distances."""
    return view.eye_depth(depth), view.depth_slope(distance), view.texel_size(distance, resolution)


def window_depth(view, points):
    clip = np.asarray(clip_of(view, jnp.asarray(points)))
    return (clip[..., 2] / clip[..., 3] + 1) / 2


@pytest.mark.parametrize("name", VIEWS)
def test_near_and_far_have_window_depth_0_and_1(name):
    view = views()[name]
    depth = window_depth(view, on_axis(view, np.stack([view.near, view.far])))
    np.testing.assert_allclose(depth, [0, 1], atol=1e-5)


@pytest.mark.parametrize("name", VIEWS)
def test_eye_depth_inverts_the_projection(name):
    with jax.enable_x64(True):
        view = views(is_double=True)[name]
        distance = np.linspace(view.near, view.far, 20)
        found, _, _ = along_axis(view, window_depth(view, on_axis(view, distance)), distance)
        np.testing.assert_allclose(found, distance, rtol=1e-9)


@pytest.mark.parametrize("name", VIEWS)
def test_depth_slope_is_the_derivative_of_window_depth(name):
    with jax.enable_x64(True):
        view = views(is_double=True)[name]
        span = float(view.far - view.near)
        distance = float(view.near) + span * np.linspace(0.05, 0.95, 20)
        step = 1e-4 * span
        above, below = (window_depth(view, on_axis(view, distance + s)) for s in (step, -step))
        np.testing.assert_allclose(along_axis(view, distance, distance)[1], (above - below) / (2 * step), rtol=1e-4)


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("resolution", [(30, 50), (64, 16)])
def test_texel_size_is_the_world_size_of_one_step_in_the_map(name, resolution):
    with jax.enable_x64(True):
        view = views(is_double=True)[name]
        distance = np.linspace(max(float(view.near), 0.1), float(view.far), 20)
        to_world = np.linalg.inv(np.asarray(view.world_to_eye))
        steps = []
        for axis, texels in ((0, resolution[1]), (1, resolution[0])):
            step = 1e-3 * to_world[:3, axis]
            start, end = (np.asarray(clip_of(view, on_axis(view, distance) + s)) for s in (0 * step, step))
            moved = (end / end[:, 3:] - start / start[:, 3:])[:, axis] / 2 * texels
            steps.append(1e-3 / np.asarray(moved))
        # The geometric mean of the width and the height of a texel.
        _, _, found = along_axis(view, distance, distance, resolution)
        np.testing.assert_allclose(found, np.sqrt(steps[0] * steps[1]), rtol=1e-9)


@pytest.mark.parametrize("name", VIEWS)
def test_clip_is_the_product_of_the_views_matrices(name):
    view, points = views()[name], np.asarray(cloud(1.0), np.float64)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=-1)
    expected = homogeneous @ np.asarray(view.matrix, np.float64).T
    np.testing.assert_allclose(clip_of(view, jnp.asarray(points, jnp.float32)), expected, atol=2e-5)
    product = np.asarray(view.eye_to_clip, np.float64) @ np.asarray(view.world_to_eye, np.float64)
    np.testing.assert_allclose(view.matrix, product, atol=1e-5)


def products(function, *arguments):
    """The precision of each matrix product that `function` is traced to."""
    found, jaxprs = [], [jax.make_jaxpr(function)(*arguments).jaxpr]
    while jaxprs:
        for equation in jaxprs.pop().eqns:
            if equation.primitive.name == "dot_general":
                found.append(equation.params["precision"])
            jaxprs += [inner.jaxpr for inner in equation.params.values() if hasattr(inner, "jaxpr")]
    return found


def test_no_product_is_left_to_a_backends_precision():
    # Some backends round the factors of a plain float32 product to 10 bits, which would move an eye by 0.1 %.
    eye = jnp.array([1.0, 2.0, 3.0])
    directional = lambda d, points: DirectionalLight.around(d, points).view().matrix
    camera = lambda e: PinholeCamera(e, jnp.zeros(3)).view().matrix
    used = [
        *products(rotation, eye, 0.5),
        *products(look_at, eye, eye, UP),
        *products(camera, eye),
        *products(directional, eye, cloud(1.0)),
    ]
    assert used
    assert all(precision == (jax.lax.Precision.HIGHEST,) * 2 for precision in used)


# Cameras


def test_pinhole_camera_sees_its_field_of_view():
    camera = PinholeCamera((0, 0, 0), (0, 0, -1), fov_y=60.0, near=0.1, far=10.0, resolution=(100, 200))
    tangent = math.tan(math.radians(30))
    assert camera.aspect == 2
    for x, y in itertools.product((-1, 1), repeat=2):
        corner = jnp.array([2 * tangent * x, tangent * y, -1.0]) * 3
        np.testing.assert_allclose(divided(camera.view().clip(corner))[:2], [x, y], atol=1e-5)


def test_orthographic_camera_sees_its_height():
    camera = OrthographicCamera((5, 0, 0), (0, 0, 0), height=4.0, resolution=(50, 100))
    # From +x, `right` is -z.
    np.testing.assert_allclose(divided(camera.view().clip(jnp.array([0.0, 2.0, -4.0])))[:2], [1, 1], atol=1e-5)


BAD_CAMERAS = [
    ({"eye": (1, 2, 3), "target": (1, 2, 3)}, r"eye and target are both \[1\.0, 2\.0, 3\.0\]"),
    ({"eye": (math.nan, 0, 0)}, r"eye\[0\] is nan; expected a number"),
    ({"near": 2.0, "far": 2.0}, "near = 2.0 and far = 2.0"),
    ({"near": 3.0, "far": 2.0}, "near = 3.0 and far = 2.0"),
    ({"far": math.inf}, "both finite"),
    ({"near": -math.inf}, "both finite"),
    ({"far": math.nan}, "both finite"),
    ({"resolution": (0, 4)}, r"resolution\[0\] is 0; expected a whole number"),
    ({"resolution": (4, 10_000)}, r"resolution\[1\] is 10000; expected a whole number"),
]


@pytest.mark.parametrize("kind", [PinholeCamera, OrthographicCamera])
@pytest.mark.parametrize(("options", "message"), BAD_CAMERAS)
def test_bad_cameras_are_refused(kind, options, message):
    with pytest.raises(ValueError, match=message):
        kind(**({"eye": (0, 0, 1), "target": (0, 0, 0)} | options))


def test_bad_openings_of_cameras_are_refused():
    for fov in (0.0, 180.0, -3.0, math.nan):
        with pytest.raises(ValueError, match=r"expected a number at least 0\.01 and at most 179\.99, in degrees"):
            PinholeCamera((0, 0, 1), (0, 0, 0), fov_y=fov)
    for height in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="expected a positive size"):
            OrthographicCamera((0, 0, 1), (0, 0, 0), height=height)
    with pytest.raises(ValueError, match="expected 0 < near < far"):
        PinholeCamera((0, 0, 1), (0, 0, 0), near=0.0)
    # A parallel view may begin behind its eye.
    OrthographicCamera((0, 0, 1), (0, 0, 0), near=-1.0)


# Meshes


def test_mesh_without_normals_is_shaded_flat_and_light_grey():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    np.testing.assert_allclose(mesh.corner_normals, [[[0, 0, 1]] * 3])
    np.testing.assert_allclose(mesh.albedo, [[0.8] * 3])
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [1, 1, 0]])


def test_bad_meshes_are_refused():
    triangle = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]
    with pytest.raises(ValueError, match="has no faces"):
        Mesh(np.zeros((3, 3)), np.zeros((0, 3), int))
    with pytest.raises(ValueError, match=r"1 of the mesh's 3 vertices.*first is vertex 2"):
        Mesh([*triangle[:2], [0, math.nan, 0]], [[0, 1, 2]])
    for faces in ([[0, 1, 3]], [[-1, 0, 1]]):
        with pytest.raises(ValueError, match=r"faces use vertices -?\d to \d, but it has 3"):
            Mesh(triangle, faces)
    with pytest.raises(ValueError, match="no meshes to merge"):
        merge([])


@eqx.filter_jit
def transformed(mesh, matrix):
    return mesh.transformed(matrix)


normals_of = eqx.filter_jit(face_normals)


def outward(mesh, centre):
    """Whether each face, and each corner's normal, looks away from `centre`; for a convex mesh."""
    away = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] - np.asarray(centre)
    by_face = (np.asarray(normals_of(mesh)) * away.mean(axis=1)).sum(-1)
    return (by_face > 0).all() and ((np.asarray(mesh.corner_normals) * away).sum(-1) > 0).all()


@many_examples
@given(vector, st.floats(-3, 3), st.tuples(*[st.sampled_from([-2.0, -0.5, 0.1, 1.0, 3.0])] * 3), vector)
def test_transformed_mesh_keeps_its_outside_outside(axis, angle, factors, offset):
    matrix = translation(jnp.array(offset)) @ rotation(jnp.array(axis), angle) @ scaling(jnp.array(factors))
    mesh = library_mesh("low_poly_sphere")
    moved = transformed(mesh, matrix)
    assert outward(mesh, [0, 0.5, 0])
    assert outward(moved, np.asarray(matrix)[:3, :3] @ [0, 0.5, 0] + np.asarray(matrix)[:3, 3])
    np.testing.assert_allclose(np.linalg.norm(moved.corner_normals, axis=-1), 1, atol=1e-5)


def test_normals_of_a_stretched_sphere_are_those_of_the_ellipsoid():
    sphere = library_mesh("sphere", subdivisions=3).transformed(translation(jnp.array([0.0, -0.5, 0.0])))
    factors = np.array([1.0, 3.0, -0.5])
    mesh = sphere.transformed(scaling(jnp.asarray(factors)))
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    # The gradient of x²/a² + y²/b² + z²/c².
    gradient = corners / factors**2
    gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
    assert (np.asarray(mesh.corner_normals) * gradient).sum(-1).min() > 0.999


def test_merge_keeps_every_triangle_with_its_normals_and_colour():
    box = library_mesh("box").transformed(translation(jnp.array([3.0, 0.0, 0.0])))
    ball = eqx.tree_at(lambda m: m.albedo, library_mesh("low_poly_sphere"), jnp.full((80, 3), 0.25))
    both = merge([box, ball])
    triangles = np.concatenate([np.asarray(m.vertices)[np.asarray(m.faces)] for m in (box, ball)])
    np.testing.assert_array_equal(np.asarray(both.vertices)[np.asarray(both.faces)], triangles)
    np.testing.assert_array_equal(both.corner_normals[12:], ball.corner_normals)
    np.testing.assert_allclose(both.albedo[:, 0], [0.8] * 12 + [0.25] * 80)


def test_padded_meshes_have_one_of_few_sizes_and_nothing_more_to_see():
    mesh = library_mesh("torus", segments=20, sides=10)
    padded = mesh.padded()
    count, vertices = len(mesh.faces), len(mesh.vertices)
    assert (padded.faces.shape, padded.vertices.shape) == ((4096, 3), (4096, 3))
    for name in ("vertices", "faces", "corner_normals", "albedo"):
        own = np.asarray(getattr(mesh, name))
        np.testing.assert_array_equal(np.asarray(getattr(padded, name))[: len(own)], own)
    further = np.asarray(padded.faces)[count:]
    assert (further == further[:, :1]).all(), "they are points"
    np.testing.assert_array_equal(padded.bounds, mesh.bounds)
    assert padded.padded() is padded
    unused = Mesh(np.vstack([[[9, 9, 9]], mesh.vertices]), mesh.faces + 1)
    np.testing.assert_array_equal(unused.padded().bounds, mesh.bounds)
    assert jax.jit(lambda m: len(m.padded().vertices))(mesh) == vertices, "traced meshes stay as they are"
    # Four sizes to an octave.
    assert [shared_size(n) for n in (1, 257, 4097, 16385, 20481, 33000, 10**6)] == [
        *(256, 4096, 16384, 20480, 24576, 40960, 1048576)
    ]


def test_padded_edges_have_further_rows_that_are_no_silhouettes():
    mesh = library_mesh("box")
    edges, padded = Edges.of(mesh), Edges.of(mesh).padded(256)
    np.testing.assert_array_equal(np.asarray(padded.vertices)[: len(edges.vertices)], edges.vertices)
    assert padded.vertices.shape == (256, 2)
    assert padded.component.shape == (256,)
    assert not np.asarray(padded.directions)[len(edges.vertices) :].any()
