"""The rasterizer against drawings by OpenGL, pixel by pixel."""

import jax.numpy as jnp
import numpy as np
import pytest
from golden_cases import GoldenCase, golden_case, golden_names

from diffshadow.raster import Capacity, Fragments, plan, rasterize

CASES = [golden_case(name) for name in golden_names()]
# Of equal depths the first face is seen, as with GL_LESS, but depth 1 is seen, as with GL_LEQUAL; no polygon offset.
COMPARABLE = [case for case in CASES if case.offset == (0, 0) and case.name not in ("coincident_lequal",)]
FAR_PLANE_UNSEEN = "near_and_far_plane_less"
# Two faces may come so close that half of 1/256 pixel decides which is nearer.
NEARLY_TIED = 1
# OpenGL's own rounding of depth, float32.
ROUNDING = 1e-5


# What every scene is filled up to, so that one compilation serves all of one resolution and culling.
FACES = 1280


@pytest.fixture(scope="module")
def room() -> Capacity:
    """Room for every scene: as many triangles of any kind as a scene has, and all blocks of twenty whole images."""
    nothing = plan(jnp.zeros((3, 4)), jnp.zeros((1, 3), jnp.int32), (8, 8))
    return Capacity(clipped=128, windows=(1024,) * len(nothing.windows), large=1024, blocks=4096)


def draw(case: GoldenCase, room: Capacity) -> Fragments:
    """The scene by our rasterizer, with faces without area added up to `FACES` of them."""
    clip = np.zeros((3 * FACES, 4), np.float32)
    clip[: len(case.clip)] = case.clip
    faces = np.zeros((FACES, 3), np.int32)
    faces[: len(case.faces)] = case.faces
    return rasterize(jnp.asarray(clip), jnp.asarray(faces), case.resolution, cull=case.cull, capacity=room)


def slopes(case: GoldenCase) -> np.ndarray:
    """(f,), the sum of |dz/dx| and |dz/dy| of each face, window depth per pixel; 0 for a face without area."""
    height, width = case.resolution
    corners = case.clip[case.faces].astype(np.float64)
    flat = corners[..., [0, 1, 3]]
    solid = np.abs(np.linalg.det(flat)) > 1e-12
    planes = np.linalg.solve(np.where(solid[:, None, None], flat, np.eye(3)), corners[..., 2:3])[..., 0]
    return np.where(solid, np.abs(planes[:, 0]) / width + np.abs(planes[:, 1]) / height, 0)


@pytest.mark.parametrize("case", [c for c in COMPARABLE if c.name != FAR_PLANE_UNSEEN], ids=lambda case: case.name)
def test_rasterizer_sees_the_faces_and_depths_that_opengl_sees(case, room):
    fragments = draw(case, room)
    face, depth = np.asarray(fragments.face), np.asarray(fragments.depth)
    sure = ~case.near_clipped_edges()
    assert sure.mean() > 0.8

    np.testing.assert_array_equal((face >= 0)[sure], (case.winner >= 0)[sure])
    assert np.sum((face != case.winner)[sure]) <= NEARLY_TIED

    # A corner moves by up to 1/512 pixel each way when it snaps, and the depth at a point inside with it.
    same = (face == case.winner) & (face >= 0)
    allowed = slopes(case)[face[same]] / 512 + ROUNDING
    assert np.all(np.abs(depth - case.depth)[same] <= allowed)


def test_goldens_hold_every_kind_of_scene():
    assert len(CASES) > 30
    assert {case.cull for case in CASES} == {"none", "back", "front"}
    assert any(height != width for height, width in (case.resolution for case in CASES))
    assert sum(case.is_clipped().any() for case in CASES) >= 8
    assert any((case.clip[..., 3] < 0).any() for case in CASES)
