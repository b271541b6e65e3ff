"""Cameras, lights and grounds that are found: all casters and their shadows are in the picture, at every size."""

import math

import numpy as np
import pytest
from scenes import marked

from diffshadow import geometry
from diffshadow.geometry import _ground as ground
from diffshadow.geometry._framing import samples_of, sun_for

LENS = geometry.Lens((math.tan(math.radians(20)),) * 2)
ALL = geometry.Wanted(True, True, True)
UP_Y, UP_Z = np.array([0.0, 1, 0]), np.array([0.0, 0, 1])


def corners_of(name, **options):
    mesh = geometry.library_mesh(name, **options)
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]


def moved(corners, *by):
    return corners + np.array(by, float)


def standing(corners):
    return corners - [0, corners[..., 1].min(), 0]


def z_up(corners):
    return np.stack([corners[..., 0], -corners[..., 2], corners[..., 1]], axis=-1)


def room():
    """A box that is seen from inside, with a table in it."""
    return np.concatenate(
        [corners_of("box", size=[6, 3, 5])[:, ::-1], moved(corners_of("box", size=[1, 0.8, 1]), 1, 0, 1)]
    )


def opened():
    sphere = corners_of("sphere", subdivisions=2)
    return sphere[sphere.mean(axis=1)[:, 1] > 0]


SCENES = {
    "closed": lambda: standing(corners_of("torus_knot")),
    "chair": lambda: corners_of("chair"),
    "open": opened,
    "flat": lambda: corners_of("box", size=[1, 0.05, 1]),
    "panel": lambda: corners_of("thin_wall"),
    "with a ground": lambda: np.concatenate([corners_of("chair"), corners_of("plane", size=4.0)]),
}


def found_for(corners, up=UP_Y, camera=None, wanted=ALL):
    return geometry.arrange(corners, geometry.Given(None, camera, LENS, np.ones(len(corners), bool), up), wanted)


def seen(points, camera, up):
    """Where points are in the picture, from -1 to 1 (n, 2)."""
    back = camera.eye - camera.target
    back /= np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    x, y, away = np.stack([right, np.cross(back, right), back]) @ (points - camera.eye).T
    assert (away < 0).all()
    return np.stack([x / -away / LENS.tangents[0], y / -away / LENS.tangents[1]], axis=-1)


@pytest.mark.parametrize("size", marked([0.01, 1.0, 1000.0], [0.01, 1000.0]))
@pytest.mark.parametrize("turn", [lambda c: c, z_up], ids=["y up", "z up"])
@pytest.mark.parametrize("name", SCENES)
def test_casters_and_their_shadows_are_in_the_picture(name, turn, size):
    corners = size * turn(SCENES[name]()) + size * np.array([3.0, -2, 5])
    up = turn(UP_Y)
    found = found_for(corners, up)
    assert not found.is_room
    assert found.has_ground == (name == "with a ground")
    assert (found.plane is None) == found.has_ground
    flat = ground.ground_of((corners - corners.mean(axis=(0, 1))) @ geometry.turn_up(up).T)
    casters = (corners if flat is None else corners[~flat.faces]).reshape(-1, 3)
    height = (corners @ up).min()
    along = found.direction / -(found.direction @ up)
    fallen = casters + (casters @ up - height)[:, None] * along
    assert np.abs(seen(np.concatenate([casters, fallen]), found.camera, up)).max() < 0.9
    assert found.camera.shadow > 0.02
    if found.plane is not None:
        middle, side = found.plane
        assert np.abs(middle @ up - height) <= 2e-3 * size
        assert np.abs(fallen - middle).max() < side / 2 + 2e-3 * size


@pytest.mark.parametrize("size", [0.01, 1000.0])
def test_a_room_is_seen_and_lit_from_inside(size):
    corners = size * room()
    found = found_for(corners)
    assert found.is_room
    assert found.plane is None
    assert found.sun is None
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    for point in (found.camera.eye, found.camera.target, found.lamp[0]):
        assert ((low < point) & (point < high)).all()
    # Seen from outside, the same walls are an object.
    assert not found_for(corners[:, ::-1]).is_room


def test_a_camera_in_a_room_sees_most_of_what_stands_there_and_its_shadows():
    """A sofa in a corner beside the camera that looks across the room from its farthest corner."""
    at = lambda size, *place: moved(corners_of("box", size=list(size)), *place)
    sofa, table, shelf = (
        at((2.2, 0.6, 0.9), -1.8, 0, -1.9),
        at((0.9, 0.4, 0.9), 0.5, 0, 0.3),
        at((0.4, 1.4, 0.4), 2, 0, 1.7),
    )
    stands = np.concatenate([sofa, table, shelf])
    corners = np.concatenate([corners_of("box", size=[6, 3, 5])[:, ::-1], stands])
    found = found_for(corners)
    assert found.is_room
    wide = LENS.tangents[0] / math.tan(math.radians(geometry.ROOM_FOV / 2))
    points = samples_of(stands)
    shown = np.abs(wide * seen(points, found.camera, UP_Y)).max(axis=1) < 1
    assert shown.mean() > 0.75
    assert found.camera.casters > 0.8
    assert found.camera.shadow > 0.55


