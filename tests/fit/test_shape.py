"""Fits of shapes: that shadows come closer to their targets, the gradient, resuming, what stays, and refusals."""

import dataclasses
import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow import geometry
from diffshadow._self_intersections import intersecting_faces
from diffshadow.fit import ShapePhase, ShapeProblem, ShapeView, check_shape, fit_shape, hull_start, shadow_size
from diffshadow.fit import _shape as shapes
from diffshadow.fit import _shape_program as programs
from diffshadow.fit._large_steps import LargeSteps
from diffshadow.fit._moving_lights import MovingLights
from diffshadow.fit._regularizers import Regularizers
from diffshadow.fit._untangle import untangled
from diffshadow.fit.problems import together
from diffshadow.fit.problems._aligned import Receivers
from diffshadow.fit.problems._shape import sights
from diffshadow.geometry import DirectionalLight, Edges, Mesh, OrthographicCamera, PointLight, split_in_four
from diffshadow.raster import draw_surface
from diffshadow.shadow import Bilinear, ConstantBias, MapSettings, ShadowMap, ShadowMapping, SilhouetteMap
from diffshadow.shadow.silhouettes import HalfPlanes

SIDE = 32
PHASES = (ShapePhase(strength=5.0, rate=0.1, steps=14), ShapePhase(2.0, 0.03, 6))
UP = np.array([0.0, 1.0, 0.0])


def sphere(radius=0.5, subdivisions=2):
    """A sphere of 162 vertices about the origin."""
    mesh = geometry.library_mesh("sphere", radius=radius, subdivisions=subdivisions)
    return Mesh(np.asarray(mesh.vertices) - [0, radius, 0], mesh.faces)


def bumpy_sphere(subdivisions=2):
    """A sphere with bumps, turned so that no two outlines coincide."""
    points = np.asarray(sphere(0.6, subdivisions).vertices, float)
    points = points @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    points = points * (1 + 0.15 * np.sin(4 * points[:, :1] / 0.6 + 1) * np.cos(5 * points[:, 1:2] / 0.6))
    return Mesh(points, sphere(0.6, subdivisions).faces)


def wall(way, away=2.0, size=2.0, side=SIDE):
    """A light along `way`, and the surface of a wall behind the origin that it falls on."""
    light = DirectionalLight(way, np.zeros(3), (size, size), -away - 1.0, away + 1.0, 0.0, UP)
    way = np.asarray(way)
    u, v, centre = np.cross(way, UP) * size, UP * size, way * away
    mesh = Mesh([centre - u - v, centre + u - v, centre + u + v, centre - u + v], [[0, 1, 2], [0, 2, 3]])
    return light, draw_surface(mesh, OrthographicCamera(way * (away - 0.5), centre, UP, size, 0.1, 1.0, (side, side)))


def ellipse(half_width, half_height, side=SIDE, size=2.0):
    """The shadow of an ellipsoid, with soft pixels at its outline."""
    x = (np.arange(side) + 0.5) / side * size - size / 2
    far = np.hypot(x / half_width, x[:, None] / half_height)
    return np.clip((far - 1) * half_width * side / size + 0.5, 0, 1)


@pytest.fixture(scope="module")
def walls():
    return [wall((0.0, 0.0, -1.0)), wall((-1.0, 0.0, 0.0))]


@pytest.fixture(scope="module")
def views(walls):
    halves = (0.7, 0.5), (0.35, 0.5)
    pairs = zip(walls, halves, strict=True)
    return [ShapeView(light, surface, ellipse(*half)) for (light, surface), half in pairs]


