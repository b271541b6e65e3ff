"""Bevy's shadows against pictures that Bevy drew, and its shaders computed another way in NumPy."""

import dataclasses
import math

import numpy as np
import pytest
from engine_states import agreement, scene_of, surface_of
from golden_engines import engine_golden, engine_goldens
from scenes import marked

from diffshadow.geometry import PinholeCamera, PointLight, Scene, library_mesh
from diffshadow.raster import draw_surface
from diffshadow.shadow import Bevy

pytestmark = pytest.mark.optimized

CASES = engine_goldens("bevy")
ENOUGH, ENOUGH_BY_OWN_MAP = 0.9995, 0.999
SIZE = 64
CAMERA = PinholeCamera((1.9, 1.9, 2.4), (0.05, 0.25, 0.0), fov_y=33, near=0.5, far=20, resolution=(48, 60))
DIRECTION, PLACE = (1.6, -2.8, -1.4), (-1.3, 2.6, 1.2)
SUN = {"maximum_distance": 8.0, "first_cascade_far_bound": 3.3, "minimum_distance": 0.5, "resolution": (SIZE, SIZE)}


def scene(light) -> Scene:
    meshes = [library_mesh("plane", size=3.2), library_mesh("torus", radius=0.4, tube=0.15, segments=24, sides=12)]
    return Scene(meshes, CAMERA, light)


