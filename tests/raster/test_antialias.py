"""Antialiased surfaces: areas in closed form, pictures against supersampling, derivatives against differences."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import quad

from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    fit_to_size,
    library_mesh,
    merge,
    rotation,
    translation,
)
from diffshadow.raster import AntialiasPlan, draw_antialiased, draw_surface, plan_antialiasing, points_within_pixels
from diffshadow.raster._antialias import _NEAR as NEAR
from diffshadow.raster._boundaries import Boundaries, Pieces, find_creases
from diffshadow.shading import Phong

SIDE = 48
SUN = DirectionalLight((0.5, -1.0, -0.35), (0, 0, 0), (4, 4), -4, 4)
SHADING = Phong(specular=0.0, background=0.05)
LIT = lambda surface: jnp.ones(surface.mask.shape)
# A unit of the world is 24 of its pixels.
FRONT = OrthographicCamera((0, 0, 4), (0, 0, 0), height=2.0, near=0.1, far=10.0, resolution=(SIDE, SIDE))


def view(side=SIDE):
    return PinholeCamera((1.2, 1.6, 1.8), (0, 0.35, 0), fov_y=45, near=0.2, far=10, resolution=(side, side))


@functools.cache
def scene(name):
    """A mesh over a plane, and how many of the vertices are the mesh's."""
    piece = library_mesh(name, **({"segments": 24, "sides": 12} if name == "torus" else {}))
    placed = translation(jnp.array([0.0, 0.6, 0.0])) @ rotation(jnp.array([1.0, 0.3, 0.2]), 0.8)
    piece = fit_to_size(piece, 0.8).transformed(placed)
    return merge([piece, library_mesh("plane", size=4.0)]), len(piece.vertices)


@functools.cache
def plan(name):
    return plan_antialiasing(scene(name)[0], view())


@eqx.filter_jit
def moved(mesh: Mesh, own, by):
    part = jnp.arange(len(mesh.vertices)) < own
    return eqx.tree_at(lambda mesh: mesh.vertices, mesh, jnp.where(part[:, None], mesh.vertices + by, mesh.vertices))


@eqx.filter_jit
def picture(mesh, own, by, planned):
    """The antialiased picture of a mesh whose first vertices are moved."""
    seen = draw_antialiased(moved(mesh, own, by), view(), planned)
    return seen.resolve(SHADING(seen.surface, LIT(seen.surface), SUN, view()))


@eqx.filter_jit
def supersampled(mesh, own, by):
    """The same picture by 8 x 8 samples a pixel."""
    camera = view(8 * SIDE)
    surface = draw_surface(moved(mesh, own, by), camera)
    fine = SHADING(surface, LIT(surface), SUN, camera)
    return fine.reshape(SIDE, 8, SIDE, 8, 3).mean(axis=(1, 3))


@eqx.filter_jit
def mean_error(image, goal):
    return jnp.mean((image - goal) ** 2)


@eqx.filter_jit
def colours(mesh, planned):
    """The mean albedo over each pixel, and the pixels of lines and the points on both sides of them."""
    seen = draw_antialiased(mesh, FRONT, planned)
    count = seen.pixel.shape[0]
    sides = lambda values: values[SIDE:].reshape(2, -1, *values.shape[2:])[:, :count]
    return seen.resolve(seen.surface.albedo)[..., 0], seen.pixel, sides(seen.surface.position), sides(seen.surface.mask)


def drawn(*quads):
    """`colours` of quads before nothing, from center, right, up and a grey."""
    meshes = [eqx.tree_at(lambda m: m.albedo, quad(*place), jnp.full((2, 3), grey)) for *place, grey in quads]
    mesh = merge(meshes)
    planned = plan_antialiasing(mesh, FRONT)
    assert planned.pieces <= 1024
    # One program for all.
    plan = AntialiasPlan(planned.edges, planned.creases, 1024, 256)
    return [np.asarray(found) for found in colours(mesh.padded(), plan)]


def coverage(*quads):
    """The mean grey of each pixel."""
    return drawn(*quads)[0]