@pytest.mark.exhaustive
def test_shadows_come_close_to_their_targets_and_pinned_vertices_stay(views):
    start = sphere()
    free = np.asarray(start.vertices)[:, 1] > -0.45
    seen = []
    problem = ShapeProblem(start, views, free=free, symmetry=(1.0, 0.0, 0.0, 0.0))
    found = fit_shape(problem, PHASES, on_step=seen.append)
    assert found.loss < 0.1 * found.initial_loss
    assert found.loss == found.losses[found.chosen] == min(found.losses)
    assert [(step.phase, step.step) for step in seen] == [(0, n) for n in range(14)] + [(1, n) for n in range(6)]
    assert [step.loss for step in seen] == [loss for _, loss in found.history]
    after, before = np.asarray(found.mesh.vertices), np.asarray(start.vertices)
    np.testing.assert_array_equal(after[~free], before[~free])
    assert np.abs(after[free] - before[free]).max() > 0.1
    partner = programs.mirror_partners(before.astype(float), (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(after[partner], after * [-1, 1, 1], atol=1e-6)


def test_another_mesh_and_subdivisions_of_one_padded_size_share_a_program(views, monkeypatch):
    asked = []
    monkeypatch.setattr(programs, "compiled", lambda function, given: asked.append(kinds(given)) or STUB)
    coarse = ShapePhase(5.0, 0.05, 1), ShapePhase(5.0, 0.05, 1, subdivisions=1)
    fit_shape(ShapeProblem(sphere(subdivisions=2), views), coarse)
    fit_shape(ShapeProblem(sphere(0.4, subdivisions=3), views), PHASES[:1])
    assert len(asked) > 10
    assert all(each == asked[0] for each in asked)


def kinds(given):
    """The structure, shapes and types that a program is compiled for."""
    leaves, tree = jax.tree.flatten(given)
    return tree, [(leaf.shape, leaf.dtype) if hasattr(leaf, "shape") else leaf for leaf in leaves]


def STUB(vertices, faces, edges, groups, receivers, poses, technique, blur, crossings):
    """An evaluation that pulls all vertices inwards."""
    images: Any = [np.zeros(group.reference.shape) for group in groups]
    found: Any = np.sum(np.square(vertices)), 2 * np.asarray(vertices), poses, images, np.asarray(9)
    return programs.Evaluation(*found)


def test_lights_that_move_descend_and_others_stay(views, monkeypatch):
    """The stub's gradient by a light's numbers is these numbers themselves, so that an azimuth of 90 falls."""
    monkeypatch.setattr(programs, "compiled", lambda function, given: STUB)
    moving = [views[0], dataclasses.replace(views[1], moves=True)]
    found = fit_shape(ShapeProblem(sphere(), moving), (ShapePhase(5.0, 0.05, 4, light_rate=2.0),))
    poses: Any = [light.pose() for light in found.lights]
    still, moved = poses
    assert float(still.azimuth) == 0
    assert 80 < float(moved.azimuth) < 88
    steep = eqx.tree_at(lambda view: view.light.direction, moving[1], jnp.array([0.0, -(3**0.5), -1.0]))
    lights = MovingLights.of([together([steep])], np.zeros(3))
    np.testing.assert_allclose(lights.lengths[0], [[2, 1, 0]], rtol=1e-5)
    np.testing.assert_allclose(lights.moved(lights.start, np.array([3.0, 1.0, 1.0])), [6, 61, 0], rtol=1e-5)


def test_memory_for_crossings_doubles_when_it_is_full_and_compiles_before(views, monkeypatch):
    needed, asked = itertools.count(100, 30), []

    def compiled(function, given):
        asked.append(given[-1])
        return lambda *given: STUB(*given)._replace(crossings=np.asarray(next(needed)))

    monkeypatch.setattr(programs, "compiled", compiled)
    monkeypatch.setattr(shapes, "crossings_for", lambda resolution: 256)
    found = fit_shape(ShapeProblem(sphere(), views), (ShapePhase(5.0, 0.05, 9),))
    assert asked[0] == 256
    assert asked.index(512) < len(asked) - 1
    assert found.state.crossings == 512


def test_large_steps_solve_their_equations_and_leave_pinned_vertices():
    mesh = sphere()
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    free = vertices[:, 1] > -0.3
    large = LargeSteps(vertices, faces, free, 7.0)
    u = large.u_of(vertices)
    np.testing.assert_allclose(large.vertices_of(u), vertices, atol=1e-12)
    rng = np.random.default_rng(0)
    moved, gradient = u + 0.1 * rng.normal(size=u.shape), rng.normal(size=vertices.shape)
    found = large.vertices_of(moved)
    np.testing.assert_array_equal(found[~free], vertices[~free])
    # The gradient by u is that by x times dx/du.
    change = np.sum(gradient * (found - vertices))
    assert change == pytest.approx(np.sum(large.gradient_of(gradient) * (moved - u)))
    plain = LargeSteps(vertices, faces, free, 0.0)
    np.testing.assert_array_equal(plain.gradient_of(gradient), gradient[free])


def test_regularizers_know_their_values():
    mesh = bumpy_sphere()
    vertices, faces = np.asarray(mesh.vertices, float), np.array(mesh.faces)
    # Neighbours that are wound otherwise have the same angle between them.
    faces[::3] = faces[::3, ::-1]
    assert Regularizers(vertices, faces, 0.0, 3.0)(vertices)[0] == pytest.approx(3)
    assert Regularizers(vertices, faces, 0.0, 3.0)(2 * vertices)[0] == pytest.approx(12)
    box = geometry.library_mesh("box")
    corners, sides, _ = geometry.weld(np.asarray(box.vertices, float), np.asarray(box.faces), 0)
    # Of 18 edges, 12 lie between sides at right angles, and 6 across a side.
    assert Regularizers(corners, sides, 1.0, 0.0)(corners)[0] == pytest.approx(12 / 18)


def test_edges_that_cost_shrink_the_mesh(views, monkeypatch):
    still = lambda *given: STUB(*given)._replace(gradient=np.zeros((2304, 3)))
    monkeypatch.setattr(programs, "compiled", lambda function, given: still)
    start, problem = sphere(), ShapeProblem(sphere(), views)
    sizes = []
    for weight in (0.0, 1.0):
        found = fit_shape(problem, (ShapePhase(1.0, 0.02, 3, edge_length=weight),))
        sizes.append(np.ptp(found.state.vertices) / np.ptp(np.asarray(start.vertices)))
    assert sizes[0] == pytest.approx(1, abs=1e-6)
    assert sizes[1] < 0.97


def test_splitting_keeps_the_surface_and_the_number_of_holes():
    mesh = geometry.library_mesh("torus", segments=12, sides=8)
    vertices, faces, ends = split_in_four(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    edges = Edges.of(Mesh(vertices, faces))
    assert edges.is_closed
    assert len(faces) == 4 * len(mesh.faces)
    assert len(vertices) - len(edges.vertices) + len(faces) == 0
    np.testing.assert_allclose(vertices[len(mesh.vertices) :], np.asarray(mesh.vertices)[ends].mean(axis=1))


def bad_views(walls):
    light, surface = walls[0]
    dark = ellipse(0.5, 0.5)
    yield lambda: ShapeView(light, surface, dark[:, :16]), r"reference has shape \(32, 16\), and its surface \(32, 32\)"
    yield lambda: ShapeView(light, surface, np.ones_like(dark)), "is lit wherever pixels count"
    yield lambda: ShapeView(light, surface, 255 * dark), "is 255 at a pixel; expected visibility"
    yield lambda: ShapeView(light, surface, dark - 1), "reference has negative"
    yield lambda: ShapeView(light, surface, dark, np.zeros_like(dark)), "no pixel of the view counts"


def test_views_that_cannot_be_fitted_are_refused(walls):
    for make, message in bad_views(walls):
        with pytest.raises(ValueError, match=message):
            make()


def test_problems_that_cannot_be_fitted_are_refused(walls, views):
    start = sphere()
    twice = geometry.merge([start, start])
    plain = ShadowMapping(Bilinear(), ConstantBias(0.0), map=MapSettings((SIDE, SIDE)))
    for make, message in (
        (lambda: ShapeProblem(start, []), "got no view"),
        (lambda: ShapeProblem(start, views, free=np.zeros(162, bool)), "True for at least one"),
        (lambda: ShapeProblem(start, views, free=[True]), r"shape \(1,\)"),
        (lambda: ShapeProblem(twice, views), "vertices are at the same position"),
        (lambda: ShapeProblem(start, views, symmetry=(1, 0, 0, 0.3)), "is not symmetric"),
        (lambda: ShapeProblem(start, views, symmetry=(0, 0, 0, 0)), "a normal"),
        (lambda: ShapeProblem(start, views, technique=plain), "no silhouettes"),
        (lambda: fit_shape(ShapeProblem(start, views), ()), "got no phase"),
        (lambda: fit_shape(ShapeProblem(start, views), (ShapePhase(blur=9.0),)), "blur is 9 pixels"),
        (lambda: ShapePhase(strength=-1.0), "ShapePhase.strength is -1.0"),
        (lambda: ShapePhase(steps=0), "ShapePhase.steps is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


@pytest.mark.exhaustive
def test_lights_that_miss_their_screen_and_starts_without_a_shadow_are_refused(walls, views):
    far = eqx.tree_at(lambda light: light.center, walls[1][0], jnp.array([0.0, 0.0, 9.0]))
    aside = dataclasses.replace(views[1], light=far)
    with pytest.raises(ValueError, match="light of view 1 reaches none"):
        check_shape(ShapeProblem(sphere(), [views[0], aside]), PHASES)
    start = sphere()
    away = Mesh(np.asarray(start.vertices) + np.array([1.9, 0, 0]), start.faces)
    with pytest.raises(ValueError, match="start casts no shadow in view 0"):
        check_shape(ShapeProblem(away, views), PHASES)


@pytest.mark.exhaustive
def test_a_state_of_another_fit_is_refused(views):
    problem = ShapeProblem(sphere(), views)
    stopped = fit_shape(problem, PHASES, on_step=lambda step: step.step == 3)
    other = ShapeProblem(sphere(subdivisions=1), views)
    for make in (
        lambda: fit_shape(other, PHASES, resume=stopped.state),
        lambda: fit_shape(problem, PHASES[:1], resume=stopped.state._replace(phase=3)),
        lambda: fit_shape(problem, PHASES, resume=stopped.state._replace(step=15)),
    ):
        with pytest.raises(ValueError, match="expected a state of a fit with the same mesh and phases"):
            make()


def test_point_lights_reach_screens_in_every_layer(walls):
    _, surface = walls[0]
    light = PointLight((0.0, 0.0, 0.0), near=0.1, far=9.0)
    group = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], ShapeView(light, surface, ellipse(0.5, 0.5)))
    (sight,) = sights([group])
    assert sight.reached.all()


def test_a_pixel_that_is_a_texel_sees_the_parts_of_it_that_are_lit():
    """Two texels: the left third of the first lies under a caster at depth 0.3; the second is empty."""
    third = -1 / 6
    planes = HalfPlanes(jnp.array([[-1.0], [0.0]]), jnp.array([[0.0], [0.0]]), jnp.array([[-third], [-1e6]]))
    numbers = lambda value: jnp.array([value], jnp.float32)
    slot, depth = jnp.array([[0, -1]], jnp.int32), jnp.array([[1.0, 1.0]])
    silhouettes = SilhouetteMap(slot, planes, numbers(0.3), numbers(1.0), jnp.array([True]))
    light = DirectionalLight((0, 0, -1), np.zeros(3), (2, 2), -1, 1, 0.0, UP)
    seen = lambda z, turned: Receivers.of(
        jnp.stack([*jnp.array([[[-0.5, 0.5]], [[0.0, 0.0]]]), jnp.full((1, 2), 2 * z - 1), jnp.ones((1, 2))], axis=-1),
        jnp.ones((1, 2), bool),
        jnp.array([turned]),
    )
    drawn = ShadowMap(depth, light, silhouettes=silhouettes)
    behind, before = seen(0.8, [True, True]), seen(0.2, [True, True])
    assert float(behind.off) < 1e-6
    np.testing.assert_allclose(behind.seen(drawn), [[2 / 3, 1]], atol=1e-6)
    np.testing.assert_allclose(before.seen(drawn), [[1, 1]], atol=1e-6)
    np.testing.assert_allclose(seen(0.8, [True, False]).seen(drawn), [[2 / 3, 0]], atol=1e-6)
    np.testing.assert_allclose(seen(1.5, [True, True]).seen(drawn), [[1, 1]], atol=1e-6)


@pytest.mark.exhaustive
def test_the_whole_gradient_matches_differences():
    """In double precision, of a bumpy sphere that is turned: mirrored outlines would coincide, which is a kink.

    Differences are over a thousandth of a texel. Over a hundredth, edges appear and vanish in the outline.
    """
    with jax.enable_x64(True):
        mesh = bumpy_sphere(subdivisions=3)
        points, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
        seen = [wall(way, side=96) for way in ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))]
        views = [ShapeView(*each, ellipse(0.5, 0.45, 96)) for each in seen]
        fit = programs.ShapeProgram(ShapeProblem(mesh, views))
        level = fit.level(points, faces, np.ones(len(points), bool))
        at = lambda points: fit.evaluate(level, points, fit.lights.start, 0.0, 2048)[0]
        found, step = np.asarray(at(points).gradient)[: len(points)], 1e-3 * 2 / 96
        difference = np.zeros_like(found)
        for vertex, axis in zip(*np.nonzero(found), strict=True):
            aside = np.zeros_like(points)
            aside[vertex, axis] = step
            difference[vertex, axis] = (at(points + aside).loss - at(points - aside).loss) / (2 * step)
    moves = np.abs(found).sum(axis=1) > 0
    error = np.linalg.norm(difference - found, axis=1)[moves] / np.linalg.norm(difference, axis=1)[moves]
    assert moves.sum() > 100
    assert np.quantile(error, 0.95) < 1e-3
    assert np.linalg.norm(difference - found) < 1e-3 * np.linalg.norm(difference)


def test_steps_are_as_long_whatever_the_size_of_the_start(views, monkeypatch):
    """A fraction of the shadows' longest side, which is 1.4; the last of 3 steps has 0.05 of the first one's rate."""
    monkeypatch.setattr(programs, "compiled", lambda function, given: STUB)
    moved = []
    for radius in (0.2, 0.5):
        start = sphere(radius)
        found = fit_shape(ShapeProblem(start, views), (ShapePhase(0.0, 0.01, 1, normal_consistency=0.0),))
        moved.append(np.linalg.norm(found.state.vertices - np.asarray(start.vertices), axis=1).max())
    assert moved[0] == pytest.approx(moved[1], rel=0.02)
    assert shadow_size(views, np.zeros(3)) == pytest.approx(1.4, abs=2 * 2 / SIDE)


def test_a_start_lies_within_the_visual_hull_of_its_shadows_and_nearly_fills_it(views):
    """The shadows have halves of 0.7 along x, 0.35 along z, and 0.5 upwards."""
    start = hull_start(views, faces=2000)
    points = np.asarray(start.vertices)
    assert Edges.of(start).is_closed
    assert 1000 < len(start.faces) <= 2000
    assert len(np.unique(points, axis=0)) == len(points)
    half = np.array([0.7, 0.5, 0.35])
    assert (np.abs(points).max(axis=0) < half).all()
    assert (np.abs(points).max(axis=0) > half - 3 * 2 / SIDE).all()
    assert np.hypot(points[:, 0] / 0.7, points[:, 1] / 0.5).max() < 1
    a, b, c = np.moveaxis(points[np.asarray(start.faces)], 1, 0)
    # The hull of two ellipses: 16/3 of the halves' product.
    assert 0.5 < np.sum(a * np.cross(b, c)) / 6 / (16 / 3 * half.prod()) < 1
    mirror = (1.0, 0.0, 0.0, 0.0)
    whole = hull_start(views, faces=2000, symmetry=mirror)
    assert Edges.of(whole).is_closed
    programs.mirror_partners(np.asarray(whole.vertices, float), mirror)
    assert np.abs(np.asarray(whole.vertices)).max(axis=0) == pytest.approx(np.abs(points).max(axis=0), abs=2 / SIDE)


def test_a_lamp_shows_a_shape_larger_than_it_is():
    """A ball of radius 0.4, lit from 3 away, on walls 2 behind: disks of radius 0.4 / √(3² − 0.4²) · 5."""
    views = []
    for way in ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.6, 0.0, -0.8)):
        _, surface = wall(way)
        radius = 0.4 / (3**2 - 0.4**2) ** 0.5 * 5
        lamp = geometry.SpotLight(-3 * np.array(way), way, outer_angle=45, near=0.1, far=9.0)
        views.append(ShapeView(lamp, surface, ellipse(radius, radius)))
    assert shadow_size(views, np.zeros(3)) == pytest.approx(0.8, abs=0.08)
    far = np.linalg.norm(np.asarray(hull_start(views, faces=1000).vertices), axis=1)
    assert far.min() > 0.25
    assert far.max() < 0.52


