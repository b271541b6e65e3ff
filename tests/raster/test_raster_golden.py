"""The rasterizer against drawings by OpenGL, pixel by pixel."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from golden_cases import GoldenCase, golden_case, golden_names

from diffshadow.raster import DepthTest, Fragments, rasterize

pytestmark = pytest.mark.optimized

CASES = [golden_case(name) for name in golden_names()]
FORMATS = ("float32", "unorm24")
STEP = 1 / ((1 << 24) - 1)
# Covered pixels whose face may differ: of two surfaces that meet, rounding decides which is nearer.
TIED = 5e-4
# Roundings of the depth plane's evaluation: each of its terms may come out another last place, or be fused.
ULPS = 8 * np.finfo(np.float32).eps


# What every scene is filled up to, so that one compilation serves all of one resolution, culling and depth test.
FACES = 1280


@functools.cache
def draw(name: str, depth_format: str) -> Fragments:
    """The scene by our rasterizer, with faces without area added up to `FACES` of them."""
    case = golden_case(name)
    clip = np.zeros((3 * FACES, 4), np.float32)
    clip[: len(case.clip)] = case.clip
    faces = np.zeros((FACES, 3), np.int32)
    faces[: len(case.faces)] = case.faces
    return rasterize(
        jnp.asarray(clip),
        jnp.asarray(faces),
        case.resolution,
        cull=case.cull,
        depth_test=DepthTest(depth_format, "less" if case.depth_function == "<" else "less_equal"),
        polygon_offset=np.float32(case.offset),
    )


def is_usual(case: GoldenCase) -> bool:
    """Whether it shares what most cases compile. Others are for the patient."""
    return (case.resolution, case.cull, case.depth_function) == ((72, 96), "none", "<")


def rounding(case: GoldenCase) -> np.ndarray:
    """(f,), how far depth may be off by rounding: in proportion to the depth plane's terms, summed over the image."""
    height, width = case.resolution
    corners = case.clip[case.faces].astype(np.float64)
    flat = corners[..., [0, 1, 3]]
    solid = np.abs(np.linalg.det(flat)) > 1e-12
    planes = np.linalg.solve(np.where(solid[:, None, None], flat, np.eye(3)), corners[..., 2:3])[..., 0]
    slopes = np.abs(planes[:, 0]) / width + np.abs(planes[:, 1]) / height
    # Where a triangle is thin, its slopes themselves are off by the rounding of its corners over its thickness.
    window = corners[..., :2] / np.where(corners[..., 3:] == 0, 1, corners[..., 3:]) * np.array([width, height]) / 2
    edges = np.roll(window, -1, axis=1) - window
    area = np.abs(np.linalg.det(np.stack([edges[:, 0], edges[:, 1]], axis=-1)))
    longest = np.linalg.norm(edges, axis=-1).max(axis=1)
    thinness = longest * np.maximum(np.abs(window).max(axis=(1, 2)), 1) / np.maximum(area, 1e-12)
    steepness = np.maximum(1 + np.abs(case.offset[0]) * slopes, 1)
    return ULPS * (1 + slopes * max(height, width) * (1 + thinness)) * steepness


@pytest.mark.parametrize(
    ("case", "depth_format"),
    [
        pytest.param(
            case,
            depth_format,
            marks=() if is_usual(case) and depth_format == "float32" else pytest.mark.exhaustive,
            id=f"{case.name}-{depth_format}",
        )
        for case in CASES
        for depth_format in FORMATS
    ],
)
def test_rasterizer_sees_the_faces_and_depths_that_opengl_sees(case, depth_format):
    winner = case.winner if depth_format == "float32" else case.winner_24
    stored = case.depth.astype(np.float64) if depth_format == "float32" else case.depth_24 * STEP
    fragments = draw(case.name, depth_format)
    face, depth = np.asarray(fragments.face), np.asarray(fragments.depth, np.float64)
    sure = ~case.near_clipped_edges()
    assert sure.mean() > 0.8

    np.testing.assert_array_equal((face >= 0)[sure], (winner >= 0)[sure])
    assert np.sum((face != winner)[sure]) <= TIED * np.sum(winner >= 0)

    # A clipped triangle's new corners round anew, and the sum of both roundings is one more.
    same = (face == winner) & (face >= 0)
    clipped = np.where(case.is_clipped(), 4, 1)[face[same]]
    allowed = rounding(case)[face[same]] * clipped + (STEP if depth_format == "unorm24" else 0)
    assert np.all(np.abs(depth - stored)[same] <= allowed)


def test_depth_is_within_2e7_of_opengl_nearly_everywhere():
    within, total = 0, 0
    for case in filter(is_usual, CASES):
        fragments = draw(case.name, "float32")
        same = (np.asarray(fragments.face) == case.winner) & (case.winner >= 0)
        error = np.abs(np.asarray(fragments.depth) - case.depth)[same]
        within, total = within + np.sum(error <= 2e-7), total + error.size
    assert total > 1e5
    assert within / total > 0.95
