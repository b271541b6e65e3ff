"""Interpolation over what was drawn, and its derivatives, against float64."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterizer_oracle import rasterize_exact
from scenes import marked
from triangle_soups import from_window, soup

from diffshadow.geometry import (
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    library_mesh,
    merge,
)
from diffshadow.raster import (
    _interpolate,
    barycentrics,
    draw_surface,
    interpolate,
    interpolate_depth,
    rasterize,
    visible_depth,
)
from diffshadow.raster._interpolate import by_bands

RESOLUTION = (24, 32)


def to_numpy(x):
    return np.asarray(x, np.float64)


def scene_mesh():
    box = library_mesh("box", size=0.8)
    return merge([box, library_mesh("low_poly_sphere", radius=0.4).transformed(jnp.eye(4).at[0, 3].set(0.8)),
                  library_mesh("plane", size=4.0, segments=2)])  # fmt: skip


MESH = scene_mesh()
CAMERA = PinholeCamera((1.9, 1.6, 2.2), (0.3, 0.3, 0.1), near=0.5, far=8.0, resolution=RESOLUTION)


# Values


def weights_exact(face, clip, faces):
    """Perspective-correct barycentric coordinates (h, w, 3), float64, by solving for them pixel by pixel."""
    height, width = face.shape
    rows = to_numpy(clip)[np.asarray(faces)[np.maximum(face, 0)]][..., [0, 1, 3]]
    y, x = np.indices(face.shape)
    centre = np.stack([(x + 0.5) * 2 / width - 1, (y + 0.5) * 2 / height - 1, np.ones(face.shape)], axis=-1)
    rows = np.where((face >= 0)[..., None, None], rows, np.eye(3))
    mixed = np.linalg.solve(np.swapaxes(rows, -1, -2), centre[..., None])[..., 0]
    return mixed / mixed.sum(axis=-1, keepdims=True)


@functools.partial(jax.jit, static_argnums=2)
def positions_by_bands(face, mesh, pixels):
    """Positions (h, w, 3) in bands of about so many pixels, with their slopes as the mesh grows."""

    def positions(scale):
        grown = eqx.tree_at(lambda m: m.vertices, mesh, mesh.vertices * scale)
        clip = CAMERA.view().clip(grown.vertices)
        band = lambda face, rows: interpolate(barycentrics(face, clip, mesh.faces, rows), grown.vertices, mesh.faces)
        return by_bands(band, face, band=pixels)

    return jax.jvp(positions, (jnp.ones(()),), (jnp.ones(()),))


@pytest.mark.exhaustive
@pytest.mark.parametrize("pixels", marked([1, 3 * 32, 32], {3 * 32, 32}))
def test_bands_of_rows_make_the_whole_image(pixels):
    # A prime number of rows: the last band of three rows is padded.
    face = rasterize(CAMERA.view().clip(MESH.vertices), MESH.faces, RESOLUTION).face[:23]
    whole, banded = positions_by_bands(face, MESH, face.size), positions_by_bands(face, MESH, pixels)
    assert np.abs(np.asarray(whole[0])).max() > 0.5
    for expected, found in zip(whole, banded, strict=True):
        np.testing.assert_allclose(found, expected, atol=5e-6)


def depth_gradient():
    """The gradient (v, 4) of the squared depth, of a face map, clip coordinates and faces; a new program each time."""
    return jax.jit(jax.grad(lambda clip, face, faces: jnp.sum(visible_depth(face, clip, faces) ** 2)))


@pytest.mark.exhaustive
def test_derivatives_of_depth_in_bands_are_those_of_the_whole_image(monkeypatch):
    clip = CAMERA.view().clip(MESH.vertices)
    face = rasterize(clip, MESH.faces, RESOLUTION).face
    whole = np.asarray(depth_gradient()(clip, face, MESH.faces))
    forward = lambda clip: jax.jvp(lambda clip: visible_depth(face, clip, MESH.faces), (clip,), (jnp.cos(clip),))
    depth, slope = jax.jit(forward)(clip)
    monkeypatch.setattr(_interpolate, "_DERIVATIVE_WHOLE", RESOLUTION[0] * RESOLUTION[1] - 1)
    monkeypatch.setattr(_interpolate, "_DERIVATIVE_BAND", 5 * 32)
    found = np.asarray(depth_gradient()(clip, face, MESH.faces))
    assert np.abs(whole).max() > 1
    np.testing.assert_allclose(found, whole, rtol=1e-5, atol=1e-5 * np.abs(whole).max())
    of_bands = jax.jit(lambda clip: forward(clip))(clip)
    np.testing.assert_array_equal(of_bands[0], depth)
    np.testing.assert_allclose(of_bands[1], slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())


@pytest.mark.exhaustive
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="bands are of CPUs")
def test_the_gradient_of_a_large_depth_map_fits_into_a_heap_of_the_c_library():
    clip = jnp.zeros((MESH.vertices.shape[0], 4))
    program = depth_gradient().lower(clip, jax.ShapeDtypeStruct((2048, 2048), jnp.int32), MESH.faces).compile()
    # The heap has 64 MiB. The face map, which is drawn first, takes 16 MiB of it.
    assert program.memory_analysis().temp_size_in_bytes < 48 << 20


@jax.jit
def interpolated(face, clip, vertices, faces):
    """The barycentrics, the vertices' place and depth of the faces that are seen."""
    at = barycentrics(face, clip, faces)
    return at, interpolate(at, vertices, faces), interpolate_depth(at, clip, faces)


