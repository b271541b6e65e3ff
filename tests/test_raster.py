"""The rasterizer against a brute-force float64 one, and its rules one by one."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterizer_oracle import acceptable, rasterize_exact
from triangle_soups import from_window, soup

from diffshadow.geometry import PinholeCamera, library_mesh
from diffshadow.raster import NO_FACE, Capacity, DepthTest, plan, rasterize, rasterize_depth

RESOLUTION = (32, 48)
COUNT = 24
FACES = np.arange(3 * COUNT, dtype=np.int32).reshape(-1, 3)
SOUPS_AN_EXAMPLE = 25
seeds = st.integers(0, 2**32 - 1)


@functools.cache
def room(resolution=RESOLUTION):
    """Room for any soup, with plenty to spare, and windows of every size."""
    clips = np.stack([soup(np.random.default_rng(k), COUNT, resolution)[0] for k in range(100)])
    planned = scaled(plan(jnp.asarray(clips), jnp.asarray(FACES), resolution), 4)
    return planned._replace(windows=(sum(planned.windows),) * 5)


def scaled(capacity, factor):
    return Capacity(*jax.tree.map(lambda n: factor * n, tuple(capacity)))


def draw(clip, faces=FACES, resolution=RESOLUTION, capacity=None, **options):
    capacity = capacity or room(resolution)
    drawn = rasterize(jnp.asarray(clip), jnp.asarray(faces), resolution, capacity=capacity, **options)
    return np.asarray(drawn.face), np.asarray(drawn.depth)


def draw_window(xy, z, faces, **options):
    """Draws faces whose corners are given in pixels and window depth, filled up so that nothing is compiled anew."""
    corners = from_window(np.asarray(xy, float), np.asarray(z, float), np.ones(len(xy)), RESOLUTION)
    clip = np.full((3 * COUNT, 4), [2.0, 2.0, 2.0, 1.0], np.float32)
    clip[: len(corners)] = corners
    filled = np.full((COUNT, 3), 3 * COUNT - 1, np.int32)
    filled[: len(faces)] = faces
    return draw(clip, filled, **options)


def assert_explained(face, exact, what):
    wrong = ~acceptable(face, exact.layers)
    assert not wrong.any(), (
        f"{what}: {wrong.sum()} pixels see the wrong face; the first is (row, column) {np.argwhere(wrong)[0]}, "
        f"which sees {face[wrong][0]} instead of {exact.face[wrong][0]}, {exact.margin[wrong][0]:.2f} sub-pixels from "
        f"an outline, with {exact.gap[wrong][0]:.2e} of depth to the next face"
    )


# Soups


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_soups_of_every_kind_see_the_nearest_face(seed):
    for k in range(SOUPS_AN_EXAMPLE):
        clip, _ = soup(np.random.default_rng([seed, k]), COUNT, RESOLUTION)
        face, depth = draw(clip)
        exact = rasterize_exact(clip, FACES, RESOLUTION)
        assert_explained(face, exact, f"soup {k} of {seed}")
        assert ((depth >= 0) & (depth <= 1)).all()
        assert (depth[face < 0] == 1).all()


@pytest.mark.parametrize("cull", ["back", pytest.param("front", marks=pytest.mark.exhaustive)])
@settings(deadline=None, max_examples=8)
@given(seed=seeds)
def test_culled_soups_see_the_nearest_face_that_is_left(cull, seed):
    for k in range(SOUPS_AN_EXAMPLE):
        clip, _ = soup(np.random.default_rng([seed, k]), COUNT, RESOLUTION)
        exact = rasterize_exact(clip, FACES, RESOLUTION, cull)
        assert_explained(draw(clip, cull=cull)[0], exact, f"soup {k} of {seed}")


@pytest.mark.exhaustive
@pytest.mark.parametrize("resolution", [(8, 8), (17, 5), (96, 64)])
def test_soups_at_other_resolutions_see_the_nearest_face(resolution):
    for k in range(40):
        clip, _ = soup(np.random.default_rng([7, k]), COUNT, resolution)
        exact = rasterize_exact(clip, FACES, resolution)
        assert_explained(draw(clip, resolution=resolution)[0], exact, f"soup {k}")


def test_rounding_decides_few_pixels_of_soups():
    covered = different = 0
    for k in range(400):
        clip, _ = soup(np.random.default_rng([3, k]), COUNT, RESOLUTION)
        face, _ = draw(clip)
        exact = rasterize_exact(clip, FACES, RESOLUTION)
        covered += np.sum(exact.face >= 0)
        different += np.sum(face != exact.face)
    assert covered > 100_000
    assert different < 5e-4 * covered, f"{different} of {covered} pixels differ"


def test_depth_of_unclipped_soups_is_that_of_their_planes():
    for k in range(100):
        clip, kinds = soup(np.random.default_rng([5, k]), COUNT, RESOLUTION)
        face, depth = draw(clip)
        exact = rasterize_exact(clip, FACES, RESOLUTION)
        pixel = (np.maximum(face, 0), *np.indices(face.shape))
        plain = (face >= 0) & ~exact.layers.clipped[np.maximum(face, 0)]
        error = np.abs(depth - exact.layers.depth[pixel])[plain]
        assert (error <= exact.layers.depth_error[pixel][plain]).all(), kinds


def test_a_mesh_in_perspective_sees_the_nearest_face():
    mesh = library_mesh("torus", segments=24, sides=12)
    camera = PinholeCamera((0.6, 0.5, 0.7), (0.0, 0.1, 0.0), near=0.05, far=4.0, resolution=(64, 80))
    clip, faces = np.asarray(camera.view().clip(mesh.vertices)), np.asarray(mesh.faces)
    exact = rasterize_exact(clip, faces, camera.resolution, "back")
    face, _ = draw(clip, faces, camera.resolution, plan(jnp.asarray(clip), mesh.faces, camera.resolution), cull="back")
    assert np.sum(face >= 0) > 1000
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


def test_the_result_does_not_depend_on_the_capacity():
    clip, _ = soup(np.random.default_rng(11), COUNT, RESOLUTION)
    planned = plan(jnp.asarray(clip), jnp.asarray(FACES), RESOLUTION)
    assert planned.grown_to(room()) == room()
    left_out = rasterize(jnp.asarray(clip), jnp.asarray(FACES), RESOLUTION)
    for got, expected in zip((left_out.face, left_out.depth), draw(clip), strict=True):
        np.testing.assert_array_equal(got, expected)


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
    face, depth = draw_window(SQUARE, [z] * 4, TWO_FACES, depth_test=DepthTest(compare=compare))
    assert np.sum(face >= 0) == (60 if seen else 0)
    assert (depth[1:7, 2:12] == z).all()


def test_of_two_faces_at_the_same_depth_less_equal_sees_the_higher_index():
    faces = [[8, 9, 10], [4, 5, 6], [0, 1, 2]]
    face, _ = draw_window(SQUARE * 3, [0.5] * 12, faces, depth_test=DepthTest(compare="less_equal"))
    assert set(np.unique(face)) == {NO_FACE, 2}


@pytest.mark.parametrize("seed", range(3))
def test_what_lies_behind_the_nearest_face_is_the_second_nearest(seed):
    clip, _ = soup(np.random.default_rng([19, seed]), COUNT, RESOLUTION)
    first, _ = draw(clip)
    second, _ = draw(clip, behind=jnp.asarray(first))
    layers = rasterize_exact(clip, FACES, RESOLUTION).layers
    # Without the nearest face, wherever it is.
    passed = np.arange(COUNT)[:, None, None] == first
    assert acceptable(second, layers._replace(inside=layers.inside & ~passed)).all()
    assert (second >= 0).any()


@pytest.mark.parametrize(
    "resolution",
    [(1, 1), (1, 8192), *(pytest.param(more, marks=pytest.mark.exhaustive) for more in [(8192, 1), (33, 47)])],
)
def test_a_face_larger_than_the_view_fills_any_resolution(resolution):
    clip = np.array([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]], np.float32)
    face, depth = draw(
        clip, np.array([[0, 1, 2]]), resolution, plan(jnp.asarray(clip), jnp.array([[0, 1, 2]]), resolution)
    )
    assert face.shape == resolution
    assert (face == 0).all()
    np.testing.assert_array_equal(depth, 0.5)


def test_nothing_is_seen_where_no_face_is():
    face, depth = draw_window(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3)))
    np.testing.assert_array_equal(face, NO_FACE)
    np.testing.assert_array_equal(depth, 1)


# Capacity


def capacity_cases():
    """A triangle that needs room of one kind: the kind's name, and the corners in pixels and their `w`."""
    yield "large", [[0, 0], [40, 0], [0, 40]], [1, 1, 1]
    # Away from the corner behind the eye, it reaches to infinity.
    yield "clipped", [[20, 20], [40, 20], [30, 5]], [1, 1, -1]