def axes() -> np.ndarray:
    back = -np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    right = np.cross((0, 1, 0), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def slice_of_view(begin: float, end: float) -> np.ndarray:
    """The corners of what the camera sees between two depths, right and below first, in world space."""
    view = np.linalg.inv(np.asarray(CAMERA.view().world_to_eye, np.float64))
    up = math.tan(math.radians(33 / 2))
    signs = [(1, -1), (1, 1), (-1, 1), (-1, -1)]
    points = [(x * up * 1.25 * d, y * up * d, -d, 1) for d in (begin, end) for x, y in signs]
    return (np.array(points) @ view.T)[:, :3]


def window(corners: np.ndarray) -> tuple[np.ndarray, float, float]:
    """The centre of a cascade's near plane in the light's axes, its width, and its depth."""
    width = math.ceil(max(np.linalg.norm(corners[0] - corners[6]), np.linalg.norm(corners[4] - corners[6])))
    across = corners @ axes().T
    low, high = across.min(0), across.max(0)
    texel = width / SIZE
    centre = [math.floor((low[k] + high[k]) / 2 / texel) * texel for k in (0, 1)]
    return np.array([*centre, high[2]]), width, high[2] - low[2]


def compare(depth: np.ndarray, x: float, y: float, z: float) -> float:
    """The texture unit's mean of four compares at (x, y), in texels."""
    i, j = math.floor(x - 0.5), math.floor(y - 0.5)
    a, b = x - 0.5 - i, y - 0.5 - j
    at = lambda k, m: float(z >= depth[min(max(m, 0), SIZE - 1), min(max(k, 0), SIZE - 1)])
    low, high = ((1 - a) * at(i, m) + a * at(i + 1, m) for m in (j, j + 1))
    return (1 - b) * low + b * high


def gaussian(depth: np.ndarray, u: float, v: float, z: float) -> float:
    x, y = u * SIZE, v * SIZE
    base_x, base_y = math.floor(x + 0.5), math.floor(y + 0.5)
    along = []
    for at, base in ((x, base_x), (y, base_y)):
        s = at + 0.5 - base
        weights = (4 - 3 * s, 7, 1 + 3 * s)
        places = ((3 - 2 * s) / weights[0] - 2, (3 + s) / 7, s / weights[2] + 2)
        along.append([(w, base - 0.5 + o) for w, o in zip(weights, places, strict=True)])
    return sum(w * q * compare(depth, px, py, z) for w, px in along[0] for q, py in along[1]) / 144


def seen(technique, light):
    """The state, the surface and its pixels."""
    of = scene(light)
    surface = draw_surface(of.mesh, CAMERA)
    state = technique.prepare(of)
    return state, surface, np.asarray(technique.visibility(state, surface))


def test_under_a_sun_cascades_are_fitted_to_the_view_and_blended():
    technique = Bevy(num_cascades=2, shadow_depth_bias=0.01, shadow_normal_bias=0.4, **SUN)
    state, surface, found = seen(technique, Bevy.directional_light(DIRECTION))
    slices = [window(slice_of_view(0.5, 3.3)), window(slice_of_view(0.8 * 3.3, 8.0))]
    maps, (near_axis, up_axis, back) = np.asarray(state.depth), axes()
    assert maps.shape == (2, SIZE, SIZE)
    eye = np.asarray(CAMERA.view().world_to_eye, np.float64)

    def in_cascade(k: int, point: np.ndarray, normal: np.ndarray) -> float:
        centre, width, deep = slices[k]
        moved = point + 0.01 * back + 0.4 * math.sqrt(2) * width / SIZE * normal
        x, y, z = (float(moved @ axis) for axis in (near_axis, up_axis, back))
        u, v, z = (x - centre[0]) / width + 0.5, (y - centre[1]) / width + 0.5, 1 + (z - centre[2]) / deep
        return gaussian(maps[k], u, v, z) if 0 <= u <= 1 and 0 <= v <= 1 and 0 <= z <= 1 else 1.0

    expected = np.ones_like(found)
    for row, column in zip(*np.nonzero(np.asarray(surface.mask)), strict=True):
        point = np.asarray(surface.position)[row, column].astype(np.float64)
        normal = np.asarray(surface.interpolated_normal)[row, column].astype(np.float64)
        normal /= np.linalg.norm(normal)
        depth = -(eye @ [*point, 1])[2]
        if depth < 3.3:
            expected[row, column] = in_cascade(0, point, normal)
            if depth >= 0.8 * 3.3:
                share = (depth - 0.8 * 3.3) / (0.2 * 3.3)
                expected[row, column] += (in_cascade(1, point, normal) - expected[row, column]) * share
        elif depth < 8:
            expected[row, column] = in_cascade(1, point, normal)
    mask = np.asarray(surface.mask)
    assert 0.02 < (expected < 0.5)[mask].mean() < 0.6
    assert (np.abs(found - expected) <= 1 / 255)[mask].mean() > 0.995


def test_under_a_spot_light_depth_is_reversed_without_an_end():
    technique = Bevy(shadow_depth_bias=0.004, shadow_normal_bias=0.3, resolution=(SIZE, SIZE))
    light = Bevy.spot_light(PLACE, (1.35, -2.6, -1.2), outer_angle=0.45, range=7.0)
    state, surface, found = seen(technique, light)
    depths = np.asarray(state.depth)
    # Near over the distance: the light is about three units away.
    assert 0.1 / 4 < depths[SIZE // 2, SIZE // 2] < 0.1 / 2
    back = -np.array([1.35, -2.6, -1.2]) / np.linalg.norm([1.35, -2.6, -1.2])
    # The axes that the shader makes of the light's direction.
    a = -1 / (1 + back[2])
    right = np.array([1 + back[0] ** 2 * a, back[0] * back[1] * a, -back[0]])
    up = np.array([back[0] * back[1] * a, 1 + back[1] ** 2 * a, -back[1]])
    tangent, expected = math.tan(0.45), np.ones_like(found)
    for row, column in zip(*np.nonzero(np.asarray(surface.mask)), strict=True):
        point = np.asarray(surface.position)[row, column].astype(np.float64)
        normal = np.asarray(surface.interpolated_normal)[row, column].astype(np.float64)
        to_light = np.array(PLACE) - point
        texel = 2 * tangent / SIZE * (to_light @ back)
        moved = -to_light + 0.004 * to_light / np.linalg.norm(to_light)
        moved = moved + 0.3 * math.sqrt(2) * texel * normal / np.linalg.norm(normal)
        z = -(moved @ back)
        u, v = (0.5 + 0.5 * (moved @ axis) / (z * tangent) for axis in (right, up))
        expected[row, column] = gaussian(depths, u, v, 0.1 / z)
    mask = np.asarray(surface.mask)
    assert 0.05 < (expected < 0.5)[mask].mean() < 0.6
    assert (np.abs(found - expected) <= 1 / 255)[mask].mean() > 0.995


def test_a_caster_before_the_first_cascade_is_flattened():
    technique, light = Bevy(num_cascades=1, **SUN), Bevy.directional_light(DIRECTION)
    ground, blocker = library_mesh("plane", size=3.2), library_mesh("plane", size=1.6)
    # Towards the light, before all that the camera sees.
    far_up = dataclasses.replace(blocker, vertices=blocker.vertices - 10 * np.float32(DIRECTION))
    state = technique.prepare(Scene([ground, far_up], CAMERA, light))
    surface = draw_surface(ground, CAMERA)
    lit = np.asarray(technique.visibility(state, surface))
    assert float(state.depth.max()) == 1
    at = np.abs(np.asarray(surface.position)[..., [0, 2]]).max(axis=-1)
    assert (lit[np.asarray(surface.mask) & (at < 0.15)] < 0.1).all()
    assert (lit[np.asarray(surface.mask) & (at > 1.3)] > 0.9).mean() > 0.9


def test_a_map_has_the_size_that_the_engine_gives_it():
    with pytest.raises(ValueError, match=r"Bevy.resolution is \(160, 160\); expected a power of two, .* sizes up: 256"):
        Bevy(resolution=(160, 160))


def test_a_point_light_is_refused():
    with pytest.raises(ValueError, match="PointLight; expected a directional, spot or matrix light"):
        Bevy(resolution=(SIZE, SIZE)).prepare(scene(PointLight((0, 2, 0), 0.1, 9.0)))


# --- Pictures that Bevy drew ---


def preset(golden) -> Bevy:
    """The engine's settings."""
    given = golden.settings["light"]
    kept = {name: given[name] for name in Bevy.settings.each() if name in given and name != "type"}
    size = golden.settings["mapSize"]
    method = golden.settings["filter"]
    return Bevy(**kept, shadow_filtering_method=method, side="double", resolution=(size, size))


def scene_in(golden) -> Scene:
    given = golden.settings["light"]
    if given["type"] == "directional":
        return scene_of(golden, Bevy.directional_light(given["direction"]))
    cone = {name: given[name] for name in ("range", "outer_angle", "shadow_map_near_z")}
    return scene_of(golden, Bevy.spot_light(given["position"], given["direction"], **cone))


def from_read_back(golden, technique) -> float:
    """The agreement from the engine's own map."""
    rows, size = golden.arrays["map"].shape
    stored = golden.arrays["map"].reshape(*(() if rows == size else (-1,)), size, size)
    state = technique.from_map(stored, scene_in(golden))
    return agreement(golden, technique.visibility(state, surface_of(golden)))


def from_own_map(golden, technique) -> float:
    return agreement(golden, technique.visibility(technique.prepare(scene_in(golden)), surface_of(golden)))


FIRST = ("directional_two_cascades", "spot_low")
"""Those that are compared in every run of the tests."""


@pytest.mark.parametrize("name", marked(CASES, set(CASES) - set(FIRST)))
def test_both_maps_give_the_engines_picture(name):
    golden = engine_golden("bevy", name)
    technique = preset(golden)
    assert from_read_back(golden, technique) >= ENOUGH
    assert from_own_map(golden, technique) >= ENOUGH_BY_OWN_MAP


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["directional_low", "directional_two_cascades", "spot_low"])
@pytest.mark.parametrize("key", ["shadow_depth_bias", "shadow_normal_bias"])
def test_a_setting_that_is_off_by_a_tenth_is_seen(name, key):
    golden = engine_golden("bevy", name)
    technique = preset(golden)
    for factor in (0.9, 1.1):
        wrong = dataclasses.replace(technique, **{key: getattr(technique, key) * factor})
        assert from_own_map(golden, wrong) < 0.99