def seen_from(clip, vertices, faces):
    """What is seen (h, w), and what is interpolated there."""
    face = rasterize(clip, jnp.asarray(faces), RESOLUTION).face
    return face, *interpolated(face, clip, vertices, faces)


_clip = eqx.filter_jit(lambda camera, vertices: camera.view().clip(vertices))


@pytest.mark.parametrize("camera", [
    CAMERA,
    OrthographicCamera((1.9, 1.6, 2.2), (0.3, 0.3, 0.1), height=3.0, near=0.5, far=8.0, resolution=RESOLUTION),
    # The floor reaches behind the eye.
    PinholeCamera((0.5, 0.5, 1.2), (0.3, 0.3, 0.1), near=0.05, far=8.0, fov_y=80.0, resolution=RESOLUTION),
])  # fmt: skip
def test_interpolation_is_perspective_correct(camera):
    clip = _clip(camera, MESH.vertices)
    face, at, got, _ = jax.tree.map(np.asarray, seen_from(clip, MESH.vertices, MESH.faces))
    seen = face >= 0
    np.testing.assert_array_equal(at.mask, seen)
    np.testing.assert_allclose(at.weights.sum(axis=-1), 1, atol=1e-6)

    exact = weights_exact(face, clip, MESH.faces)
    corners = to_numpy(MESH.vertices)[np.asarray(MESH.faces)[np.maximum(face, 0)]]
    expected = np.sum(exact[..., None] * corners, axis=-2)
    # A centre on an outline may lie outside its face by the half sub-pixel of snapping, and is pulled back only then.
    inner = seen & (exact.min(axis=-1) > -0.05)
    assert inner.sum() > 0.95 * seen.sum() > 100
    np.testing.assert_allclose(got[inner], expected[inner], atol=5e-6)
    np.testing.assert_array_equal(got[~seen], 0)


@jax.jit
def depth_of(face, clip, faces):
    return interpolate_depth(barycentrics(face, clip, faces), clip, faces)