def test_shadows_without_a_hull_are_refused(walls, views):
    with pytest.raises(ValueError, match="shine from one direction"):
        hull_start(views[:1])
    high, low = np.ones((2, SIDE, SIDE))
    high[24:28, 8:24], low[4:8, 8:24] = 0, 0
    apart = [ShapeView(*at, image) for at, image in zip(walls, (high, low), strict=True)]
    with pytest.raises(ValueError, match="no shape casts all of the views' shadows"):
        hull_start(apart)


def poked_sphere(vertices):
    """The top, a little aside, moved through the bottom."""
    return vertices + np.where(vertices[:, 1:2] > 0.4, [0.013, -1.2, 0.007], 0)


def test_a_wall_that_passes_through_another_is_moved_back_and_pinned_vertices_stay():
    mesh = sphere(subdivisions=3)
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    poked = poked_sphere(vertices)
    free = vertices[:, 0] > -2
    assert len(intersecting_faces(poked, faces)) > 10
    apart = untangled(poked, faces, free)
    assert len(intersecting_faces(apart, faces)) == 0
    untouched = np.abs(vertices[:, 1]) < 0.1
    np.testing.assert_array_equal(apart[untouched], vertices[untouched])
    assert untangled(vertices, faces, free) is vertices
    free = vertices[:, 1] > 0
    np.testing.assert_array_equal(untangled(poked, faces, free)[~free], poked[~free])


def test_a_fit_ends_without_walls_that_pass_through_others(views, monkeypatch):
    """The stub pulls all vertices inwards; some of the start's lie beyond the opposite wall."""
    monkeypatch.setattr(programs, "compiled", lambda function, given: STUB)
    mesh = sphere(subdivisions=3)
    start = Mesh(poked_sphere(np.asarray(mesh.vertices, float)), mesh.faces)
    found = fit_shape(ShapeProblem(start, views), (ShapePhase(1.0, 0.001, 2),))
    assert len(intersecting_faces(np.asarray(start.vertices), np.asarray(mesh.faces))) > 10
    assert len(intersecting_faces(found.state.vertices, found.state.faces)) == 0
