"""The irregular z-buffer against traced rays."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import quad
from volume_oracle import Truth

from diffshadow.geometry import (
    DirectionalLight,
    Mesh,
    PinholeCamera,
    PointLight,
    Scene,
    SpotLight,
    library_mesh,
    merge,
    translation,
)
from diffshadow.raster import draw_surface, hidden_points
from diffshadow.reference import trace_visibility, trace_visibility_exact
from diffshadow.shadow import IrregularZBuffer

# Alike for all scenes, so that there is one program for each kind of light.
RESOLUTION, FACES = (48, 64), 256
# How far from an outline, in pixels, visibility must be right: 10⁻⁵ of the image is six times as far. Where the
# rasterizer sees another face than a ray does, it is within a step of its corners of an outline.
BAR, STEP = 1e-4, 1 / 256
TECHNIQUE = IrregularZBuffer()
GROUND = library_mesh("plane", size=6.0)
EYE, TARGET = (1.8, 2.2, 3.0), (0.1, 0.3, 0.0)


def sun(scale=1.0):
    return DirectionalLight((0.5, -1.0, -0.3), (0.0, 0.0, 0.0), (8 * scale, 8 * scale), -8 * scale, 8 * scale)


def spot(scale=1.0):
    position = scale * np.array([-1.2, 3.0, 0.9])
    return SpotLight(position, (0.4, -1.0, -0.3), 70.0, 0.1 * scale, 20 * scale)


def point(scale=1.0):
    """Among the casters."""
    return PointLight(scale * np.array([0.35, 1.1, 0.45]), 0.3 * scale, 20 * scale)


LIGHTS = {"directional": sun, "spot": spot, "point": point}
# The sun's program is tried every time where techniques are compared.
EACH_LIGHT = [pytest.param("directional", marks=pytest.mark.exhaustive), "spot", "point"]


def triangles(corners):
    return Mesh(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)).reshape(-1, 3))


def soup(seed=3, count=80):
    """Triangles of all sizes above the ground, which cross one another."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-1.2, 0.1, -1.2], [1.2, 1.6, 1.2], (count, 1, 3))
    return triangles(middle + rng.normal(size=(count, 3, 3)) * rng.choice([0.03, 0.1, 0.4], (count, 1, 1)))


def slivers():
    """Long and thin, the way that the sun and the lamp shine: each overlaps most strips of points, and hides few, so
    that there are more pairs than one round of the loop takes."""
    rng = np.random.default_rng(5)
    along, across = np.array([[0.86, 0, -0.51], [0.51, 0, 0.86]])
    ends = rng.uniform(-2, 2, (2, 62, 1)) * across + [0, 1.5, 0] + np.array([-2.4, 2.4]).reshape(2, 1, 1) * along
    # Four to each pair of ends, of which each is two vertices.
    vertices = np.concatenate([ends, ends + rng.normal(size=ends.shape) * 0.02]).swapaxes(0, 1)
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]]) + 4 * np.arange(62)[:, None, None]
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3))


CASTERS = {
    "torus": lambda: library_mesh("torus", segments=12, sides=9),
    "box": lambda: library_mesh("box"),
    "fence": lambda: library_mesh("fence"),
    "blob": lambda: library_mesh("blob", subdivisions=1),
    "soup": soup,
    "slivers": slivers,
    "card": lambda: quad((0, 0.8, 0), (0.5, 0, 0), (0, 0, -0.5)),
}


def camera(scale=1.0, eye=EYE, target=TARGET):
    eye, target = scale * np.array(eye), scale * np.array(target)
    return PinholeCamera(eye, target, fov_y=35.0, near=0.1 * scale, far=20 * scale, resolution=RESOLUTION)


@functools.cache
def scene_of(name, light, scale=1.0):
    mesh = merge([CASTERS[name](), GROUND])
    assert len(mesh.faces) <= FACES
    return Scene(Mesh(mesh.vertices * scale, mesh.faces), camera(scale), LIGHTS[light](scale))


def found(scene):
    """What the camera sees, which pixels are covered, and their visibility."""
    surface = draw_surface(scene.mesh, scene.camera)
    # In few sizes, so that little is compiled.
    mesh = scene.mesh.padded()
    assert len(mesh.faces) == FACES
    state = TECHNIQUE.prepare(scene, surface)
    return surface, np.asarray(TECHNIQUE.covered(state, surface)), np.asarray(TECHNIQUE.visibility(state, surface))


