"""The rasterizer against a brute-force float64 one, and its rules one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rasterizer_oracle import acceptable, rasterize_exact
from scenes import compiled_programs, marked
from triangle_soups import from_window, soup

from diffshadow.geometry import Mesh, OrthographicCamera, PinholeCamera, library_mesh
from diffshadow.raster import NO_FACE, DepthTest, at_steps, draw_surface, rasterize, rasterize_depth
from diffshadow.raster._windows import _up_to_last

pytestmark = pytest.mark.optimized

RESOLUTION = (32, 48)
COUNT = 24
FACES = np.arange(3 * COUNT, dtype=np.int32).reshape(-1, 3)
SOUPS_AN_EXAMPLE = 25
# What all meshes are filled up to, so that a kind of drawing is compiled once.
MAX_FACES, MAX_VERTICES = 4096, 4095
seeds = st.integers(0, 2**32 - 1)


NOTHING_PASSED = np.full(RESOLUTION, NO_FACE, np.int32)
LESS_EQUAL = DepthTest(compare="less_equal")


def padded_to(clip, faces):
    """Vertices and faces, and more of either that are not seen."""
    vertices = np.full((MAX_VERTICES, 4), [2.0, 2.0, 2.0, 1.0], np.float32)
    vertices[: len(clip)] = clip
    corners = np.full((MAX_FACES, 3), MAX_VERTICES - 1, np.int32)
    corners[: len(faces)] = faces
    return jnp.asarray(vertices), jnp.asarray(corners)


def draw(clip, faces=FACES, resolution=RESOLUTION, **options):
    drawn = rasterize(*padded_to(clip, faces), resolution, **options)
    return np.asarray(drawn.face), np.asarray(drawn.depth)


def draw_culled(clip, faces=FACES, cull="back", behind=NOTHING_PASSED):
    """With culling, where equal depths pass, and faces `behind` do not: all by one program."""
    return draw(clip, faces, cull=cull, depth_test=LESS_EQUAL, behind=jnp.asarray(behind))


def draw_window(xy, z, faces, cull="none"):
    """Draws faces whose corners are given in pixels and window depth."""
    clip = from_window(np.asarray(xy, float), np.asarray(z, float), np.ones(len(xy)), RESOLUTION)
    faces = np.asarray(faces, int).reshape(-1, 3)
    if cull == "front":
        return draw(clip, faces, cull=cull)
    return draw(clip, faces) if cull == "none" else draw_culled(clip, faces, cull)


def assert_explained(face, exact, what):
    wrong = ~acceptable(face, exact.layers)
    assert not wrong.any(), (
        f"{what}: {wrong.sum()} pixels see the wrong face; the first is (row, column) {np.argwhere(wrong)[0]}, "
        f"which sees {face[wrong][0]} instead of {exact.face[wrong][0]}, {exact.margin[wrong][0]:.2f} sub-pixels from "
        f"an outline, with {exact.gap[wrong][0]:.2e} of depth to the next face"
    )


# Soups


# Clipping leaves a sliver of thousands of pixels by a tenth of one.
@example(seed=12543)
@settings(deadline=None, max_examples=3)
@given(seed=seeds)
def test_soups_of_every_kind_see_the_nearest_face(seed):
    for k in range(SOUPS_AN_EXAMPLE):
        clip, _ = soup(np.random.default_rng([seed, k]), COUNT, RESOLUTION)
        face, depth = draw(clip)
        exact = rasterize_exact(clip, FACES, RESOLUTION)
        assert_explained(face, exact, f"soup {k} of {seed}")
        assert ((depth >= 0) & (depth <= 1)).all()
        assert (depth[face < 0] == 1).all()


def test_depth_of_unclipped_soups_is_that_of_their_planes():
    for k in range(100):
        clip, kinds = soup(np.random.default_rng([5, k]), COUNT, RESOLUTION)
        face, depth = draw(clip)
        exact = rasterize_exact(clip, FACES, RESOLUTION)
        pixel = (np.maximum(face, 0), *np.indices(face.shape))
        plain = (face >= 0) & ~exact.layers.clipped[np.maximum(face, 0)]
        error = np.abs(depth - exact.layers.depth[pixel])[plain]
        assert (error <= exact.layers.depth_error[pixel][plain]).all(), kinds


@pytest.mark.exhaustive
def test_a_mesh_in_perspective_sees_the_nearest_face():
    mesh = library_mesh("torus", segments=24, sides=12)
    camera = PinholeCamera((0.6, 0.5, 0.7), (0.0, 0.1, 0.0), near=0.05, far=4.0, resolution=RESOLUTION)
    clip, faces = np.asarray(camera.view().clip(mesh.vertices)), np.asarray(mesh.faces)
    exact = rasterize_exact(clip, faces, camera.resolution, "back")
    face, _ = draw_culled(clip, faces)
    assert np.sum(face >= 0) > 300
    assert_explained(face, exact, "torus")
    np.testing.assert_array_equal(face >= 0, exact.face >= 0)


# Invariance


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_shuffling_the_faces_permutes_the_indices(seed):
    rng = np.random.default_rng(seed)
    clip, _ = soup(rng, COUNT, RESOLUTION)
    order = rng.permutation(COUNT)
    face, depth = draw(clip)
    shuffled, shuffled_depth = draw(clip, FACES[order])
    np.testing.assert_array_equal(shuffled_depth, depth)
    # At the same depth the lower index wins, so there alone the faces may differ.
    same = np.where(shuffled >= 0, order[np.maximum(shuffled, 0)], NO_FACE) == face
    tied = rasterize_exact(clip, FACES, RESOLUTION).gap < 1e-6
    assert (same | tied).all()


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_scaling_a_vertex_in_clip_space_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    clip, _ = soup(rng, COUNT, RESOLUTION)
    # Powers of two scale without rounding.
    scale = np.exp2(rng.integers(-8, 9, (len(clip), 1))).astype(np.float32)
    unclipped = ~rasterize_exact(clip, FACES, RESOLUTION).layers.clipped
    kept = FACES * unclipped[:, None]
    for got, expected in zip(draw(clip * scale, kept), draw(clip, kept), strict=True):
        np.testing.assert_array_equal(got, expected)
    # Clipping rounds otherwise, and then any factor may do.
    factor = rng.uniform(0.1, 10, (COUNT, 1)).repeat(3, axis=0).astype(np.float32)
    scaled = (clip * factor).astype(np.float32)
    assert_explained(draw(scaled)[0], rasterize_exact(scaled, FACES, RESOLUTION), f"scaled soup of {seed}")


# Rules


SQUARE = [[2, 1], [12, 1], [12, 7], [2, 7]]
TWO_FACES = [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(("cull", "turned", "seen"), [
    ("none", False, True), ("none", True, True),
    ("back", False, True), ("back", True, False),
    ("front", False, False), ("front", True, True),
])  # fmt: skip
def test_culling_goes_by_winding_in_the_window(cull, turned, seen):
    faces = np.array(TWO_FACES)[:, ::-1] if turned else TWO_FACES
    face, _ = draw_window(SQUARE, [0.5] * 4, faces, cull=cull)
    expected = np.zeros(RESOLUTION, bool)
    expected[1:7, 2:12] = seen
    np.testing.assert_array_equal(face >= 0, expected)


def test_left_and_bottom_edges_own_the_centres_on_them():
    corners = np.array([[1.5, 1.5], [4.5, 1.5], [4.5, 3.5], [1.5, 3.5]])
    face, _ = draw_window(corners, [0.5] * 4, TWO_FACES)
    expected = np.zeros(RESOLUTION, bool)
    expected[1:3, 1:4] = True
    np.testing.assert_array_equal(face >= 0, expected)


def test_of_two_faces_at_the_same_depth_the_lower_index_is_seen():
    corners, z = SQUARE * 3, [0.5] * 12
    face, _ = draw_window(corners, z, [[8, 9, 10], [4, 5, 6], [0, 1, 2]])
    assert set(np.unique(face)) == {NO_FACE, 0}
    # Whatever their sizes.
    wide = [[0, 0], [64, 0], [64, 32], [0, 32], [8, 8], [10, 8], [10, 10], [8, 10]]
    faces = [[4, 5, 6], [4, 6, 7], [0, 1, 2], [0, 2, 3]]
    # The centre of column 9, row 8 lies in the small one's lower and in the wide one's upper half.
    for order in (faces, faces[::-1]):
        face, _ = draw_window(wide, [0.5] * 8, order)
        assert face[8, 9] == min(order.index([4, 5, 6]), order.index([0, 2, 3]))


def test_each_pixel_is_cut_at_the_near_and_the_far_plane():
    # Depth runs from -0.5 at the left border to 1.5 at the right: x = 12 is at 0, x = 36 at 1.
    corners = [[0, 0], [48, 0], [48, 32], [0, 32]]
    face, depth = draw_window(corners, [-0.5, 1.5, 1.5, -0.5], TWO_FACES)
    expected = np.zeros(RESOLUTION, bool)
    expected[:, 12:36] = True
    np.testing.assert_array_equal(face >= 0, expected)
    ramp = (np.arange(48) + 0.5) / 24 - 0.5
    np.testing.assert_allclose(depth[:, 12:36], np.tile(ramp[12:36], (32, 1)), atol=3e-7)


@pytest.mark.parametrize(("z", "compare", "seen"), [
    (0.0, "less", True), (1.0, "less", False), (0.0, "less_equal", True), (1.0, "less_equal", True),
])  # fmt: skip
def test_faces_on_the_near_and_on_the_far_plane(z, compare, seen):
    face, depth = draw_window(SQUARE, [z] * 4, TWO_FACES, "none" if compare == "less" else "back")
    assert np.sum(face >= 0) == (60 if seen else 0)
    assert (depth[1:7, 2:12] == z).all()


def test_of_two_faces_at_the_same_depth_less_equal_sees_the_higher_index():
    faces = [[8, 9, 10], [4, 5, 6], [0, 1, 2]]
    face, _ = draw_window(SQUARE * 3, [0.5] * 12, faces, "back")
    assert set(np.unique(face)) == {NO_FACE, 2}


@pytest.mark.parametrize("seed", range(3))
def test_what_lies_behind_the_nearest_face_is_the_second_nearest(seed):
    clip, _ = soup(np.random.default_rng([19, seed]), COUNT, RESOLUTION)
    first, _ = draw_culled(clip)
    second, _ = draw_culled(clip, behind=first)
    layers = rasterize_exact(clip, FACES, RESOLUTION, "back").layers
    # Without the nearest face, wherever it is.
    passed = np.arange(COUNT)[:, None, None] == first
    assert acceptable(second, layers._replace(inside=layers.inside & ~passed)).all()
    assert (second >= 0).any()


VIEW_FILLING = np.array([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]], np.float32)


@pytest.mark.parametrize(
    "resolution",
    marked([(1, 1), (33, 47), (1, 8192), (8192, 1)], [(1, 8192), (8192, 1)]),
)
def test_a_face_larger_than_the_view_fills_any_resolution(resolution):
    face, depth = draw(VIEW_FILLING, np.array([[0, 1, 2]]), resolution)
    assert face.shape == resolution
    assert (face == 0).all()
    np.testing.assert_array_equal(depth, 0.5)


def test_large_faces_have_as_many_blocks_as_they_need():
    # Two halves of the view, each of 16 rows of up to 16 blocks, in many layers of which the last is the nearest.
    layers = 64
    corners = np.tile([[0, 0], [256, 0], [256, 256], [0, 256]], (layers, 1))
    depth = np.repeat(np.linspace(0.9, 0.1, layers), 4)
    clip = from_window(corners, depth, np.ones(4 * layers), (256, 256))
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(layers)[:, None, None]
    face, seen = draw(clip, faces.reshape(-1, 3), (256, 256))
    row, column = np.indices(face.shape)
    np.testing.assert_array_equal((face - 2 * (layers - 1))[row != column], (row > column)[row != column])
    assert (face != NO_FACE).all()
    np.testing.assert_allclose(seen, 0.1, rtol=1e-6)


def test_nothing_is_seen_where_no_face_is():
    face, depth = draw_window(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3)))
    np.testing.assert_array_equal(face, NO_FACE)
    np.testing.assert_array_equal(depth, 1)


# However many triangles


def test_slivers_are_no_deeper_and_no_nearer_than_their_corners():
    """Thinner than a sub-pixel: snapped, they hold centres at which their own planes run far off."""
    rng = np.random.default_rng(0)
    count, size = 1300, np.array(RESOLUTION[::-1])
    # Along lines through centres.
    centre, way = rng.integers(0, size, (count, 2)) + 0.5, rng.normal(size=(count, 2)) * 10
    start = centre - rng.uniform(0.2, 0.8, (count, 1)) * way
    across = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1, keepdims=True)
    middle = start + rng.uniform(0.2, 0.8, (count, 1)) * way + rng.uniform(-2e-3, 2e-3, (count, 1)) * across
    corners, z = np.stack([start, start + way, middle], axis=1).reshape(-1, 2), rng.uniform(0.4, 0.6, 3 * count)
    face, depth = draw_window(corners, z, np.arange(3 * count))
    depth = depth[face >= 0]
    assert len(depth) > 100
    assert depth.min() > 0.4 - 0.02 * 0.2
    assert depth.max() < 0.6 + 0.02 * 0.2


def test_many_triangles_of_every_size_are_drawn_as_few_are():
    """So many that every loop runs several times: small ones, large ones, and those that are clipped."""
    times = MAX_FACES // COUNT // 3
    for seed in (11, 12):
        clip, _ = soup(np.random.default_rng(seed), COUNT, RESOLUTION)
        face, depth = draw(np.tile(clip, (times, 1)), np.arange(3 * COUNT * times).reshape(-1, 3))
        few, expected = draw(clip)
        # Of equal depths, the first counts.
        np.testing.assert_array_equal(face, few)
        np.testing.assert_array_equal(depth, expected)


def test_meshes_and_small_images_of_like_size_share_a_program():
    with compiled_programs() as compiled:
        for n, resolution in ((14, (21, 33)), (25, (50, 9)), (40, (64, 64))):
            corners = np.indices((n, n)).reshape(2, -1).T / (n - 1.0) * 70
            clip = from_window(corners, np.full(n * n, 0.5), np.ones(n * n), resolution)
            cell = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1, 1)
            faces = np.concatenate([cell + np.array([0, n, 1]), cell + np.array([n, n + 1, 1])])
            face = np.asarray(rasterize(jnp.asarray(clip), jnp.asarray(faces), resolution).face)
            assert face.shape == resolution
            assert (face >= 0).all()
    # None if another test has drawn such an image before.
    assert sum("_shared" in name for name in compiled) <= 1


def window_triangles(*sides):
    """Triangles whose pixel boxes are as wide."""
    corners = np.concatenate([[[0, 0], [side - 0.1, 0], [0, side - 0.1]] for side in sides])
    clip = from_window(corners, np.full(len(corners), 0.5), np.ones(len(corners)), RESOLUTION)
    return padded_to(clip, np.arange(len(corners)).reshape(-1, 3))


def test_a_drawing_carries_no_gradient_and_shares_its_program_with_those_in_double_precision():
    clip, faces = window_triangles(8, 16)
    depth = lambda c: jnp.sum(rasterize(c, faces, RESOLUTION).depth)
    expected = depth(clip)
    with compiled_programs() as compiled:
        value, gradient = jax.value_and_grad(depth)(clip)
        with jax.enable_x64(True):
            in_double = depth(clip.astype(jnp.float64))
    np.testing.assert_array_equal(gradient, 0)
    assert value == expected
    assert in_double == pytest.approx(float(expected))
    assert not any("_shared" in name for name in compiled)


@pytest.mark.exhaustive
def test_a_batch_is_drawn_one_by_one():
    clips = np.stack([soup(np.random.default_rng(k), COUNT, RESOLUTION)[0] for k in range(3)])
    batch = rasterize(jnp.asarray(clips), jnp.asarray(FACES), RESOLUTION)
    mapped = jax.vmap(lambda c: rasterize(c, jnp.asarray(FACES), RESOLUTION).face)(jnp.asarray(clips))
    depth = rasterize_depth(jnp.asarray(clips), jnp.asarray(FACES), RESOLUTION)
    for k, clip in enumerate(clips):
        face, expected_depth = draw(clip)
        np.testing.assert_array_equal(batch.face[k], face)
        np.testing.assert_array_equal(mapped[k], face)
        # The last digit may differ: the compiler fuses other multiplications and additions.
        np.testing.assert_allclose(batch.depth[k], expected_depth, rtol=0, atol=3e-7)
        np.testing.assert_allclose(depth[k], expected_depth, rtol=0, atol=3e-7)


def test_mapped_loops_over_windows_are_as_long_as_the_longest():
    faces = jnp.array([[3, -1, -1, -1], [5, -1, 2, -1]])
    assert [int(_up_to_last(row)) for row in faces] == [1, 3]
    assert jax.vmap(_up_to_last)(faces).tolist() == [3, 3]


@pytest.mark.parametrize("resolution", [(0, 4), (4, 8193)])
def test_a_resolution_out_of_range_is_refused(resolution):
    with pytest.raises(
        ValueError, match=r"resolution.* is (0|8193); expected a whole number at least 1 and at most 8192"
    ):
        rasterize(jnp.zeros((3, 4)), jnp.array([[0, 1, 2]]), resolution)


@pytest.mark.parametrize("buffer", [(8, 31), (8193, 32)])
def test_a_buffer_that_is_too_small_or_too_large_is_refused(buffer):
    with pytest.raises(ValueError, match=r"the buffer is \(.*expected .* at least \(8, 32\) and at most 8192"):
        rasterize(jnp.zeros((3, 4)), jnp.array([[0, 1, 2]]), (8, 32), buffer=buffer)


# --- Rasterizers with coarser steps ---


def test_vertices_are_placed_at_whole_steps_but_for_those_behind_the_eye():
    clip = np.random.default_rng(0).uniform(-2, 2, (40, 4)).astype(np.float32)
    placed = np.asarray(at_steps(jnp.asarray(clip), RESOLUTION, 16))
    ahead = clip[:, 3] > 0
    np.testing.assert_array_equal(placed[~ahead], clip[~ahead])
    np.testing.assert_array_equal(placed[:, 2:], clip[:, 2:])
    height, width = RESOLUTION
    steps = lambda clip: (clip[ahead, :2] / clip[ahead, 3:] + 1) / 2 * [width * 16, height * 16]
    np.testing.assert_allclose(steps(placed), np.round(steps(clip)), atol=0.01)


@pytest.mark.exhaustive
def test_a_surface_at_coarse_steps_is_interpolated_between_the_steps():
    """In a parallel view that is two units high, 32 pixels with 2 steps each place vertices at whole 32nds."""
    vertices = np.array([[-0.83, -0.91, 0], [0.87, -0.79, 0], [0.11, 0.93, 0]])
    camera = OrthographicCamera((0, 0, 5), (0, 0, 0), height=2.0, near=1.0, far=9.0, resolution=(32, 32))
    mesh = Mesh(vertices, np.array([[0, 1, 2]]))
    surface = draw_surface(mesh, camera, subpixels=2)
    rows, columns = np.nonzero(surface.mask)
    assert len(rows) > 300
    centres = (
        np.stack([columns, rows, np.full_like(rows, 16)], axis=-1) / 16 + np.array([1 / 32, 1 / 32, 0]) - [1, 1, 0]
    )
    corners = np.round(vertices * 32) / 32
    assert np.abs(corners - vertices).max() > 0.01
    shares = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), centres.T)
    np.testing.assert_allclose(np.asarray(surface.position)[rows, columns], shares.T @ vertices, atol=1e-5)
    with pytest.raises(ValueError, match="subpixels is 0; expected a whole number of steps to a pixel, such as 16"):
        draw_surface(mesh, camera, subpixels=0)