@pytest.mark.parametrize(("name", "corners", "w"), list(capacity_cases()))
def test_a_capacity_that_is_too_small_is_named(name, corners, w):
    clip = jnp.asarray(from_window(np.array(corners), np.full(3, 0.5), np.array(w), (64, 64)), jnp.float32)
    faces = jnp.array([[0, 1, 2]])
    needed = plan(clip, faces, (64, 64))
    assert np.any(np.asarray(rasterize(clip, faces, (64, 64), capacity=needed).face) == 0)
    with pytest.raises(Exception, match="capacity") as caught:
        rasterize(clip, faces, (64, 64), capacity=Capacity()).face.block_until_ready()
    assert f"capacity.{name} of 0 is too small" in str(caught.value)
    # A caller that reads it as data gets no error, and knows.
    overflows = []
    rasterize(clip, faces, (64, 64), capacity=Capacity(), overflows=overflows)
    rasterize(clip, faces, (64, 64), capacity=needed, overflows=overflows)
    assert list(map(bool, overflows)) == [True, False]
    assert "plan(" in str(caught.value)


def window_triangles(*sides):
    """Triangles whose pixel boxes are as wide."""
    corners = np.concatenate([[[0, 0], [side - 0.1, 0], [0, side - 0.1]] for side in sides])
    clip = from_window(corners, np.full(len(corners), 0.5), np.ones(len(corners)), (64, 64))
    return jnp.asarray(clip, jnp.float32), jnp.arange(len(corners)).reshape(-1, 3)