class TestArea:
    def test_of_an_upright_quad_is_that_of_its_pixels(self):
        # In pixels of 2 / 48, from 20.25 to 30.5 and from 17.75 to 40.125.
        low, high = np.array([20.25, 17.75]), np.array([30.5, 40.125])
        middle, half = ((low + high) / 2 - 24) / 24, (high - low) / 48
        image = coverage(((*middle, 0), (half[0], 0, 0), (0, half[1], 0), 1.0))
        number = np.arange(SIDE)
        along = [
            np.clip(np.minimum(number + 1, b) - np.maximum(number, a), 0, 1) for a, b in zip(low, high, strict=True)
        ]
        np.testing.assert_allclose(image, along[1][:, None] * along[0], atol=2e-5)

    def test_of_a_turned_quad_adds_up(self):
        image, pixel, beside, mask = drawn(((0.03, 0.01, 0), (0.5, 0.2, 0), (-0.12, 0.3, 0), 1.0))
        np.testing.assert_array_less(np.abs(image - 0.5), 0.5 + 1e-4)
        # Four times the determinant, in pixels.
        np.testing.assert_allclose(image.sum(), 4 * (0.5 * 0.3 + 0.2 * 0.12) * 24**2, rtol=1e-4)
        # Its outline is shaded a quarter of a pixel inside, near the outline's pixel.
        side = np.stack([pixel % SIDE, pixel // SIDE], axis=-1)
        place = 24 + 24 * beside[..., :2][mask]
        away = place - np.broadcast_to(side + 0.5, (*mask.shape, 2))[mask]
        assert len(away) > 60
        assert np.abs(away).max() < 0.75 + 1e-3
        turn = np.linalg.inv(24 * np.array([[0.5, -0.12], [0.2, 0.3]]))
        inside = (1 - np.abs((place - 24 - 24 * np.array([0.03, 0.01])) @ turn.T)) / np.linalg.norm(turn, axis=1)
        assert inside.min() > -1e-3
        # But at its corners, where lines end.
        assert np.mean(np.abs(inside.min(axis=1) - 0.25) < 2e-3) > 0.9

    def test_of_a_strip_between_pixel_centres_is_not_lost(self):
        # A tenth of a pixel wide, and nowhere at a centre.
        image = coverage((((24.8 - 24) / 24, 0, 0), (0.05 / 24, 0, 0), (0, 0.5, 0), 1.0))
        np.testing.assert_allclose(image.sum(), 0.1 * 24, rtol=1e-3)
        np.testing.assert_allclose(image[20:28, 24], 0.1, atol=1e-3)

    def test_behind_another_is_cut_where_that_ends(self):
        near = (-0.5, 0.003, 1.0), (0.51, 0, 0), (0, 0.7, 0), 0.3
        far = (0.0, -0.4, 0.0), (0.9, 0.11, 0), (0, 0.4, 0), 1.0
        image = coverage(near, far)
        x, y = ((np.arange(16 * SIDE) + 0.5) / (8 * SIDE) - 1 for _ in range(2))
        x, y = x[None], y[:, None]
        rise = 0.11 / 0.9 * x
        behind = (np.abs(x) < 0.9) & (np.abs(y + 0.4 - rise) < 0.4)
        before = (np.abs(x + 0.5) < 0.51) & (np.abs(y - 0.003) < 0.7)
        fine = np.where(before, 0.3, np.where(behind, 1.0, 0.0))
        np.testing.assert_allclose(image, fine.reshape(SIDE, 16, SIDE, 16).mean(axis=(1, 3)), atol=0.035)

    def test_of_two_that_cross_each_other_ends_where_they_cross(self):
        # The slanted one is the nearer one to the right of x = 0.13, which is pixel 27.12.
        upright = (0.0, 0.0, 0.0), (0.9, 0.0, 0), (0.0, 0.9, 0), 0.3
        slanted = (0.13, 0.0, 0.0), (0.6, 0.0, 0.7), (0.0, 0.9, 0), 1.0
        image = coverage(upright, slanted)[10:38]
        np.testing.assert_allclose(image[:, 4:27], 0.3, atol=1e-4)
        np.testing.assert_allclose(image[:, 27], 0.12 * 0.3 + 0.88, atol=1e-3)
        np.testing.assert_allclose(image[:, 28:40], 1, atol=1e-4)


@eqx.filter_jit
def pieces_of(mesh, planned):
    clip = FRONT.view().clip_vertices(mesh.vertices)
    found = Boundaries.of(clip, mesh.faces, planned.edges, planned.creases, "none", FRONT.resolution)
    return found.segments, Pieces.of(found, FRONT.resolution, 1024, jnp.zeros(found.right.shape))


def pixels_along(start, end):
    """The pixels that a segment passes through, by many points on it that are not on the grid's lines."""
    points = np.array(start) + np.linspace(0, 1, 20_003)[1:-1, None] * np.subtract(end, start)
    inside = np.abs(points - np.round(points)).min(axis=1) > 1e-4
    return {(int(x), int(y)) for x, y in points[inside]}


SEGMENTS = {
    "from a corner through corners": ((3.0, 4.0), (9.0, 10.0)),
    "backwards through corners": ((9.5, 9.5), (2.5, 2.5)),
    "upright": ((5.3, 1.3), (5.3, 8.8)),
    "slanted": ((8.2, 6.1), (1.4, 6.9)),
    "downwards from a line": ((7.0, 9.0), (8.5, 3.25)),
}


@pytest.mark.parametrize("segment", SEGMENTS)
def test_a_segment_has_one_piece_in_each_pixel(segment):
    start, end = SEGMENTS[segment]
    place = (np.array([start, end, (40.0, 45.0)]) - SIDE / 2) * 2 / SIDE
    triangle = Mesh(np.c_[place, [0, 0, 0]], [(0, 1, 2)])
    segments, pieces = pieces_of(triangle.padded(), plan_antialiasing(triangle, FRONT))
    middle = (np.asarray(segments.start) + np.asarray(segments.end)) / 2
    distance = np.abs(middle - np.mean([start, end], axis=0)).sum(axis=1)
    edge = np.argmin(np.where(segments.used, distance, np.inf))
    own = (np.asarray(pieces.segment) == edge) & (np.asarray(pieces.pixel) < SIDE * SIDE)
    # Pieces without length, at corners, have no area.
    own &= np.asarray(pieces.beyond) != 0
    found = [(int(pixel % SIDE), int(pixel // SIDE)) for pixel in np.asarray(pieces.pixel)[own]]
    expected = pixels_along(start, end)
    assert len(set(found)) == len(found)
    assert set(found) <= expected
    reached = np.asarray(pieces.pixel)[(np.asarray(pieces.segment) == edge) & (np.asarray(pieces.pixel) < SIDE * SIDE)]
    assert {(int(pixel % SIDE), int(pixel // SIDE)) for pixel in reached} >= expected


def test_creases_are_where_colours_differ():
    box = library_mesh("box")
    edges = Edges.of(box)
    assert find_creases(box, edges).sum() == 12
    ball = library_mesh("sphere")
    assert not find_creases(ball, Edges.of(ball)).any()
    card = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    two_colours = eqx.tree_at(lambda mesh: mesh.albedo, card, jnp.array([[0.2] * 3, [0.9] * 3]))
    assert [find_creases(mesh, Edges.of(mesh)).sum() for mesh in (card, two_colours)] == [0, 1]


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["torus", "box"])
def test_picture_is_close_to_the_mean_of_many_samples(name):
    mesh, own = scene(name)
    truth, image = supersampled(mesh, own, jnp.zeros(3)), picture(mesh, own, jnp.zeros(3), plan(name))
    surface = draw_surface(mesh, view())
    plain = SHADING(surface, LIT(surface), SUN, view())
    error, before = (float(jnp.sqrt(mean_error(each, truth))) for each in (image, plain))
    assert error < min(0.006, before / 5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["torus", "box"])
def test_derivative_is_that_of_a_supersampled_picture(name):
    """A plain picture's derivative is wrong by more than half."""
    mesh, own = scene(name)
    goal = supersampled(mesh, own, jnp.array([0.06, 0.02, -0.04]))
    step = 0.02
    error = lambda by: float(mean_error(supersampled(mesh, own, by), goal))
    slopes = [(error(step * axis) - error(-step * axis)) / (2 * step) for axis in jnp.eye(3)]
    found = eqx.filter_jit(jax.grad(lambda by: mean_error(picture(mesh, own, by, plan(name)), goal)))(jnp.zeros(3))
    assert np.linalg.norm(found - np.array(slopes)) < 0.06 * np.linalg.norm(slopes)


@pytest.mark.exhaustive
def test_values_at_centres_extend_to_the_nearest_surface():
    """Of a bright card before a dark one, points on both sides of the outline have their own card's albedo."""
    grey = lambda mesh, value: eqx.tree_at(lambda m: m.albedo, mesh, jnp.full((2, 3), value))
    near, far = quad((0.1, 0, 1), (0.4, 0.1, 0), (-0.1, 0.3, 0)), quad((0, 0, 0), (2, 0, 0), (0, 2, 0))
    mesh = merge([grey(near, 0.9), grey(far, 0.2)])
    planned = plan_antialiasing(mesh, FRONT)
    plan = AntialiasPlan(planned.edges, planned.creases, 1024, 256)
    own, extended, of_centres = extended_albedo(mesh.padded(), plan)
    np.testing.assert_array_equal(extended[:SIDE], own[:SIDE])
    np.testing.assert_array_equal(extended[SIDE:][own[SIDE:] > 0], own[SIDE:][own[SIDE:] > 0])
    # A centre on the near card counts the less, the closer the card's outline is to it.
    corners = 24 + 24 * (np.array([0.1, 0]) + np.array([[-0.3, -0.4], [0.5, -0.2], [0.3, 0.4], [-0.5, 0.2]]))
    middle = np.stack(np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5), axis=-1)
    distance = np.full((SIDE, SIDE), np.inf)
    for start, along in zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True):
        t = np.clip((middle - start) @ along / (along @ along), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(start + t[..., None] * along - middle, axis=-1))
    expected = np.where(np.isclose(own[:SIDE, :, 0], 0.9), np.clip(distance / NEAR, 0, 1), 1)
    assert (expected < 0.1).any()
    assert np.mean(np.abs(of_centres - expected)[expected < 1] < 1e-3) > 0.9
    np.testing.assert_allclose(of_centres[expected == 1], 1, atol=1e-6)


@eqx.filter_jit
def extended_albedo(mesh, planned):
    """The albedo of all points, and as extended from pixel centres; and how much each pixel's centre counts."""
    seen = draw_antialiased(mesh, FRONT, planned)
    is_centre = jnp.zeros(seen.surface.mask.shape).at[:SIDE].set(1)
    return seen.surface.albedo, seen.extend(seen.centres.albedo), seen.resolve(is_centre)


@pytest.mark.exhaustive
def test_a_plan_that_is_too_small_is_an_error():
    mesh = quad((0, 0, 0), (0.5, 0.2, 0), (-0.2, 0.5, 0))
    planned = plan_antialiasing(mesh, FRONT)
    with pytest.raises(RuntimeError, match="memory for 16 pieces"):
        jax.block_until_ready(colours(mesh.padded(), AntialiasPlan(planned.edges, planned.creases, 16, 256)))


def test_means_over_points_within_pixels_are_those_of_finer_images():
    """Of a wave that is shorter than a pixel, on the ground."""
    mesh, camera = quad((-9, 0, -9), (18, 0, 0), (0, 0, 18)), view()
    wave = lambda surface: np.where(surface.mask, np.sin(40 * np.asarray(surface.position)[..., 0]), 0)
    coarse = draw_surface(mesh, camera)
    fine = wave(draw_surface(mesh, dataclasses.replace(camera, resolution=(8 * SIDE, 8 * SIDE))))
    truth = fine.reshape(SIDE, 8, SIDE, 8).mean(axis=(1, 3))
    off = lambda image: np.sqrt(np.mean((np.asarray(image) - truth)[np.asarray(coarse.mask)] ** 2))
    one, several = (points_within_pixels(coarse, camera, count) for count in (1, 13))
    assert one.surface is coarse
    assert off(several.mean(jnp.asarray(wave(several.surface)))) < 0.25 * off(one.mean(jnp.asarray(wave(coarse))))


@pytest.mark.parametrize("count", [0, True])
def test_a_count_of_points_is_a_whole_number(count):
    with pytest.raises(ValueError, match=f"the count of points is {count}; expected a whole number at least 1"):
        points_within_pixels(draw_surface(quad((-1, 0, 0), (2, 0, 0), (0, 2, 0)), FRONT), FRONT, count)


def test_points_within_pixels_lie_in_them_and_on_what_is_seen_there():
    mesh, _ = scene("box")
    surface = draw_surface(mesh, view())
    within = eqx.filter_jit(points_within_pixels)(surface, view(), 5).surface
    moved = np.asarray(within.position).reshape(5, SIDE, SIDE, 3) - np.asarray(surface.position)
    np.testing.assert_allclose(np.sum(moved * np.asarray(surface.normal), axis=-1), 0, atol=1e-5)
    clip = np.c_[np.asarray(within.position).reshape(-1, 3), np.ones(5 * SIDE**2)] @ np.asarray(view().view().matrix).T
    place = ((clip[:, :2] / clip[:, 3:] + 1) * SIDE / 2).reshape(5, SIDE, SIDE, 2)
    place = (place - np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1))[:, np.asarray(surface.mask)]
    is_steep = (np.abs(place - 0.5) < 1e-3).all(axis=(0, 2))
    assert is_steep.mean() < 0.02
    for axis in range(2):
        expected = np.broadcast_to((np.arange(5)[:, None] + 0.5) / 5, place[:, ~is_steep, axis].shape)
        np.testing.assert_allclose(np.sort(place[:, ~is_steep, axis], axis=0), expected, atol=2e-3)