def test_depth_of_well_shaped_triangles_is_within_rounding_of_float64():
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(40):
        shape = np.array([[-7, -6], [8, -5], [1, 9]])
        xy = shape + rng.uniform(0, [32, 24], (8, 1, 2)) + rng.uniform(-2, 2, (8, 3, 2))
        w = np.exp(rng.uniform(-1, 1, (8, 3)))
        clip = from_window(xy, rng.random((8, 3)), w, RESOLUTION).reshape(-1, 4).astype(np.float32)
        faces = np.arange(24, dtype=np.int32).reshape(8, 3)
        exact = rasterize_exact(clip, faces, RESOLUTION)
        # The same face for both: which one is nearest is tested elsewhere.
        depth = np.asarray(depth_of(exact.face.astype(np.int32), clip, faces))
        seen = exact.face >= 0
        np.testing.assert_allclose(depth[seen], exact.depth[seen], rtol=0, atol=6e-7)
        assert np.mean(np.abs(depth - exact.depth)[seen]) < 1e-7
        np.testing.assert_array_equal(depth[~seen], 1)
        checked += seen.sum()
    assert checked > 10_000


@pytest.mark.parametrize("size", [20, 200, 2000])
def test_depth_of_a_floor_round_the_eye_is_off_by_little_of_its_distance_from_the_far_plane(size):
    # The corners lie `size` away on all sides, and their weights cancel at the pixels.
    floor = library_mesh("plane", size=float(size))
    camera = PinholeCamera(
        (0.3, 0.7, 0.4), (1.3, 0.3, 0.9), near=0.05, far=4.0 * size, fov_y=60.0, resolution=RESOLUTION
    )
    # Filled up to as many vertices and faces as the other scenes have.
    vertices, faces = np.zeros(MESH.vertices.shape, np.float32), np.zeros(MESH.faces.shape, np.int32)
    vertices[: len(floor.vertices)], faces[: len(floor.faces)] = floor.vertices, floor.faces
    clip = _clip(camera, vertices)
    face, _, _, depth = jax.tree.map(np.asarray, seen_from(clip, vertices, faces))
    seen = face >= 0
    assert seen.sum() > 0.5 * seen.size
    exact = weights_exact(face, clip, faces)
    corners = to_numpy(clip)[faces[np.maximum(face, 0)]]
    z, w = np.moveaxis(np.sum(exact[..., None] * corners[..., 2:], axis=-2), -1, 0)
    error = np.abs(to_numpy(depth) - (z / w * 0.5 + 0.5))[seen]
    # What rounding of the corners leaves behind of w, as a share of it, for the part of depth that depends on w.
    eps = np.finfo(np.float32).eps
    bound = (eps * (1 + np.abs(corners[..., 2:]).max(axis=(-1, -2)) / w * np.abs(z - w) / w))[seen]
    assert (error <= bound).all(), (error / bound).max()


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_face_makes_a_nan_in_value_or_gradient(seed):
    clip, _ = soup(np.random.default_rng(seed), 24, RESOLUTION)
    faces = jnp.arange(72, dtype=jnp.int32).reshape(-1, 3)
    # Any face at any pixel, covered or not: slivers, edge-on, without area, behind the eye.
    face = jnp.asarray(np.random.default_rng([seed, 1]).integers(-1, 24, RESOLUTION), jnp.int32)
    value, gradient = VALUE_AND_GRADIENT(jnp.asarray(clip), faces, face)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


@jax.jit
def VALUE_AND_GRADIENT(clip, faces, face):
    def total(clip):
        at = barycentrics(face, clip, faces)
        # Weights within [0, 1] of any finite attribute; depth is w's business where w comes near 0.
        return jnp.sum(interpolate(at, clip, faces)) + jnp.sum(at.weights**2)

    return jax.value_and_grad(total)(clip)