def assert_right(scene, expected, least=0.02, most=0.98):
    """Equal to `expected` in all pixels that are not close to an outline."""
    surface, covered, visibility = found(scene)
    assert set(np.unique(visibility)) <= {0, 1}
    assert covered[expected.mask].all()
    assert least < np.mean(expected.visibility[expected.mask]) < most
    truth = Truth(scene.mesh, scene.light, scene.camera)
    differing = np.flatnonzero((visibility != expected.visibility).ravel())
    same = (np.asarray(surface.face) == expected.face).ravel()[differing]
    centres = truth.centres()[differing]
    explained = [near_outline(truth, *each) for each in zip(centres, same, strict=True)]
    assert all(explained), list(zip(centres.tolist(), same, explained, strict=True))
    assert len(differing) < 12


def near_outline(truth, centre, same_face):
    """Whether a pixel is close to the outline of a shadow or, if a ray sees another face than the rasterizer, to one
    of a face."""
    if same_face:
        return truth.changes_within(centre[None], BAR)[0]
    around = truth.at(centre + STEP * np.array([[0, 0], [0, 1], [1, 0], [0, -1], [-1, 0]])).face
    return len(set(around)) > 1


SCENES = [(name, light) for name in CASTERS for light in LIGHTS]
FEW = {("torus", "spot"), ("slivers", "spot")}


@pytest.mark.parametrize(
    ("name", "light"),
    [pytest.param(*scene, marks=[] if scene in FEW else pytest.mark.exhaustive) for scene in SCENES],
)
def test_visibility_is_that_of_float64_rays(name, light):
    scene = scene_of(name, light)
    assert_right(scene, trace_visibility_exact(scene, 1))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["chair", "torus_knot"])
def test_fine_meshes_agree_with_the_reference(name):
    light, mesh = spot(), merge([library_mesh(name), GROUND])
    scene = Scene(mesh, eqx.tree_at(lambda c: c.fov_y, camera(), jnp.asarray(25.0)), light)
    surface, expected = draw_surface(mesh, scene.camera), trace_visibility(scene, 1)
    visibility = np.asarray(TECHNIQUE.visibility(TECHNIQUE.prepare(scene), surface))
    same = expected.mask & (np.asarray(surface.face) == expected.face)
    assert same.sum() > 0.9 * expected.mask.sum()
    assert np.mean(visibility != expected.visibility, where=same) < 2e-3
    assert 0.05 < np.mean(expected.visibility == 0, where=same) < 0.9


# Where points and triangles are


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", EACH_LIGHT)
def test_a_lid_hides_every_point_and_one_below_them_hides_none(light):
    lid = quad((0, 0, 0), (40, 0, 0), (0, 0, -40))
    ground = quad((0, 0, 0), (3, 0, 0), (0, 0, -3))
    # The lamps are at 3 and at 1.1.
    for height, expected in ((0.9, 0), (-0.5, 1)):
        moved = lid.transformed(translation(jnp.array([0, height, 0])))
        scene = Scene([moved, ground], camera(eye=(0.3, 0.8, 0.4), target=(0, 0, 0)), LIGHTS[light]())
        surface, _, visibility = found(scene)
        mask = np.asarray(surface.mask)
        assert mask.mean() > 0.5
        assert (np.asarray(surface.face)[mask] >= 2).all()
        assert (visibility[mask] == expected).all()


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["spot", "point"])
def test_triangles_across_the_lights_plane_hide_what_they_hide(light):
    position = np.asarray(LIGHTS[light]().position)
    rng = np.random.default_rng(8)
    # Long enough to reach from before the light to behind it, through its near plane.
    corners = position + rng.normal(size=(5, 3, 3)) * [1.5, 0.6, 1.5]
    scene = Scene([triangles(corners), GROUND], camera(), LIGHTS[light]())
    axis = np.asarray(scene.light.view().world_to_eye).reshape(-1, 4, 4)[0, 2, :3]
    depth = (corners - position) @ -axis
    assert np.mean((depth.min(axis=1) < 0) & (depth.max(axis=1) > 0.1)) > 0.4
    assert_right(scene, trace_visibility_exact(scene, 1), least=0.1)


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", EACH_LIGHT)
def test_points_on_edges_of_a_convex_mesh_are_not_hidden_where_it_faces_the_light(light):
    """Rounded, they lie on either side of both faces of their edge."""
    mesh, rng = library_mesh("sphere", subdivisions=1), np.random.default_rng(1)
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    own = rng.integers(len(faces), size=RESOLUTION[0] * RESOLUTION[1])
    share, corner = rng.choice([0, 0.3, 0.5, 1], len(own))[:, None], rng.integers(3, size=len(own))
    start, end = vertices[faces[own, corner]], vertices[faces[own, (corner + 1) % 3]]
    points = np.float32(start + share * (end - start))
    a, b, c = np.moveaxis(vertices[faces[own]], 1, 0)
    away = LIGHTS[light]()
    lit = np.sum(np.cross(b - a, c - a) * np.asarray(away.towards(jnp.asarray(a, jnp.float32))), axis=1) > 1e-6
    casts = jnp.ones(FACES, bool)
    padded = mesh.padded()
    hidden = hidden_points(padded, casts, away, jnp.asarray(points), jnp.asarray(own, jnp.int32))
    assert 0.1 < lit.mean() < 0.9
    assert not np.asarray(hidden)[lit].any()
    assert np.asarray(hidden)[~lit].mean() > 0.7