def test_a_size_class_that_is_too_small_is_named():
    sides = [2, 4, 8, 16, 32]
    drawn = lambda *sides: rasterize(*window_triangles(*sides), (64, 64), capacity=Capacity(windows=(1,) * 5)).face
    assert set(np.unique(drawn(*sides))) == {NO_FACE, 0, 1, 2, 3, 4}
    for k, side in enumerate(sides):
        others = sides[:k] + sides[k + 1 :]
        with pytest.raises(Exception, match=rf"windows\[{k}\] \({side} x {side} pixels\) of 1 is too small"):
            drawn(side, side, *others[1:]).block_until_ready()


def test_few_triangles_share_the_windows_of_larger_ones():
    clip, faces = window_triangles(2, 2, 8, 32)
    shared = plan(clip, faces, (64, 64))
    assert shared == Capacity(windows=(0, 0, 0, 0, 16))
    assert plan(*window_triangles(*[2] * 40, 32), (64, 64)) == Capacity(windows=(64, 0, 0, 0, 16))
    apart = rasterize(clip, faces, (64, 64), capacity=Capacity(windows=(2, 0, 1, 0, 1)))
    together = rasterize(clip, faces, (64, 64), capacity=shared)
    np.testing.assert_array_equal(together.face, apart.face)
    np.testing.assert_array_equal(together.depth, apart.depth)