@pytest.mark.exhaustive
def test_depth_of_thin_and_edge_on_faces_has_finite_gradients():
    # Edge-on; without area; a sliver of 1e-6; all corners alike. Each seen at every pixel.
    w = np.ones(3)
    shapes = [
        [[4, 4], [20, 12], [12, 8]],
        [[4, 4], [20, 12], [20, 12]],
        [[4, 4], [20, 12], [12, 8 + 1e-6]],
        [[9.5, 9.5]] * 3,
    ]
    faces, face = jnp.array([[0, 1, 2]], jnp.int32), jnp.zeros(RESOLUTION, jnp.int32)

    @jax.jit
    def depth_and_gradient(clip):
        depths = lambda clip: jnp.stack([depth_of(face, clip, faces), visible_depth(face, clip, faces)])
        depth, pull = jax.vjp(depths, clip)
        return depth, pull(jnp.ones_like(depth))[0]

    for xy in shapes:
        clip = from_window(np.array(xy, float), np.array([0.2, 0.5, 0.9]), w, RESOLUTION).astype(np.float32)
        depth, gradient = map(np.asarray, depth_and_gradient(clip))
        assert np.isfinite(depth.sum())
        np.testing.assert_array_equal(depth[0], depth[1])
        assert np.isfinite(gradient).all()
        assert ((depth >= 0.2 - 1e-5) & (depth <= 0.9 + 1e-5)).all()


# Derivatives


def clip_of(case, parameter):
    view, vertices = case.view_and_vertices(parameter)
    return view.clip(vertices), vertices


def maps(case, face, parameter):
    """Both depths and position (h, w, 5) of the faces (h, w) that are seen, as functions of the parameter."""
    clip, vertices = clip_of(case, parameter)
    at = barycentrics(face, clip, MESH.faces)
    position = interpolate(at, jnp.asarray(vertices, clip.dtype), MESH.faces)
    depths = jnp.stack([interpolate_depth(at, clip, MESH.faces), visible_depth(face, clip, MESH.faces)], axis=-1)
    return jnp.concatenate([depths, position], axis=-1)


def differences(case, step=1e-5):
    """Central differences (h, w, 5, p) in float64, and where (h, w) one face is seen throughout."""
    with jax.enable_x64(True):
        clip, values = jax.jit(lambda p: clip_of(case, p)[0]), jax.jit(lambda face, p: maps(case, face, p))

        def drawn(parameter):
            face = rasterize(clip(parameter), MESH.faces, RESOLUTION).face
            return values(face, parameter), face

        middle = np.array(case.parameter)
        slopes, same = [], True
        for offset in np.eye(len(middle)) * step:
            (high, face_high), (low, face_low) = drawn(middle + offset), drawn(middle - offset)
            slopes.append((np.asarray(high) - np.asarray(low)) / (2 * step))
            same = same & (np.asarray(face_high) == np.asarray(face_low)) & (np.asarray(face_low) >= 0)
        assert high.dtype == jnp.float64
    return np.stack(slopes, axis=-1), same


# Surfaces


def test_the_surface_of_a_plane_lies_on_it_and_faces_the_camera():
    height, width = RESOLUTION
    mesh = Mesh(MESH.vertices, MESH.faces[-8:], np.broadcast_to(np.float32([0, 1, 0]), (8, 3, 3)))
    for eye in ((1.9, 1.6, 2.2), (1.9, -1.6, 2.2)):
        camera = PinholeCamera(eye, (0.0, 0.0, 0.0), near=0.5, far=8.0, resolution=RESOLUTION)
        surface = draw_surface(mesh, camera)
        seen = np.asarray(surface.mask)
        np.testing.assert_array_equal(seen, np.asarray(surface.face) >= 0)
        assert seen.sum() > 100
        np.testing.assert_allclose(np.asarray(surface.position)[seen][:, 1], 0, atol=1e-6)
        up = np.sign(eye[1]) * np.array([0, 1, 0])
        for normal in (surface.normal, surface.shading_normal):
            np.testing.assert_allclose(np.asarray(normal)[seen], np.broadcast_to(up, (seen.sum(), 3)), atol=1e-5)
            np.testing.assert_array_equal(np.asarray(normal)[~seen], 0)
        # Each point projects to the centre of its pixel.
        clip = to_numpy(_clip(camera, surface.position))
        row, column = np.nonzero(seen)
        window = (clip[seen][:, :2] / clip[seen][:, 3:] * 0.5 + 0.5) * [width, height]
        np.testing.assert_allclose(window, np.stack([column, row], axis=-1) + 0.5, atol=0.01)