def test_points_outside_of_a_frustum_are_lit_and_not_covered():
    card = quad((0, 1.2, 0), (0.6, 0, 0), (0, 0, -0.6))
    shelf = quad((0, 3.5, 0), (0.6, 0, 0), (0, 0, -0.6))
    light = SpotLight((0.0, 2.0, 0.0), (0, -1.0, 0), 35.0, 0.1, 10.0)
    high = PinholeCamera((2.5, 4.5, 5.5), (0, 1.5, 0), fov_y=60.0, near=0.1, far=30.0, resolution=RESOLUTION)
    scene = Scene([card, shelf, GROUND], high, light)
    surface, covered, visibility = found(scene)
    place, face = np.asarray(surface.position), np.asarray(surface.face)
    half = np.tan(np.radians(35.0)) * (2 - place[..., 1])
    inside = (half > 0) & (np.abs(place[..., [0, 2]]).max(axis=-1) < half)
    assert 0.02 < inside[face >= 4].mean() < 0.5
    np.testing.assert_array_equal(covered, inside & (face >= 0))
    # The shelf is behind the light, which sees none of it; the camera sees its upper side.
    assert np.isin([0, 2], face).all()
    lit_side = ~np.isin(face, (2, 3))
    assert (visibility[~covered & lit_side] == 1).all()
    assert np.mean(visibility[covered] == 0) > 0.1


def test_pixels_without_a_surface_are_lit():
    scene = scene_of("box", "spot")
    away = eqx.tree_at(lambda one: one.camera, scene, camera(eye=(1.8, 2.2, 3.0), target=(4.0, 9.0, 9.0)))
    _, covered, visibility = found(away)
    assert not covered.any()
    assert (visibility == 1).all()


def test_a_mesh_that_does_not_cast_hides_nothing():
    card = quad((0, 0.8, 0), (0.5, 0, 0), (0, 0, -0.5))
    shelf = quad((-0.1, 0.4, 0.25), (0.6, 0, 0), (0, 0, -0.6))
    scene = Scene([shelf, card, GROUND], camera(), spot(), casts=(False, True, True))
    surface, _, visibility = found(scene)
    without = found(Scene([quad((0, -9, 0), (1, 0, 0), (0, 0, -1)), card, GROUND], camera(), spot()))
    same = np.asarray(surface.face) == np.asarray(without[0].face)
    assert same.mean() > 0.7
    np.testing.assert_array_equal(visibility[same], without[2][same])
    # It receives the card's shadow.
    on_shelf = np.asarray(surface.face) < 2
    assert 0 < np.mean(visibility[on_shelf & np.asarray(surface.mask)]) < 1


@pytest.mark.exhaustive
def test_a_lamp_on_a_surface_is_not_hidden_by_it():
    """Rounding puts it on either side."""
    tilted = quad((0.1, 1.0, 0.2), (0.7, 0.21, 0.13), (0.11, 0.17, -0.67))
    corners = np.asarray(tilted.vertices, np.float64)
    for share in np.random.default_rng(2).dirichlet(np.ones(3), 6):
        light = PointLight(share @ corners[:3], 0.1, 20.0)
        scene = Scene([tilted, GROUND], camera(), light)
        expected = trace_visibility_exact(scene, 1)
        surface, _, visibility = found(scene)
        on_ground = expected.mask & (expected.face >= 2) & (np.asarray(surface.face) >= 2)
        assert on_ground.mean() > 0.3
        assert expected.visibility[on_ground].all()
        assert visibility[on_ground].all()


def test_more_pixels_give_more_points():
    """The mean over a finer surface's pixels lies between 0 and 1 at outlines."""
    scene = scene_of("card", "spot")
    finer = eqx.tree_at(lambda one: one.camera, scene, eqx.tree_at(lambda c: c.fov_y, scene.camera, jnp.asarray(17.5)))
    wide, narrow = found(scene)[2], found(finer)[2]
    assert narrow.shape == wide.shape
    means = narrow.reshape(24, 2, 32, 2).mean(axis=(1, 3))
    centre = wide[12:36, 16:48]
    assert set(np.unique(means)) > {0, 1}
    assert np.mean(np.abs(means - centre)) < 0.05
    agree = (means == 0) | (means == 1)
    np.testing.assert_array_equal(means[agree], centre[agree])