def test_too_few_blocks_are_named_also_under_jit():
    clip = jnp.array([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]], jnp.float32)
    faces = jnp.array([[0, 1, 2]])
    needed = plan(clip, faces, (64, 64))
    assert needed == Capacity(large=16, candidates=16, blocks=16)
    for kind, room in (("blocks", 8), ("blocks", 0), ("candidates", 8)):
        short = needed._replace(**{kind: room})
        with pytest.raises(Exception, match=f"{kind} of {room} is too small"):
            jax.jit(lambda c, short=short: rasterize(c, faces, (64, 64), capacity=short).depth)(clip)


def test_a_capacity_must_be_given_under_a_trace():
    clip, faces = jnp.zeros((3, 4)), jnp.array([[0, 1, 2]])
    with pytest.raises(ValueError, match=r"inside jax\.jit .* without a capacity; .* call plan"):
        jax.jit(lambda c: rasterize(c, faces, (4, 4)))(clip)
    with pytest.raises(ValueError, match="without a capacity"):
        jax.vmap(lambda c: rasterize(c, faces, (4, 4)))(clip[None])


def test_capacities_grow_to_hold_either_scene():
    a = Capacity(clipped=4, windows=(0, 8, 0, 2, 1))
    b = Capacity(windows=(2, 4, 0, 4, 1), large=8, candidates=128, blocks=64)
    # Small triangles of the first stand among its 8 of up to 4 pixels: all of them may be as small as that.
    both = Capacity(clipped=4, windows=(8, 8, 0, 4, 1), large=8, candidates=128, blocks=64)
    assert a.grown_to(b) == b.grown_to(a) == both
    assert a.grown_to(a) == a


@pytest.mark.exhaustive
def test_a_plan_holds_what_it_was_made_for_in_powers_of_two():
    clip, _ = soup(np.random.default_rng(13), COUNT, RESOLUTION)
    planned = plan(jnp.asarray(clip), jnp.asarray(FACES), RESOLUTION)
    for n in jax.tree.leaves(tuple(planned)):
        assert n == 0 or n & (n - 1) == 0
    assert planned.clipped > 0
    assert planned.large > 0
    culled = plan(jnp.asarray(clip), jnp.asarray(FACES), RESOLUTION, cull="back")
    assert planned.grown_to(culled) == planned
    assert culled != planned


def test_a_drawing_carries_no_gradient():
    clip, _ = soup(np.random.default_rng(17), COUNT, RESOLUTION)
    depth = lambda c: jnp.sum(rasterize(c, jnp.asarray(FACES), RESOLUTION, capacity=room()).depth)
    np.testing.assert_array_equal(jax.grad(depth)(jnp.asarray(clip)), 0)


@pytest.mark.exhaustive
def test_a_batch_is_drawn_one_by_one():
    clips = np.stack([soup(np.random.default_rng(k), COUNT, RESOLUTION)[0] for k in range(3)])
    batch = rasterize(jnp.asarray(clips), jnp.asarray(FACES), RESOLUTION, capacity=room())
    mapped = jax.vmap(lambda c: rasterize(c, jnp.asarray(FACES), RESOLUTION, capacity=room()).face)(jnp.asarray(clips))
    depth = rasterize_depth(jnp.asarray(clips), jnp.asarray(FACES), RESOLUTION, capacity=room())
    for k, clip in enumerate(clips):
        face, expected_depth = draw(clip)
        np.testing.assert_array_equal(batch.face[k], face)
        np.testing.assert_array_equal(mapped[k], face)
        # The last digit may differ: the compiler fuses other multiplications and additions.
        np.testing.assert_allclose(batch.depth[k], expected_depth, rtol=0, atol=3e-7)
        np.testing.assert_allclose(depth[k], expected_depth, rtol=0, atol=3e-7)


@pytest.mark.parametrize("resolution", [(0, 4), (4, 8193)])
def test_a_resolution_out_of_range_is_refused(resolution):
    with pytest.raises(ValueError, match=r"expected \(height, width\), each from 1 to 8192"):
        rasterize(jnp.zeros((3, 4)), jnp.array([[0, 1, 2]]), resolution)