def hills(trees, size=1.0):
    """A height field of side 8, with closed trees on it, and its height by x and z."""
    x, z = np.meshgrid(*[np.linspace(-4, 4, 25)] * 2, indexing="ij")
    height = lambda x, z: 0.6 * np.sin(x) * np.cos(0.7 * z) + 0.1 * x
    grid = np.stack([x, height(x, z), z], axis=-1)
    a, b, c, d = (grid[i : i + 24 or None, j : j + 24 or None].reshape(-1, 3) for i in (0, 1) for j in (0, 1))
    faces = np.concatenate([np.stack(three, axis=1) for three in ((a, b, c), (b, d, c))])
    places = [(u, v) for u in (-2.2, 0.3, 1.9) for v in (-1.8, 0.9)][:trees]
    parts = [moved(corners_of("box", size=[0.3, 1, 0.3]), u, height(u, v) - 0.1, v) for u, v in places]
    return size * np.concatenate([faces, *parts]), len(faces)


@pytest.mark.parametrize("size", marked([1.0, 100.0], [100.0]))
@pytest.mark.parametrize("trees", [0, 6])
def test_a_height_field_is_its_own_ground(trees, size):
    corners, faces = hills(trees, size)
    found = found_for(corners)
    assert found.has_ground
    assert found.plane is None
    assert not found.is_room
    terrain = ground.height_field_of(corners)
    assert terrain.faces.sum() == faces
    assert terrain.faces[:faces].all()
    points = corners[:faces].mean(axis=1)
    assert np.abs(terrain.under(points) - points[:, 1]).max() < 0.3 * size
    if trees:
        shown = np.abs(seen(corners[faces:].reshape(-1, 3), found.camera, UP_Y)).max()
        assert 0.5 < shown < 0.9
        assert found.sun[1] >= 38


@pytest.mark.parametrize("name", ["closed", "open", "chair", "panel"])
def test_an_object_is_no_height_field(name):
    assert ground.height_field_of(SCENES[name]()) is None


def test_the_gaps_of_a_machine_are_no_room():
    rng, box = np.random.default_rng(1), corners_of("box")
    place = lambda: rng.uniform([-1.4, 0.3, -0.9], [1.4, 1.6, 0.9])
    parts = [box * rng.uniform(0.1, 0.5, 3) + place() for _ in range(300)]
    corners = np.concatenate([corners_of("box", size=[3, 0.2, 2]), *parts])
    assert ground.inside_of(corners) is None
    assert found_for(corners).plane is not None


def test_a_sun_is_found_for_a_camera_that_is_given():
    corners = corners_of("box")
    camera = np.array([0.0, 3, 5]), np.array([0.0, 0, 0])
    found = found_for(corners, camera=camera, wanted=geometry.Wanted(light=True))
    # From behind the camera, the box would hide its shadow.
    assert 50 < abs(found.sun[0]) < 150
    assert found.camera is None


def test_a_ground_is_level_and_larger_than_what_stands_on_it():
    plane, box = corners_of("plane", size=4.0), corners_of("box")
    assert ground.ground_of(np.concatenate([box, plane])).height == 0
    assert ground.ground_of(box) is None
    assert ground.ground_of(plane) is None
    # Floor and walls of the same outline are an object without its lid.
    assert ground.ground_of(corners_of("box", size=[4, 1, 4])[2:]) is None
    assert ground.ground_of(np.concatenate([moved(box, 0, 2, 0), moved(plane, 0, -5, 0)])).height == -5


def test_what_lies_flat_across_z_has_z_up():
    scene = SCENES["with a ground"]()
    assert ground.up_of(scene, True) == "y"
    assert ground.up_of(z_up(scene), True) == "z"
    # A column with a flat foot, under a ball that hides no part of it.
    column = np.concatenate([corners_of("box"), moved(corners_of("sphere", subdivisions=1) * 1.5, 0, 1.5, 0)])
    assert ground.up_of(z_up(column), False) == "z"
    assert ground.up_of(column, False) == "y"
    # A format that has y up by definition is not contradicted by a foot.
    assert ground.up_of(z_up(column), True) == "y"
    assert (ground.stands_on_z(z_up(column)), ground.stands_on_z(column)) == (True, False)
    assert ground.up_of(z_up(SCENES["chair"]()), True) == "y"
    assert ground.up_of(corners_of("sphere", subdivisions=2), False) == "y"


def test_angles_turn_as_their_matrix_does():
    for up in (UP_Z, -UP_Y, np.array([1.0, 0, 0]), np.array([0.3, 0.5, -0.8])):
        turn = geometry.turn_up(up)
        assert np.allclose(turn @ up, [0, np.linalg.norm(up), 0])
        x, y, z = np.radians(geometry.angles_of(turn))
        about = lambda angle, k: np.roll(
            [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]],
            k + 1,
            axis=(0, 1),
        )
        assert np.allclose(about(z, 2) @ about(y, 1) @ about(x, 0), turn, atol=1e-6)


@pytest.mark.parametrize(("tall", "elevations"), [(0.01, {20}), (0.4, {30, 32}), (5.0, {50})])
def test_a_sun_that_is_found_stands_lower_for_flat_casters(tall, elevations):
    """Its shadow is half as long as the caster is wide, 1.37 or 1.28 by azimuth, within 20 to 50 degrees."""
    samples = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 12)] * 3), axis=-1).reshape(-1, 3) * [1, tall, 1]
    azimuth, elevation = sun_for(samples, -tall / 2)
    assert elevation in elevations
    assert abs(azimuth) in (20, 60, 120, 160)
