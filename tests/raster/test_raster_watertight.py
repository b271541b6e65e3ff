"""Faces that share edges cover each pixel centre between them exactly once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from triangle_soups import from_window

from diffshadow.geometry import PinholeCamera, library_mesh
from diffshadow.raster import rasterize

pytestmark = pytest.mark.optimized

RESOLUTION = (32, 48)
COLUMNS, ROWS = 7, 5


MAX_FACES, MAX_VERTICES = 80, 49


@jax.jit
def _coverage(clip, faces):
    hits = jax.lax.map(lambda face: rasterize(clip, face[None], RESOLUTION).face == 0, faces)
    return jnp.sum(hits, axis=0)


def coverage(clip, faces):
    """How many of the faces cover each pixel centre, each drawn by itself; any number by one program."""
    vertices = np.full((MAX_VERTICES, 4), [2, 2, 2, 1], np.float32)
    vertices[: len(clip)] = clip
    corners = np.full((MAX_FACES, 3), MAX_VERTICES - 1, np.int32)
    corners[: len(faces)] = faces
    return np.asarray(_coverage(vertices, corners))


def grid_faces(columns, rows, rising):
    """Two triangles for each cell of a grid of corners, split along either diagonal (bool, one a cell)."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    b, c, d = a + 1, a + columns + 1, a + columns
    along, across = np.stack([a, b, c, a, c, d], axis=1), np.stack([a, b, d, b, c, d], axis=1)
    return np.where(rising[:, None], along, across).reshape(-1, 3).astype(np.int32)


def grid_corners(rng, jitter):
    """A grid that reaches beyond the view, its inner corners off their places by up to `jitter` of a cell."""
    height, width = RESOLUTION
    x, y = np.meshgrid(np.linspace(-1, width + 1, COLUMNS), np.linspace(-1, height + 1, ROWS))
    corners = np.stack([x, y], axis=-1)
    cell = np.array([(width + 2) / (COLUMNS - 1), (height + 2) / (ROWS - 1)])
    corners[1:-1, 1:-1] += rng.uniform(-jitter, jitter, (ROWS - 2, COLUMNS - 2, 2)) * cell
    return corners.reshape(-1, 2)


def to_clip(rng, xy, spread):
    """Clip coordinates at various depths and with `w` over a factor of e^(2 · spread)."""
    return from_window(xy, rng.uniform(0.1, 0.9, len(xy)), np.exp(rng.uniform(-spread, spread, len(xy))), RESOLUTION)


@pytest.mark.exhaustive
@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), to_centres=st.booleans(), turned=st.booleans())
def test_a_jittered_grid_covers_every_pixel_once(seed, to_centres, turned):
    rng = np.random.default_rng(seed)
    corners = grid_corners(rng, 0.2)
    if to_centres:
        # Corners, and with them many edges, exactly on pixel centres.
        corners = np.floor(corners) + 0.5
    faces = grid_faces(COLUMNS, ROWS, rng.random((ROWS - 1) * (COLUMNS - 1)) < 0.5)
    faces = faces[:, ::-1] if turned else faces
    # Powers of two keep the centres exact.
    clip = from_window(corners, rng.random(len(corners)), np.exp2(rng.integers(-3, 4, len(corners))), RESOLUTION)
    clip = clip if to_centres else to_clip(rng, corners, 3)
    np.testing.assert_array_equal(coverage(clip, faces), 1)


_clip = eqx.filter_jit(lambda camera, vertices: camera.view().clip(vertices))


@pytest.mark.exhaustive
@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_closed_mesh_round_the_eye_covers_every_pixel_once(seed):
    # Faces cross the near plane and the plane of the eye, reach behind it, and leave the guard band.
    rng = np.random.default_rng(seed)
    mesh = library_mesh("sphere", radius=1.0, subdivisions=1)
    vertices = np.asarray(mesh.vertices) - [0, 1, 0]
    vertices = vertices * np.exp(rng.uniform(-0.05, 0.05, (len(vertices), 1)))
    stretched = np.float32(vertices * np.exp(rng.uniform(-1, 3, 3)))
    eye = rng.uniform(-0.2, 0.2, 3)
    camera = PinholeCamera(eye, eye + rng.normal(size=3), fov_y=rng.uniform(30, 110), near=0.01, far=100.0)
    np.testing.assert_array_equal(coverage(_clip(camera, stretched), mesh.faces), 1)
